// What the phone measures, as the browser says it, in SI units.

import { RAD, type Quat, type Vec3, norm, rotationOf } from "./vectors";

/** One event: angular velocity rad/s, acceleration with gravity m/s², orientation if there is one; time of the browser's clock. */
export type Reading = { t_us: number; gyro: Vec3; acceleration: Vec3; q: Quat | null };

/** Why nothing is measured. */
export type Refusal = "insecure" | "denied" | "none" | "no_gyroscope";

/** So long an event is waited for, ms. */
const FIRST_MS = 1500;
/** Browsers say an orientation when it has changed: one that is older, ms, holds for as long as the phone has turned by less, rad. */
const [OLD_MS, TURNED_RAD] = [200, 0.02];

type Asks = { requestPermission?: () => Promise<"granted" | "denied"> };

/** Asks for permission, which has to happen in the handler of a press, before anything else is waited for; then measures until it is stopped. */
export async function measure(each: (reading: Reading) => void): Promise<{ stop: () => void } | Refusal> {
  if (!isSecureContext) return "insecure";
  if (typeof DeviceMotionEvent === "undefined") return "none";
  const [motion, orientation] = [DeviceMotionEvent as unknown as Asks, window.DeviceOrientationEvent as unknown as Asks | undefined];
  // Both are asked before either is waited for.
  const asked = [motion.requestPermission?.(), orientation?.requestPermission?.()];
  try {
    for (const answer of asked) if ((await answer) === "denied") return "denied";
  } catch {
    return "denied";
  }
  let newest: { q: Quat; at_ms: number; turned_rad: number } | null = null;
  let before_ms: number | null = null;
  let seen: (found: true | "no_gyroscope") => void = () => undefined;
  const onOrientation = ({ alpha, beta, gamma, timeStamp }: DeviceOrientationEvent): void => {
    if (alpha !== null && beta !== null && gamma !== null) newest = { q: rotationOf(alpha, beta, gamma), at_ms: timeStamp, turned_rad: 0 };
  };
  const onMotion = ({ rotationRate, accelerationIncludingGravity, timeStamp }: DeviceMotionEvent): void => {
    const { x, y, z } = accelerationIncludingGravity ?? {};
    const { alpha, beta, gamma } = rotationRate ?? {};
    if (x == null || y == null || z == null) return;
    if (alpha == null || beta == null || gamma == null) return seen("no_gyroscope");
    seen(true);
    // About x, y and z: the names are those of angles that have another order.
    const gyro: Vec3 = [alpha * RAD, beta * RAD, gamma * RAD];
    if (newest !== null && before_ms !== null) newest.turned_rad += norm(gyro) * (timeStamp - before_ms) * 1e-3;
    before_ms = timeStamp;
    const q = newest !== null && (timeStamp - newest.at_ms < OLD_MS || newest.turned_rad < TURNED_RAD) ? newest.q : null;
    each({ t_us: Math.round(timeStamp * 1000), gyro, acceleration: [x, y, z], q });
  };
  addEventListener("deviceorientation", onOrientation);
  addEventListener("devicemotion", onMotion);
  const stop = (): void => {
    removeEventListener("deviceorientation", onOrientation);
    removeEventListener("devicemotion", onMotion);
  };
  const found = await new Promise<true | Refusal>((resolve) => {
    seen = resolve;
    setTimeout(() => resolve("none"), FIRST_MS);
  });
  if (found === true) return { stop };
  stop();
  return found;
}
