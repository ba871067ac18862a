// The body in 3-D: simple solids per segment; where a sensor is faulty, a mark of another shape and colour with its reason.

import * as THREE from "three";
import { mergeGeometries } from "three/examples/jsm/utils/BufferGeometryUtils.js";
import type { Contacts, SegmentEntry, SegmentState } from "../protocol";
import { Labels } from "./labels";
import { quaternion, vector } from "./scene";
import { spoken } from "../dom";

/** Lengths in parts of the height, as the daemon has them (docs/body.md). */
const TRUNK = 0.288;
const SHOULDER = 0.129;
const HIP = 0.05;
const UPPER_ARM = 0.186;
const FOREARM = 0.146;
const THIGH = 0.245;
const SHANK = 0.246;
const ANKLE = 0.039;
const HEAD = 0.182;
const HAND = 0.108;
const TOES = 0.125;
/** The heel and the ball of the foot, ahead of the ankle. */
const HEEL = -0.031;
const BALL = 0.081;
const USUAL_HEIGHT_M = 1.75;

/** How a segment looks by its state: colour, opacity and whether it is a net all say the same. */
export const BODY_LOOKS: Record<SegmentState, { words: string; sign: string; colour: number; opacity: number; net: boolean }> = {
  ok: { words: "segment, measured", sign: "▮", colour: 0x6f94b8, opacity: 1, net: false },
  inferred: { words: "segment, from its neighbours", sign: "▯", colour: 0x6f94b8, opacity: 0.55, net: false },
  suspect: { words: "segment, its sensor is faulty", sign: "◆", colour: 0xd98e04, opacity: 0.9, net: false },
  missing: { words: "segment, not shown by anything", sign: "▒", colour: 0x888888, opacity: 0.35, net: true },
};
/** The mark under a foot that stands. */
export const STANDS_LOOK = { words: "foot that stands", sign: "●", colour: 0x3a9d5d };
const ILL = 0xb3261e;
const GHOST = new THREE.MeshStandardMaterial({ color: 0x2a9d8f, roughness: 0.8, transparent: true, opacity: 0.4 });

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
  PLACES[`upper_arm_${side}`] = { parent: "torso", inParent: [0, TRUNK / 2, z * SHOULDER], inOwn: [0, 0, 0] };
  PLACES[`forearm_${side}`] = { parent: `upper_arm_${side}`, inParent: [0, -UPPER_ARM, 0], inOwn: [0, 0, 0] };
  PLACES[`thigh_${side}`] = { parent: "pelvis", inParent: [0, 0, z * HIP], inOwn: [0, 0, 0] };
  PLACES[`shank_${side}`] = { parent: `thigh_${side}`, inParent: [0, -THIGH, 0], inOwn: [0, 0, 0] };
  PLACES[`hand_${side}`] = { parent: `forearm_${side}`, inParent: [0, -FOREARM, 0], inOwn: [0, 0, 0] };
  PLACES[`foot_${side}`] = { parent: `shank_${side}`, inParent: [0, -SHANK, 0], inOwn: [0, 0, 0] };
}

function ball(x: number, y: number, z: number, size: [number, number, number]): THREE.BufferGeometry {
  return new THREE.SphereGeometry(1, 24, 16).scale(...size).translate(x, y, z);
}

/** A limb from its joint downwards, with the joint as a ball. */
function limb(radius: number, length: number): THREE.BufferGeometry[] {
  const tube = new THREE.CylinderGeometry(radius, radius * 0.75, length, 20).translate(0, -length / 2, 0);
  return [tube, ball(0, 0, 0, [radius * 1.15, radius * 1.15, radius * 1.15])];
}

/** Solids of a segment in its axes (x forward, y up, z right), in parts of the height. */
function solids(name: string): THREE.BufferGeometry[] {
  switch (name.replace(/_[rl]$/, "")) {
    case "torso":
      return [
        ball(0, 0.055, 0, [0.062, 0.105, 0.112]),
        ball(0, -0.07, 0, [0.052, 0.08, 0.08]),
      ];
    case "head":
      return [
        new THREE.CylinderGeometry(0.025, 0.028, 0.06, 16).translate(0, 0.02, 0),
        ball(0.01, HEAD - 0.066, 0, [0.052, 0.066, 0.046]),
        // The nose: which way it looks.
        new THREE.ConeGeometry(0.012, 0.03, 12).rotateZ(-Math.PI / 2).translate(0.072, HEAD - 0.071, 0),
      ];
    case "pelvis":
      return [ball(0, 0.01, 0, [0.056, 0.055, 0.092])];
    case "upper_arm":
      return limb(0.026, UPPER_ARM);
    case "forearm":
      return limb(0.021, FOREARM);
    case "hand":
      // Palm and fingers, and the thumb, which points forward.
      return [ball(0, -0.46 * HAND, 0, [0.022, 0.46 * HAND, 0.01]), ball(0.022, -0.3 * HAND, 0, [0.008, 0.024, 0.008])];
    case "thigh":
      return limb(0.043, THIGH);
    case "shank":
      return limb(0.031, SHANK);
    case "foot": {
      // Heel, sole and toes; flat below.
      const [heel, ball_of] = [-0.027, 0.7 * TOES];
      return [
        new THREE.BoxGeometry(ball_of - heel, ANKLE - 0.006, 0.046).translate((ball_of + heel) / 2, -ANKLE / 2 - 0.003, 0),
        new THREE.CylinderGeometry(0.023, 0.023, 0.02, 20).scale((TOES - ball_of) / 0.023, 1, 1).translate(ball_of, -ANKLE + 0.01, 0),
        ball(0, -0.006, 0, [0.026, 0.02, 0.022]),
      ];
    }
    default:
      return [];
  }
}

interface Part {
  group: THREE.Group;
  mesh: THREE.Mesh;
  state: SegmentState | null;
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

  /** A ghost is see-through, whatever its segments' states. */
  constructor(kind: "person" | "ghost" = "person") {
    const material = (state: SegmentState) => {
      if (kind === "ghost") return GHOST;
      const { colour, opacity, net } = BODY_LOOKS[state];
      return new THREE.MeshStandardMaterial({ color: colour, roughness: 0.65, transparent: opacity < 1, opacity, wireframe: net });
    };
    this.materials = { ok: material("ok"), inferred: material("inferred"), suspect: material("suspect"), missing: material("missing") };
    for (const name of Object.keys(PLACES)) {
      const group = new THREE.Group();
      // One solid, since every one is a call to draw.
      const mesh = new THREE.Mesh(mergeGeometries(solids(name)), this.materials.missing);
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
    for (const state of ["ok", "inferred"] as const) {
      (this.materials[state] as THREE.MeshStandardMaterial).color.set(colour);
    }
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
        part.mesh.material = this.materials[state];
      }
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
    const said = ill.map(({ name, fault }) => `${name}: ${spoken(fault ?? "faulty")}`);
    if (said.join("\n") !== this.said.join("\n")) {
      this.said = said;
      this.reasons.write(said, getComputedStyle(document.body).color);
    }
    while (this.marks.length < ill.length) {
      const mark = new THREE.Mesh(new THREE.OctahedronGeometry(0.06), new THREE.MeshStandardMaterial({ color: ILL, roughness: 0.4 }));
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
