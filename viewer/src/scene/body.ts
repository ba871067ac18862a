// The body in 3-D: simple solids per segment; where a sensor is faulty, a mark of another shape and colour with its reason.

import * as THREE from "three";
import type { Contacts, SegmentEntry, SegmentState } from "../protocol";
import { Labels } from "./labels";
import { quaternion, vector } from "./scene";
import { words } from "../text/index.svelte";
import { token } from "../theme.svelte";
import { ANKLE, FOREARM, HIP, SHANK, SHOULDER, SHOULDER_ROOT, THIGH, TRUNK, UPPER_ARM, segmentShape } from "./shape";

/** The heel and the ball of the foot, ahead of the ankle. */
const HEEL = -0.031;
const BALL = 0.081;
const USUAL_HEIGHT_M = 1.75;

/** How a segment looks by its state: colour, and whether it is a net, say the same; docs/design.md. */
export const BODY_LOOKS: Record<SegmentState, { sign: string; colour: number; net: boolean }> = {
  ok: { sign: "▮", colour: 0x6f94b8, net: false },
  inferred: { sign: "▯", colour: 0x9aa7b3, net: false },
  suspect: { sign: "◆", colour: 0xd98e04, net: false },
  missing: { sign: "▒", colour: 0x888888, net: true },
};
/** The mark under a foot that stands. */
export const STANDS_LOOK = { sign: "●", colour: 0x3a9d5d };
/** What is not measured itself is so much greyer than the person. */
const GREYER = 0.5;
const CHOSEN = 0x3b9cff;
const ILL = 0xb3261e;
const GHOST = new THREE.MeshLambertMaterial({ color: 0x2a9d8f, transparent: true, opacity: 0.4 });

/** A segment as it is drawn; without a state it is as good as one that is measured. */
type Drawn = Pick<SegmentEntry, "name" | "position_m" | "orientation_wxyz"> & Partial<Pick<SegmentEntry, "state" | "fault">>;

/** Parents first; where the joint sits in the parent and in the segment itself. */
type Place = { parent: string | null; inParent: [number, number, number]; inOwn: [number, number, number] };
const PLACES: Record<string, Place> = {
  pelvis: { parent: null, inParent: [0, 0, 0], inOwn: [0, 0, 0] },
  torso: { parent: "pelvis", inParent: [0, 0, 0], inOwn: [0, -TRUNK / 2, 0] },
  head: { parent: "torso", inParent: [0, TRUNK / 2, 0], inOwn: [0, 0, 0] },
};
for (const [side, z] of [["r", 1], ["l", -1]] as const) {
  PLACES[`shoulder_${side}`] = { parent: "torso", inParent: [0, TRUNK / 2, z * SHOULDER_ROOT], inOwn: [0, 0, 0] };
  PLACES[`upper_arm_${side}`] = { parent: "torso", inParent: [0, TRUNK / 2, z * SHOULDER], inOwn: [0, 0, 0] };
  PLACES[`forearm_${side}`] = { parent: `upper_arm_${side}`, inParent: [0, -UPPER_ARM, 0], inOwn: [0, 0, 0] };
  PLACES[`thigh_${side}`] = { parent: "pelvis", inParent: [0, 0, z * HIP], inOwn: [0, 0, 0] };
  PLACES[`shank_${side}`] = { parent: `thigh_${side}`, inParent: [0, -THIGH, 0], inOwn: [0, 0, 0] };
  PLACES[`hand_${side}`] = { parent: `forearm_${side}`, inParent: [0, -FOREARM, 0], inOwn: [0, 0, 0] };
  PLACES[`foot_${side}`] = { parent: `shank_${side}`, inParent: [0, -SHANK, 0], inOwn: [0, 0, 0] };
}

interface Part {
  group: THREE.Group;
  mesh: THREE.Mesh;
  state: SegmentState | null;
}

/** The same material, but that it shines. */
function shining(material: THREE.Material): THREE.Material {
  const bright = (material as THREE.MeshLambertMaterial).clone();
  bright.emissive.set(CHOSEN);
  bright.emissiveIntensity = 0.55;
  return bright;
}

export class BodyFigure {
  readonly group = new THREE.Group();
  /** The hips, room, m. */
  readonly hips = new THREE.Vector3();
  /** Which way the hips look, rad from room x. */
  facing = 0;
  private readonly materials: Record<SegmentState, THREE.Material>;
  private readonly parts = new Map<string, Part>();
  private readonly marks: THREE.Mesh[] = [];
  /** Under each foot: whole, or heel and toe of one that wears a sensor. */
  private readonly soles: { side: "r" | "l"; whole: THREE.Mesh; heel: THREE.Mesh; toe: THREE.Mesh }[] = [];
  private readonly reasons = new Labels();
  private said: string[] = [];
  private readonly offset = new THREE.Vector3();
  private painted = "";
  private chosen: string | null = null;

  /** A ghost is see-through, whatever its segments' states. */
  constructor(kind: "person" | "ghost" = "person") {
    const material = (state: SegmentState) => {
      if (kind === "ghost") return GHOST;
      const { colour, net } = BODY_LOOKS[state];
      return new THREE.MeshLambertMaterial({ color: colour, wireframe: net, transparent: net, opacity: net ? 0.25 : 1 });
    };
    this.materials = { ok: material("ok"), inferred: material("inferred"), suspect: material("suspect"), missing: material("missing") };
    for (const name of Object.keys(PLACES)) {
      const group = new THREE.Group();
      // One solid, since every one is a call to draw.
      const mesh = new THREE.Mesh(segmentShape(name), this.materials.missing);
      mesh.name = name;
      group.add(mesh);
      this.group.add(group);
      this.parts.set(name, { group, mesh, state: null });
    }
    const green = new THREE.MeshBasicMaterial({ color: STANDS_LOOK.colour, transparent: true, opacity: 0.7 });
    const mark = (radius: number) => {
      const mesh = new THREE.Mesh(new THREE.CircleGeometry(radius, 24), green);
      mesh.visible = false;
      this.group.add(mesh);
      return mesh;
    };
    for (const side of ["r", "l"] as const) this.soles.push({ side, whole: mark(0.055), heel: mark(0.028), toe: mark(0.028) });
    this.group.add(this.reasons.group);
    this.group.visible = false;
  }

  /** The colour of segments that are as they should be, "#rrggbb". */
  paint(colour: string): void {
    if (colour === this.painted) return;
    this.painted = colour;
    const [ok, inferred] = [this.materials.ok, this.materials.inferred] as THREE.MeshLambertMaterial[];
    ok!.color.set(colour);
    inferred!.color.set(colour).lerp(new THREE.Color(BODY_LOOKS.inferred.colour), GREYER);
  }

  /** The segment that is hit first, with how far away. */
  hit(ray: THREE.Raycaster): { segment: string; distance: number } | null {
    const first = ray.intersectObjects([...this.parts.values()].map(({ mesh }) => mesh), false)[0];
    return first ? { segment: first.object.name, distance: first.distance } : null;
  }

  /** Makes one segment shine; null: none. */
  choose(segment: string | null): void {
    if (segment === this.chosen) return;
    for (const name of [this.chosen, segment]) {
      const part = name === null ? undefined : this.parts.get(name);
      // Dressed anew in the next update.
      if (part) part.state = null;
    }
    this.chosen = segment;
  }

  /** The middle of a segment, room, m; null where there is none. */
  middle(segment: string, into: THREE.Vector3): THREE.Vector3 | null {
    const mesh = this.parts.get(segment)?.mesh;
    if (!mesh) return null;
    mesh.geometry.boundingSphere ?? mesh.geometry.computeBoundingSphere();
    mesh.updateWorldMatrix(true, false);
    return into.copy(mesh.geometry.boundingSphere!.center).applyMatrix4(mesh.matrixWorld);
  }

  update({ segments, contacts }: { segments: readonly Drawn[]; contacts?: Contacts | null }, height_m: number | null): void {
    const scale = height_m ?? USUAL_HEIGHT_M;
    this.group.visible = true;
    const byName = new Map(segments.map((segment) => [segment.name, segment]));
    for (const [name, { parent, inParent, inOwn }] of Object.entries(PLACES)) {
      const part = this.parts.get(name)!;
      const segment = byName.get(name);
      const state = segment ? (segment.state ?? "ok") : "missing";
      if (state !== part.state) {
        part.state = state;
        part.mesh.material = name === this.chosen ? shining(this.materials[state]) : this.materials[state];
      }
      // Messages have shoulders where they wear sensors; else the torso is drawn as wide as it is.
      part.mesh.visible = segment !== undefined || !name.startsWith("shoulder_");
      const above = parent === null ? null : this.parts.get(parent)!.group;
      if (segment?.orientation_wxyz) quaternion(segment.orientation_wxyz, part.group.quaternion);
      else if (above) part.group.quaternion.copy(above.quaternion);
      else this.upright(part.group.quaternion, byName.get("torso"));
      if (segment?.position_m) vector(segment.position_m, part.group.position);
      else if (above) {
        // Straight on from its parent: where it would hang.
        part.group.position.copy(above.position).add(this.offset.set(...inParent).multiplyScalar(scale).applyQuaternion(above.quaternion));
        part.group.position.sub(this.offset.set(...inOwn).multiplyScalar(scale).applyQuaternion(part.group.quaternion));
      } else this.below(part.group, byName.get("torso"), scale);
      part.group.scale.setScalar(scale);
    }
    for (const { side, whole, heel, toe } of this.soles) {
      const sole = contacts?.[`sole_${side}`];
      const stands = (probability: number | undefined) => probability !== undefined && probability > 0.5;
      whole.visible = !sole && stands(contacts?.[`foot_${side}`]);
      heel.visible = stands(sole?.heel);
      toe.visible = stands(sole?.toe);
      const { position, quaternion } = this.parts.get(`foot_${side}`)!.group;
      for (const [mesh, ahead] of [[heel, HEEL], [toe, BALL]] as const) {
        mesh.position.copy(position).add(this.offset.set(ahead * scale, -ANKLE * scale, 0).applyQuaternion(quaternion));
      }
      whole.position.copy(position);
      whole.position.z -= ANKLE * scale;
      for (const mesh of [whole, heel, toe]) {
        // On the floor, and no deeper than to be seen.
        mesh.position.z += 0.005;
        mesh.scale.setScalar(scale);
      }
    }
    this.markIll(segments.filter(({ name, state }) => state === "suspect" && this.parts.has(name)));
    const pelvis = this.parts.get("pelvis")!.group;
    this.hips.copy(pelvis.position);
    this.offset.set(1, 0, 0).applyQuaternion(pelvis.quaternion);
    this.facing = Math.atan2(this.offset.y, this.offset.x);
  }

  /** A pelvis that nothing shows: as the torso, or upright. */
  private upright(into: THREE.Quaternion, torso: Drawn | undefined): void {
    if (torso?.orientation_wxyz) quaternion(torso.orientation_wxyz, into);
    else into.set(Math.SQRT1_2, 0, 0, Math.SQRT1_2);
  }

  private below(pelvis: THREE.Group, torso: Drawn | undefined, scale: number): void {
    if (torso?.position_m) {
      vector(torso.position_m, pelvis.position);
      pelvis.position.sub(this.offset.set(0, (TRUNK / 2) * scale, 0).applyQuaternion(pelvis.quaternion));
    } else pelvis.position.set(0, 0, 0.53 * scale);
  }

  /** An octahedron with the reason at each segment's joint. */
  private markIll(ill: Drawn[]): void {
    const said = ill.map(({ name, fault }) => `${name}: ${words.text.daemon.term(fault ?? "faulty")}`);
    if (said.join("\n") !== this.said.join("\n")) {
      this.said = said;
      this.reasons.write(said, token("ink"));
    }
    while (this.marks.length < ill.length) {
      const mark = new THREE.Mesh(new THREE.OctahedronGeometry(0.06), new THREE.MeshLambertMaterial({ color: ILL }));
      this.marks.push(mark);
      this.group.add(mark);
    }
    this.marks.forEach((mark, index) => {
      mark.visible = index < ill.length;
      if (!mark.visible) return;
      mark.position.copy(this.parts.get(ill[index]!.name)!.group.position);
      this.reasons.put(index, mark.position);
    });
    this.reasons.finish();
  }
}
