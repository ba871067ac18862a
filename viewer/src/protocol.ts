// The messages, as generated from the daemon's types, and what this page makes of them.

export type * from "../../clients/typescript/src/posed.v1";

import type { FaultMessage, SensorState } from "../../clients/typescript/src/posed.v1";

/** A fault of a sensor that began or ended, and a fault map that was swapped in. */
export type FaultEvent = Extract<FaultMessage, { event: "fault" }>;
export type FaultMap = Extract<FaultMessage, { event: "map" }>;

export type Vec3 = [number, number, number];
export type Quat = [number, number, number, number];

/** How reliable a state is: colour, shape and words all follow from it. */
export type Trust = "good" | "care" | "bad";

const TRUST: Record<SensorState, Trust> = {
  ok: "good",
  repaired: "good",
  extrapolated: "care",
  suspect: "care",
  late: "care",
  missing: "bad",
  stuck: "bad",
};

export function trustOf(state: SensorState): Trust {
  return TRUST[state] ?? "care";
}
