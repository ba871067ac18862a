// A slice through what a map of the field does: on a plane of the transmitter's frame the length of the correction, as colour.

import * as THREE from "three";
import type { Vec3 } from "../protocol";

/** Dark blue over teal to yellow: brightness alone tells it too. */
const RAMP = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]] as const;
const OPACITY = 0.75;

/** Which axis of the transmitter the plane stands across: 0, 1, 2 for x, y, z. */
export type Axis = 0 | 1 | 2;

export class FieldSlice {
  readonly group = new THREE.Group();
  /** The longest correction, which the ramp ends with, m. */
  longest_m = 0;
  private readonly plane: THREE.Mesh<THREE.PlaneGeometry, THREE.MeshBasicMaterial>;
  private texture: THREE.DataTexture | null = null;
  /** Corrections by place in the grid; NaN outside of the map. */
  private lengths_m = new Float64Array(0);
  private counts: Vec3 = [0, 0, 0];
  private origin_m: Vec3 = [0, 0, 0];
  private step_m = 1;

  constructor() {
    const material = new THREE.MeshBasicMaterial({ transparent: true, opacity: OPACITY, side: THREE.DoubleSide, depthWrite: false });
    this.plane = new THREE.Mesh(new THREE.PlaneGeometry(1, 1), material);
    this.plane.matrixAutoUpdate = false;
    this.plane.visible = false;
    this.group.add(this.plane);
  }

  get hasMap(): boolean {
    return this.lengths_m.length > 0;
  }

  /** Pairs of a reading, on a regular grid, and its corrected place, m; none: no map. */
  take(arrows: [Vec3, Vec3][]): void {
    const along = ([0, 1, 2] as const).map((axis) => [...new Set(arrows.map(([from]) => from[axis]))].sort((a, b) => a - b));
    const steps = along.flatMap((places) => places.slice(1).map((place, i) => place - places[i]!)).filter((step) => step > 0.01);
    this.plane.visible = false;
    this.lengths_m = new Float64Array(0);
    this.longest_m = 0;
    if (steps.length === 0) return;
    this.step_m = Math.min(...steps);
    this.origin_m = along.map((places) => places[0]!) as Vec3;
    this.counts = along.map((places) => Math.round((places[places.length - 1]! - places[0]!) / this.step_m) + 1) as Vec3;
    this.lengths_m = new Float64Array(this.counts[0] * this.counts[1] * this.counts[2]).fill(NaN);
    for (const [from, to] of arrows) {
      const cell = from.map((place, axis) => Math.round((place - this.origin_m[axis]!) / this.step_m)) as Vec3;
      const length_m = Math.hypot(to[0] - from[0], to[1] - from[1], to[2] - from[2]);
      this.lengths_m[this.index(cell)] = length_m;
      this.longest_m = Math.max(this.longest_m, length_m);
    }
  }

  /** Puts the plane across an axis, at a share of its way from 0 to 1; where that is on the axis, m. */
  cut(axis: Axis, share: number): number {
    const [u, v] = [(axis + 1) % 3, (axis + 2) % 3] as [Axis, Axis];
    const [columns, rows] = [this.counts[u], this.counts[v]];
    const layer = share * (this.counts[axis] - 1);
    const place_m = this.origin_m[axis] + layer * this.step_m;
    this.plane.visible = this.hasMap;
    if (!this.hasMap) return place_m;
    const pixels = new Uint8Array(4 * columns * rows);
    for (let row = 0; row < rows; row++) {
      for (let column = 0; column < columns; column++) {
        const length_m = this.between(axis, u, column, v, row, layer);
        pixels.set([...colour(length_m / this.longest_m), Number.isNaN(length_m) ? 0 : 255], 4 * (row * columns + column));
      }
    }
    this.texture?.dispose();
    this.texture = new THREE.DataTexture(pixels, columns, rows);
    this.texture.colorSpace = THREE.SRGBColorSpace;
    this.texture.magFilter = THREE.LinearFilter;
    this.texture.needsUpdate = true;
    this.plane.material.map = this.texture;
    this.plane.material.needsUpdate = true;
    const unit = (of: Axis) => new THREE.Vector3().setComponent(of, 1);
    const centre = new THREE.Vector3().setComponent(axis, place_m);
    for (const [of, count] of [[u, columns], [v, rows]] as const) {
      centre.setComponent(of, this.origin_m[of] + ((count - 1) * this.step_m) / 2);
    }
    this.plane.matrix.makeBasis(unit(u), unit(v), unit(axis))
      .scale(new THREE.Vector3(columns * this.step_m, rows * this.step_m, 1))
      .setPosition(centre);
    return place_m;
  }

  /** Between two layers of the grid; at the border of the map the layer that knows, if it is the nearer one. */
  private between(axis: Axis, u: Axis, column: number, v: Axis, row: number, layer: number): number {
    const cell: Vec3 = [0, 0, 0];
    [cell[u], cell[v], cell[axis]] = [column, row, Math.floor(layer)];
    const below = this.lengths_m[this.index(cell)]!;
    const part = layer - cell[axis];
    cell[axis] = Math.min(cell[axis] + 1, this.counts[axis] - 1);
    const above = this.lengths_m[this.index(cell)]!;
    if (!Number.isNaN(below) && !Number.isNaN(above)) return below + part * (above - below);
    return part < 0.5 ? below : above;
  }

  private index([x, y, z]: Vec3): number {
    return x + this.counts[0] * (y + this.counts[1] * z);
  }
}

/** The ramp at a share from 0 to 1. */
function colour(share: number): [number, number, number] {
  const at = Math.min(Math.max(share || 0, 0), 1) * (RAMP.length - 1);
  const first = Math.min(Math.floor(at), RAMP.length - 2);
  return [0, 1, 2].map((c) => Math.round(RAMP[first]![c]! + (at - first) * (RAMP[first + 1]![c]! - RAMP[first]![c]!))) as [number, number, number];
}
