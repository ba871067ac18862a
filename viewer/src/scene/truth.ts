// The ground truth, on a simulated stage: a thin cross at each true pose.

import * as THREE from "three";
import type { TruthsMessage } from "../protocol";
import { quaternion, vector } from "./scene";
import { segments } from "./buffers";

const ARM_M = 0.045;

export class Truth {
  readonly group = new THREE.Group();
  private lines: THREE.LineSegments | null = null;
  private readonly tip = new THREE.Vector3();
  private readonly at = new THREE.Vector3();
  private readonly rotation = new THREE.Quaternion();
  private capacity = 0;

  update(truth: TruthsMessage): void {
    if (truth.sensors.length > this.capacity) {
      this.capacity = truth.sensors.length;
      this.group.clear();
      this.lines = segments(this.capacity * 6, new THREE.LineBasicMaterial({ color: 0x888888 }));
      this.group.add(this.lines);
    }
    if (!this.lines) return;
    const points = this.lines.geometry.getAttribute("position") as THREE.BufferAttribute;
    let vertex = 0;
    for (const { position_m, orientation_wxyz } of truth.sensors) {
      if (!position_m) continue;
      vector(position_m, this.at);
      if (orientation_wxyz) quaternion(orientation_wxyz, this.rotation);
      for (let end = 0; end < 6; end++) {
        this.tip.set(0, 0, 0).setComponent(end >> 1, end & 1 ? ARM_M : -ARM_M).applyQuaternion(this.rotation).add(this.at);
        points.setXYZ(vertex++, this.tip.x, this.tip.y, this.tip.z);
      }
    }
    this.lines.geometry.setDrawRange(0, vertex);
    points.needsUpdate = true;
  }
}
