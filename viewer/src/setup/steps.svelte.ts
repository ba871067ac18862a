// The steps from plugged in to tracking, and how each stands.

import { findings } from "../check/findings.svelte";
import { live } from "../page.svelte";
import type { DeviceStatus } from "../protocol";
import type { Text } from "../text/en";
import { draft } from "./draft.svelte";
import { lineOf } from "./line";

export const STEPS = ["find", "place", "line", "calibrate", "done"] as const;
export type Step = (typeof STEPS)[number];
/** `open`: it has not been done, and need not be for what comes before it. */
export type Standing = "good" | "care" | "bad" | "open";

/** Drivers whose units send angular velocity and specific force. */
const INERTIAL = ["xbus", "x-imu3", "slimevr", "open-imu"];

/** Sensors that are worn but sit on no segment. */
export function unplaced(): string[] {
  const { setup } = draft;
  if (!setup || setup.bodies.length === 0) return [];
  const inertial = new Set(setup.devices.filter(({ driver }) => INERTIAL.includes(driver)).map(({ name }) => name));
  return setup.sensors.filter(({ device, segment }) => inertial.has(device) && segment === null).map(({ name }) => name);
}

/** Whether the daemon says that the body's sensors are not calibrated. */
export function bodyIsMissing(): boolean {
  return live.status?.problems.some(({ code }) => code === "body_not_calibrated") ?? false;
}

export function standing(step: Step, text: Text): Standing {
  const { setup } = draft;
  const devices: DeviceStatus[] = live.status?.devices ?? [];
  const wrong = (table: string) => setup?.problems.some((problem) => problem.table === table) ?? false;
  switch (step) {
    case "find":
      if (wrong("device")) return "bad";
      return (setup?.devices.length ?? 0) > 0 ? "good" : "open";
    case "place":
      if (wrong("sensor") || wrong("body")) return "bad";
      if (!setup || setup.bodies.length === 0 || setup.sensors.length === 0) return "open";
      return unplaced().length > 0 || setup.sensors.every(({ segment }) => segment === null) ? "care" : "good";
    case "line": {
      if (devices.length === 0) return "open";
      const lines = devices.map((device) => lineOf(device, text).grave);
      return lines.includes("bad") ? "bad" : lines.includes("care") ? "care" : "good";
    }
    case "calibrate":
      if ((live.hello?.sensors.length ?? 0) === 0) return "open";
      return bodyIsMissing() ? "care" : "good";
    case "done": {
      if (devices.length === 0) return "open";
      const isFit = STEPS.every((other) => other === "done" || ["good", "open"].includes(standing(other, text)));
      return isFit && draft.changes.length === 0 && findings(text).length === 0 ? "good" : "care";
    }
  }
}
