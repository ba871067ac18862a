// How an exercise was taught: a see-through figure that repeats it beside the person, and looks where the person looks.

import { Group, Vector3 } from "three";
import type { Demonstration } from "../protocol";
import { BodyFigure } from "./body";

/** How far it stands at the person's left hand, m. */
const BESIDE_M = 0.95;
/** How long it rests between two repetitions, s. */
const REST_S = 0.8;

export class Ghost {
  readonly group = new Group();
  private readonly figure = new BodyFigure("ghost");
  private shown: Demonstration | null = null;
  private begun_ms = 0;
  private frame = -1;

  constructor() {
    this.group.add(this.figure.group);
    this.group.visible = false;
  }

  /** Nobody where there is no demonstration. */
  show(demonstration: Demonstration | null): void {
    this.shown = demonstration;
    this.group.visible = demonstration !== null;
    this.begun_ms = performance.now();
    this.frame = -1;
  }

  /** From the person's hips to its own, level. */
  static beside(facing: number): Vector3 {
    return new Vector3(Math.cos(facing + Math.PI / 2), Math.sin(facing + Math.PI / 2), 0).multiplyScalar(BESIDE_M);
  }

  /** Goes on; whether it looks another way than before. */
  draw(now_ms: number, hips: Vector3, facing: number, height_m: number | null): boolean {
    if (this.shown === null) return false;
    const { frames, duration_s } = this.shown;
    const since_s = ((now_ms - this.begun_ms) / 1000) % (duration_s + REST_S);
    const frame = Math.round(Math.min(1, Math.max(0, since_s / duration_s)) * (frames.length - 1));
    this.group.position.set(hips.x, hips.y, 0).add(Ghost.beside(facing));
    this.group.rotation.z = facing;
    if (frame === this.frame) return false;
    this.frame = frame;
    this.figure.update({ segments: frames[frame]! }, height_m);
    return true;
  }
}
