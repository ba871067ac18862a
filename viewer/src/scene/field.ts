// The field in 3-D: what the map in use does, where the pole has not been, and where the tracker said that sensors are.
// All of it in the transmitter's frame: the group rides on the transmitter.

import * as THREE from "three";
import type { FieldEventMessage, SensorEntry, Vec3 } from "../protocol";
import { vector } from "./scene";
import { finish, instanced, segments } from "./buffers";
import { FieldSlice } from "./slice";

/** The longest arrow is drawn this long, m, whatever its true length. */
const LONGEST_M = 0.12;
const CELL_M = 0.06;
const MOST_CELLS = 64;

export class FieldScene {
  readonly group = new THREE.Group();
  readonly arrows = new THREE.Group();
  readonly corrections = new THREE.Group();
  readonly slice = new FieldSlice();
  /** How many times longer than true the arrows are. */
  magnified = 1;
  /** Whether a map is in use. */
  hasMap = false;
  private readonly cells = instanced(new THREE.BoxGeometry(CELL_M, CELL_M, CELL_M),
    new THREE.MeshBasicMaterial({ color: 0xd98e04, transparent: true, opacity: 0.35, depthWrite: false }), MOST_CELLS);
  private lines: THREE.LineSegments | null = null;
  private moved: THREE.LineSegments | null = null;
  private capacity = 0;
  private readonly from = new THREE.Vector3();
  private readonly to = new THREE.Vector3();
  private readonly matrix = new THREE.Matrix4();

  constructor() {
    finish(this.cells, 0);
    this.group.add(this.arrows, this.corrections, this.cells, this.slice.group);
  }

  take(message: FieldEventMessage): void {
    if (message.event === "map_swapped") {
      this.hasMap = message.map !== null;
      this.draw(message.arrows_m as [Vec3, Vec3][]);
    } else if (message.event === "calibrating") {
      const { collecting, unvisited_m } = message.progress;
      const places = collecting ? unvisited_m.slice(0, MOST_CELLS) : [];
      places.forEach((place, index) => {
        vector(place as Vec3, this.from);
        this.cells.setMatrixAt(index, this.matrix.makeTranslation(this.from));
      });
      finish(this.cells, places.length);
    }
  }

  forget(): void {
    this.hasMap = false;
    this.draw([]);
    finish(this.cells, 0);
  }

  /** A line from where the tracker said that a sensor is to where the map puts it. `inverse`: room to transmitter. */
  update(sensors: SensorEntry[], inverse: THREE.Matrix4): void {
    if (sensors.length > this.capacity) {
      this.capacity = sensors.length;
      this.corrections.clear();
      this.moved = segments(2 * this.capacity, new THREE.LineBasicMaterial({ color: 0xc2407a }));
      this.corrections.add(this.moved);
    }
    if (!this.moved) return;
    const points = this.moved.geometry.getAttribute("position") as THREE.BufferAttribute;
    let vertex = 0;
    for (const { measured, position_m } of this.hasMap ? sensors : []) {
      if (!measured?.position_m || !position_m) continue;
      vector(measured.position_m, this.from);
      vector(position_m, this.to).applyMatrix4(inverse);
      points.setXYZ(vertex++, this.from.x, this.from.y, this.from.z);
      points.setXYZ(vertex++, this.to.x, this.to.y, this.to.z);
    }
    this.moved.geometry.setDrawRange(0, vertex);
    points.needsUpdate = true;
  }

  private draw(arrows: [Vec3, Vec3][]): void {
    this.slice.take(arrows);
    for (const old of this.arrows.children) (old as THREE.LineSegments).geometry.dispose();
    this.arrows.clear();
    const length = ([a, b]: [Vec3, Vec3]) => Math.hypot(b[0] - a[0], b[1] - a[1], b[2] - a[2]);
    const longest = Math.max(1e-6, ...arrows.map(length));
    this.magnified = LONGEST_M / longest;
    if (arrows.length === 0) return;
    // A shaft, and a cross at its foot, so that its direction is visible.
    this.lines = segments(arrows.length * 4, new THREE.LineBasicMaterial({ vertexColors: true }));
    const points = this.lines.geometry.getAttribute("position") as THREE.BufferAttribute;
    const colours: number[] = [];
    const colour = new THREE.Color();
    arrows.forEach((arrow, index) => {
      vector(arrow[0], this.from);
      vector(arrow[1], this.to).sub(this.from).multiplyScalar(this.magnified).add(this.from);
      points.setXYZ(4 * index, this.from.x, this.from.y, this.from.z);
      points.setXYZ(4 * index + 1, this.to.x, this.to.y, this.to.z);
      points.setXYZ(4 * index + 2, this.from.x - 0.008, this.from.y, this.from.z);
      points.setXYZ(4 * index + 3, this.from.x + 0.008, this.from.y, this.from.z);
      // From teal over amber to red with its length.
      colour.setHSL(0.5 * (1 - length(arrow) / longest), 0.75, 0.42);
      for (let end = 0; end < 4; end++) colours.push(colour.r, colour.g, colour.b);
    });
    points.needsUpdate = true;
    this.lines.geometry.setAttribute("color", new THREE.Float32BufferAttribute(colours, 3));
    this.arrows.add(this.lines);
  }
}
