// The stage in 3-D: all that is there, in layers; the camera's places; what is chosen and measured.

import * as THREE from "three";
import type { Model } from "../model";
import type { Hello, Pose, ServerMessage } from "../protocol";
import { Afterimages } from "./afterimages";
import { BodyFigure } from "./body";
import { FieldScene } from "./field";
import { Marking } from "./measure";
import { shadow } from "./room";
import { Scene, quaternion, vector } from "./scene";
import { Screws } from "./screws";
import { Sensors } from "./sensors";
import { transmitter } from "./transmitter";
import { Truth } from "./truth";

export const LAYERS = ["body", "names", "trails", "ghosts", "sigma", "truth", "screws", "corrections", "arrows", "slice"] as const;
export type Layer = (typeof LAYERS)[number];
export const CAMERAS = ["home", "front", "side", "top"] as const;
export type CameraPlace = (typeof CAMERAS)[number];

/** So far from a sensor, in pixels, somebody may press who means it. */
const NEAR_PX = 22;
/** How far the camera stands, and how high the middle of the picture is where nobody is there, m. */
const AWAY_M = 3.1;
const MIDDLE_M = 0.92;
/** How long a room without anybody or anything waits to be drawn, ms: where the processor draws, it would hold up the first picture. */
const EMPTY_MS = 1500;
/** Width by height of a picture that a person with arms spread fills. */
const NARROW = 0.75;

export class StageScene {
  readonly scene: Scene;
  readonly field = new FieldScene();
  readonly layers: Record<Layer, { visible: boolean }>;
  follows = false;
  private readonly sensors = new Sensors();
  /** Everybody, by name. */
  private readonly figures = new Map<string, BodyFigure>();
  private readonly shadows = new Map<string, THREE.Mesh>();
  private readonly everybody = new THREE.Group();
  private readonly truth = new Truth();
  private readonly screws = new Screws();
  private readonly transmitter = transmitter();
  private readonly ghosts = new Afterimages();
  private readonly marking = new Marking();
  /** People of another recording. */
  private readonly others: BodyFigure[] = [];
  private readonly toTransmitter = new THREE.Matrix4();
  private readonly hips = new THREE.Vector3();
  private readonly at = new THREE.Vector3();
  private changed = true;
  private readonly emptyFromMs = performance.now() + EMPTY_MS;

  /** Throws where the browser has no WebGL. */
  constructor(private readonly model: Model, says: string) {
    this.scene = new Scene(says);
    this.transmitter.add(this.field.group);
    // So that a layer hides what a message would show.
    this.scene.scene.add(this.transmitter, this.sensors.group, this.everybody, this.truth.group, this.screws.group, this.ghosts.group, this.marking.group);
    this.layers = {
      body: this.everybody, names: this.sensors.labels.group, trails: this.sensors.trails.group, ghosts: this.ghosts.group, sigma: this.sensors.sigma,
      truth: this.truth.group, screws: this.screws.group, corrections: this.field.corrections, arrows: this.field.arrows, slice: this.field.slice.group,
    };
    this.camera("home");
    model.listen((message) => this.take(message));
    // What came before this was made.
    if (model.hello) this.introduce(model.hello);
    if (model.transmitter) this.placeTransmitter(model.transmitter);
    if (model.fieldMap) this.field.take(model.fieldMap);
    for (const [sensor, screw] of model.screws) this.screws.take(sensor, screw);
  }

  /** Draws anew, whatever came. */
  touch(): void {
    this.changed = true;
  }

  /** Light or dark has changed. */
  recolour(): void {
    this.sensors.recolour();
    this.touch();
  }

  /** Puts the camera somewhere, as the person stands. */
  camera(place: CameraPlace): void {
    const figure = this.figures.get(this.model.person ?? "");
    const [hips, facing] = figure?.group.visible ? [figure.hips, figure.facing] : [new THREE.Vector3(0.45, -0.05, MIDDLE_M), Math.PI];
    const at = new THREE.Vector3(hips.x, hips.y, MIDDLE_M);
    const ahead = (turn: number, away_m: number, up_m: number) => new THREE.Vector3(Math.cos(facing + turn) * away_m, Math.sin(facing + turn) * away_m, up_m).add(at);
    const from = {
      home: () => new THREE.Vector3(-1.75, -1.5, 0.8).add(at),
      front: () => ahead(0, AWAY_M, 0.1), side: () => ahead(-Math.PI / 2, AWAY_M, 0.1),
      top: () => ahead(Math.PI, 0.02, AWAY_M + 0.6),
    }[place]();
    // Whoever is in it fits a narrow picture too.
    this.scene.look(from.sub(at).multiplyScalar(Math.max(1, NARROW / this.scene.aspect)).add(at), at);
    this.touch();
  }

  /** The sensor at a place of the picture, in pixels from its upper left corner. */
  pick(x: number, y: number): string | null {
    const { clientWidth, clientHeight } = this.scene.canvas;
    const { camera } = this.scene;
    let [nearest, name]: [number, string | null] = [NEAR_PX, null];
    for (const sensor of this.model.seenSensors ?? []) {
      if (!sensor.position_m) continue;
      vector(sensor.position_m, this.at).project(camera);
      const away = Math.hypot(((this.at.x + 1) / 2) * clientWidth - x, ((1 - this.at.y) / 2) * clientHeight - y);
      if (this.at.z < 1 && away < nearest) [nearest, name] = [away, sensor.name];
    }
    if (name !== null || !this.everybody.visible) return name;
    const ray = new THREE.Raycaster();
    ray.setFromCamera(new THREE.Vector2((2 * x) / clientWidth - 1, 1 - (2 * y) / clientHeight), camera);
    const hits = [...this.figures].flatMap(([body, figure]) => {
      const hit = figure.group.visible ? figure.hit(ray) : null;
      return hit ? [{ body, ...hit }] : [];
    });
    const first = hits.sort((a, b) => a.distance - b.distance)[0];
    return first ? (this.model.bodies.get(first.body)?.segments.find(({ name: segment }) => segment === first.segment)?.sensor ?? null) : null;
  }

  /** Draws what has come; the distance that is measured, m. */
  draw(chosen: string | null, measured: readonly [string, string] | null): number | null {
    const { model } = this;
    const sensors = model.seenSensors;
    if (sensors) {
      this.sensors.update(sensors);
      this.transmitter.updateMatrixWorld();
      this.field.update(sensors, this.toTransmitter.copy(this.transmitter.matrixWorld).invert());
    }
    this.drawBodies(chosen);
    this.drawOthers();
    if (model.truth) this.truth.update(model.truth);
    const ends = measured?.map((name) => this.place(name, new THREE.Vector3()));
    const distance_m = this.marking.measure(ends?.[0] && ends[1] ? [ends[0], ends[1]] : null);
    this.marking.choose(chosen === null ? null : this.sensors.place(chosen, this.at), this.scene.camera);
    this.touch();
    return distance_m;
  }

  /** Once per picture. */
  render(): void {
    if (!this.model.seenSensors && this.model.bodies.size === 0 && performance.now() < this.emptyFromMs) return;
    this.scene.render(this.changed);
    this.changed = false;
  }

  /** The picture as a PNG, on the colour of the page. */
  snapshot(ground: string): Promise<Blob> {
    const { canvas } = this.scene;
    const copy = document.createElement("canvas");
    [copy.width, copy.height] = [canvas.width, canvas.height];
    const draw = copy.getContext("2d")!;
    draw.fillStyle = ground;
    draw.fillRect(0, 0, copy.width, copy.height);
    draw.drawImage(canvas, 0, 0);
    return new Promise((resolve, reject) => copy.toBlob((blob) => (blob ? resolve(blob) : reject(new Error("no picture"))), "image/png"));
  }

  private take(message: ServerMessage): void {
    switch (message.type) {
      case "hello":
        this.introduce(message);
        this.field.forget();
        this.screws.forget();
        break;
      case "sensors":
        this.sensors.trails.extend(message);
        break;
      case "body":
        if (message.name === this.model.person) this.ghosts.take(message);
        break;
      case "keyframes":
        if (message.screw) this.screws.take(message.sensor, message.screw);
        break;
      case "field":
        if (message.event === "model_swapped" && message.model.kind === "transmitter") this.placeTransmitter(message.model);
        this.field.take(message);
        this.touch();
        break;
    }
  }

  /** A figure for each of the stage's bodies. */
  private introduce({ bodies, transmitter }: Hello): void {
    this.everybody.clear();
    for (const { name, color } of bodies) {
      // Whom a connection before has shown already: what is drawn takes memory of the graphics.
      const figure = this.figures.get(name) ?? new BodyFigure();
      const dark = this.shadows.get(name) ?? shadow(0.35);
      figure.paint(color);
      dark.visible = figure.group.visible;
      this.figures.set(name, figure);
      this.shadows.set(name, dark);
      this.everybody.add(figure.group, dark);
    }
    this.placeTransmitter(transmitter);
  }

  private placeTransmitter({ position_m, orientation_wxyz }: Pose): void {
    vector(position_m, this.transmitter.position);
    quaternion(orientation_wxyz, this.transmitter.quaternion);
    this.touch();
  }

  private drawBodies(chosen: string | null): void {
    const { model } = this;
    for (const { name, height_m } of model.hello?.bodies ?? []) {
      const [body, figure, dark] = [model.seenBody(name), this.figures.get(name), this.shadows.get(name)];
      if (!body || !figure || !dark) continue;
      // Which sensor a segment wears is not in what is looked at.
      figure.choose((model.bodies.get(name)?.segments ?? []).find(({ sensor }) => chosen !== null && sensor === chosen)?.name ?? null);
      const before = figure.group.visible;
      figure.update(body, height_m);
      dark.visible = true;
      dark.position.set(figure.hips.x, figure.hips.y, 0.003);
      if (name !== model.person) continue;
      if (!before) this.camera("home");
      if (this.ghosts.group.visible) this.ghosts.draw(height_m);
      if (this.follows && before) this.scene.shift(this.at.subVectors(figure.hips, this.hips).setZ(0));
      this.hips.copy(figure.hips);
    }
  }

  private drawOthers(): void {
    const { beside, looked } = this.model;
    while (this.others.length < beside.length) {
      const figure = new BodyFigure("ghost");
      this.others.push(figure);
      this.scene.scene.add(figure.group);
    }
    this.others.forEach((figure, i) => {
      const body = beside[i];
      if (body) figure.update(body, looked?.height_m ?? null);
      else figure.group.visible = false;
    });
  }

  /** Where a sensor is, or the segment that it sits on. */
  private place(name: string, into: THREE.Vector3): THREE.Vector3 | null {
    const own = this.sensors.place(name, into);
    if (own) return own;
    for (const [body, figure] of this.figures) {
      const segment = this.model.bodies.get(body)?.segments.find(({ sensor }) => sensor === name);
      if (segment) return figure.middle(segment.name, into);
    }
    return null;
  }
}
