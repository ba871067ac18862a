// Messages of the posed websocket. Generated from the Rust types by `posed schema --typescript`; do not edit.

/** How units on the intra-bird bus are numbered. */
export type Addressing = "normal" | "expanded" | "super-expanded";

/** A surveyed point that a sensor of the pole stood on. */
export type AnchorSpec = {
  /** For messages. */
  name: string;
  /** The point in the transmitter frame, m. */
  position_m: [number, number, number];
  /** The sensor, by name. */
  sensor: string;
  /** Until when, stream time, s. */
  t_end: number;
  /** From when, stream time, s. */
  t_start: number;
};

/** What a request was answered with; which one gets which: [`Answers`]. All others are answered with `ok` alone. */
export type Answer = Resumed | RecordingBegun | Started | Forgotten | Recordings | Tracked | Takes | Digested | Removed | Look | Labels | HealthHistory | Exercises | Demonstration | MapVersion | Setup | Invitation | Phones | KeptFile | SessionBegun | ListedSessions | Shown | Report | People | Plans | Renamed;

/** The `result` of each request that has one, by the request's `type`. */
export type Answers = {
  "body.calibrate": Started;
  "exercise.demonstration": Demonstration;
  "exercise.list": Exercises;
  "exercise.teach": Started;
  "faults.name_cell": KeptFile;
  "faults.train": Started;
  "field.accept": MapVersion;
  "field.finish": Started;
  "field.rollback": MapVersion;
  "health.history": HealthHistory;
  "imu.calibrate": Started;
  "library.digest": Digested;
  "library.empty_bin": Removed;
  "library.export": Started;
  "library.list": Takes;
  "library.remove": Renamed;
  "library.rename": Renamed;
  "library.restore": Renamed;
  "phone.invite": Invitation;
  "phone.list": Phones;
  "record.start": RecordingBegun;
  "replay.label": Labels;
  "replay.labels": Labels;
  "replay.list": Recordings;
  "replay.look": Look;
  "replay.seek": Started;
  "replay.track": Tracked;
  resume: Resumed;
  "segments.train": Started;
  "session.begin": SessionBegun;
  "session.forget": Forgotten;
  "session.list": ListedSessions;
  "session.people": People;
  "session.plans": Plans;
  "session.report": Report;
  "session.show": Shown;
  "setup.find": Started;
  "setup.read": Setup;
  "stage.align": Started;
};

/** A repetition that is not judged. */
export type Begun = {
  /** Repetitions counted since it was selected or reset; only rises. */
  count: number;
  /** The exercise. */
  exercise: string;
  /** Repetitions of the set. */
  set_count: number;
  /** Beginning of the repetition, s. */
  t_start_s: number;
};

/** A hinge between two sensors. */
export type CalibratedHinge = {
  /** The same axis in the segment's own sensor. */
  axis: [number, number, number];
  /** Unit axis in the parent's sensor. */
  parent_axis: [number, number, number];
  /** How far two halves of the movement disagree about the axis, degrees. */
  quality_deg: number;
  /** Angle that counts as zero, rad, beside that of the segments' frames. */
  zero_rad: number;
};

/** How one sensor of a chain sits. */
export type CalibratedSegment = {
  /** The hinge to its parent; absent for the root. */
  hinge?: CalibratedHinge | null;
  /** The segment. */
  name: string;
  /** Turns segment coordinates into the sensor's. */
  quat_wxyz: [number, number, number, number];
};

/** Requests for the daemon. All but those that only tell something need the role `operate`: `replay.list`, `replay.track`, `replay.look`, `replay.labels`, `library.list`, `library.digest` without `make`, `health.history`, `exercise.list` and `exercise.demonstration`. */
export type Call = {
  /** The reply carries it. */
  id: RequestId;
  /** File name within the recordings' folder, without a path; absent: stage and time. */
  name?: string | null;
  type: "record.start";
} | {
  /** The reply carries it. */
  id: RequestId;
  type: "record.stop";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** What happens now, 200 bytes at most; absent: nothing is said of it. */
  label?: string | null;
  type: "mark";
} | {
  /** The reply carries it. */
  id: RequestId;
  type: "replay.list";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** A name that `replay.list` gave. */
  name: string;
  type: "replay.open";
} | {
  /** Up to six channels; absent: only their names are answered. */
  columns?: string[];
  /** The reply carries it. */
  id: RequestId;
  /** A name that `replay.list` gave. */
  name: string;
  type: "replay.track";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** Seconds since the recording's epoch. */
  t_s: number;
  type: "replay.seek";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** Multiple of real time; 0 pauses. */
  speed: Speed;
  type: "replay.speed";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** Seconds since the recording's epoch. */
  t_s: number;
  type: "replay.look";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** A name that `library.list` gave. */
  name: string;
  type: "replay.labels";
} | {
  /** Since when, stage time, s. */
  from_s: number;
  /** The reply carries it. */
  id: RequestId;
  /** What it shows, 200 bytes at most; empty: nothing is said of that time any more. */
  label: string;
  /** A name that `library.list` gave. */
  name: string;
  /** Until when, s. */
  to_s: number;
  type: "replay.label";
} | {
  /** Those in the bin instead; absent: those in the folder. */
  bin?: boolean;
  /** The reply carries it. */
  id: RequestId;
  type: "library.list";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** Whether a job makes one where there is none: by a replay, as long as that takes; needs the role `operate`. Absent: no. */
  make?: boolean;
  /** A name that `library.list` gave. */
  name: string;
  type: "library.digest";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** A name that `library.list` gave. */
  name: string;
  /** File name of letters, digits, `-`, `_`, `.` and spaces, without a path; one that is free. */
  to: string;
  type: "library.rename";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** A name that `library.list` gave. */
  name: string;
  type: "library.remove";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** A name that `library.list` of the bin gave. */
  name: string;
  type: "library.restore";
} | {
  /** The reply carries it. */
  id: RequestId;
  type: "library.empty_bin";
} | {
  /** As `--body`: which of several bodies is shown, by name. */
  body?: string | null;
  /** As `--bones`, for `bvh`; absent: `posed`. */
  bones?: string | null;
  /** As `--to` of `posed export`: `csv`, `jsonl`, `bvh`, `trc`, `glb`, `vrm`, `vrma`, `usda`, `c3d`, `sto`, `mot`, `mcap`. */
  format: string;
  /** As `--frame`, for `csv`: `room` or `transmitter`; absent: `room`. */
  frame?: string | null;
  /** The reply carries it. */
  id: RequestId;
  /** As `--model`, for `mot`; absent: `rajagopal`. */
  model?: string | null;
  /** A name that `library.list` gave. */
  name: string;
  type: "library.export";
} | {
  /** The reply carries it. */
  id: RequestId;
  type: "health.history";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** The pole's sensors by name, in their order along it. */
  sensors: string[];
  /** Measured distance between neighbours, m. */
  spacing_m: number;
  type: "field.start";
} | {
  /** Surveyed points that a sensor of the pole stood on meanwhile; three or more make positions absolute. */
  anchors?: AnchorSpec[];
  /** The reply carries it. */
  id: RequestId;
  type: "field.finish";
} | {
  /** The reply carries it. */
  id: RequestId;
  type: "field.accept";
} | {
  /** The reply carries it. */
  id: RequestId;
  type: "field.rollback";
} | {
  /** The reply carries it. */
  id: RequestId;
  type: "exercise.list";
} | {
  /** Its name, as `exercise.list` gave it. */
  exercise: string;
  /** The reply carries it. */
  id: RequestId;
  type: "exercise.demonstration";
} | {
  /** The body whose joints are looked at, by name; absent: the one that is called as the subject, or else the first one. */
  body?: string | null;
  /** Only these channels; absent: those that do the same in every repetition. */
  channels?: string[] | null;
  /** The reply carries it. */
  id: RequestId;
  /** The repetitions lie in the last so many seconds; absent: they are about to be done, and the job ends once they were done and the subject rests. */
  last_s?: number | null;
  /** Name of the exercise: 1 to 64 letters, digits, spaces, `-` and `_`. */
  name: string;
  /** How many repetitions it is taught from; 3 to 10 are good. */
  repetitions: number;
  /** Only these sensors, by name; absent: all. */
  sensors?: string[] | null;
  /** Who moves; absent: the name of the body, or `default`. */
  subject?: string | null;
  type: "exercise.teach";
} | {
  /** The body whose joints are counted, by name; absent: the one that is called as the subject, or else the first one. */
  body?: string | null;
  /** Their names; none ends the counting. */
  exercises: string[];
  /** The reply carries it. */
  id: RequestId;
  /** Repetitions of a set; absent: one set without end. */
  repetitions?: number | null;
  /** Rest after a set, s; absent: none. */
  rest_s?: number | null;
  /** For each sensor that the exercises were taught with the one that this subject wears; absent: the same. */
  sensors?: Record<string, string> | null;
  /** Sets of each exercise; absent: no end. */
  sets?: number | null;
  /** Who moves; absent: the name of the body, or `default`. */
  subject?: string | null;
  type: "exercise.select";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** Who moves; absent: `default`. */
  subject?: string | null;
  type: "exercise.reset";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** From the last so many seconds; absent: from all that is remembered, five minutes at most. */
  last_s?: number | null;
  /** From a recording instead: a name that `replay.list` gave. */
  recording?: string | null;
  type: "faults.train";
} | {
  /** What frames of this cell are. */
  class: FaultClass;
  /** Column, from 0. */
  column: number;
  /** The reply carries it. */
  id: RequestId;
  /** Row, from 0. */
  row: number;
  type: "faults.name_cell";
} | {
  /** Most epochs; absent: 30. */
  epochs?: number | null;
  /** The reply carries it. */
  id: RequestId;
  /** Frames of 1/24 s that the network may look ahead: the fewer, the sooner labels are sure. More than 40, half of what it sees, is 40; absent: 40. */
  look_ahead?: number | null;
  type: "segments.train";
} | {
  /** The person, by the name of the body; absent: the only one. */
  body?: string | null;
  /** How much is asked for; absent: `full`. */
  how?: Thoroughness | null;
  /** The reply carries it. */
  id: RequestId;
  type: "body.calibrate";
} | {
  /** The person, by the name of the body; absent: the one who wears the IMU, or the only one. */
  body?: string | null;
  /** How far to the left of the room's x the person looks, degrees, -360 to 360; absent: 0. */
  heading_deg?: number | null;
  /** The reply carries it. */
  id: RequestId;
  /** The IMU, by name; absent: all on the body. */
  sensor?: string | null;
  type: "heading.reset";
} | {
  /** Surveyed points of the room that the sensor is held at, in this order; three or more where no IMU is attached to it. */
  anchors?: RoomPoint[];
  /** The reply carries it. */
  id: RequestId;
  /** The magnetic sensor, by name; absent: the first that has an IMU, else the first. */
  sensor?: string | null;
  type: "stage.align";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** The sensor, by name; absent: the only IMU of the stage. */
  sensor?: string | null;
  type: "imu.calibrate";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** Who trains: a name or a number of 1 to 64 bytes; taken in where it is new. */
  person: string;
  /** A plan that `session.plans` gave; absent: what is selected by hand. */
  plan?: string | null;
  /** The subject of the exercises; absent: `default`. */
  subject?: string | null;
  type: "session.begin";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** Of this subject; absent: `default`. */
  subject?: string | null;
  type: "session.end";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** At most so many, 1 to 1000; absent: 100. */
  limit?: number | null;
  /** Only those of this person. */
  person?: string | null;
  type: "session.list";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** Its number. */
  session: number;
  type: "session.show";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** In which language; absent: `english`. */
  language?: ReportLanguage | null;
  /** the person. */
  person?: string | null;
  /** Number of the session; or */
  session?: number | null;
  /** Time zone of its dates by its IANA name, `Europe/Berlin`; absent: that of the daemon. */
  time_zone?: string | null;
  type: "session.report";
} | {
  /** Repetitions that were really done. */
  counted: number;
  /** The reply carries it. */
  id: RequestId;
  /** Number of the session. */
  session: number;
  /** Number of the set in it. */
  set: number;
  type: "session.correct";
} | {
  /** The reply carries it. */
  id: RequestId;
  type: "session.people";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** Who. */
  person: string;
  /** Whether the recordings of their sessions go too, whoever else is in them. */
  recordings: boolean;
  type: "session.forget";
} | {
  /** The reply carries it. */
  id: RequestId;
  type: "session.plans";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** The plan. */
  plan: Plan;
  type: "session.save_plan";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** Its name. */
  name: string;
  type: "session.delete_plan";
} | {
  /** Made one after the other; none: the file as it is. */
  changes?: StageChange[];
  /** The reply carries it. */
  id: RequestId;
  type: "setup.read";
} | {
  /** Made one after the other. */
  changes: StageChange[];
  /** The reply carries it. */
  id: RequestId;
  /** The `revision` that `setup.read` gave. */
  revision: string;
  type: "setup.save";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** Only this one: path of a serial port, tcp://HOST:PORT or udp://HOST:PORT; absent: all serial ports, and the units that announce themselves on the network. */
  port?: string | null;
  type: "setup.find";
} | {
  /** The reply carries it. */
  id: RequestId;
  type: "phone.invite";
} | {
  /** The reply carries it. */
  id: RequestId;
  type: "phone.list";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** Its id. */
  phone_id: string;
  type: "phone.blink";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** Its number. */
  job: number;
  type: "job.cancel";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** The model, in full. */
  model: Model;
  type: "model.load";
};

/** What tells of a disturbance. */
export type Cause = "reference_sensor" | "rigid_pair" | "hum";

/** What a calibration found of a chain. */
export type ChainCalibration = {
  /** One per segment, in the order of the stage file. */
  segments: CalibratedSegment[];
};

/** The statistic of key poses: it speaks of an earlier frame, since it needs the frames around it. */
export type Change = {
  /** How clear a change of motion there would be: without unit, comparable between sensors; with `method = "paper"`, m a frame. */
  score: number;
  /** Capture time of the frame that it speaks of, s. */
  t_s: number;
  /** What a peak must exceed to be a key pose; with `method = "paper"`, a share of the mean motion before it. */
  threshold: number;
};

/** Everything a client can send. */
export type ClientMessage = Feed | Call;

/** How likely each foot stands on the floor, 0 to 1: any part of it, or without a sensor on it, all of it. */
export type Contacts = {
  /** The left foot. */
  foot_l: number;
  /** The right foot. */
  foot_r: number;
  /** Heel and toes of the left foot; null where it wears no sensor. */
  sole_l: Sole | null;
  /** Heel and toes of the right foot; null where it wears no sensor. */
  sole_r: Sole | null;
};

/** How an exercise was taught, as a figure that moves. */
export type Demonstration = {
  /** The angles that are shown, by their channels; all other joints hang straight. */
  angles: string[];
  /** How long a repetition takes, s: the median of the lesson. */
  duration_s: number;
  /** Name of the exercise. */
  exercise: string;
  /** The figure at equal distances in time, from the beginning of a repetition to its end. */
  frames: FigureSegment[][];
  /** How often it was taught. */
  revision: number;
};

/** How a repetition differed from the taught ones. */
export type Deviation = {
  /** The channel that deviated most. */
  channel: string;
  /** Duration of each fifth of the movement, the taught one being 1. */
  fifth_tempo: [number, number, number, number, number];
  /** Log dimensionless jerk above the taught one; 0.7 is twice the jerk. */
  jerk: number;
  /** Where in the movement: 0 is the beginning, 1 the end. */
  phase: number;
  /** Range of the channel, the taught one being 1. */
  range: number;
  /** Its deviation, in the channel's unit; positive is more than taught. At a turning point that of its way, beside how far the other joints went. */
  size: number;
  /** Duration, the taught median being 1. */
  tempo: number;
  /** The same, the least that is worth a word being 1; 0 of a channel that no word is said of. */
  worth: number;
};

/** In which way a channel deviates. */
export type DeviationKind = "too_far" | "short" | "too_high" | "too_low" | "moved";

/** Health of a device. Counts never go back. */
export type DeviceStatus = {
  /** Age of its newest sample, s; null before the first. */
  age_s: number | null;
  /** Bytes that belong to no accepted record and no answer. */
  bytes_skipped: number;
  /** Its driver. */
  driver: string;
  /** Its name. */
  name: string;
  /** Its port. */
  port: string;
  /** Measured rate, Hz; null until known. */
  rate_hz: number | null;
  /** Why, and what to check; null while streaming. */
  reason: string | null;
  /** Records accepted. */
  records: number;
  /** Records refused. */
  rejected: number;
  /** How well its clock is fitted to the host's: standard deviation of its capture times, s; null until known. */
  sigma_t_s: number | null;
  /** What its link does. */
  state: LinkState;
};

/** What happens in a recording. Times are stage time, s, as in `status.replay`. Of more than 2000 of a kind an even choice is listed. */
export type Digest = {
  /** Stage time at which the recording begins, s. */
  begun_s: number;
  /** How many of each kind happened. */
  counts: DigestCounts;
  /** How many of each kind are not listed. */
  dropped: DigestCounts;
  /** Faults of sensors. One that has gone on since before the recording is in it from its end on. */
  faults: FaultSpan[];
  /** Capture time of its first frame, s: labels that are kept beside it count from there. Null where there is none. */
  first_frame_s: number | null;
  /** Confirmed key poses. */
  key_poses: DigestKeyPose[];
  /** From there to its last entry, s. */
  length_s: number;
  /** Moments that somebody noted. */
  marks: DigestMark[];
  /** Where sensors went. */
  picture: Picture;
  /** Repetitions that were judged. */
  repetitions: DigestRepetition[];
  /** Segments of motion. */
  segments: SegmentSpan[];
};

/** How many of each kind there are. */
export type DigestCounts = {
  /** Faults of sensors that began or went on. */
  faults: number;
  /** Confirmed key poses. */
  key_poses: number;
  /** Moments that somebody noted. */
  marks: number;
  /** Repetitions of exercises that were judged. */
  repetitions: number;
  /** Segments of motion. */
  segments: number;
};

/** A frame at which a sensor's motion changes. */
export type DigestKeyPose = {
  /** Which sensor. */
  sensor: string;
  /** When, s. */
  t_s: number;
};

/** A moment that somebody noted. */
export type DigestMark = {
  /** What happened, in their words; may be empty. */
  label: string;
  /** When, s. */
  t_s: number;
};

/** A repetition that was judged. */
export type DigestRepetition = {
  /** Whether it counts. */
  counted: boolean;
  /** The exercise. */
  exercise: string;
  /** Its beginning, s. */
  from_s: number;
  /** Who moved. */
  subject: string;
  /** Its end, s. */
  t_s: number;
};

/** What `library.digest` is answered with. */
export type Digested = {
  /** It. */
  digest: Digest;
} | {
  /** Always true. */
  unknown: boolean;
} | {
  /** Its number. */
  job: number;
};

/** What to do with messages for which a client is too slow. Either way the oldest goes first and is counted. */
export type DropPolicy = "latest" | "queue";

/** Durations of repetitions, s. */
export type Durations = {
  /** Median from the end of one to the end of the next; 0: not known. */
  interval_s?: number;
  /** Longest. */
  longest_s: number;
  /** Median. */
  median_s: number;
  /** Shortest. */
  shortest_s: number;
};

/** How a session ended. */
export type EndedBy = "request" | "plan" | "daemon" | "interruption" | "recording";

/** Whether the bytes of somebody who was forgotten are gone from the disk. */
export type Erasure = "done" | "pending";

/** Reply to a request that was not carried out. */
export type ErrorReply = {
  /** For programs: `bad_message`, `bad_request`, `unknown_type`, `unknown_sensor`, `forbidden`, `busy`, ... */
  code: string;
  /** The request's; null where it could not be read. */
  id: RequestId | null;
  /** For people: what was wrong and what would be right, in one sentence. */
  message: string;
  /** Which sentence, for who says it in another language; null where only `message` has it. */
  reason?: RefusalReason | null;
  /** What the sentence names, by name: all that another language needs to say `reason`. */
  values?: Record<string, string>;
};

/** A taught exercise. */
export type Exercise = {
  /** The channels it looks at, as `channels` names them. */
  channels: string[];
  /** Durations of the taught repetitions. */
  durations: Durations;
  /** `posed-exercise`. */
  format: string;
  /** What a repetition must be like to count. */
  gate: Gate;
  /** Log dimensionless jerk of the taught repetitions. */
  log_jerk: number;
  /** Values and velocities of the channels, in this order. */
  movement: Movement;
  /** Name, as in events. */
  name: string;
  /** Frames per second of the model. */
  rate_hz: number;
  /** Where each channel was while all joints of the lesson rested, in the order of `channels`; empty: not known. */
  rest?: number[];
  /** Counts how often an exercise of this name was taught, from 1. */
  revision?: number;
  /** Sizes in which the movement was taught, falling from 1: the first and the last step of a walk are smaller. */
  sizes?: number[];
  /** Joints that keep still in it; empty: nothing is known of them. */
  still?: Still[];
  /** Tempi in which it is counted, the taught one, 1, first: how fast joints go against the lesson. Other people go about it in their own. */
  tempi?: number[];
  /** Turning point of each channel, in the order of `channels`; empty: those of the states' means, whose spread is not known. */
  turns?: Turn[];
  /** Version of the format. */
  version: number;
};

/** What every data message starts with, and its body. */
export type ExerciseEventMessage = ({
  /** The channels it looks at. */
  channels: string[];
  /** Median duration of a repetition, s. */
  duration_s: number;
  event: "loaded";
  /** Its name. */
  exercise: string;
  /** How often an exercise of this name was taught. */
  revision: number;
} | {
  event: "state";
  /** How far the subject is. */
  state: ExerciseState;
} | Begun & {
  event: "started";
} | Begun & {
  event: "provisional";
} | Begun & {
  event: "withdrawn";
} | Judged & {
  event: "counted";
} | Judged & {
  event: "rejected";
} | {
  /** For half a second the movement has been likelier to be something else. */
  anomaly: boolean;
  event: "hint";
  /** Its name; null, like the rest: what was said before is over. */
  exercise: string | null;
  /** Where in the movement: 0 is the beginning, 1 the end. */
  phase: number | null;
  /** In words. */
  sentence: string | null;
  /** The same in German. */
  sentence_de: string | null;
}) & {
  /** Data messages of all topics that were dropped for this client so far. */
  dropped: number;
  /** Stage-wide number of the event, from 1. */
  event_id: number;
  /** Counts this topic's messages to this client from 0; a gap is a message that was dropped. */
  seq: number;
  /** Who moves; null where it concerns all. */
  subject: string | null;
  /** Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame). */
  t_s: number;
  /** Capture time it speaks of, s: of a repetition its end. */
  t_valid_s: number;
  /** Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`. */
  timecode?: string | null;
};

/** How far a subject is with an exercise. */
export type ExerciseProgress = {
  /** Repetitions since it was selected or reset. */
  count: number;
  /** All sets are complete. */
  done: boolean;
  /** Name of the exercise. */
  exercise: string;
  /** End of the rest that goes on, s; null: none. */
  rest_until_s: number | null;
  /** Number of the set, from 1. */
  set: number;
  /** Repetitions of that set. */
  set_count: number;
};

/** Exercises of a subject, and how far it is. */
export type ExerciseState = {
  /** The body whose joints are counted, by name; null on a stage without bodies. */
  body: string | null;
  /** The exercises that are counted. */
  exercises: ExerciseProgress[];
  /** Repetitions of a set; null: one set without end. */
  repetitions: number | null;
  /** Rest after a set, s. */
  rest_s: number;
  /** Sets of each exercise; null: no end. */
  sets: number | null;
};

/** The exercises of the stage's folder. */
export type Exercises = {
  /** By name. */
  exercises: KeptExercise[];
};

/** A family of units that share commands, words and error codes. */
export type Family = "flock" | "3d-guidance";

/** Why a measurement, or a sensor, is not simply good. */
export type FaultCause = "hemisphere_inversion" | "vertical_inversion" | "stuck" | "gate" | "missing" | "not_finite" | "saturated" | "misfit" | "swapped" | "jump" | "bone" | "map" | "distance";

/** What a measurement, or a frame, is. */
export type FaultClass = "clean" | "inverted" | "anomalous" | "unknown";

/** What every data message starts with, and its body. */
export type FaultMessage = ({
  /** Whether it began or ended. */
  active: boolean;
  /** What is wrong with it. */
  cause: FaultCause;
  event: "fault";
  /** Which sensor. */
  sensor: string;
} | {
  /** Class of each cell, row by row. */
  cells: FaultClass[];
  /** Columns of the map. */
  columns: number;
  event: "map";
  /** Counted up by `faults.train` and `faults.name_cell`. */
  revision: number;
  /** Rows of the map. */
  rows: number;
  /** The sensors that it knows. */
  sensors: string[];
  /** A frame that is farther from its cell than this is unusual. */
  usual_distance: number;
}) & {
  /** Data messages of all topics that were dropped for this client so far. */
  dropped: number;
  /** Stage-wide number of the event, from 1. */
  event_id: number;
  /** Counts this topic's messages to this client from 0; a gap is a message that was dropped. */
  seq: number;
  /** Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame). */
  t_s: number;
  /** Capture time it speaks of, s. */
  t_valid_s: number;
  /** Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`. */
  timecode?: string | null;
};

/** How long a sensor had a fault. */
export type FaultSpan = {
  /** What was wrong with it. */
  fault: FaultCause;
  /** Since when, s: the recording's beginning where it had begun before. */
  from_s: number;
  /** Which sensor. */
  sensor: string;
  /** Until when, s: the recording's end where it went on. */
  to_s: number;
};

/** Requests about what this client receives. */
export type Feed = {
  /** What to do when this client is too slow; absent: `latest`. */
  drop?: DropPolicy | null;
  /** What `sensors` and `truth` say of each sensor, beside its name and state; absent: `device`, `position_m`, `orientation_wxyz`, `sigma_m`. */
  fields?: Field[] | null;
  /** The reply carries it. */
  id: RequestId;
  /** At most so many messages per second and topic, events excepted; absent: every frame. */
  max_rate_hz?: number | null;
  /** Only these sensors, by name; absent: all. */
  sensors?: string[] | null;
  /** Which ones. */
  topics: Topic[];
  type: "subscribe";
} | {
  /** The reply carries it. */
  id: RequestId;
  /** Which ones. */
  topics: Topic[];
  type: "unsubscribe";
} | {
  /** The last `event_id` that the client has; 0: all. */
  after: number;
  /** The reply carries it. */
  id: RequestId;
  type: "resume";
};

/** Something that a `sensors` entry can say; name and state are always said. */
export type Field = "name" | "state" | "device" | "position_m" | "orientation_wxyz" | "sigma_m" | "measured" | "covariance" | "velocity" | "quality" | "fault" | "change";

/** What somebody is asked to do with the pole. Directions and places are in the transmitter's frame. */
export type FieldAsk = {
  ask: "show";
} | {
  ask: "move";
} | {
  ask: "begin";
  /** Instants that could be used so far. */
  instants: number;
} | {
  /** Which. */
  along: [number, number, number];
  ask: "carry";
  /** How far its middle has moved that way (standard deviation), m. */
  moved_m: number;
} | {
  /** Which. */
  along: [number, number, number];
  ask: "hold";
} | {
  /** Which. */
  along: [number, number, number];
  ask: "hold_once";
} | {
  ask: "visit";
  /** Middle of what was not, m. */
  near_m: [number, number, number];
  /** Share of the volume that was visited, 0 to 1. */
  visited: number;
} | {
  ask: "go_on";
};

/** What every data message starts with, and its body. */
export type FieldEventMessage = ({
  event: "model_swapped";
  /** The model, in full. */
  model: Model;
} | {
  /** Rms at the anchors, m; null without three. */
  anchors_m: number | null;
  /** What it does: pairs of a reading and its corrected place all over the calibrated volume, transmitter frame, m. */
  arrows_m: ([[number, number, number], [number, number, number]])[];
  event: "map_swapped";
  /** The same on blocks that were held out, m. */
  heldout_m: number | null;
  /** What it is made of; null: poses are not corrected. */
  map: string | null;
  /** Rms distance from straight poles when it was made, m: without correction, and with it; null without a map. */
  raw_m: number | null;
  /** See `raw_m`. */
  residual_m: number | null;
  /** Its number on this stage, 0 for none. */
  version: number;
} | {
  /** Began or ended. */
  active: boolean;
  /** What tells of it. */
  cause: Cause;
  /** How far off they are, m. */
  deviation_m: number;
  event: "disturbed";
  /** The reference sensor, or the pair. */
  sensors: string[];
} | {
  /** How far off they have stayed, m. */
  deviation_m: number;
  event: "drifted";
  /** The reference sensor, or the pair. */
  sensors: string[];
} | {
  event: "calibrating";
  /** Where it is. */
  progress: Progress;
}) & {
  /** Data messages of all topics that were dropped for this client so far. */
  dropped: number;
  /** Stage-wide number of the event, from 1. */
  event_id: number;
  /** Counts this topic's messages to this client from 0; a gap is a message that was dropped. */
  seq: number;
  /** Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame). */
  t_s: number;
  /** Capture time it speaks of, s. */
  t_valid_s: number;
  /** Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`. */
  timecode?: string | null;
};

/** What every data message starts with, and its body. */
export type FigureMessage = {
  /** How likely each foot stands; null unless sensors show the pelvis and both legs now. */
  contacts: Contacts | null;
  /** Data messages of all topics that were dropped for this client so far. */
  dropped: number;
  /** Where the heading comes from. */
  heading: HeadingSource;
  /** For how long it has been held without a field that is believed, s; 0 otherwise. */
  heading_held_s: number;
  /** Standard deviation of the heading, degrees: a calibrated magnetometer's, or how far calibrated gyros drift since a field last identified it, or since `heading.reset`; null where it is not known. */
  heading_sigma_deg: number | null;
  /** The joints between them. */
  joints: JointEntry[];
  /** Which body it is, by its name in the stage file. */
  name: string;
  /** Standard deviation of the position along each level axis, m: by trackers, or from where they were heard last, or where it began, by the feet; null where nobody knows how far it has gone. */
  position_sigma_m: number | null;
  /** Where the position comes from. */
  position_source: PositionSource;
  /** The segments, parents and children by the skeleton of the stage. */
  segments: SegmentEntry[];
  /** Counts this topic's messages to this client from 0; a gap is a message that was dropped. */
  seq: number;
  /** Capture time of the newest sample in it, s; rises strictly from one message of this body to the next. */
  t_s: number;
  /** Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`. */
  timecode?: string | null;
};

/** A segment of a figure that stands above the room's origin and looks along the room's x. */
export type FigureSegment = {
  /** Its name, as in `body`. */
  name: string;
  /** Segment to room, unit, scalar first. */
  orientation_wxyz: [number, number, number, number];
  /** Its origin, room, m. */
  position_m: [number, number, number];
};

/** What went with a person. */
export type Forgotten = {
  /** Whether the bytes are gone too. */
  erasure: Erasure;
  /** The recordings that these sessions name; whoever has the files removes them. */
  recordings: string[];
  /** Sessions with all that was in them. */
  sessions: number;
};

/** The `result` of a job of `setup.find`, of `posed doctor` likewise; grows while ports answer. */
export type Found = {
  /** What was found at each port. */
  ports: FoundPort[];
};

/** What was found at one port. */
export type FoundPort = {
  /** How units on the bus are numbered. */
  addressing: Addressing | null;
  /** The changes that add the device with its sensors to the stage file; none where nothing usable answers. */
  adds?: StageChange[];
  /** Line rate at which it answers, bit/s. */
  baud: number | null;
  /** The device of this stage that the port belongs to, by name: it is not asked. Absent where there is none. */
  device?: string | null;
  /** The driver that understands what is there; null where nothing answers. */
  driver: string | null;
  /** Which of Ascension's units it is, where it is no Flock of Birds. */
  family?: Family | null;
  /** What to do about it. */
  fix: string | null;
  /** Port of this computer that the device sends to, where it has a certain one. */
  local_port?: number | null;
  /** Model as the unit writes it. */
  model: string | null;
  /** The port as a stage file names it. */
  port: string;
  /** What is wrong. */
  problem: string | null;
  /** Measurement rate, Hz. */
  rate_hz: number | null;
  /** Software revision, such as `3.67`. */
  revision: string | null;
  /** Units that have a sensor, by rising address. */
  sensors: FoundSensor[];
};

/** One unit with a sensor. */
export type FoundSensor = {
  /** Address on the device; 0 is a stand-alone unit. */
  address: number;
  /** Serial number, where the device reports one; a SlimeVR tracker's network address. */
  serial?: string | null;
};

/** What the fault map reports about a frame. */
export type FrameLabel = {
  /** Why; null where it is clean. */
  cause: FaultCause | null;
  /** The cell that wins: row times columns plus column; null where no sensor is there. */
  cell: number | null;
  /** Distance of the frame from its cell, in shares of a chain; null where no sensor is there. */
  distance: number | null;
  /** Rules and map together: inverted if most sensors are, anomalous if any is not clean. */
  label: FaultClass;
};

/** What a repetition must be like to count; see `judge`. */
export type Gate = {
  /** Least and greatest duration, the taught one being 1. */
  duration: [number, number];
  /** Least mean log ratio in the worst fifth. */
  fifth_log_ratio: number;
  /** Least and greatest size of the movement, the taught one being 1. */
  gain: [number, number];
  /** Least mean log ratio of exercise and background, per frame. */
  mean_log_ratio: number;
  /** Least correlation with the taught movement. */
  similarity: number;
  /** Least share of the states visited. */
  visited: number;
};

/** Means and standard deviations of Gaussians with one variance per channel, `[channel][state]`. */
export type Gaussians = {
  /** Mean, in the channel's unit (velocities: per second). */
  mean: number[][];
  /** Standard deviation, in the same. */
  sd: number[][];
};

/** Where a body's heading comes from. */
export type HeadingSource = "unknown" | "field" | "held";

/** The last hour in equal steps, the oldest first. All lists have the same length, 360 at most; null where nothing is known of a step. */
export type HealthHistory = {
  /** Length of a step, s. */
  bin_s: number;
  /** Host time at which the newest step ends, s; null before the first. */
  newest_t_s: number | null;
  /** Sensors, in the stage file's order. */
  sensors: SensorHistory[];
};

/** Who speaks, and what there is. */
export type Hello = {
  /** The bodies that wear sensors, in the stage's order. */
  bodies: HelloBody[];
  /** The stage's epoch: UTC in RFC 3339 with nanoseconds. */
  epoch_utc: string;
  /** Its height, m: gives the lengths of the segments; null where it is not known. */
  height_m: number | null;
  /** Number of the newest event, 0 before the first: what a client that starts now has not missed. */
  last_event_id: number;
  /** What this client may do. */
  role: Role;
  /** The stage's sensors, in the order of the `sensors` message. */
  sensors: HelloSensor[];
  /** The first body's skeleton; null on a stage without a body. */
  skeleton: Skeleton | null;
  /** Name of the stage. */
  stage: string;
  /** Topics that this stage publishes. */
  topics: Topic[];
  /** Magnetic transmitter to room, as the stage file has it; a `field` event tells when it is changed. */
  transmitter: Pose;
  /** Whether the stage file says how the transmitter stands; without, `transmitter` is where the room's axes are taken from. */
  transmitter_given: boolean;
  /** Version of the daemon. */
  version: string;
};

/** Who wears sensors. */
export type HelloBody = {
  /** Colour that it is to be drawn in, `#rrggbb`. */
  color: string;
  /** Its height, m: gives the lengths of its segments; null where it is not known. */
  height_m: number | null;
  /** Its name. */
  name: string;
  /** Its skeleton. */
  skeleton: Skeleton;
};

/** A sensor by name. */
export type HelloSensor = {
  /** Its device's name. */
  device: string;
  /** Whether it is a magnetic tracker's, and so measures positions. */
  magnetic: boolean;
  /** Its name. */
  name: string;
};

/** The wall clock of the computer that the stage runs on. The stage's own times do not follow it: they count from `hello.epoch_utc`. */
export type HostClock = {
  /** How far off it is taken to be, s. */
  estimated_error_s: number;
  /** How far off it may be at most, s; 16 s and more where nothing follows. */
  max_error_s: number;
  /** Whether it follows another clock, by NTP or PTP. */
  synchronised: boolean;
  /** TAI minus UTC, s, which PTP works with; null where nobody has set it. */
  tai_offset_s: number | null;
};

/** What was found for one unit. */
export type Intrinsics = {
  /** Subtract from the accelerometer, m/s²; then multiply by scale and cross-axis terms. */
  accel_bias_m_s2: [number, number, number];
  /** What each axis feels of another, beside the scale: yz, xz, xy of a symmetric matrix; zero from fewer than 12 directions. */
  accel_cross?: [number, number, number];
  /** Root mean square of the length's error over the rests, m/s². */
  accel_residual_m_s2: number;
  /** Multiply the accelerometer, after subtracting the bias. */
  accel_scale: [number, number, number];
  /** Directions that were held. */
  directions: number;
  /** Subtract from the gyro, rad/s. */
  gyro_bias_rad_s: [number, number, number];
  /** Standard deviation of that bias between the rests, rad/s. */
  gyro_bias_sigma_rad_s: number;
  /** The magnetometer's, where there is one. */
  mag?: MagIntrinsics | null;
  /** The unit: its serial number, or the sensor's name where the device tells none; absent: the file's name specifies it. */
  unit?: string | null;
};

/** How a phone comes. */
export type Invitation = {
  /** What the daemon's own authority is called, which a phone may be set to trust; null where the stage file names a certificate. */
  authority: string | null;
  /** The SHA-256 fingerprint of the authority's certificate; empty where the stage file names a certificate. */
  fingerprint: string;
  /** The same page by the other addresses and the name of this computer. */
  others: string[];
  /** The page to open on the phone, with the token for sensors behind `#`. */
  page: string;
  /** `page` as a QR code. */
  qr: QrCode;
};

/** A long job. */
export type Job = {
  /** Its number, for `job.cancel`. */
  job: number;
  /** What it does, by the name of the request that started it. */
  kind: string;
  /** Outcome or reason of failure, in one sentence. */
  message: string | null;
  /** 0 to 1; null where it has no known end, as a recording. */
  progress: number | null;
  /** Expected time to its end, s; null where unknown. */
  remaining_s: number | null;
  /** What came of it, where it is more than a sentence: of `exercise.teach` where the repetitions were seen. */
  result?: unknown;
  /** How it stands. */
  state: JobState;
};

/** How a job stands. */
export type JobState = "running" | "done" | "failed" | "cancelled";

/** What every data message starts with, and its body. */
export type JobsMessage = {
  /** Data messages of all topics that were dropped for this client so far. */
  dropped: number;
  /** All jobs, running and lately ended. */
  jobs: Job[];
  /** Counts this topic's messages to this client from 0; a gap is a message that was dropped. */
  seq: number;
  /** Host time, s; rises strictly. */
  t_s: number;
  /** Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`. */
  timecode?: string | null;
};

/** A joint. */
export type JointEntry = {
  /** Standard deviation of each angle, degrees, by the same names; null where the angle is. */
  angle_sigmas_deg: Record<string, number | null>;
  /** Its angles by name, degrees; null where a segment beside it is not known. */
  angles_deg: Record<string, number | null>;
  /** The independent angles, in the order of the covariance's rows: a shoulder's flexion and abduction follow from the others. */
  covariance_of: string[];
  /** Covariance of the angles in `covariance_of`, rad²: the upper triangle row by row; null where they are. */
  covariance_rad2: number[] | null;
  /** The segment whose sensor is faulty or missing, if any: why the joint is not `ok`. */
  limited_by: string | null;
  /** Its name. */
  name: string;
  /** Root mean square of the expected error of one angle, degrees. */
  sigma_deg: number;
  /** How far to trust it: as the worse of the segments beside it. */
  state: SegmentState;
};

/** A repetition that is judged. */
export type Judged = {
  /** Repetitions counted since it was selected or reset, with this one; only rises. */
  count: number;
  /** What deviated most, worth a word or not. */
  deviation: Deviation | null;
  /** The exercise. */
  exercise: string;
  /** Why it does not count; null where it does. */
  reason: Reason | null;
  /** The one thing to say of it; null where all was as taught. */
  remark: Spoken | null;
  /** The repetition in points; null of one that does not count, and where it was not measured. */
  score: Score | null;
  /** The same in words of the body; of one that does not count, why; null too of a movement that was not meant: another one, outside of a set. */
  sentence: string | null;
  /** The same in German. */
  sentence_de: string | null;
  /** Repetitions of the set, with this one. */
  set_count: number;
  /** Beginning of the repetition, s. */
  t_start_s: number;
};

/** An exercise that can be selected. */
export type KeptExercise = {
  /** Its name. */
  name: string;
  /** The newest revision: how often it was taught. */
  revision: number;
};

/** A file that was written. */
export type KeptFile = {
  /** Its name. */
  file: string;
  /** The revision of what it holds. */
  revision: number;
};

/** What every data message starts with, and its body. */
export type KeyPoseMessage = {
  /** Whether the velocity changes at once rather than gently. */
  corner: boolean;
  /** Data messages of all topics that were dropped for this client so far. */
  dropped: number;
  /** Stage-wide number of the event, from 1. */
  event_id: number;
  /** Whether it is for good. */
  phase: Phase;
  /** How clear the change is: without unit, comparable between sensors; with `method = "paper"`, m a frame. */
  score: number;
  /** Where it is for good: what the sensor did since the key pose before it, as one screw motion; null where nothing moved, or nobody knows where the sensor is. */
  screw: ScrewMotion | null;
  /** Which sensor. */
  sensor: string;
  /** Counts this topic's messages to this client from 0; a gap is a message that was dropped. */
  seq: number;
  /** Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame). */
  t_s: number;
  /** Capture time of the key pose, s: the same in all events about one key pose. */
  t_valid_s: number;
  /** Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`. */
  timecode?: string | null;
};

/** What somebody says that a motion shows for a while. */
export type LabelSpan = {
  /** Since when, stage time, s. */
  from_s: number;
  /** What it shows. */
  label: string;
  /** Until when, s. */
  to_s: number;
};

/** What somebody says that a recording shows. */
export type Labels = {
  /** In order of time. */
  labels: LabelSpan[];
};

/** What movements have shown of a segment. */
export type LearntEntry = {
  /** Length of a thigh, an upper arm or a shank, m; null for a forearm. */
  length_m: number | null;
  /** Its standard deviation, m. */
  length_sigma_m: number | null;
  /** How well it is known how its sensor sits, root mean square about an axis, degrees. */
  mounting_sigma_deg: number;
  /** By how much its sensor sits otherwise than the calibration found, degrees: a strap has slipped, or a pose was not held so well. */
  turned_deg: number;
};

/** A recording in one line. */
export type LibraryTake = {
  /** Size of the file, bytes. */
  bytes: number;
  /** Whether it has an index: it was ended in order, or repaired. */
  complete: boolean;
  /** How much happens in it; null where it has no digest. */
  counts: DigestCounts | null;
  /** How long it is, s; null where that is not known without reading all of it. */
  length_s: number | null;
  /** Its file name. */
  name: string;
  /** A small picture; null where it has no digest. */
  picture: Picture | null;
  /** Name of its stage; empty where it cannot be read. */
  stage: string;
  /** Why it cannot be read; null where it can. */
  unreadable: string | null;
  /** When it begins: UTC in RFC 3339; null where it cannot be read. */
  utc: string | null;
};

/** What a device's link does. */
export type LinkState = "streaming" | "connecting" | "silent" | "failed";

/** Sessions in one line each. */
export type ListedSessions = {
  /** The newest first. */
  sessions: SessionSummary[];
};

/** Where everything was, as a recording shows it to viewers: five times a second, in a full one at every frame. */
export type Look = {
  /** Bodies of which something was shown, in the stage file's order. */
  bodies: LookBody[];
  /** Sensors that were good then, in the stage file's order. */
  sensors: LookSensor[];
  /** Stage time of what is shown, s: of several the latest. */
  t_s: number;
};

/** A body at a time. */
export type LookBody = {
  /** Its name. */
  name: string;
  /** Its segments, as in `body`. */
  segments: FigureSegment[];
};

/** A sensor at a time. */
export type LookSensor = {
  /** Its name. */
  name: string;
  /** Sensor to room, unit quaternion, scalar first. */
  orientation_wxyz: [number, number, number, number];
  /** Its position in the room, m; null for one that measures none. */
  position_m: [number, number, number] | null;
};

/** Hard and soft iron: `m = matrix (raw - offset)` has the length `norm` in every direction. */
export type MagIntrinsics = {
  /** Soft iron, row by row; symmetric, determinant 1. */
  matrix: [[number, number, number], [number, number, number], [number, number, number]];
  /** Length of the corrected field, in the unit of the samples. */
  norm: number;
  /** Hard iron, in the unit of the samples. */
  offset: [number, number, number];
  /** Root mean square of the length's error, as a part of the length. */
  residual: number;
};

/** The map of the field that is in use now. */
export type MapVersion = {
  /** Its version. */
  version: number;
};

/** What every data message starts with, and its body. */
export type MarkMessage = {
  /** Data messages of all topics that were dropped for this client so far. */
  dropped: number;
  /** Stage-wide number of the event, from 1. */
  event_id: number;
  /** What happened, in the words of whoever noted it; may be empty. */
  label: string;
  /** Counts this topic's messages to this client from 0; a gap is a message that was dropped. */
  seq: number;
  /** Stream time at which it was noted, s; rises strictly (by 1 µs between events of one frame). */
  t_s: number;
  /** Capture time of the frame before it, s. */
  t_valid_s: number;
  /** Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`. */
  timecode?: string | null;
};

/** A raw record in device axes. */
export type Measured = {
  /** Angular rate of a body-worn sensor in its own axes, rad/s; this and the following only where the record holds them. */
  angular_velocity_rad_s?: [number, number, number] | null;
  /** Button byte; null where button mode is off. */
  button: number | null;
  /** Acceleration in sensor axes with gravity taken out by the device, m/s². */
  linear_acceleration_m_s2?: [number, number, number] | null;
  /** Magnetic field in sensor axes, about 1 at the place of calibration. */
  magnetic_field?: [number, number, number] | null;
  /** Sensor to device axes; null in position-only formats. */
  orientation_wxyz: [number, number, number, number] | null;
  /** Position in device axes, m; null in orientation-only formats. */
  position_m: [number, number, number] | null;
  /** Specific force in sensor axes (+g on the axis that points up, at rest), m/s². */
  specific_force_m_s2?: [number, number, number] | null;
  /** Capture time of this record, s. */
  t_s: number;
};

/** A model that can be swapped in between two frames. */
export type Model = {
  kind: "transmitter";
  /** Turns transmitter coordinates into room coordinates. */
  orientation_wxyz: [number, number, number, number];
  /** Position of the transmitter in the room, m. */
  position_m: [number, number, number];
} | {
  /** The device it speaks of, by name. */
  device: string;
  kind: "tracker_noise";
  /** Reference distance from the transmitter, m. */
  r0_m: number;
  /** Standard deviation along the transmitter ray at `r0_m`, m (grows with r^4). */
  sigma_radial_m: number;
  /** Rotation standard deviation at `r0_m`, rad (grows with r^3). */
  sigma_rotation_rad: number;
} | {
  kind: "field";
  /** The map; null takes the present one away. */
  map?: Record<string, unknown> | null;
  /** Number of the map on its stage, from 1; 0 is none. */
  version: number;
} | {
  /** The body, by name; absent: the only one. */
  body?: string | null;
  kind: "mounting";
  /** One per sensor on the body. */
  sensors: MountedSensor[];
} | {
  /** The body, by name; absent: the only one. */
  body?: string | null;
  /** One entry per segment of the stage file. */
  calibration: ChainCalibration;
  kind: "chain";
} | {
  /** Capture time of a magnetic record on the IMU's clock minus the one it is given, s. */
  clock_offset_s: number;
  kind: "attached_imu";
  /** From the magnetic sensor to the IMU, the magnetic sensor's axes, m. */
  offset_m: [number, number, number];
  /** Turns the IMU's coordinates into the magnetic sensor's. */
  quat_wxyz: [number, number, number, number];
  /** The magnetic sensor, by name. */
  sensor: string;
} | {
  /** As in its file; the field in the unit that the device itself measures in, about 1. */
  intrinsics: Intrinsics;
  kind: "imu";
  /** The unit: its serial number, or the name of its sensor where neither device nor stage file tell one. */
  unit: string;
} | {
  /** The exercise, as in its file. */
  exercise: Exercise;
  kind: "exercise";
};

/** What every data message starts with, and its body. */
export type MotionSegmentMessage = {
  /** Whose motion it is, by the name of the body; null on a stage without one. */
  body: string | null;
  /** The network's probability of the label at the segment's first frame, 0 to 1; 0 of a withdrawn one. */
  confidence: number;
  /** How long after its beginning a segment is confirmed at the latest, s. */
  delay_s: number;
  /** Data messages of all topics that were dropped for this client so far. */
  dropped: number;
  /** What is said of the segment. */
  event: SegmentEvent;
  /** Stage-wide number of the event, from 1. */
  event_id: number;
  /** What it shows. */
  label: string;
  /** Number of the segment, from 1, body by body: all events of one segment carry it. It ends where the next confirmed one of the body begins. */
  segment: number;
  /** Counts this topic's messages to this client from 0; a gap is a message that was dropped. */
  seq: number;
  /** Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame). */
  t_s: number;
  /** Capture time at which the segment begins, s; of a confirmed one it may differ a little from the provisional one's. */
  t_valid_s: number;
  /** Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`. */
  timecode?: string | null;
};

/** How one sensor sits on its segment. */
export type MountedSensor = {
  /** Turns sensor coordinates into segment coordinates. */
  mount_quat_wxyz: [number, number, number, number];
  /** Where it sits, segment frame, m. */
  offset_m: [number, number, number];
  /** The segment it was found on, by name; absent: where it was taken to sit before. */
  segment?: string | null;
  /** The sensor, by name. */
  sensor: string;
  /** How well the rotation is known: standard deviations about the segment's axes, degrees; absent: it is exact. */
  sigma_deg?: [number, number, number] | null;
};

/** What is known about an exercise's movement. */
export type Movement = {
  /** Half the range of the mean of the largest channel of each channel's kind. */
  amplitude: number[];
  /** Background: state 0 is rest, 1 is any movement. */
  background: Gaussians;
  /** The states in order. */
  states: Gaussians;
};

/** Where in the movement, relative to the turning point of the channel. */
export type MovementPhase = "start" | "way_up" | "top" | "way_back" | "end";

/** Reply to a request that was carried out. */
export type OkReply = {
  /** The request's. */
  id: RequestId | null;
  /** What was asked for, where the request asks for something: see `Answers`. */
  result?: Answer | null;
};

/** Everybody who trains. */
export type People = {
  /** By name. */
  people: Person[];
};

/** Somebody who trains. */
export type Person = {
  /** When the newest began, RFC 3339 in UTC; absent: none yet. */
  last?: string | null;
  /** A name or a number. */
  name: string;
  /** Sessions so far. */
  sessions: number;
};

/** How final an event is that can be taken back. */
export type Phase = "provisional" | "confirmed" | "withdrawn";

/** One that is connected. */
export type Phone = {
  /** The changes that make it one, without a segment; none where it is one. */
  adds: StageChange[];
  /** How it is held, as it reports that itself: its axes in a world whose z is up; null where it has not. */
  orientation_wxyz: [number, number, number, number] | null;
  /** Where it is connected from. */
  peer: string;
  /** What it calls itself for good. */
  phone_id: string;
  /** Its name, for people; may be empty. */
  phone_name: string;
  /** The stage's sensor that it is, by name; null: none yet. */
  sensor: string | null;
};

/** What is connected to the websocket `/imu`. */
export type Phones = {
  /** Each by its id, in the order of these. */
  phones: Phone[];
};

/** Where sensors went, thinned out: enough for a thumbnail. */
export type Picture = {
  /** A path for each sensor that measures positions; where none does, for hips, hands and feet of each body. */
  paths: PicturePath[];
};

/** A path of a picture. */
export type PicturePath = {
  /** The sensor, or `BODY/SEGMENT`. */
  name: string;
  /** Places in order of time, room, m. */
  position_m: ([number, number, number])[];
};

/** A rate of pictures. */
export type PictureRate = "23.976" | "24" | "25" | "29.97" | "29.97df" | "30" | "47.952" | "48" | "50" | "59.94" | "59.94df" | "60";

/** A plan: its steps in order, each with all its sets. */
export type Plan = {
  /** Its name, 1 to 64 bytes. */
  name: string;
  /** 1 to 64 of them. */
  steps: PlanStep[];
};

/** How far a plan is. */
export type PlanProgress = {
  /** The exercise of that step; how far it is with its sets: topic `exercise`. */
  exercise: string;
  /** Its name. */
  name: string;
  /** End of the rest between two steps that goes on, s; null: none. Rests between sets: topic `exercise`. */
  rest_until_s: number | null;
  /** The step that is at hand or comes after the rest, from 1. */
  step: number;
  /** How many it has. */
  steps: number;
};

/** One exercise of a plan. */
export type PlanStep = {
  /** Name of the exercise. */
  exercise: string;
  /** Repetitions of each set, 1 to 1000. */
  repetitions: number;
  /** Rest after each set, s, 0 to 3600. */
  rest_s?: number;
  /** Sets, 1 to 100. */
  sets: number;
};

/** All plans. */
export type Plans = {
  /** By name. */
  plans: Plan[];
};

/** A pose: the named frame in the room. */
export type Pose = {
  /** Unit quaternion, scalar first. */
  orientation_wxyz: [number, number, number, number];
  /** Position, m. */
  position_m: [number, number, number];
};

/** Where a body's position comes from. */
export type PositionSource = "origin" | "trackers" | "held" | "feet";

/** Something that is wrong now. */
export type Problem = {
  /** For programs, and for who says it in another language. */
  code: string;
  /** For people: what to do, in one sentence of English. */
  message: string;
  /** What the sentence names, by name: all that another language needs to say the same. Empty where only `message` has it. */
  values: Record<string, string>;
};

/** How far a run is. */
export type Progress = {
  /** The same for programs; null when there is enough. */
  asks: FieldAsk | null;
  /** False once the run has ended: it is the last of its reports. */
  collecting: boolean;
  /** Share of the 20 cm cells inside the hull that the pole came near, 0 to 1. */
  covered: number;
  /** Share of the four pairs of opposite octants in which the pole was held, 0 to 1. */
  directions: number;
  /** What to do next; empty when there is enough. */
  hint: string;
  /** Instants with readings of three sensors or more. */
  instants: number;
  /** Rms distance of the last second's readings from a straight pole of the stated spacing, m: what there is to correct. */
  residual_m: number;
  /** Time since the first reading, s. */
  seconds: number;
  /** The pole's sensors in their order along it. */
  sensors: string[];
  /** Middles of cells inside the hull that it did not come near, at most 60, transmitter frame, m. */
  unvisited_m: ([number, number, number])[];
};

/** A picture of squares. */
export type QrCode = {
  /** The dark ones, as a path of SVG with squares of one unit. */
  path: string;
  /** How many squares are side by side, without the margin of four that it needs. */
  width: number;
};

/** How good a pose is. */
export type Quality = {
  /** No record of this frame is in the pose: the IMU that is attached to the sensor carries it on, for half a second at most. */
  coasted?: boolean;
  /** Root mean square of the expected rotation error, rad. */
  sigma_rotation_rad: number;
};

/** Why a repetition does not count. */
export type Reason = "too_fast" | "too_slow" | "too_small" | "too_large" | "different" | "incomplete" | "too_soon";

/** A recording that has begun. */
export type RecordingBegun = {
  /** Its job. */
  job: number;
  /** Name of the file in the folder of recordings. */
  name: string;
};

/** A recording in progress. */
export type RecordingStatus = {
  /** Bytes written so far. */
  bytes: number;
  /** Its file name. */
  name: string;
  /** When it began, s. */
  started_s: number;
};

/** The recordings of the folder. */
export type Recordings = {
  /** Their names, in order. */
  recordings: string[];
};

/** Why a request was not carried out, as far as other languages than English say it. Words in backquotes are names of `values`. */
export type RefusalReason = "bad_name" | "file_changed" | "hub" | "is_read" | "is_recorded" | "is_watched" | "is_written" | "job_runs" | "jobs_run" | "no_attached_imu" | "no_body" | "no_file" | "no_imu" | "no_magnetic" | "no_sensor" | "no_take" | "not_magnetic" | "nothing_collected" | "pole_sensors" | "pole_spacing" | "repetitions" | "requests_wait" | "session_runs" | "take_exists" | "watches";

/** How a stage's clock stands to the hub's. */
export type RelatedClock = {
  /** Hub time minus stage time, s: add it to the times of the stage's messages. */
  offset_s: number;
  /** The shortest of the round trips that it is known from, s. */
  round_trip_s: number;
  /** The offset is wrong by no more than this, s, whatever the network does, as long as neither clock is wrong by more than 50 ppm. */
  uncertainty_s: number;
};

/** What was removed for good. */
export type Removed = {
  /** How many recordings. */
  removed: number;
};

/** What a recording is called now. */
export type Renamed = {
  /** Its file name. */
  name: string;
};

/** How a published pose differs from the record. */
export type Repair = "mirrored" | "coasted";

/** A recording being replayed. After `replay.open` and `replay.seek` the times of all other topics start anew. */
export type ReplayStatus = {
  /** Stage time at which it begins, s. */
  begun_s: number;
  /** Stage time at which it ends, s. */
  end_s: number;
  /** Why it goes no further: its end, or damage; null while it can go on. */
  ended: string | null;
  /** Its file name. */
  name: string;
  /** Up to where it has been passed through, s: to any time before that it is sought in a moment. */
  passed_s: number;
  /** Multiple of real time; 0 is a pause, null as fast as it goes. */
  speed: number | null;
  /** Where it stands, s. */
  t_s: number;
};

/** A report. */
export type Report = {
  /** One self-contained HTML page. */
  html: string;
};

/** Languages of a report. */
export type ReportLanguage = "english" | "german";

/** What a client calls its request; replies carry it. */
export type RequestId = number | string;

/** Which events follow. */
export type Resumed = {
  /** Whether none of those that were missed is too old to be known. */
  complete: boolean;
  /** The newest of the stage. */
  last_event_id: number;
};

/** What a client may do. */
export type Role = "sensor" | "watch" | "operate";

/** A surveyed point of the room. */
export type RoomPoint = {
  /** For messages. */
  name: string;
  /** Where it is, room, m. */
  position_m: [number, number, number];
};

/** A session that goes on. */
export type RunningSession = {
  /** When it began, s. */
  begun_s: number;
  /** Repetitions counted since. */
  counted: number;
  /** Who trains. */
  person: string;
  /** How far its plan is; null: it follows none. */
  plan: PlanProgress | null;
  /** What stands against it, in one sentence; null: nothing. */
  problem: string | null;
  /** Its number, for `session.show` and others. */
  session: number;
  /** The subject of the exercises. */
  subject: string;
};

/** A repetition beside the lesson, in points from 0 to 100: 100 is as taught. */
export type Score = {
  /** How far the joints went, in percent of the lesson, each weighted by its way; farther is 100. Without joints the size of the whole movement. */
  amplitude: number;
  /** 100 as smooth as the lesson (log dimensionless jerk, Hogan & Sternad 2009); twice the jerk costs 15. */
  smoothness: number;
  /** The lesser of left and right in percent of the other, each beside its own way in the lesson; null where the exercise does not move the same joint on both sides. */
  symmetry: number | null;
  /** 100 between the shortest and the longest repetition of the lesson; beyond, their ratio in percent. */
  tempo: number;
  /** The parts below, weighted 0.5, 0.2, 0.15 and 0.15; without symmetry the others in the same proportion. */
  total: number;
};

/** A rotation about an axis and a translation along it. */
export type ScrewMotion = {
  /** How far it went along the axis, m. */
  advance_m: number;
  /** How far it turned, degrees; 0 for a translation. */
  angle_deg: number;
  /** Direction of the axis, room frame: a unit vector; the rotation is positive about it. */
  axis_direction: [number, number, number];
  /** The point of the axis that is nearest to where the sensor began, room frame, m. */
  axis_point_m: [number, number, number];
  /** Where the sensor was then, room frame, m. */
  from_m: [number, number, number];
  /** Capture time at which it began, s: that of the key pose before, or of the first pose. */
  since_s: number;
};

/** A segment. */
export type SegmentEntry = {
  /** What is wrong with that sensor; null where nothing is. */
  fault: FaultCause | null;
  /** What its movements have shown of a limb's segment since its sensor was calibrated; null for other segments, and where the stage file says how it sits. */
  learnt: LearntEntry | null;
  /** Its name. */
  name: string;
  /** Segment to room, unit quaternion, scalar first; null where nothing shows it. */
  orientation_wxyz: [number, number, number, number] | null;
  /** Its origin in the room, m; null where nothing shows it. */
  position_m: [number, number, number] | null;
  /** Its sensor; null where it wears none. */
  sensor: string | null;
  /** Root mean square of its expected error about an axis, degrees; of limbs, against the trunk. */
  sigma_deg: number;
  /** How far to trust it. */
  state: SegmentState;
};

/** What is said of a segment. */
export type SegmentEvent = "provisional" | "confirmed" | "withdrawn";

/** What a motion showed for a while. */
export type SegmentSpan = {
  /** Whose motion, by the name of the body; null on a stage without one. */
  body: string | null;
  /** Since when, s. */
  from_s: number;
  /** What it showed. */
  label: string;
  /** Until when, s: the beginning of the next one, or the end of the recording. */
  to_s: number;
};

/** How far a segment can be trusted; the later, the less. */
export type SegmentState = "ok" | "inferred" | "suspect" | "missing";

/** One sensor in one frame. `name` and `state` are always there; the others as `fields` asks for. */
export type SensorEntry = {
  /** Angular velocity in sensor axes, rad/s. */
  angular_velocity_rad_s?: [number, number, number] | null;
  /** The statistic of key poses; absent where they are not looked for, or not of this sensor. */
  change?: Change | null;
  /** Covariance of (position in room, m; rotation error in sensor axes, rad): the 21 numbers of the upper triangle of the 6 x 6 matrix, row by row. */
  covariance?: number[] | null;
  /** Its device's name. */
  device?: string | null;
  /** What the fault map reports about it; absent where the stage has none, or not for this sensor. */
  fault?: SensorLabel | null;
  /** The raw record, unfiltered, in device axes; null where none arrived. */
  measured?: Measured | null;
  /** Its name. */
  name: string;
  /** Sensor to room, unit quaternion, scalar first; null where there is no estimate. */
  orientation_wxyz?: [number, number, number, number] | null;
  /** Filtered position in the room, m; null where there is no estimate, and for sensors that measure none. */
  position_m?: [number, number, number] | null;
  /** More on how good the pose is. */
  quality?: Quality | null;
  /** Root mean square of the expected 3-D position error, m; null where there is no position. */
  sigma_m?: number | null;
  /** How far to trust it; only `ok`, `repaired` and `extrapolated` are poses to use. */
  state: SensorState;
  /** Velocity in the room, m/s; null where there is no position. */
  velocity_m_s?: [number, number, number] | null;
};

/** A sensor in the last hour. */
export type SensorHistory = {
  /** Charge of its battery at the end of the step, 0 to 1; null where its device reports none. */
  battery: (number | null)[];
  /** Standard deviation of the capture times of its device, s, at the end of the step. */
  clock_sigma_s: (number | null)[];
  /** Share of the frames in which its record was suspect, stuck, or repaired: 0 to 1. */
  faulty: (number | null)[];
  /** Share of the expected samples that were lost, as in `status`: 0 to 1. */
  lost: (number | null)[];
  /** Its name. */
  name: string;
  /** Noise of its measured position, m: from the median of how far each one is from the middle of its neighbours. Motion adds to it: that of a sensor at rest is the tracker's own. Null for one that measures no position. */
  noise_m: (number | null)[];
  /** Samples per second. */
  rate_hz: (number | null)[];
  /** Strength of its radio signal at the end of the step, dBm; null where its device reports none. */
  signal_dbm: (number | null)[];
};

/** What the fault map reports about a sensor in a frame. */
export type SensorLabel = {
  /** Why; null where it is clean. */
  cause: FaultCause | null;
  /** Distance from the nearest place where it was in training, m; null where it is missing. */
  distance_m: number | null;
  /** Rules and map together. */
  label: FaultClass;
  /** How the published pose differs from the record; null where it does not. */
  repair: Repair | null;
};

/** How far a sensor's pose can be trusted. */
export type SensorState = "ok" | "suspect" | "missing" | "late" | "stuck" | "repaired" | "extrapolated";

/** Health of a sensor. Counts never go back. */
export type SensorStatus = {
  /** Age of the newest sample, s; null before the first. */
  age_s: number | null;
  /** Charge of its battery, 0 to 1; null where its device reports none, and after it is gone. */
  battery: number | null;
  /** Voltage of its battery, V; null likewise. */
  battery_v: number | null;
  /** Whether its records are corrected by its unit's own biases and scales (`imu.calibrate`), kept from before or found just now. */
  corrected: boolean;
  /** Whether `lost` is partly estimated, because whole cycles left no trace in the bytes. */
  estimated: boolean;
  /** Version of its firmware, such as `0.7.3`; null likewise. */
  firmware: string | null;
  /** Expected samples that were not published as `ok`, but for those with which its filter began. */
  lost: number;
  /** Those of `lost` that never came: by the device's own count where it has one. */
  missed: number;
  /** Its name. */
  name: string;
  /** Samples per second, of the last second or more; null before that. */
  rate_hz: number | null;
  /** Whether the receiver on USB through which it is to come knows it; null where it comes another way, or nobody knows yet. */
  registered: boolean | null;
  /** Samples that arrived. */
  samples: number;
  /** Strength of its radio signal, dBm (-50 is strong, -80 weak); null likewise. */
  signal_dbm: number | null;
};

/** What every data message starts with, and its body. */
export type SensorsMessage = {
  /** Data messages of all topics that were dropped for this client so far. */
  dropped: number;
  /** What the fault map reports about the frame (field `fault`). */
  fault?: FrameLabel | null;
  /** Number of the frame (field `quality`). */
  frame?: number | null;
  /** The subscribed sensors, in the stage file's order. */
  sensors: SensorEntry[];
  /** Counts this topic's messages to this client from 0; a gap is a message that was dropped. */
  seq: number;
  /** Standard deviation of the capture time itself, s (field `quality`). */
  sigma_t_s?: number | null;
  /** Capture time that the poses belong to, s; rises strictly. */
  t_s: number;
  /** Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`. */
  timecode?: string | null;
};

/** Everything a client can receive. */
export type ServerMessage = Hello & {
  type: "hello";
} | OkReply & {
  type: "ok";
} | ErrorReply & {
  type: "error";
} | StatusMessage & {
  type: "status";
} | SensorsMessage & {
  type: "sensors";
} | FigureMessage & {
  type: "body";
} | TruthsMessage & {
  type: "truth";
} | JobsMessage & {
  type: "jobs";
} | SessionsMessage & {
  type: "session";
} | FaultMessage & {
  type: "faults";
} | KeyPoseMessage & {
  type: "keyframes";
} | FieldEventMessage & {
  type: "field";
} | ExerciseEventMessage & {
  type: "exercise";
} | MotionSegmentMessage & {
  type: "segments";
} | MarkMessage & {
  type: "marks";
} | TimecodeMessage & {
  type: "timecode";
} | Stages & {
  type: "stages";
};

/** A session that has begun. */
export type SessionBegun = {
  /** Its number. */
  session: number;
};

/** A session in one line. */
export type SessionSummary = {
  /** When it began, RFC 3339 in UTC. */
  begun: string;
  /** Repetitions counted. */
  counted: number;
  /** How long it took, s; absent while it goes on. */
  duration_s?: number | null;
  /** How it ended; absent while it goes on. */
  ended_by?: EndedBy | null;
  /** Who trained. */
  person: string;
  /** The plan that was followed; absent: none. */
  plan?: string | null;
  /** The recording of it, if one was kept. */
  recording?: string | null;
  /** Repetitions that were seen and not counted. */
  rejected: number;
  /** Mean score of those counted, points; absent where none has one. */
  score?: number | null;
  /** Its number. */
  session: number;
  /** Sets begun. */
  sets: number;
};

/** What every data message starts with, and its body. */
export type SessionsMessage = {
  /** Data messages of all topics that were dropped for this client so far. */
  dropped: number;
  /** Counts this topic's messages to this client from 0; a gap is a message that was dropped. */
  seq: number;
  /** Sessions that go on, one per subject at most. */
  sessions: RunningSession[];
  /** Host time, s; rises strictly. */
  t_s: number;
  /** Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`. */
  timecode?: string | null;
};

/** A stage file, as it is or as it would be with changes, and what is wrong with it. */
export type Setup = {
  /** Its bodies, in their order. */
  bodies: SetupBody[];
  /** Its devices, in their order. */
  devices: SetupDevice[];
  /** Name of the file. */
  file: string;
  /** The stage's name; empty where none stands there. */
  name: string;
  /** What is wrong: the stage cannot run like this. As `posed check` says it. */
  problems: SetupProblem[];
  /** Which contents of the file this was made from; `setup.save` is refused where it has others by then. */
  revision: string;
  /** Its sensors, in their order. */
  sensors: SetupSensor[];
  /** The text, with a placeholder for every secret. */
  toml: string;
  /** What works, but hardly as it was meant. */
  warnings: SetupProblem[];
  /** Why it cannot be changed from here; null where it can. */
  why_not: string | null;
};

/** A body of a stage file. */
export type SetupBody = {
  /** Height of the person, m; null where it is not given. */
  height_m: number | null;
  /** Its name. */
  name: string;
};

/** A device of a stage file; texts that are not there are empty. */
export type SetupDevice = {
  /** Its driver. */
  driver: string;
  /** Its name. */
  name: string;
  /** Its port. */
  port: string;
};

/** Something that is wrong with a stage file, or doubtful. */
export type SetupProblem = {
  /** What to do about it. */
  fix: string;
  /** The key it is about; may be empty. */
  key: string;
  /** Line of the text, from 1. */
  line: number;
  /** What is wrong. */
  message: string;
  /** Which one, by the name that stands there. */
  name: string | null;
  /** What it is about, where it is a device, a sensor or a body; null: something else. */
  table: StageTable | null;
};

/** A sensor of a stage file; texts that are not there are empty. */
export type SetupSensor = {
  /** Its address on the device. */
  address: number;
  /** The body that wears it, by name; null: the only one. */
  body: string | null;
  /** Its device, by name. */
  device: string;
  /** Its name. */
  name: string;
  /** The segment that it sits on, as its `segment` or its name says; null: on none. */
  segment: string | null;
};

/** A session in full. */
export type Shown = {
  /** Its sets, repetitions, scores and courses, as `posed session show --json` prints them. */
  shown: unknown;
};

/** Side of the body. */
export type Side = "left" | "right";

/** Which segments a body has. */
export type Skeleton = "human" | "custom";

/** How likely the two ends of a sole stand on the floor, 0 to 1. */
export type Sole = {
  /** The heel. */
  heel: number;
  /** The toes, which stand by the ball of the foot. */
  toe: number;
};

/** Speed of a replay. */
export type Speed = number | SpeedWord;

/** A speed in words. */
export type SpeedWord = "max";

/** A remark for programs. */
export type Spoken = {
  about: "joint";
  /** The angle less the taught one, degrees; at a turning point that of its way, beside how far the other joints went. */
  deviation_deg: number;
  /** `elbow`, as in the name of the angle. */
  joint: string;
  /** In which way it deviates. */
  kind: DeviationKind;
  /** `flexion`, as in the name of the angle; empty where the name has none. */
  movement: string;
  /** Where in the movement; `top` is the turning point of this joint. */
  place: MovementPhase;
  /** Its side; null of the trunk, and where the name has none. */
  side: Side | null;
} | {
  about: "size";
  /** The taught one being 1. */
  size: number;
} | {
  about: "tempo";
  /** Duration, the taught median being 1. */
  tempo: number;
} | {
  about: "smoothness";
};

/** One change of a stage file. */
export type StageChange = {
  change: "name_stage";
  /** Which. */
  name: string;
} | {
  change: "place_transmitter";
  /** Turns transmitter coordinates into room coordinates: unit quaternion, scalar first. */
  orientation_wxyz: [number, number, number, number];
  /** Its place, m. */
  position_m: [number, number, number];
} | {
  change: "add";
  /** Its keys, as in the stage file. */
  keys: Record<string, unknown>;
  /** What. */
  table: StageTable;
} | {
  change: "set";
  /** Which key. */
  key: string;
  /** Of which, by its name. */
  name: string;
  /** Of what. */
  table: StageTable;
  /** Its value, as in the stage file; null or absent: the key is removed. */
  value?: unknown;
} | {
  change: "remove";
  /** Which, by its name. */
  name: string;
  /** What. */
  table: StageTable;
};

/** One of them. */
export type StageEntry = {
  /** How its clock stands to the hub's; null until it is known. */
  clock: RelatedClock | null;
  /** Devices, and how many of them stream. */
  devices: number;
  /** Its epoch: UTC of its own computer in RFC 3339 with nanoseconds; null until it is known. */
  epoch_utc: string | null;
  /** Events that are lost for good: the hub was cut off for longer than the stage keeps them. */
  events_lost: number;
  /** Frames per second that arrive here. */
  frames_hz: number;
  /** Whether this hub fuses it from its input log. */
  fused: boolean;
  /** Its name at this hub: its page is at `/ID/`, its websocket at `/ID/ws`. */
  id: string;
  /** Newest event that has arrived here. */
  last_event_id: number;
  /** Its own name, from the stage file; empty until it is known. */
  name: string;
  /** What is wrong there, as in its `status`. */
  problems: Problem[];
  /** Since when, s of the hub's time. */
  since_s: number;
  /** Whether it is there. */
  state: StagePresence;
  /** Of them. */
  streaming: number;
  /** How often it has vanished so far. */
  vanished: number;
};

/** Latency of one stage of the flow, ms. */
export type StageLatency = {
  /** Longest, ms. */
  max_ms: number;
  /** Median, ms. */
  p50_ms: number;
  /** 99 % quantile, ms. */
  p99_ms: number;
  /** From where to where. */
  stage: string;
};

/** Whether a stage is there. */
export type StagePresence = "joining" | "present" | "gone";

/** Tables that a change can be about. */
export type StageTable = "device" | "sensor" | "body";

/** All stages that a hub has heard of. */
export type Stages = {
  /** In the order of their names. */
  stages: StageEntry[];
  /** The hub's own time, s since it was started. */
  t_s: number;
};

/** A job that has begun; the topic `jobs` reports its progress. */
export type Started = {
  /** Its number. */
  job: number;
};

/** What every data message starts with, and its body. */
export type StatusMessage = {
  /** Connected clients. */
  clients: number;
  /** Devices, in the stage file's order. */
  devices: DeviceStatus[];
  /** Data messages of all topics that were dropped for this client so far. */
  dropped: number;
  /** What the disk of the recordings still takes, bytes; null where nobody knows, and in a replay. */
  free_bytes: number | null;
  /** Whether this computer's clock follows another, as its kernel tells; null where it does not, and in a replay. */
  host_clock: HostClock | null;
  /** How long each stage of the flow took since the last status. */
  latency: StageLatency[];
  /** What is wrong now, beside the devices' own reasons: disk full, wall clock set, ... */
  problems: Problem[];
  /** The recording in progress; null without one. */
  recording: RecordingStatus | null;
  /** The recording that is being replayed; null on a live stage. */
  replay: ReplayStatus | null;
  /** Sensors, in the stage file's order. */
  sensors: SensorStatus[];
  /** Counts this topic's messages to this client from 0; a gap is a message that was dropped. */
  seq: number;
  /** Host time, s; rises strictly. */
  t_s: number;
  /** Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`. */
  timecode?: string | null;
};

/** An angle that keeps still in an exercise, in the channel's unit. */
export type Still = {
  /** The channel. */
  channel: string;
  /** Mean of how far it goes with the movement there and back. */
  moves: number;
  /** Standard deviation of that from repetition to repetition. */
  moves_sd: number;
  /** Least and greatest value in the taught repetitions. */
  range: [number, number];
};

/** The takes of the folder. */
export type Takes = {
  /** The file that is being recorded into; null without one. */
  recording: string | null;
  /** The newest first; those that cannot be read last. */
  takes: LibraryTake[];
};

/** How much is done. */
export type Thoroughness = "quick" | "full" | "movement" | "assign";

/** What every data message starts with, and its body. */
export type TimecodeMessage = {
  /** By how much the code is faster than its rate on the host's clock, ppm; null with `rate`. */
  drift_ppm: number | null;
  /** Data messages of all topics that were dropped for this client so far. */
  dropped: number;
  /** How often the code has gone on somewhere else since the stage's beginning. */
  jumps: number;
  /** Rate of the pictures; null while the pace does not tell yet, which takes a MIDI source some seconds. */
  rate: PictureRate | null;
  /** Counts this topic's messages to this client from 0; a gap is a message that was dropped. */
  seq: number;
  /** Standard deviation of the code, s: it grows while the code is carried on. */
  sigma_s: number;
  /** How the code is known. */
  state: TimecodeState;
  /** When this is so, s; rises strictly. */
  t_s: number;
  /** Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`. */
  timecode?: string | null;
};

/** How the time code of a moment is known. */
export type TimecodeState = "locked" | "holding" | "none";

/** A topic; its name is the `type` of its messages. */
export type Topic = "status" | "sensors" | "body" | "faults" | "keyframes" | "segments" | "exercise" | "field" | "jobs" | "truth" | "session" | "marks" | "timecode";

/** Channels of a whole recording. */
export type Tracked = {
  /** The names of all. */
  columns: string[];
} | {
  /** Time of each row, s. */
  t_s: number[];
  /** Each row, in the order that was asked for; null where nothing was measured. */
  values: ((number | null)[])[];
};

/** Ground truth of one sensor. `name`, `state` and `class` are always there; the others as `fields` asks for. */
export type TruthEntry = {
  /** What the simulator did to the record: `clean`, `inverted`, `stuck`, `jump`, `disturbed`. */
  class: string;
  /** Its device's name. */
  device?: string | null;
  /** Its name. */
  name: string;
  /** Sensor to room. */
  orientation_wxyz?: [number, number, number, number] | null;
  /** Position in the room, m. */
  position_m?: [number, number, number] | null;
  /** Always 0. */
  sigma_m?: number | null;
  /** Always `ok`. */
  state: SensorState;
};

/** What every data message starts with, and its body. */
export type TruthsMessage = {
  /** Data messages of all topics that were dropped for this client so far. */
  dropped: number;
  /** The simulated sensors. */
  sensors: TruthEntry[];
  /** Counts this topic's messages to this client from 0; a gap is a message that was dropped. */
  seq: number;
  /** Capture time, exact, s; rises strictly. */
  t_s: number;
  /** Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`. */
  timecode?: string | null;
};

/** The turning point of a channel, as it was taught. */
export type Turn = {
  /** Standard deviation of the way from repetition to repetition, of a joint beside the other joints' ways. */
  sd: number;
  /** The state in which the channel is farthest from its ends, from 0. */
  state: number;
  /** Mean way from the nearer end to the turning point, in the channel's unit; negative where it falls. */
  way: number;
};
