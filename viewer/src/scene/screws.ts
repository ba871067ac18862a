// What each sensor did between its latest two key poses, as one screw motion: the axis, and the way about and along it.

import * as THREE from "three";
import type { ScrewMotion } from "../protocol";
import { segments } from "./buffers";
import { vector } from "./scene";

/** Pieces of a way. */
const PIECES = 48;
/** How far an axis is drawn beyond the way along it. */
const BEYOND_M = 0.05;
const VERTICES = 2 * (PIECES + 1);

export class Screws {
  readonly group = new THREE.Group();
  private lines: THREE.LineSegments | null = null;
  private readonly latest = new Map<string, ScrewMotion>();
  private capacity = 0;

  take(sensor: string, screw: ScrewMotion): void {
    this.latest.set(sensor, screw);
    this.draw();
  }

  forget(): void {
    this.latest.clear();
    this.draw();
  }

  private draw(): void {
    if (this.latest.size > this.capacity) {
      this.capacity = 2 * this.latest.size;
      this.lines?.removeFromParent();
      this.lines?.geometry.dispose();
      this.lines = segments(this.capacity * VERTICES, new THREE.LineBasicMaterial({ color: 0xd62728 }));
      this.group.add(this.lines);
    }
    if (!this.lines) return;
    const points = this.lines.geometry.getAttribute("position") as THREE.BufferAttribute;
    let vertex = 0;
    const line = (...ends: THREE.Vector3[]) => ends.forEach(({ x, y, z }) => points.setXYZ(vertex++, x, y, z));
    for (const { from_m, axis_point_m, axis_direction, angle_deg, advance_m } of this.latest.values()) {
      const [foot, axis] = [vector(axis_point_m), vector(axis_direction)];
      const arm = vector(from_m).sub(foot);
      line(foot.clone().addScaledVector(axis, Math.min(advance_m, 0) - BEYOND_M), foot.clone().addScaledVector(axis, Math.max(advance_m, 0) + BEYOND_M));
      const at = (share: number) =>
        arm.clone().applyAxisAngle(axis, THREE.MathUtils.degToRad(angle_deg * share)).add(foot).addScaledVector(axis, advance_m * share);
      for (let piece = 0; piece < PIECES; piece++) line(at(piece / PIECES), at((piece + 1) / PIECES));
    }
    this.lines.geometry.setDrawRange(0, vertex);
    points.needsUpdate = true;
  }
}
