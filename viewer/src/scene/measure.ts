// A line between two places that somebody measures, and a ring around the sensor that is looked at.

import * as THREE from "three";
import { segments } from "./buffers";

const COLOUR = 0x3b9cff;

export class Marking {
  readonly group = new THREE.Group();
  private readonly line = segments(2, new THREE.LineBasicMaterial({ color: COLOUR, depthTest: false }));
  private readonly ring = new THREE.Mesh(new THREE.RingGeometry(0.045, 0.054, 40), new THREE.MeshBasicMaterial({ color: COLOUR, depthTest: false, side: THREE.DoubleSide }));

  constructor() {
    this.line.visible = this.ring.visible = false;
    this.line.renderOrder = this.ring.renderOrder = 2;
    this.group.add(this.line, this.ring);
  }

  /** The ring looks at the camera. */
  choose(at: THREE.Vector3 | null, camera: THREE.Camera): void {
    this.ring.visible = at !== null;
    if (at === null) return;
    this.ring.position.copy(at);
    this.ring.quaternion.copy(camera.quaternion);
  }

  /** Between two places; null: nothing is measured. How far they are apart, m. */
  measure(ends: [THREE.Vector3, THREE.Vector3] | null): number | null {
    this.line.visible = ends !== null;
    if (ends === null) return null;
    const points = this.line.geometry.getAttribute("position") as THREE.BufferAttribute;
    ends.forEach(({ x, y, z }, end) => points.setXYZ(end, x, y, z));
    points.needsUpdate = true;
    return ends[0].distanceTo(ends[1]);
  }
}
