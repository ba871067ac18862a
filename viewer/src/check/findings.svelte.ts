// What is wrong now, in one line each with its fix: what the daemon says, and what follows from what it sends.

import { field } from "../field.svelte";
import { num } from "../format";
import { live, model } from "../page.svelte";
import type { Text } from "../text/en";

/** What a button beside it does: the kind of {@link Text} `check.go`. */
export type Way = "body" | "field" | "recording" | "sensor";
export type Finding = { key: string; grave: "care" | "bad"; says: string; way?: Way; sensor?: string };

/** Damaged records beyond this share are a cable's, 0 to 1. */
const DAMAGED = 0.01;
/** A sensor that has been so for less is not worth a line yet, s. */
const LASTS_S = 3;
const WAYS: Record<string, Way> = { body_not_calibrated: "body", field_map: "field", recording: "recording" };

/** Messages that were dropped longer ago are forgotten, s. */
const DROPPED_S = 10;
/** How many messages had been dropped for this page, by host time, s; the oldest is that of so long ago. */
let drops: { t_s: number; dropped: number }[] = [];

/** Since when each sensor has been what it is, host time, s. */
const since = new Map<string, { state: string; t_s: number }>();
model.listen((message) => {
  if (message.type === "hello") {
    since.clear();
    drops = [];
  }
  if (message.type !== "status") return;
  drops = [...drops.filter(({ t_s }) => t_s > message.t_s - DROPPED_S), { t_s: message.t_s, dropped: model.sensors?.dropped ?? 0 }];
  for (const { name, state } of model.sensors?.sensors ?? []) {
    if (since.get(name)?.state !== state) since.set(name, { state, t_s: message.t_s });
  }
});

export function findings(text: Text): Finding[] {
  const { status } = live;
  if (!status) return [];
  const { check, calibrate } = text;
  const found: Finding[] = status.problems.map((problem, i) => {
    const { code, message } = problem;
    const way = WAYS[code];
    return { key: `daemon ${i} ${code}`, grave: code === "recording" ? "bad" : "care", says: text.daemon.problem(problem) ?? message, ...(way ? { way } : {}) };
  });
  // Of what is old nobody knows whether it still holds. A take may stand.
  if (!status.replay && live.linkState !== "open") found.push({ key: "lost", grave: "bad", says: text.page.lost(live.linkWhy) });
  else if (!status.replay && live.old_s !== null) found.push({ key: "old", grave: "bad", says: check.old(live.old_s) });
  for (const { name, state, reason } of status.devices) {
    if (reason) found.push({ key: `device ${name}`, grave: state === "failed" ? "bad" : "care", says: `${name}: ${text.daemon.device(state, reason)}` });
    const refused = model.refused.get(name) ?? 0;
    if (refused > DAMAGED) found.push({ key: `damaged ${name}`, grave: "care", says: check.damaged(name, num(100 * refused, 1)) });
  }
  const lasting = (model.sensors?.sensors ?? []).filter(({ name }) => status.t_s - (since.get(name)?.t_s ?? Infinity) >= LASTS_S);
  // Of a device that does not stream its own line speaks.
  const streams = new Set(status.devices.filter(({ state }) => state === "streaming").map(({ name }) => name));
  const heard = lasting.filter(({ device }) => !device || streams.has(device));
  const outside = heard.filter(({ state }) => state === "extrapolated").map(({ name }) => name);
  if (outside.length > 0) found.push({ key: "outside", grave: "care", says: check.outside(outside.join(", ")), way: "field" });
  for (const { name, state, fault } of heard) {
    if (state === "ok" || state === "repaired" || state === "extrapolated") continue;
    const cause = fault?.cause ? text.daemon.term(fault.cause) : text.states[state];
    found.push({ key: `sensor ${name}`, grave: "bad", says: check.suspect(name, cause), way: "sensor", sensor: name });
  }
  if (field.disturbed.length > 0) found.push({ key: "disturbed", grave: "care", says: `${check.disturbed} ${calibrate.less}`, way: "field" });
  if (field.drifted) found.push({ key: "drifted", grave: "bad", says: calibrate.drifted(field.drifted.sensors.join(calibrate.and), num(1000 * field.drifted.deviation_m, 1)), way: "field" });
  const dropped = (drops.at(-1)?.dropped ?? 0) - (drops[0]?.dropped ?? 0);
  if (dropped > 0) found.push({ key: "dropped", grave: "care", says: check.dropped(dropped) });
  return found;
}
