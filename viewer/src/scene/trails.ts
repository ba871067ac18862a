// Where each sensor was in the last seconds: line pieces in a ring, of which each message renews one per sensor and each frame that is
// drawn uploads only the new ones.

import * as THREE from "three";
import type { SensorEntry, SensorsMessage } from "../protocol";
import { segments } from "./buffers";

/** Pieces of a trail: two seconds. */
const PIECES = 120;
const NOWHERE = -1000;

export class Trails {
  readonly group = new THREE.Group();
  private lines: THREE.LineSegments | null = null;
  private sensors: SensorEntry[] = [];
  private t_s = -Infinity;
  /** The piece that is renewed next, and how many are newer than what was uploaded. */
  private next = 0;
  private fresh = 0;

  /** From where the sensors were to where they are. */
  extend({ t_s, sensors }: SensorsMessage): void {
    const others = sensors.length !== this.sensors.length || sensors.some(({ name }, i) => name !== this.sensors[i]!.name);
    if (others) this.rebuild(sensors.length);
    else if (t_s < this.t_s) this.forget();
    const before = others || t_s < this.t_s ? sensors : this.sensors;
    const { array } = this.points();
    let at = this.next * 6 * sensors.length;
    sensors.forEach(({ position_m }, index) => {
      const from = before[index]!.position_m;
      for (const end of [from, position_m]) {
        for (let axis = 0; axis < 3; axis++) array[at++] = from && position_m ? end![axis]! : NOWHERE;
      }
    });
    this.next = (this.next + 1) % PIECES;
    this.fresh = Math.min(this.fresh + 1, PIECES);
    this.sensors = sensors;
    this.t_s = t_s;
  }

  /** Before a frame is drawn that shows them. */
  upload(): void {
    if (this.fresh === 0) return;
    const points = this.points();
    const piece = 6 * this.sensors.length;
    points.clearUpdateRanges();
    // Around the end of the ring in two parts; all of it without a range.
    const from = this.next - this.fresh;
    if (this.fresh < PIECES) {
      points.addUpdateRange(Math.max(from, 0) * piece, (this.next - Math.max(from, 0)) * piece);
      if (from < 0) points.addUpdateRange((PIECES + from) * piece, -from * piece);
    }
    points.needsUpdate = true;
    this.fresh = 0;
  }

  private points(): THREE.BufferAttribute {
    return this.lines!.geometry.getAttribute("position") as THREE.BufferAttribute;
  }

  private forget(): void {
    this.points().array.fill(NOWHERE);
    this.fresh = PIECES;
  }

  private rebuild(count: number): void {
    this.lines?.removeFromParent();
    this.lines?.geometry.dispose();
    const material = new THREE.LineBasicMaterial({ color: 0x2a78b8, transparent: true, opacity: 0.45 });
    this.lines = segments(count * 2 * PIECES, material);
    this.group.add(this.lines);
    this.forget();
  }
}
