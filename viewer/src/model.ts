// What the daemon has said: the newest state of each topic, a short history for curves and trails, the last events.
// Bounded: it never grows over hours.

import type { Change, ExerciseEventMessage, FaultEvent, FaultMap, FigureMessage, Hello, JobsMessage, KeyPoseMessage, SegmentMessage, SensorsMessage, ServerMessage, StatusMessage, TruthsMessage } from "./protocol";

/** Seconds of history for curves. */
export const HISTORY_S = 20;
const HISTORY_ROWS = HISTORY_S * 60;
const EVENTS = 200;

/** The last rows of one sensor, oldest overwritten: t, x, y, z, speed, sigma. */
export class History {
  static readonly COLUMNS = 6;
  private readonly rows = new Float64Array(HISTORY_ROWS * History.COLUMNS);
  private next = 0;
  length = 0;

  push(t_s: number, x: number, y: number, z: number, sigma_m: number): void {
    const before = this.length > 0 ? this.at(this.length - 1) : null;
    const dt = before ? t_s - before[0]! : 0;
    const speed = before && dt > 0 ? Math.hypot(x - before[1]!, y - before[2]!, z - before[3]!) / dt : 0;
    this.rows.set([t_s, x, y, z, speed, sigma_m], this.next * History.COLUMNS);
    this.next = (this.next + 1) % HISTORY_ROWS;
    this.length = Math.min(this.length + 1, HISTORY_ROWS);
  }

  /** Row `index`, 0 the oldest; a view, not a copy. */
  at(index: number): Float64Array {
    const row = (this.next - this.length + index + HISTORY_ROWS) % HISTORY_ROWS;
    return this.rows.subarray(row * History.COLUMNS, (row + 1) * History.COLUMNS);
  }

  /** A column, oldest first. */
  column(index: number): Float64Array {
    const out = new Float64Array(this.length);
    for (let i = 0; i < this.length; i++) out[i] = this.at(i)[index]!;
    return out;
  }

  clear(): void {
    this.length = 0;
    this.next = 0;
  }
}

/** The last rows of named numbers, oldest overwritten: t and one column per name. */
export class Series {
  readonly names: string[];
  private readonly width: number;
  private readonly rows: Float64Array;
  private next = 0;
  length = 0;

  constructor(names: string[]) {
    this.names = names;
    this.width = names.length + 1;
    this.rows = new Float64Array(HISTORY_ROWS * this.width);
  }

  push(t_s: number, values: Record<string, number | null>): void {
    const row = this.next * this.width;
    this.rows[row] = t_s;
    this.names.forEach((name, i) => (this.rows[row + 1 + i] = values[name] ?? NaN));
    this.next = (this.next + 1) % HISTORY_ROWS;
    this.length = Math.min(this.length + 1, HISTORY_ROWS);
  }

  /** A column, oldest first; 0 is the time. */
  column(index: number): Float64Array {
    const out = new Float64Array(this.length);
    for (let i = 0; i < this.length; i++) {
      out[i] = this.rows[((this.next - this.length + i + HISTORY_ROWS) % HISTORY_ROWS) * this.width + index]!;
    }
    return out;
  }
}

/** Appends to the series of a name, which begins with its first values. */
function keep(all: Map<string, Series>, name: string, t_s: number, values: Record<string, number | null>): void {
  let series = all.get(name);
  if (!series) all.set(name, (series = new Series(Object.keys(values))));
  series.push(t_s, values);
}

/** A repetition that has been judged. */
export type Repetition = Extract<ExerciseEventMessage, { event: "counted" | "rejected" }>;

export class Model {
  hello: Hello | null = null;
  sensors: SensorsMessage | null = null;
  body: FigureMessage | null = null;
  truth: TruthsMessage | null = null;
  status: StatusMessage | null = null;
  jobs: JobsMessage | null = null;
  faults: FaultEvent[] = [];
  faultMap: FaultMap | null = null;
  /** What was said of segments of the motion and not taken back, by beginning. */
  segments: SegmentMessage[] = [];
  readonly history = new Map<string, History>();
  /** Repetitions that were counted or refused. */
  repetitions: Repetition[] = [];
  /** By joint: its angles, and their standard deviations. */
  readonly angles = new Map<string, Series>();
  readonly angleSigmas = new Map<string, Series>();
  /** By sensor: the statistic of key poses, and what a peak of it must exceed. */
  readonly changes = new Map<string, Series>();
  /** Confirmed ones. */
  keyPoses: KeyPoseMessage[] = [];
  /** Browser time of the newest frame, ms. */
  lastFrameMs = -Infinity;
  /** Rises with every message, so that views see whether there is something to draw. */
  version = 0;
  private readonly listeners = new Set<(message: ServerMessage) => void>();

  /** Calls `listener` for each message, after it has been taken in. */
  listen(listener: (message: ServerMessage) => void): void {
    this.listeners.add(listener);
  }

  take(message: ServerMessage): void {
    this.version++;
    switch (message.type) {
      case "hello":
        this.hello = message;
        this.history.clear();
        this.angles.clear();
        this.angleSigmas.clear();
        this.changes.clear();
        this.keyPoses = [];
        this.body = null;
        this.truth = null;
        this.faultMap = null;
        this.segments = [];
        this.repetitions = [];
        break;
      case "sensors":
        this.takeSensors(message);
        break;
      case "body":
        this.takeBody(message);
        break;
      case "truth":
        this.truth = message;
        break;
      case "keyframes":
        if (message.phase === "confirmed") this.keyPoses.push(message);
        if (this.keyPoses.length > EVENTS) this.keyPoses.shift();
        break;
      case "status":
        this.status = message;
        break;
      case "jobs":
        this.jobs = message;
        break;
      case "faults":
        if (message.event === "map") {
          this.faultMap = message;
          break;
        }
        this.faults.push(message);
        if (this.faults.length > EVENTS) this.faults.shift();
        break;
      case "segments":
        this.takeSegment(message);
        break;
      case "exercise":
        if (message.event === "counted" || message.event === "rejected") this.repetitions.push(message);
        if (this.repetitions.length > EVENTS) this.repetitions.shift();
        break;
    }
    this.listeners.forEach((listener) => listener(message));
  }

  private takeSegment(message: SegmentMessage): void {
    const rewound = message.t_s < (this.segments.at(-1)?.t_s ?? -Infinity);
    const others = rewound ? [] : this.segments.filter(({ segment }) => segment !== message.segment);
    if (message.event !== "withdrawn") others.push(message);
    this.segments = others.sort((a, b) => a.t_valid_s - b.t_valid_s).slice(-EVENTS);
  }

  private takeBody(message: FigureMessage): void {
    if (this.body !== null && message.t_s < this.body.t_s) {
      this.angles.clear();
      this.angleSigmas.clear();
    }
    this.body = message;
    for (const { name, angles_deg, angle_sigmas_deg } of message.joints) {
      keep(this.angles, name, message.t_s, angles_deg);
      keep(this.angleSigmas, name, message.t_s, angle_sigmas_deg);
    }
  }

  private takeChange(name: string, { t_s, score, threshold }: Change): void {
    let series = this.changes.get(name);
    if (!series) this.changes.set(name, (series = new Series(["score", "threshold"])));
    series.push(t_s, { score, threshold });
  }

  private takeSensors(message: SensorsMessage): void {
    const rewound = this.sensors !== null && message.t_s < this.sensors.t_s;
    this.sensors = message;
    this.lastFrameMs = performance.now();
    if (rewound) {
      this.history.forEach((history) => history.clear());
      this.changes.clear();
      this.keyPoses = [];
    }
    for (const { name, position_m, sigma_m, change } of message.sensors) {
      if (change) this.takeChange(name, change);
      if (!position_m) continue;
      let history = this.history.get(name);
      if (!history) this.history.set(name, (history = new History()));
      history.push(message.t_s, ...position_m, sigma_m ?? NaN);
    }
  }
}
