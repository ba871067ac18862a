// Vectors and rotations, as far as this page needs them.

export type Vec3 = [number, number, number];
/** Rows. */
export type Mat3 = [Vec3, Vec3, Vec3];
/** w, x, y, z. */
export type Quat = [number, number, number, number];

export const RAD = Math.PI / 180;
export const IDENTITY: Mat3 = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];

export const dot = (a: Vec3, b: Vec3): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const norm = (a: Vec3): number => Math.sqrt(dot(a, a));
export const scale = (k: number, [x, y, z]: Vec3): Vec3 => [k * x, k * y, k * z];
export const add = (a: Vec3, b: Vec3): Vec3 => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const cross = (a: Vec3, b: Vec3): Vec3 => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const apply = (m: Mat3, v: Vec3): Vec3 => [dot(m[0], v), dot(m[1], v), dot(m[2], v)];

/** Between two directions, rad. */
export function angle(a: Vec3, b: Vec3): number {
  return Math.acos(Math.max(-1, Math.min(1, dot(a, b) / (norm(a) * norm(b)))));
}

/** The angles of `deviceorientation` (degrees, intrinsic Z-X'-Y'') as a rotation from the phone into the world. */
export function rotationOf(alpha: number, beta: number, gamma: number): Quat {
  const [a, b, g] = [(alpha * RAD) / 2, (beta * RAD) / 2, (gamma * RAD) / 2];
  const [ca, sa, cb, sb, cg, sg] = [Math.cos(a), Math.sin(a), Math.cos(b), Math.sin(b), Math.cos(g), Math.sin(g)];
  return [cb * cg * ca - sb * sg * sa, sb * cg * ca - cb * sg * sa, cb * sg * ca + sb * cg * sa, cb * cg * sa + sb * sg * ca];
}

/** Up, as the phone sees it that is held like this. */
export function upOf([w, x, y, z]: Quat): Vec3 {
  return [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)];
}
