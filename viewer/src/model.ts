// What the daemon has said: the newest state of each topic, a short history for curves and trails, the last events.
// Bounded: it never grows over hours.

import type { Change, ExerciseEventMessage, FaultEvent, FaultMap, FieldEventMessage, FigureMessage, Hello, HelloBody, JobsMessage, KeyPoseMessage, Look, LookBody, MotionSegmentMessage, Pose, ScrewMotion, SegmentEntry, SensorEntry, SensorsMessage, ServerMessage, StatusMessage, TruthsMessage, Vec3 } from "./protocol";
import { Rows } from "./rows";

/** Seconds of history for curves. */
export const HISTORY_S = 20;
const HISTORY_ROWS = HISTORY_S * 60;
const EVENTS = 200;
/** Rates that are kept of a sensor: those of a minute. */
const RATES = 60;
/** Of a sensor's history: m, m/s. */
const HISTORY_NAMES = ["x", "y", "z", "speed", "sigma"];

/** In the address: who is looked at. */
export const PERSON = "person";

function personOf(bodies: readonly HelloBody[]): string | null {
  const asked = new URLSearchParams(location.search).get(PERSON);
  return (bodies.find(({ name }) => name === asked) ?? bodies[0])?.name ?? null;
}

/** Appends to the rows of a name, which begin with its first values. */
function keep(all: Map<string, Rows>, name: string, t_s: number, values: Record<string, number | null>): void {
  let rows = all.get(name);
  if (!rows) all.set(name, (rows = new Rows(Object.keys(values), HISTORY_ROWS)));
  rows.begin(t_s);
  rows.names.forEach((key, i) => rows.set(i + 1, values[key]));
}

/** All faults of one cause at one sensor: when the newest began or ended, and how many there were. */
export type Faults = { sensor: string; cause: string; t_s: number; times: number; active: boolean };

/** A map of the field that was swapped in. */
export type FieldMap = Extract<FieldEventMessage, { event: "map_swapped" }>;

/** A body as it is drawn. */
export type Seen = { segments: readonly (Pick<SegmentEntry, "name" | "position_m" | "orientation_wxyz"> & Partial<SegmentEntry>)[]; contacts?: FigureMessage["contacts"] };

/** A repetition that has been judged. */
export type Repetition = Extract<ExerciseEventMessage, { event: "counted" | "rejected" }>;

function remember(history: Rows, t_s: number, [x, y, z]: Vec3, sigma_m: number | null | undefined): void {
  history.begin(t_s);
  history.set(1, x);
  history.set(2, y);
  history.set(3, z);
  const dt_s = t_s - history.newest(0, 1);
  const moved_m = Math.hypot(x - history.newest(1, 1), y - history.newest(2, 1), z - history.newest(3, 1));
  if (dt_s > 0) history.set(4, moved_m / dt_s);
  history.set(5, sigma_m);
}

export class Model {
  hello: Hello | null = null;
  sensors: SensorsMessage | null = null;
  /** Of who is looked at: {@link person}. */
  body: FigureMessage | null = null;
  /** The newest of everybody, by name. */
  readonly bodies = new Map<string, FigureMessage>();
  /** Who is looked at, by the name of the body: whom the address names, or the first one. */
  person: string | null = null;
  /** What somebody looks at in a recording in the place of what plays: sensors and bodies by name; null: nobody does. */
  private moment: { sensors: SensorEntry[]; bodies: Map<string, Seen> } | null = null;
  /** Bodies of another recording, over those of this one. */
  beside: readonly LookBody[] = [];
  truth: TruthsMessage | null = null;
  status: StatusMessage | null = null;
  jobs: JobsMessage | null = null;
  /** By sensor and cause. */
  readonly faults = new Map<string, Faults>();
  faultMap: FaultMap | null = null;
  /** The map of the field that is in use, as it was swapped in. */
  fieldMap: FieldMap | null = null;
  /** Where the transmitter stands now. */
  transmitter: Pose | null = null;
  /** By sensor: what it did between its latest two key poses. */
  readonly screws = new Map<string, ScrewMotion>();
  /** What was said of segments of the motion and not taken back, by beginning. */
  segments: MotionSegmentMessage[] = [];
  /** By sensor: where it was. */
  readonly history = new Map<string, Rows>();
  /** Repetitions that were counted or refused. */
  repetitions: Repetition[] = [];
  /** By joint: its angles, and their standard deviations. */
  readonly angles = new Map<string, Rows>();
  readonly angleSigmas = new Map<string, Rows>();
  /** By sensor: the statistic of key poses, and what a peak of it must exceed. */
  readonly changes = new Map<string, Rows>();
  /** By sensor: its rate in the last minute, Hz, once a second. */
  readonly rates = new Map<string, number[]>();
  /** By device: the share of its records of the last minute that were refused, 0 to 1. */
  readonly refused = new Map<string, number>();
  private readonly records = new Map<string, [records: number, rejected: number][]>();
  /** Confirmed ones. */
  keyPoses: KeyPoseMessage[] = [];
  /** Browser time of the newest frame, ms. */
  lastFrameMs = -Infinity;
  /** Rises with every message, so that views see whether there is something to draw. */
  version = 0;
  private readonly listeners = new Set<(message: ServerMessage) => void>();

  /** What exercises of this page are counted for. */
  get subject(): string {
    return this.several ? this.person! : "default";
  }

  /** Whether there is more than one person. */
  get several(): boolean {
    return (this.hello?.bodies.length ?? 0) > 1;
  }

  /** Who is looked at; null on a stage without bodies. */
  get looked(): HelloBody | null {
    return this.hello?.bodies.find(({ name }) => name === this.person) ?? null;
  }

  /** What requests about the person carry: nothing where there is only one. */
  get about(): { body?: string } {
    return this.several ? { body: this.person! } : {};
  }

  /** What the picture shows of sensors: what came last, or what is looked at. */
  get seenSensors(): SensorEntry[] | null {
    return this.moment?.sensors ?? this.sensors?.sensors ?? null;
  }

  /** What the picture shows of a body. */
  seenBody(name: string): Seen | undefined {
    return this.moment ? this.moment.bodies.get(name) : this.bodies.get(name);
  }

  /** Shows a moment of the recording in the picture; null: what plays. */
  look(moment: Look | null): void {
    this.version++;
    const known = new Map(moment?.sensors.map((sensor) => [sensor.name, sensor]));
    // All of the stage, in its order: what was not good then is missing.
    const entry = (name: string): SensorEntry => ({ name, state: known.has(name) ? "ok" : "missing", ...known.get(name) });
    this.moment = moment && {
      sensors: (this.hello?.sensors ?? []).map(({ name }) => entry(name)),
      bodies: new Map(moment.bodies.map((body): [string, Seen] => [body.name, body])),
    };
  }

  /** Shows the bodies of another recording beside; null: none. */
  lookBeside(moment: Look | null): void {
    this.version++;
    this.beside = moment?.bodies ?? [];
  }

  /** Calls `listener` for each message, after it has been taken in. */
  listen(listener: (message: ServerMessage) => void): void {
    this.listeners.add(listener);
  }

  take(message: ServerMessage): void {
    this.version++;
    switch (message.type) {
      case "hello":
        this.hello = message;
        this.person = personOf(message.bodies);
        this.bodies.clear();
        this.history.clear();
        this.angles.clear();
        this.angleSigmas.clear();
        this.changes.clear();
        this.rates.clear();
        this.records.clear();
        this.refused.clear();
        this.keyPoses = [];
        this.body = null;
        this.moment = null;
        this.truth = null;
        this.faultMap = null;
        this.fieldMap = null;
        this.transmitter = message.transmitter;
        this.screws.clear();
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
        if (message.screw) this.screws.set(message.sensor, message.screw);
        if (message.phase === "confirmed") this.keyPoses.push(message);
        if (this.keyPoses.length > EVENTS) this.keyPoses.shift();
        break;
      case "status":
        this.status = message;
        this.takeRates(message);
        this.takeRecords(message);
        break;
      case "jobs":
        this.jobs = message;
        break;
      case "faults":
        if (message.event === "map") {
          this.faultMap = message;
          break;
        }
        this.takeFault(message);
        break;
      case "segments":
        this.takeSegment(message);
        break;
      case "field":
        if (message.event === "map_swapped") this.fieldMap = message;
        else if (message.event === "model_swapped" && message.model.kind === "transmitter") this.transmitter = message.model;
        break;
      case "exercise":
        if ((message.subject ?? this.subject) !== this.subject) break;
        if (message.event === "counted" || message.event === "rejected") this.repetitions.push(message);
        if (this.repetitions.length > EVENTS) this.repetitions.shift();
        break;
    }
    this.listeners.forEach((listener) => listener(message));
  }

  private takeRates({ sensors }: StatusMessage): void {
    for (const { name, rate_hz } of sensors) {
      if (rate_hz === null) continue;
      // A new list each time: who draws it sees that it has changed.
      this.rates.set(name, [...(this.rates.get(name) ?? []), rate_hz].slice(-RATES));
    }
  }

  private takeRecords({ devices }: StatusMessage): void {
    for (const { name, records, rejected } of devices) {
      const kept = [...(this.records.get(name) ?? []), [records, rejected] as [number, number]].slice(-RATES);
      this.records.set(name, kept);
      const [[good, bad]] = kept as [[number, number]];
      this.refused.set(name, (rejected - bad) / Math.max(1, records - good + rejected - bad));
    }
  }

  private takeFault({ sensor, cause, t_s, active }: FaultEvent): void {
    const name = `${sensor}\n${cause}`;
    const times = (this.faults.get(name)?.times ?? 0) + Number(active);
    // One whose beginning was missed is one all the same.
    this.faults.set(name, { sensor, cause, t_s, times: Math.max(times, 1), active });
  }

  private takeSegment(message: MotionSegmentMessage): void {
    if (message.body !== null && message.body !== this.person) return;
    const rewound = message.t_s < (this.segments.at(-1)?.t_s ?? -Infinity);
    const others = rewound ? [] : this.segments.filter(({ segment }) => segment !== message.segment);
    if (message.event !== "withdrawn") others.push(message);
    this.segments = others.sort((a, b) => a.t_valid_s - b.t_valid_s).slice(-EVENTS);
  }

  private takeBody(message: FigureMessage): void {
    this.bodies.set(message.name, message);
    if (message.name !== this.person) return;
    if (this.body !== null && message.t_s < this.body.t_s) {
      this.angles.clear();
      this.angleSigmas.clear();
    }
    this.body = message;
    for (const { name, angles_deg, angle_sigmas_deg } of message.joints) {
      // Of a joint that nothing has shown yet there is nothing to draw.
      if (!this.angles.has(name) && Object.values(angles_deg).every((angle) => angle === null)) continue;
      keep(this.angles, name, message.t_s, angles_deg);
      keep(this.angleSigmas, name, message.t_s, angle_sigmas_deg);
    }
  }

  private takeChange(name: string, { t_s, score, threshold }: Change): void {
    let rows = this.changes.get(name);
    if (!rows) this.changes.set(name, (rows = new Rows(["score", "threshold"], HISTORY_ROWS)));
    rows.begin(t_s);
    rows.set(1, score);
    rows.set(2, threshold);
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
      if (!history) this.history.set(name, (history = new Rows(HISTORY_NAMES, HISTORY_ROWS)));
      remember(history, message.t_s, position_m, sigma_m);
    }
  }
}
