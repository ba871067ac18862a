//! Messages from the daemon to a client, as types: the source of the schema.
//!
//! `sensors` and `truth` are written from borrowed frames by [`super::encode`]; the types here describe the result, and a
//! test reads every written message back through them. Times are seconds since the stage's epoch.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{RequestId, Topic};
use crate::input::Model;
use crate::output::{FaultCause, SensorState};
use crate::stage::{Role, Skeleton};

/// Everything a client can receive.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum ServerMessage {
    /// First message on every connection.
    Hello(Hello),
    /// A request was carried out.
    Ok(OkReply),
    /// A request was refused, or could not be read.
    Error(ErrorReply),
    /// Health.
    Status(Data<Status>),
    /// Poses of one frame.
    Sensors(Data<Sensors>),
    /// Ground truth of one instant.
    Truth(Data<Truths>),
    /// All jobs, running and lately ended.
    Jobs(Data<Jobs>),
    /// A fault began or ended.
    Faults(Data<Fault>),
    /// A model of the field changed.
    Field(Data<FieldEvent>),
}

/// Who speaks, and what there is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Hello {
    /// Version of the daemon.
    pub version: String,
    /// Name of the stage.
    pub stage: String,
    /// The stage's epoch: UTC in RFC 3339 with nanoseconds.
    pub epoch_utc: String,
    /// The body's skeleton; null on a stage without a body.
    pub skeleton: Option<Skeleton>,
    /// Topics that this stage publishes.
    pub topics: Vec<Topic>,
    /// The stage's sensors, in the order of the `sensors` message.
    pub sensors: Vec<HelloSensor>,
    /// What this client may do.
    pub role: Role,
    /// Number of the newest event, 0 before the first: what a client that starts now has not missed.
    pub last_event_id: u64,
}

/// A sensor by name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct HelloSensor {
    /// Its name.
    pub name: String,
    /// Its device's name.
    pub device: String,
}

/// Reply to a request that was carried out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct OkReply {
    /// The request's.
    pub id: Option<RequestId>,
    /// What was asked for, where the request asks for something.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub result: Option<serde_json::Value>,
}

/// Reply to a request that was not carried out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ErrorReply {
    /// The request's; null where it could not be read.
    pub id: Option<RequestId>,
    /// For programs: `bad_message`, `bad_request`, `unknown_type`, `unknown_sensor`, `forbidden`, `busy`, ...
    pub code: String,
    /// For people: what was wrong and what would be right, in one sentence.
    pub message: String,
}

/// What every data message starts with, and its body.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "{B}Message")]
pub struct Data<B> {
    /// Counts this topic's messages to this client from 0; a gap is a message that was dropped.
    pub seq: u64,
    /// Data messages of all topics that were dropped for this client so far.
    pub dropped: u64,
    /// The rest.
    #[serde(flatten)]
    pub body: B,
}

/// Body of `sensors`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Sensors {
    /// Capture time that the poses belong to, s; rises strictly.
    pub t_s: f64,
    /// Number of the frame (field `quality`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<u64>,
    /// Standard deviation of the capture time itself, s (field `quality`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_t_s: Option<f64>,
    /// The subscribed sensors, in the stage file's order.
    pub sensors: Vec<SensorEntry>,
}

/// One sensor in one frame. `name` and `state` are always there; the others as `fields` asks for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SensorEntry {
    /// Its name.
    pub name: String,
    /// Its device's name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// How far to trust it; only `ok`, `repaired` and `extrapolated` are poses to use.
    pub state: SensorState,
    /// Filtered position in the room, m; null where there is no estimate, and for sensors that measure none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_m: Option<[f64; 3]>,
    /// Sensor to room, unit quaternion, scalar first; null where there is no estimate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Root mean square of the expected 3-D position error, m; null where there is no position.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_m: Option<f64>,
    /// The raw record, unfiltered, in device axes; null where none arrived.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<Measured>,
    /// Velocity in the room, m/s; null where there is no position.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub velocity_m_s: Option<[f64; 3]>,
    /// Angular velocity in sensor axes, rad/s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub angular_velocity_rad_s: Option<[f64; 3]>,
    /// Covariance of (position in room, m; rotation error in sensor axes, rad): the 21 numbers of the upper triangle
    /// of the 6 x 6 matrix, row by row.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub covariance: Option<Vec<f64>>,
    /// More on how good the pose is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quality: Option<Quality>,
}

/// A raw record in device axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Measured {
    /// Capture time of this record, s.
    pub t_s: f64,
    /// Position in device axes, m; null in orientation-only formats.
    pub position_m: Option<[f64; 3]>,
    /// Sensor to device axes; null in position-only formats.
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Button byte; null where button mode is off.
    pub button: Option<u8>,
    /// Angular rate of a body-worn sensor in its own axes, rad/s; this and the following only where the record holds them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub angular_rate_rad_s: Option<[f64; 3]>,
    /// Specific force in sensor axes (+9.81 on the axis that points up, at rest), m/s².
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub specific_force_m_s2: Option<[f64; 3]>,
    /// Acceleration in sensor axes with gravity taken out by the device, m/s².
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub linear_acceleration_m_s2: Option<[f64; 3]>,
    /// Magnetic field in sensor axes, about 1 at the place of calibration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub magnetic_field: Option<[f64; 3]>,
}

/// How good a pose is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Quality {
    /// Root mean square of the expected rotation error, rad.
    pub sigma_rotation_rad: f64,
}

/// Body of `truth`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Truths {
    /// Capture time, exact, s; rises strictly.
    pub t_s: f64,
    /// The simulated sensors.
    pub sensors: Vec<TruthEntry>,
}

/// Ground truth of one sensor. `name`, `state` and `class` are always there; the others as `fields` asks for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TruthEntry {
    /// Its name.
    pub name: String,
    /// Its device's name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// Always `ok`.
    pub state: SensorState,
    /// Position in the room, m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_m: Option<[f64; 3]>,
    /// Sensor to room.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Always 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_m: Option<f64>,
    /// What the simulator did to the record: `clean`, `inverted`, `stuck`, `jump`, `disturbed`.
    pub class: String,
}

/// Body of `status`: published at 1 Hz and on change.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Status {
    /// Host time, s; rises strictly.
    pub t_s: f64,
    /// Devices, in the stage file's order.
    pub devices: Vec<DeviceStatus>,
    /// Sensors, in the stage file's order.
    pub sensors: Vec<SensorStatus>,
    /// How long each stage of the flow took since the last status.
    pub latency: Vec<StageLatency>,
    /// The recording in progress; null without one.
    pub recording: Option<RecordingStatus>,
    /// The recording that is being replayed; null on a live stage.
    #[serde(default)]
    pub replay: Option<ReplayStatus>,
    /// What is wrong now, beside the devices' own reasons: disk full, wall clock set, ...
    pub problems: Vec<Problem>,
    /// Connected clients.
    pub clients: u32,
}

/// What a device's link does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LinkState {
    /// Records are coming in.
    Streaming,
    /// The port is not open, or set-up is under way.
    #[default]
    Connecting,
    /// The port is open, and nothing comes.
    Silent,
    /// The device refused to work.
    Failed,
}

impl From<&posed_drivers::State> for LinkState {
    fn from(state: &posed_drivers::State) -> Self {
        match state {
            posed_drivers::State::Connecting { .. } => Self::Connecting,
            posed_drivers::State::Streaming => Self::Streaming,
            posed_drivers::State::Silent { .. } => Self::Silent,
            posed_drivers::State::Failed { .. } => Self::Failed,
        }
    }
}

/// Health of a device. Counts never go back.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DeviceStatus {
    /// Its name.
    pub name: String,
    /// Its driver.
    pub driver: String,
    /// Its port.
    pub port: String,
    /// What its link does.
    pub state: LinkState,
    /// Why, and what to check; null while streaming.
    pub reason: Option<String>,
    /// Measured rate, Hz; null until known.
    pub rate_hz: Option<f64>,
    /// Records accepted.
    pub records: u64,
    /// Records refused.
    pub rejected: u64,
    /// Bytes that belong to no accepted record and no answer.
    pub bytes_skipped: u64,
}

/// Health of a sensor. Counts never go back.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SensorStatus {
    /// Its name.
    pub name: String,
    /// Samples that arrived.
    pub samples: u64,
    /// Expected samples that were not published as `ok`.
    pub lost: u64,
    /// Whether `lost` is partly estimated, because whole cycles left no trace in the bytes.
    pub estimated: bool,
}

/// Latency of one stage of the flow, ms.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StageLatency {
    /// From where to where.
    pub stage: String,
    /// Median, ms.
    pub p50_ms: f64,
    /// 99 % quantile, ms.
    pub p99_ms: f64,
    /// Longest, ms.
    pub max_ms: f64,
}

/// A recording in progress.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RecordingStatus {
    /// Its file name.
    pub name: String,
    /// Bytes written so far.
    pub bytes: u64,
    /// When it began, s.
    pub started_s: f64,
}

/// A recording being replayed. After `replay.open` and `replay.seek` the times of all other topics start anew.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ReplayStatus {
    /// Its file name.
    pub name: String,
    /// Stage time at which it begins, s.
    pub begun_s: f64,
    /// Stage time at which it ends, s.
    pub end_s: f64,
    /// Where it stands, s.
    pub t_s: f64,
    /// Multiple of real time; 0 is a pause, null as fast as it goes.
    pub speed: Option<f64>,
    /// Why it goes no further: its end, or damage; null while it can go on.
    pub ended: Option<String>,
}

/// Something that is wrong now.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Problem {
    /// For programs.
    pub code: String,
    /// For people: what to do, in one sentence.
    pub message: String,
}

/// Body of `jobs`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Jobs {
    /// Host time, s; rises strictly.
    pub t_s: f64,
    /// All jobs, running and lately ended.
    pub jobs: Vec<Job>,
}

/// A long job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Job {
    /// Its number, for `job.cancel`.
    pub job: u64,
    /// What it does, by the name of the request that started it.
    pub kind: String,
    /// How it stands.
    pub state: JobState,
    /// 0 to 1.
    pub progress: f64,
    /// Expected time to its end, s; null where unknown.
    pub remaining_s: Option<f64>,
    /// Outcome or reason of failure, in one sentence.
    pub message: Option<String>,
}

/// How a job stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// At work.
    Running,
    /// Ended well.
    Done,
    /// Ended badly; the message says why.
    Failed,
    /// Ended by `job.cancel`.
    Cancelled,
}

/// Body of `faults`: an event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Fault {
    /// Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame).
    pub t_s: f64,
    /// Stage-wide number of the event, from 1.
    pub event_id: u64,
    /// Capture time it speaks of, s.
    pub t_valid_s: f64,
    /// Which sensor.
    pub sensor: String,
    /// What is wrong with it.
    pub cause: FaultCause,
    /// Whether it began or ended.
    pub active: bool,
}

/// Body of `field`: an event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FieldEvent {
    /// Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame).
    pub t_s: f64,
    /// Stage-wide number of the event, from 1.
    pub event_id: u64,
    /// Capture time it speaks of, s.
    pub t_valid_s: f64,
    /// What happened.
    #[serde(flatten)]
    pub change: FieldChange,
}

/// What happened to the field's models.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum FieldChange {
    /// A model was swapped in between two frames.
    ModelSwapped {
        /// The model, in full.
        model: Model,
    },
}
