// The shape of a person: each segment a closed surface through a few cross-sections. Lengths in parts of the height; axes of a segment: x
// forward, y up, z right.

import * as THREE from "three";
import { mergeGeometries } from "three/examples/jsm/utils/BufferGeometryUtils.js";

/** Lengths in parts of the height, as the daemon has them (docs/body.md). */
export const TRUNK = 0.288;
export const SHOULDER = 0.129;
/** Where the collar bone begins. */
export const SHOULDER_ROOT = 0.14 * SHOULDER;
export const HIP = 0.05;
export const UPPER_ARM = 0.186;
export const FOREARM = 0.146;
export const THIGH = 0.245;
export const SHANK = 0.246;
export const ANKLE = 0.039;
const HAND = 0.108;

/** A cross-section: where along the axis, half of it in the two other directions, and its middle in the first of them. */
type Ring = [along: number, first: number, second: number, middle?: number];

const SIDES = 18;
/** Rings between two that are given. */
const BETWEEN = 1;

/** With smooth rings between: a Catmull-Rom spline through each of their numbers. */
function smooth(rings: Ring[]): Ring[] {
  const full = rings.map(([along, first, second, middle = 0]) => [along, first, second, middle] as const);
  const at = (index: number) => full[Math.min(Math.max(index, 0), full.length - 1)]!;
  return full.flatMap((ring, index) => {
    if (index === full.length - 1) return [[...ring] as Ring];
    return Array.from({ length: BETWEEN + 1 }, (_, step) => {
      const t = step / (BETWEEN + 1);
      const [a, b, c, d] = [at(index - 1), ring, at(index + 1), at(index + 2)];
      return ring.map((_, part) => {
        const [p, q, r, s] = [a[part]!, b[part]!, c[part]!, d[part]!];
        return 0.5 * (2 * q + (r - p) * t + (2 * p - 5 * q + 4 * r - s) * t * t + (3 * q - p - 3 * r + s) * t * t * t);
      }) as unknown as Ring;
    });
  });
}

/** A closed surface through rings along y (then `first` is x), or along x (then `first` is y); nothing of it below `least_y`. */
function loft(given: Ring[], axis: "x" | "y" = "y", least_y = -Infinity): THREE.BufferGeometry {
  const rings = smooth(given);
  const points: number[] = [];
  const put = (along: number, first: number, second: number) => {
    const [x, y] = axis === "y" ? [first, along] : [along, first];
    points.push(x, Math.max(y, least_y), second);
  };
  for (const [along, first, second, middle = 0] of rings) {
    for (let side = 0; side < SIDES; side++) {
      const angle = (2 * Math.PI * side) / SIDES;
      put(along, middle + first * Math.cos(angle), second * Math.sin(angle));
    }
  }
  const ends = [rings[0]!, rings[rings.length - 1]!];
  for (const [along, , , middle = 0] of ends) put(along, middle, 0);
  const at = (ring: number, side: number) => ring * SIDES + (side % SIDES);
  const faces: number[] = [];
  for (let ring = 0; ring + 1 < rings.length; ring++) {
    for (let side = 0; side < SIDES; side++) {
      const [a, b, c, d] = [at(ring, side), at(ring, side + 1), at(ring + 1, side), at(ring + 1, side + 1)];
      faces.push(a, c, b, b, c, d);
    }
  }
  const [low, high] = [rings.length * SIDES, rings.length * SIDES + 1];
  for (let side = 0; side < SIDES; side++) {
    faces.push(low, at(0, side), at(0, side + 1), high, at(rings.length - 1, side + 1), at(rings.length - 1, side));
  }
  if (volume(points, faces) < 0) faces.reverse();
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(points, 3));
  geometry.setIndex(faces);
  geometry.computeVertexNormals();
  return geometry;
}

/** Six times what the surface encloses; negative where its faces look inwards. */
function volume(points: number[], faces: number[]): number {
  const corner = (face: number) => new THREE.Vector3().fromArray(points, 3 * faces[face]!);
  let sum = 0;
  for (let face = 0; face < faces.length; face += 3) sum += corner(face).dot(corner(face + 1).cross(corner(face + 2)));
  return sum;
}

function ball(x: number, y: number, z: number, size: [number, number, number]): THREE.BufferGeometry {
  const geometry = new THREE.SphereGeometry(1, 14, 10).scale(...size).translate(x, y, z);
  geometry.deleteAttribute("uv");
  return geometry;
}

/** A finger from one point to another in the plane of the palm. */
function finger(radius: number, [x, y]: [number, number], [to_x, to_y]: [number, number]): THREE.BufferGeometry {
  const length = Math.hypot(to_x - x, to_y - y);
  const geometry = new THREE.CapsuleGeometry(radius, length, 2, 7)
    .rotateZ(Math.atan2(to_y - y, to_x - x) - Math.PI / 2)
    .translate((x + to_x) / 2, (y + to_y) / 2, 0);
  geometry.deleteAttribute("uv");
  return geometry;
}

const TORSO: Ring[] = [
  [-0.16, 0.03, 0.05], [-0.14, 0.05, 0.082], [-0.1, 0.05, 0.08], [-0.06, 0.053, 0.083, 0.002], [0, 0.06, 0.094, 0.005], [0.05, 0.065, 0.107, 0.007],
  [0.085, 0.062, 0.117, 0.004], [0.115, 0.05, 0.123, -0.002], [0.138, 0.041, 0.122, -0.005], [0.153, 0.033, 0.106, -0.007], [0.164, 0.03, 0.066, -0.007], [0.171, 0.026, 0.038, -0.006], [0.177, 0.02, 0.026, -0.006],
];
const HEAD: Ring[] = [
  [0.046, 0.014, 0.012, 0.022], [0.052, 0.028, 0.023, 0.019], [0.065, 0.04, 0.033, 0.014], [0.085, 0.048, 0.04, 0.009], [0.11, 0.054, 0.044, 0.003],
  [0.135, 0.056, 0.045, -0.002], [0.156, 0.05, 0.04, -0.004], [0.171, 0.036, 0.03, -0.005], [0.18, 0.016, 0.014, -0.005],
];
const NECK: Ring[] = [[-0.015, 0.03, 0.034, -0.006], [0.01, 0.026, 0.027, -0.004], [0.04, 0.025, 0.026, 0], [0.075, 0.026, 0.026, 0.002]];
const PELVIS: Ring[] = [
  [0.1, 0.03, 0.05], [0.085, 0.049, 0.08], [0.05, 0.053, 0.087], [0.015, 0.058, 0.094, -0.003], [-0.02, 0.06, 0.097, -0.005], [-0.045, 0.05, 0.082, -0.003], [-0.062, 0.026, 0.045],
];
const UPPER_ARM_RINGS: Ring[] = [
  [0.014, 0.008, 0.009], [0.008, 0.019, 0.019], [-0.008, 0.0285, 0.0275], [-0.04, 0.0295, 0.028], [-0.09, 0.027, 0.0255, 0.002], [-0.14, 0.0225, 0.022], [-UPPER_ARM, 0.0195, 0.0205], [-0.203, 0.01, 0.011],
];
const FOREARM_RINGS: Ring[] = [
  [0.014, 0.01, 0.011], [0, 0.0195, 0.02], [-0.035, 0.023, 0.0225, 0.002], [-0.08, 0.0185, 0.0185], [-0.125, 0.015, 0.013], [-FOREARM, 0.0145, 0.0115], [-0.156, 0.009, 0.007],
];
const PALM: Ring[] = [[0.004, 0.008, 0.007], [-0.004, 0.0135, 0.0105], [-0.02, 0.0185, 0.0115], [-0.04, 0.0215, 0.0095], [-0.053, 0.02, 0.0075], [-0.058, 0.012, 0.005]];
const THIGH_RINGS: Ring[] = [
  [0.045, 0.018, 0.02], [0.025, 0.04, 0.04], [-0.01, 0.051, 0.0495], [-0.06, 0.051, 0.048, 0.002], [-0.12, 0.045, 0.042, 0.002], [-0.19, 0.035, 0.034], [-THIGH, 0.0305, 0.0305], [-0.265, 0.015, 0.016],
];
const SHANK_RINGS: Ring[] = [
  [0.016, 0.014, 0.016], [0, 0.028, 0.0285, 0.001], [-0.035, 0.028, 0.0275, -0.002], [-0.075, 0.0325, 0.03, -0.008], [-0.12, 0.028, 0.026, -0.007], [-0.18, 0.0195, 0.019, -0.003], [-0.23, 0.017, 0.0165], [-0.255, 0.017, 0.017],
];
const FOOT: Ring[] = [
  [-0.037, 0.009, 0.009, -0.025], [-0.031, 0.019, 0.018, -0.02], [-0.012, 0.03, 0.0225, -0.012], [0.012, 0.031, 0.0215, -0.012], [0.038, 0.024, 0.0225, -0.02],
  [0.07, 0.016, 0.0255, -0.028], [0.098, 0.012, 0.025, -0.031], [0.117, 0.009, 0.0185, -0.0325], [0.126, 0.004, 0.009, -0.034],
];

/** A segment, as one solid: every one is a call to draw. */
export function segmentShape(name: string): THREE.BufferGeometry {
  return mergeGeometries(solids(name));
}

function solids(name: string): THREE.BufferGeometry[] {
  switch (name.replace(/_[rl]$/, "")) {
    case "torso":
      return [loft(TORSO)];
    case "head":
      return [
        loft(NECK), loft(HEAD),
        // The nose, which shows where it looks, and the ears.
        ball(0.057, 0.094, 0, [0.009, 0.013, 0.007]), ball(-0.004, 0.1, 0.045, [0.011, 0.016, 0.005]), ball(-0.004, 0.1, -0.045, [0.011, 0.016, 0.005]),
      ];
    case "shoulder": {
      // From the root of the collar bone to the arm.
      const half = (SHOULDER - SHOULDER_ROOT) / 2;
      return [ball(0, 0, name.endsWith("_r") ? half : -half, [0.024, 0.02, half])];
    }
    case "pelvis":
      return [loft(PELVIS)];
    case "upper_arm":
      return [loft(UPPER_ARM_RINGS)];
    case "forearm":
      return [loft(FOREARM_RINGS)];
    case "hand":
      // Palm, four fingers, and the thumb, which points forward.
      return [
        loft(PALM), finger(0.0055, [0.015, -0.05], [0.017, -0.087]), finger(0.0056, [0.006, -0.052], [0.0065, -HAND + 0.01]),
        finger(0.0055, [-0.004, -0.052], [-0.0045, -0.094]), finger(0.005, [-0.0135, -0.05], [-0.015, -0.083]), finger(0.006, [0.016, -0.02], [0.032, -0.05]),
      ];
    case "thigh":
      return [loft(THIGH_RINGS)];
    case "shank":
      return [loft(SHANK_RINGS)];
    case "foot":
      return [loft(FOOT, "x", -ANKLE), ball(0, -0.002, 0, [0.0185, 0.02, 0.019])];
    default:
      return [];
  }
}
