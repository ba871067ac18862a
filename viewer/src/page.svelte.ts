// The one connection of this page, what came through it, and what of that the views are drawn from.

import { type LinkState, Link } from "./link";
import { Model } from "./model";
import { Pace } from "./pace";
import type { FigureMessage, Hello, JobsMessage, Job, RunningSession, SensorsMessage, StatusMessage, TimecodeMessage } from "./protocol";

/** Data older than this are shown as old. */
const STALE_MS = 1500;
/** Numbers move faster than eyes: what is read is renewed so often. */
const READ_MS = 100;

/** What the views show, renewed where it changes. */
class Live {
  linkState = $state<LinkState>("connecting");
  /** Why there is no connection, as the browser or the daemon says it. */
  linkWhy = $state("");
  hello = $state.raw<Hello | null>(null);
  status = $state.raw<StatusMessage | null>(null);
  jobs = $state.raw<JobsMessage | null>(null);
  sessions = $state.raw<RunningSession[]>([]);
  /** Null where the stage reads none, or has not yet. */
  timecode = $state.raw<TimecodeMessage | null>(null);
  /** Ten times a second. */
  sensors = $state.raw<SensorsMessage | null>(null);
  body = $state.raw<FigureMessage | null>(null);
  /** A frame has come, and how old the newest is, in whole seconds once that is worth saying. */
  known = $state(false);
  old_s = $state<number | null>(null);
  /** Pictures this browser draws a second; 0 before it is known. */
  drawn_hz = $state(0);

  /** Whether this page may change anything on the stage; who presses before the stage has answered is heard as soon as it has. */
  get operates(): boolean {
    return this.hello?.role !== "watch" && !this.status?.replay;
  }

  /** The newest job of a kind. */
  job(kind: string): Job | null {
    return this.jobs?.jobs.filter((job) => job.kind === kind).at(-1) ?? null;
  }
}

export const live = new Live();
export const model = new Model();
export const link = new Link(
  (message) => model.take(message),
  (state, why) => {
    live.linkState = state;
    live.linkWhy = why;
  },
);

model.listen((message) => {
  switch (message.type) {
    case "hello":
      live.hello = message;
      live.timecode = null;
      break;
    case "status":
      live.status = message;
      break;
    case "jobs":
      live.jobs = message;
      break;
    case "session":
      live.sessions = message.sessions;
      break;
    case "timecode":
      live.timecode = message;
      break;
  }
});

type Draw = (now_ms: number, fresh: boolean) => void;
const drawn = new Set<Draw>();
const turns: (() => void)[] = [];
let next = 0;
let round_ms = -Infinity;

/** Calls `draw` once per picture until what it returns is called; `fresh` when something came since the last one. For effects. */
export function onFrame(draw: Draw): () => void {
  drawn.add(draw);
  return () => drawn.delete(draw);
}

/** Calls `renew` ten times a second at most, never two of them in one picture: all at once would take longer than a picture may. */
export function onTurn(renew: () => void): () => void {
  turns.push(renew);
  return () => turns.splice(turns.indexOf(renew), 1);
}

const pace = new Pace((rate_hz) => link.useRate(rate_hz), (drawn_hz) => (live.drawn_hz = Math.round(drawn_hz)));
let version = -1;
let read_ms = -Infinity;
let read_version = -1;

function frame(now_ms: number): void {
  const fresh = model.version !== version;
  version = model.version;
  pace.frame(now_ms);
  const age_ms = now_ms - model.lastFrameMs;
  live.known = Number.isFinite(model.lastFrameMs);
  live.old_s = live.known && age_ms > STALE_MS ? Math.round(age_ms / 1000) : null;
  if (now_ms >= read_ms + READ_MS && version !== read_version) {
    [read_ms, read_version] = [now_ms, version];
    live.sensors = model.sensors;
    live.body = model.body;
  }
  turn(now_ms);
  for (const draw of drawn) draw(now_ms, fresh);
  requestAnimationFrame(frame);
}

function turn(now_ms: number): void {
  if (next >= turns.length) {
    if (turns.length === 0 || now_ms < round_ms + READ_MS) return;
    next = 0;
  }
  if (next === 0) round_ms = now_ms;
  turns[next++]!();
}

requestAnimationFrame(frame);
