// Stage: the room in 3-D, and beside it what the shapes mean.

import { Group, Matrix4 } from "three";
import { el, setText } from "../dom";
import { BODY_LOOKS, BodyFigure, STANDS_LOOK } from "../scene/body";
import { FieldScene } from "../scene/field";
import { Scene, quaternion, vector } from "../scene/scene";
import { Screws } from "../scene/screws";
import { transmitter } from "../scene/transmitter";
import { LOOKS, Sensors } from "../scene/sensors";
import type { Axis } from "../scene/slice";
import { Truth } from "../scene/truth";
import type { FigureMessage, Hello, Pose, SensorState } from "../protocol";
import type { Context, View } from "../view";

/** Where the legend would hide half of the room. */
const NARROW = "(max-width: 60rem)";

/** So far from where it was calibrated a sensor has been moved; below it, a pose was held as people hold it, degrees. */
const TURNED_DEG = 15;

export class StageView implements View {
  readonly id = "stage-view";
  readonly title = "Stage";
  readonly element = el("div");
  private readonly summary = el("p", { id: "summary" });
  private readonly bodySummary = el("p", { id: "body-summary" });
  private scene: Scene | null = null;
  private readonly sensors = new Sensors();
  /** Everybody, by name. */
  private readonly figures = new Map<string, BodyFigure>();
  private readonly everybody = new Group();
  private readonly truth = new Truth();
  private readonly screws = new Screws();
  private readonly transmitter: Group = transmitter();
  private readonly field = new FieldScene();
  private readonly arrowsLabel = el("span", { id: "field-arrows" });
  private readonly sliceAxis = el("select", { id: "slice-axis", "aria-label": "Slice across the transmitter's axis" },
    ...["x", "y", "z"].map((axis, value) => el("option", { value, selected: axis === "z" }, `across ${axis}`)));
  private readonly slicePlace = el("input", { type: "range", id: "slice-place", min: 0, max: 1, step: "any", value: 0.5, "aria-label": "Where the slice is" });
  private readonly sliceSays = el("output", { id: "slice", for: "slice-place" });
  private readonly toTransmitter = new Matrix4();
  private drawn = -1;

  constructor(private readonly context: Context) {
    try {
      this.scene = new Scene("the room with its sensors and the body; the tables under Health and the curves under Analysis say the same in numbers");
    } catch {
      this.element.append(el("p", {}, "This browser has no WebGL, which the picture needs. Health shows the same in numbers."));
      return;
    }
    this.transmitter.add(this.field.group);
    // So that the switch hides what a message would show.
    this.scene.scene.add(this.transmitter, this.sensors.group, this.everybody, this.truth.group, this.screws.group);
    context.model.listen((message) => {
      if (message.type === "hello") {
        this.introduce(message);
        this.placeTransmitter(message.transmitter);
        this.field.forget();
        this.screws.forget();
        this.cut();
      } else if (message.type === "sensors") {
        this.sensors.trails.extend(message);
      } else if (message.type === "keyframes") {
        if (message.screw) this.screws.take(message.sensor, message.screw);
      } else if (message.type === "field") {
        if (message.event === "model_swapped" && message.model.kind === "transmitter") this.placeTransmitter(message.model);
        this.field.take(message);
        if (message.event === "map_swapped") this.cut();
      }
    });
    this.sliceAxis.addEventListener("change", () => this.cut());
    this.slicePlace.addEventListener("input", () => this.cut());
    const legend = [...LOOKS, ...Object.values(BODY_LOOKS), STANDS_LOOK].map(({ sign, words, colour }) => {
      const mark = el("span", {}, `${sign} `);
      mark.style.color = `#${colour.toString(16).padStart(6, "0")}`;
      return el("li", {}, mark, words);
    });
    const layer = (words: string, group: { visible: boolean }, on: boolean, changed = () => {}) => {
      group.visible = on;
      const box = el("input", { type: "checkbox", checked: on });
      box.addEventListener("change", () => {
        group.visible = box.checked;
        changed();
        this.drawn = -1;
      });
      return el("label", {}, box, ` ${words}`);
    };
    this.element.append(
      this.scene.canvas,
      el("aside", {}, el("details", { open: !matchMedia(NARROW).matches }, el("summary", {}, "Sensors and layers"), this.summary, this.bodySummary,
        layer("body", this.everybody, true),
        layer("names", this.sensors.labels.group, true),
        layer("trails", this.sensors.trails.group, true),
        layer("uncertainty, two sigma", this.sensors.sigma, true),
        layer("truth of the simulation", this.truth.group, true),
        layer("screws between key poses", this.screws.group, true),
        layer("corrections, from where the tracker said", this.field.corrections, true),
        layer("what the map of the field does", this.field.arrows, true), this.arrowsLabel,
        layer("a slice through it", this.field.slice.group, false, () => this.cut()), this.sliceAxis, this.slicePlace, this.sliceSays,
        el("button", { onclick: () => this.scene?.reset() }, "Camera back"),
        el("ul", { class: "legend", "aria-label": "What the shapes mean" }, ...legend))),
    );
  }

  /** A figure for each of the stage's bodies. */
  private introduce({ bodies }: Hello): void {
    this.everybody.clear();
    for (const { name, color } of bodies) {
      // Whom a connection before has shown already: what is drawn takes memory of the graphics.
      const figure = this.figures.get(name) ?? new BodyFigure();
      figure.paint(color);
      this.figures.set(name, figure);
      this.everybody.add(figure.group);
    }
  }

  private drawBodies(bodies: ReadonlyMap<string, FigureMessage>): void {
    const { hello } = this.context.model;
    const said = (hello?.bodies ?? []).flatMap(({ name, height_m }) => {
      const body = bodies.get(name);
      if (body === undefined) return [];
      this.figures.get(name)?.update(body, height_m);
      return [`${hello!.bodies.length > 1 ? name : "body"}: ${this.words(body)}`];
    });
    setText(this.bodySummary, said.join("\n"));
  }

  private words(body: FigureMessage): string {
    const good = body.segments.filter(({ state }) => state === "ok").length;
    // Head, hands and feet that wear nothing are not counted.
    const worn = body.segments.filter(({ sensor, state }) => sensor !== null || state === "missing").length;
    const heading = body.heading === "held" ? `, heading held for ${body.heading_held_s.toFixed(0)} s (± ${(2 * (body.heading_sigma_deg ?? 180)).toFixed(0)}°)` : "";
    const place = { trackers: "", feet: `, place by its feet (± ${(200 * (body.position_sigma_m ?? 0)).toFixed(0)} cm)`, held: ", place as last seen", origin: ", place not known" }[body.position_source];
    // A strap that slipped, or a pose that was not held: as far as the limb's movements have shown it since.
    const moved = body.segments.flatMap(({ name, learnt }) => learnt != null && learnt.turned_deg > TURNED_DEG
      ? [`, ${name}'s sensor sits ${learnt.turned_deg.toFixed(0)}° otherwise than calibrated (± ${(2 * learnt.mounting_sigma_deg).toFixed(0)}°)`]
      : []);
    return `${good} of ${worn} segments measured${heading}${place}${moved.join("")}`;
  }

  /** The slice where the operator wants it. */
  private cut(): void {
    const { slice } = this.field;
    const axis = Number(this.sliceAxis.value) as Axis;
    const place_m = slice.cut(axis, Number(this.slicePlace.value));
    const shown = slice.hasMap && slice.group.visible;
    this.sliceAxis.hidden = this.slicePlace.hidden = this.sliceSays.hidden = !shown;
    setText(this.sliceSays, shown
      ? `at ${"xyz"[axis]} = ${place_m.toFixed(2)} m from the transmitter; dark 0, bright ${(1000 * slice.longest_m).toFixed(1)} mm`
      : "");
    this.drawn = -1;
  }

  private placeTransmitter({ position_m, orientation_wxyz }: Pose): void {
    vector(position_m, this.transmitter.position);
    quaternion(orientation_wxyz, this.transmitter.quaternion);
    this.drawn = -1;
  }

  shown(): void {
    this.drawn = -1;
  }

  draw(): void {
    const { model } = this.context;
    const changed = this.drawn !== model.version;
    this.drawn = model.version;
    if (changed && model.sensors) {
      this.sensors.update(model.sensors.sensors);
      const { sensors, fault } = model.sensors;
      this.transmitter.updateMatrixWorld();
      this.field.update(sensors, this.toTransmitter.copy(this.transmitter.matrixWorld).invert());
      const count = (...states: SensorState[]) => sensors.filter(({ state }) => states.includes(state)).length;
      const outside = count("extrapolated");
      setText(this.summary, `${count("ok", "repaired")} of ${sensors.length} are good`
        + (this.field.hasMap ? `, corrected by the map${outside ? `; ${outside} outside of it` : ""}` : "")
        + (fault && fault.label !== "clean" ? `; the frame is ${fault.label}` : ""));
      setText(this.arrowsLabel, this.field.hasMap ? `arrows ${this.field.magnified.toFixed(0)} times as long` : "");
    }
    if (changed && model.bodies.size > 0) this.drawBodies(model.bodies);
    if (changed && model.truth) this.truth.update(model.truth);
    this.scene?.render(changed);
  }
}
