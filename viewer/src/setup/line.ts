// Whether the line to a device is good enough, and what to do where it is not.

import { num } from "../format";
import { live, model } from "../page.svelte";
import type { DeviceStatus } from "../protocol";
import type { Text } from "../text/en";

/** Records that arrive damaged, 0 to 1: beyond it, a cable's. */
const DAMAGED = 0.01;
/** Samples that were lost of the last ones, 0 to 1. */
const LOST = 0.02;
/** So many of them are the last: what happened earlier is over, s. */
const LAST_S = 10;
/** A clock that is fitted worse than this is not settled, s. */
const CLOCK_S = 0.005;

/** Of each sensor what came and what was lost by then, once a second. */
const counts = new Map<string, { samples: number; lost: number }[]>();
model.listen((message) => {
  if (message.type === "hello") counts.clear();
  if (message.type !== "status") return;
  for (const { name, samples, lost } of message.sensors) counts.set(name, [...(counts.get(name) ?? []), { samples, lost }].slice(-LAST_S));
});

/** How much of what the sensors of a device measured was lost lately, 0 to 1. */
function lostOf(device: string): number {
  let [lost, all] = [0, 0];
  for (const sensor of live.hello?.sensors ?? []) {
    const [first, last] = [counts.get(sensor.name)?.[0], counts.get(sensor.name)?.at(-1)];
    if (sensor.device !== device || !first || !last) continue;
    lost += last.lost - first.lost;
    all += last.lost - first.lost + last.samples - first.samples;
  }
  return lost / Math.max(1, all);
}

export type Line = { grave: "good" | "care" | "bad"; says: string; fix: string; lost: number };

export function lineOf(device: DeviceStatus, text: Text): Line {
  const { setup } = text;
  const lost = lostOf(device.name);
  if (device.state !== "streaming") {
    return { grave: device.state === "connecting" ? "care" : "bad", says: text.links[device.state], fix: device.reason ? text.daemon.device(device.state, device.reason) : setup.waits, lost };
  }
  const damaged = model.refused.get(device.name) ?? 0;
  if (damaged > DAMAGED) return { grave: "care", says: setup.damaged(num(100 * damaged, 1)), fix: setup.damagedFix, lost };
  if (lost > LOST) return { grave: "care", says: setup.loses(num(100 * lost, 1)), fix: setup.losesFix, lost };
  if (device.rate_hz === null) return { grave: "care", says: setup.noRate, fix: setup.waits, lost };
  if ((device.sigma_t_s ?? 0) > CLOCK_S) return { grave: "care", says: setup.clockLoose(num(1000 * (device.sigma_t_s ?? 0), 1)), fix: setup.clockFix, lost };
  return { grave: "good", says: setup.lineGood, fix: "", lost };
}
