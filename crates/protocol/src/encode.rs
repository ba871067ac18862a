//! Data messages as bytes: a body that clients share, and a head of their own in front of it.
//!
//! A body is a complete map without `type`, `seq` and `dropped`; [`message`] puts these three first, with `stage` for a client of
//! a hub, and takes the rest over as it is. Nothing is serialised a second time.

use serde::{Deserialize, Serialize};

use super::body::FigureBody;
use super::message::{
    ExerciseEvent, Fault, FaultChange, FieldChange, FieldEvent, Jobs, KeyPose, Mark, ScrewMotion,
    SegmentBody, Sessions, Status, Timecode,
};
use super::sensors::{SensorsBody, TruthBody};
use super::{Names, Stamp, Topic, View, exercise, round};
use posed_motion::keyframes::Screw;
use posed_stage::input::{Model, Truth};
use posed_stage::output::{self, Body, Estimate, KeyPoseEvent, Outcome, OutcomeKind, Output, ScrewSegment};
use posed_timecode::Label;

/// How messages are written; chosen by the websocket sub-protocol.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Encoding {
    /// JSON text messages.
    #[default]
    Json,
    /// MessagePack binary messages, maps with text keys.
    MessagePack,
}

/// What a data message is made from.
#[derive(Clone, Copy, Debug)]
pub enum Payload<'a> {
    /// To `sensors`.
    Estimate(&'a Estimate),
    /// To `body`.
    Body(&'a Body),
    /// To `truth`.
    Truth(&'a Truth),
    /// To the topic of the event.
    Outcome(&'a Outcome),
    /// To `status`; its `t_s` is when it was true, and is rounded on the way.
    Status(&'a Status),
    /// To `jobs`; its `t_s` is when it was true, and is rounded on the way.
    Jobs(&'a Jobs),
    /// To `session`; its `t_s` is when it was true, and is rounded on the way.
    Sessions(&'a Sessions),
    /// To `timecode`; from then on all messages have the code of their time.
    Timecode(&'a output::Timecode),
}

impl<'a> Payload<'a> {
    /// What clients receive of an output; `None` for bytes to devices, their states and warnings, and what only the daemon uses.
    pub fn of(output: &Output<'a>) -> Option<Self> {
        match *output {
            Output::Estimate(estimate) => Some(Self::Estimate(estimate)),
            Output::Body(body) => Some(Self::Body(body)),
            Output::Outcome(outcome) => Some(Self::Outcome(outcome)),
            Output::Truth(truth) => Some(Self::Truth(truth)),
            Output::Timecode(timecode) => Some(Self::Timecode(timecode)),
            Output::Transmit { .. }
            | Output::SetRts { .. }
            | Output::Named
            | Output::Device { .. }
            | Output::PoleRun(_)
            | Output::Warning { .. } => None,
        }
    }

    /// The topic that it is published on.
    pub fn topic(&self) -> Topic {
        match self {
            Self::Estimate(_) => Topic::Sensors,
            Self::Body(_) => Topic::Body,
            Self::Truth(_) => Topic::Truth,
            Self::Status(_) => Topic::Status,
            Self::Jobs(_) => Topic::Jobs,
            Self::Sessions(_) => Topic::Session,
            Self::Timecode(_) => Topic::Timecode,
            Self::Outcome(outcome) => match outcome.what {
                OutcomeKind::Fault { .. } => Topic::Faults,
                OutcomeKind::ModelSwapped(Model::Exercise { .. }) | OutcomeKind::Exercise(_) => {
                    Topic::Exercise
                }
                OutcomeKind::ModelSwapped(Model::Faults { .. }) => Topic::Faults,
                OutcomeKind::ModelSwapped(_) | OutcomeKind::Field(_) => Topic::Field,
                OutcomeKind::KeyPose(_) => Topic::Keyframes,
                OutcomeKind::MotionSegment(_) => Topic::Segments,
                OutcomeKind::Mark { .. } => Topic::Marks,
            },
        }
    }
}

/// Appends the body of a message to `out`, in the view's encoding: to be completed by [`message`]. Numbers are rounded to the
/// stated resolution, `t_s` is the time of `stamp`. The view's sensors and fields count for `sensors` and `truth` alone; a sensor
/// of the view that the frame lacks is `missing`. An event whose stamp has no number gets 0.
pub fn body(payload: &Payload<'_>, stamp: &Stamp, names: &Names, view: &View, out: &mut Vec<u8>) {
    let encoding = view.encoding;
    let from = out.len();
    match *payload {
        Payload::Estimate(estimate) => write(encoding, &SensorsBody { stamp, estimate, names, view }, out),
        Payload::Body(body) => write(encoding, &FigureBody { stamp, body, names }, out),
        Payload::Truth(truth) => write(encoding, &TruthBody { stamp, truth, names, view }, out),
        Payload::Status(status) => write(encoding, &rounded_status(status, stamp), out),
        Payload::Jobs(jobs) => write(encoding, &rounded_jobs(jobs, stamp), out),
        Payload::Sessions(sessions) => write(encoding, &rounded_sessions(sessions, stamp), out),
        Payload::Timecode(timecode) => write(encoding, &timecode_body(timecode, stamp), out),
        Payload::Outcome(outcome) => {
            let t_s = stamp.t_s();
            let event_id = stamp.event_id.unwrap_or(0);
            let t_valid_s = round::seconds(round::microseconds(outcome.t_valid));
            match &outcome.what {
                OutcomeKind::Fault { sensor, cause, active } => {
                    let sensor = names.sensor(*sensor).to_owned();
                    let change = FaultChange::Fault { sensor, cause: *cause, active: *active };
                    write(encoding, &Fault { t_s, event_id, t_valid_s, change }, out);
                }
                OutcomeKind::ModelSwapped(Model::Faults { fault_map }) => {
                    let (rows, columns) = fault_map.size();
                    let change = FaultChange::Map {
                        revision: fault_map.revision,
                        sensors: fault_map.sensors.clone(),
                        rows,
                        columns,
                        cells: fault_map.cells.clone(),
                        usual_distance: round::significant(fault_map.usual_distance),
                    };
                    write(encoding, &Fault { t_s, event_id, t_valid_s, change }, out);
                }
                OutcomeKind::ModelSwapped(Model::Exercise { exercise }) => {
                    let change = exercise::loaded(exercise);
                    write(encoding, &ExerciseEvent { t_s, event_id, t_valid_s, subject: None, change }, out);
                }
                OutcomeKind::Exercise(outcome) => {
                    let change = exercise::change(&outcome.what);
                    let subject = Some(outcome.subject.to_string());
                    write(encoding, &ExerciseEvent { t_s, event_id, t_valid_s, subject, change }, out);
                }
                OutcomeKind::KeyPose(event) => {
                    let sensor = names.sensor(event.sensor).to_owned();
                    let KeyPoseEvent { phase, corner, segment, .. } = *event;
                    let score = round::to(round::score(event.score), event.score);
                    let screw = segment.as_ref().map(screw);
                    let key = KeyPose { t_s, event_id, t_valid_s, sensor, phase, score, corner, screw };
                    write(encoding, &key, out);
                }
                OutcomeKind::MotionSegment(segment) => {
                    let body = SegmentBody {
                        t_s,
                        event_id,
                        t_valid_s,
                        body: segment.body.map(|body| names.body_name(body).to_owned()),
                        event: segment.event,
                        segment: segment.segment,
                        label: segment.label.clone(),
                        confidence: round::to(1e3, segment.confidence),
                        delay_s: round::to(1e3, segment.delay_s),
                    };
                    write(encoding, &body, out);
                }
                OutcomeKind::Mark { label } => {
                    write(encoding, &Mark { t_s, event_id, t_valid_s, label: label.clone() }, out);
                }
                OutcomeKind::ModelSwapped(model) => {
                    let change = FieldChange::swapped(model);
                    write(encoding, &FieldEvent { t_s, event_id, t_valid_s, change }, out);
                }
                OutcomeKind::Field(news) => {
                    let change = FieldChange::news(news, names);
                    write(encoding, &FieldEvent { t_s, event_id, t_valid_s, change }, out);
                }
            }
        }
    }
    if let Some(label) = stamp.timecode {
        append_timecode(encoding, label, from, out);
    }
}

/// Adds one more key to the map that was written to `out` at `from`.
fn append_timecode(encoding: Encoding, label: Label, from: usize, out: &mut Vec<u8>) {
    const KEY: &str = "timecode";
    let text = label.text();
    match encoding {
        Encoding::Json if out.last() == Some(&b'}') => {
            out.pop();
            for part in [&b",\""[..], KEY.as_bytes(), b"\":\"", &text, b"\"}"] {
                out.extend_from_slice(part);
            }
        }
        Encoding::MessagePack if out.get(from).is_some_and(|map| (0x80..=0x8f).contains(map)) => {
            // Fifteen keys are the most that one byte counts.
            match out[from] {
                0x8f => _ = out.splice(from..=from, [0xde, 0, 16]),
                small => out[from] = small + 1,
            }
            push_text(KEY, out);
            out.push(0xa0 | text.len() as u8);
            out.extend_from_slice(&text);
        }
        _ => debug_assert!(false, "a body is a small map"),
    }
}

/// What differs from client to client in front of a shared body.
#[derive(Clone, Copy, Debug)]
pub struct Head<'a> {
    /// The stage, for a client of a hub that sees several.
    pub stage: Option<&'a str>,
    /// Where it is published.
    pub topic: Topic,
    /// Counts this topic's messages to this client from 0.
    pub seq: u64,
    /// Data messages that were dropped for this client so far.
    pub dropped: u64,
}

/// Appends a whole message to `out`: the client's head and the shared body, which [`body()`] wrote in the same encoding. An empty
/// body makes no message.
///
/// # Panics
/// In debug builds, where a MessagePack body is no map of a few keys.
pub fn message(encoding: Encoding, head: Head<'_>, body: &[u8], out: &mut Vec<u8>) {
    use std::io::Write;
    let Head { stage, topic, seq, dropped } = head;
    let Some((&opening, rest)) = body.split_first() else { return };
    match encoding {
        Encoding::Json => {
            // Writing to a Vec cannot fail.
            let _ = write!(out, r#"{{"type":"{}","seq":{seq},"dropped":{dropped},"#, topic.name());
            if let Some(stage) = stage {
                out.extend_from_slice(br#""stage":"#);
                let _ = serde_json::to_writer(&mut *out, stage);
                out.push(b',');
            }
            out.extend_from_slice(rest);
        }
        Encoding::MessagePack => {
            // Up to 15 keys are counted in the low half of the first byte, more in two bytes behind it.
            let (keys, rest) = match rest {
                [high, low, rest @ ..] if opening == 0xde => (u16::from_be_bytes([*high, *low]), rest),
                rest => (u16::from(opening & 0xf), rest),
            };
            debug_assert!(matches!(opening, 0x80..=0x8f | 0xde), "a body is a small map");
            match keys + 3 + u16::from(stage.is_some()) {
                small @ ..=15 => out.push(0x80 | small as u8),
                large => {
                    out.push(0xde);
                    out.extend_from_slice(&large.to_be_bytes());
                }
            }
            push_text("type", out);
            push_text(topic.name(), out);
            for (key, value) in [("seq", seq), ("dropped", dropped)] {
                push_text(key, out);
                let _ = rmp_serde::encode::write(out, &value);
            }
            if let Some(stage) = stage {
                push_text("stage", out);
                let _ = rmp_serde::encode::write(out, stage);
            }
            out.extend_from_slice(rest);
        }
    }
}

/// MessagePack's text of up to 31 bytes.
fn push_text(text: &str, out: &mut Vec<u8>) {
    out.push(0xa0 | text.len() as u8);
    out.extend_from_slice(text.as_bytes());
}

/// The bytes of a message without a shared body: `hello`, replies. Empty where the encoding cannot hold it, which none of our own
/// types is.
///
/// # Panics
/// In debug builds, where the encoding cannot hold it.
pub fn whole<T: Serialize>(encoding: Encoding, message: &T) -> Vec<u8> {
    let mut out = Vec::new();
    write(encoding, message, &mut out);
    out
}

fn write<T: Serialize + ?Sized>(encoding: Encoding, value: &T, out: &mut Vec<u8>) {
    let from = out.len();
    let written = match encoding {
        Encoding::Json => serde_json::to_writer(&mut *out, value).map_err(|e| e.to_string()),
        Encoding::MessagePack => rmp_serde::encode::write_named(&mut *out, value).map_err(|e| e.to_string()),
    };
    if let Err(error) = written {
        // Our own types are maps with text keys: neither encoding can refuse them.
        debug_assert!(false, "a message could not be written: {error}");
        out.truncate(from);
    }
}

fn screw(segment: &ScrewSegment) -> ScrewMotion {
    let Screw { axis_point_m, axis_direction, angle_rad, advance_m } = segment.screw;
    ScrewMotion {
        since_s: round::seconds(round::microseconds(segment.since)),
        from_m: round::each(round::POSITION, segment.from_m),
        axis_point_m: round::each(round::POSITION, axis_point_m),
        axis_direction: round::each(round::QUATERNION, axis_direction),
        angle_deg: round::to(round::DEGREES, angle_rad.to_degrees()),
        advance_m: round::to(round::POSITION, advance_m),
    }
}

fn rounded_status(status: &Status, stamp: &Stamp) -> Status {
    let mut status = Status { t_s: stamp.t_s(), ..status.clone() };
    for device in &mut status.devices {
        device.rate_hz = device.rate_hz.map(|rate| round::to(round::RATE, rate));
        device.age_s = device.age_s.map(|age| round::to(round::AGE, age));
        device.sigma_t_s = device.sigma_t_s.map(|sigma| round::to(round::CLOCK, sigma));
    }
    for sensor in &mut status.sensors {
        sensor.rate_hz = sensor.rate_hz.map(|rate| round::to(round::RATE, rate));
        sensor.age_s = sensor.age_s.map(|age| round::to(round::AGE, age));
        for value in [&mut sensor.battery, &mut sensor.battery_v, &mut sensor.signal_dbm] {
            *value = value.map(|value| round::to(1e3, value));
        }
    }
    for stage in &mut status.latency {
        for value in [&mut stage.p50_ms, &mut stage.p99_ms, &mut stage.max_ms] {
            *value = round::to(1e3, *value);
        }
    }
    if let Some(clock) = &mut status.host_clock {
        for value in [&mut clock.max_error_s, &mut clock.estimated_error_s] {
            *value = round::to(1e6, *value);
        }
    }
    if let Some(recording) = &mut status.recording {
        recording.started_s = round::to(1e6, recording.started_s);
    }
    status
}

fn timecode_body(timecode: &output::Timecode, stamp: &Stamp) -> Timecode {
    let output::Timecode { t, relation, jumps } = timecode;
    Timecode {
        t_s: stamp.t_s(),
        state: relation.state(*t),
        rate: relation.rate(),
        sigma_s: round::to(round::CLOCK, relation.sigma_s(*t)),
        drift_ppm: relation.drift_ppm().map(|ppm| round::to(1e1, ppm)),
        jumps: *jumps,
    }
}

fn rounded_sessions(sessions: &Sessions, stamp: &Stamp) -> Sessions {
    let mut sessions = Sessions { t_s: stamp.t_s(), ..sessions.clone() };
    for session in &mut sessions.sessions {
        session.begun_s = round::to(1e6, session.begun_s);
        if let Some(plan) = &mut session.plan {
            plan.rest_until_s = plan.rest_until_s.map(|t_s| round::to(1e3, t_s));
        }
    }
    sessions
}

fn rounded_jobs(jobs: &Jobs, stamp: &Stamp) -> Jobs {
    let mut jobs = Jobs { t_s: stamp.t_s(), ..jobs.clone() };
    for job in &mut jobs.jobs {
        job.progress = job.progress.map(|progress| round::to(1e3, progress));
        job.remaining_s = job.remaining_s.map(|t| round::to(1e1, t));
    }
    jobs
}
