// Sensors in 3-D: a shape and a colour for how far each can be trusted, axes, uncertainty, name.

import * as THREE from "three";
import type { SensorEntry, SensorState } from "../protocol";
import { finish, instanced, segments } from "./buffers";
import { Labels } from "./labels";
import { quaternion, vector } from "./scene";
import { token } from "../theme.svelte";
import { Trails } from "./trails";

const AXIS_M = 0.07;
const SIZE_M = 0.022;
const AXIS_COLOURS = [[0.85, 0.25, 0.2], [0.2, 0.65, 0.3], [0.25, 0.45, 0.95]] as const;

/** Shape and colour say the same, so that neither is needed alone. */
export const LOOKS: { states: SensorState[]; look: "good" | "repaired" | "outside" | "unreliable"; sign: string; colour: number; geometry: () => THREE.BufferGeometry }[] = [
  { states: ["ok"], look: "good", sign: "■", colour: 0x2a78b8, geometry: () => new THREE.BoxGeometry(1, 1, 1) },
  { states: ["repaired"], look: "repaired", sign: "◆", colour: 0x2a9d8f, geometry: () => new THREE.OctahedronGeometry(0.8) },
  { states: ["extrapolated"], look: "outside", sign: "▲", colour: 0xd98e04, geometry: () => new THREE.TetrahedronGeometry(0.9) },
  { states: ["suspect", "late", "stuck", "missing"], look: "unreliable", sign: "●", colour: 0xb3261e, geometry: () => new THREE.SphereGeometry(0.55, 16, 12) },
];

export class Sensors {
  readonly group = new THREE.Group();
  readonly sigma = new THREE.Group();
  readonly trails = new Trails();
  readonly labels = new Labels();
  private names: string[] = [];
  private entries: SensorEntry[] = [];
  private looks: THREE.InstancedMesh[] = [];
  private bubbles: THREE.InstancedMesh | null = null;
  private axes: THREE.LineSegments | null = null;
  private readonly position = new THREE.Vector3();
  private readonly rotation = new THREE.Quaternion();
  private readonly scale = new THREE.Vector3();
  private readonly matrix = new THREE.Matrix4();
  private readonly tip = new THREE.Vector3();

  constructor() {
    this.group.add(this.sigma, this.trails.group, this.labels.group);
  }

  /** Where a sensor is, room, m; null where nobody knows. */
  place(name: string, into: THREE.Vector3): THREE.Vector3 | null {
    const entry = this.entries.find((sensor) => sensor.name === name);
    return entry?.position_m ? vector(entry.position_m, into) : null;
  }

  /** Names in the colour of the text, which has changed. */
  recolour(): void {
    this.labels.write(this.names, token("ink"));
  }

  update(sensors: SensorEntry[]): void {
    if (sensors.length !== this.names.length || sensors.some(({ name }, i) => name !== this.names[i])) this.rebuild(sensors);
    this.entries = sensors;
    const counts = this.looks.map(() => 0);
    let bubble = 0;
    const axes = this.axes!.geometry.getAttribute("position") as THREE.BufferAttribute;
    sensors.forEach((sensor, index) => {
      const { position_m, orientation_wxyz, sigma_m, state } = sensor;
      if (!position_m) {
        this.labels.hide(index);
        for (let end = 0; end < 6; end++) axes.setXYZ(index * 6 + end, 0, 0, -100);
        return;
      }
      vector(position_m, this.position);
      if (orientation_wxyz) quaternion(orientation_wxyz, this.rotation);
      else this.rotation.identity();
      this.labels.put(index, this.position);
      const look = Math.max(0, LOOKS.findIndex(({ states }) => states.includes(state)));
      this.put(this.looks[look]!, counts[look]!++, SIZE_M);
      if (sigma_m != null) this.put(this.bubbles!, bubble++, Math.max(2 * sigma_m, 1e-4));
      for (let axis = 0; axis < 3; axis++) {
        this.tip.set(0, 0, 0).setComponent(axis, orientation_wxyz ? AXIS_M : 0).applyQuaternion(this.rotation).add(this.position);
        axes.setXYZ(index * 6 + axis * 2, this.position.x, this.position.y, this.position.z);
        axes.setXYZ(index * 6 + axis * 2 + 1, this.tip.x, this.tip.y, this.tip.z);
      }
    });
    axes.needsUpdate = true;
    this.labels.finish();
    this.looks.forEach((mesh, i) => finish(mesh, counts[i]!));
    finish(this.bubbles!, bubble);
    if (this.trails.group.visible) this.trails.upload();
  }

  private put(mesh: THREE.InstancedMesh, index: number, size_m: number): void {
    this.matrix.compose(this.position, this.rotation, this.scale.setScalar(size_m));
    mesh.setMatrixAt(index, this.matrix);
  }

  private rebuild(sensors: SensorEntry[]): void {
    const count = sensors.length;
    this.names = sensors.map(({ name }) => name);
    for (const old of [...this.looks, this.bubbles, this.axes]) {
      old?.removeFromParent();
      old?.geometry.dispose();
    }
    this.looks = LOOKS.map(({ geometry, colour }) =>
      instanced(geometry(), new THREE.MeshLambertMaterial({ color: colour }), count));
    this.group.add(...this.looks);
    const glass = new THREE.MeshBasicMaterial({ color: 0x7a5ac2, transparent: true, opacity: 0.22, depthWrite: false });
    this.bubbles = instanced(new THREE.SphereGeometry(1, 16, 12), glass, count);
    this.sigma.add(this.bubbles);
    this.axes = segments(count * 6, new THREE.LineBasicMaterial({ vertexColors: true }));
    const colours = Array.from({ length: count }, () => AXIS_COLOURS.flatMap((colour) => [...colour, ...colour])).flat();
    this.axes.geometry.setAttribute("color", new THREE.Float32BufferAttribute(colours, 3));
    this.group.add(this.axes);
    this.labels.write(this.names, token("ink"));
  }
}
