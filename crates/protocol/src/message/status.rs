//! Topic `status`: health of devices, sensors and daemon.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

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
    /// What the disk of the recordings still takes, bytes; null where nobody knows, and in a replay.
    #[serde(default)]
    pub free_bytes: Option<u64>,
    /// The recording that is being replayed; null on a live stage.
    #[serde(default)]
    pub replay: Option<ReplayStatus>,
    /// Whether this computer's clock follows another, as its kernel tells; null where it does not, and in a replay.
    #[serde(default)]
    pub host_clock: Option<HostClock>,
    /// What is wrong now, beside the devices' own reasons: disk full, wall clock set, ...
    pub problems: Vec<Problem>,
    /// Connected clients.
    pub clients: u32,
}

/// The wall clock of the computer that the stage runs on. The stage's own times do not follow it: they count from `hello.epoch_utc`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HostClock {
    /// Whether it follows another clock, by NTP or PTP.
    pub synchronised: bool,
    /// How far off it may be at most, s; 16 s and more where nothing follows.
    pub max_error_s: f64,
    /// How far off it is taken to be, s.
    pub estimated_error_s: f64,
    /// TAI minus UTC, s, which PTP works with; null where nobody has set it.
    pub tai_offset_s: Option<i32>,
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
    /// Age of its newest sample, s; null before the first.
    pub age_s: Option<f64>,
    /// How well its clock is fitted to the host's: standard deviation of its capture times, s; null until known.
    pub sigma_t_s: Option<f64>,
    /// Records accepted.
    pub records: u64,
    /// Records refused.
    pub rejected: u64,
    /// Bytes that belong to no accepted record and no answer.
    pub bytes_skipped: u64,
}

/// Health of a sensor. Counts never go back.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SensorStatus {
    /// Its name.
    pub name: String,
    /// Samples that arrived.
    pub samples: u64,
    /// Samples per second, of the last second or more; null before that.
    pub rate_hz: Option<f64>,
    /// Age of the newest sample, s; null before the first.
    pub age_s: Option<f64>,
    /// Expected samples that were not published as `ok`, but for those with which its filter began.
    pub lost: u64,
    /// Those of `lost` that never came: by the device's own count where it has one.
    #[serde(default)]
    pub missed: u64,
    /// Whether `lost` is partly estimated, because whole cycles left no trace in the bytes.
    pub estimated: bool,
    /// Charge of its battery, 0 to 1; null where its device reports none, and after it is gone.
    #[serde(default)]
    pub battery: Option<f64>,
    /// Voltage of its battery, V; null likewise.
    #[serde(default)]
    pub battery_v: Option<f64>,
    /// Strength of its radio signal, dBm (-50 is strong, -80 weak); null likewise.
    #[serde(default)]
    pub signal_dbm: Option<f64>,
    /// Whether its records are corrected by its unit's own biases and scales (`imu.calibrate`), kept from before or found just now.
    #[serde(default)]
    pub corrected: bool,
    /// Version of its firmware, such as `0.7.3`; null likewise.
    #[serde(default)]
    pub firmware: Option<String>,
    /// Whether the receiver on USB through which it is to come knows it; null where it comes another way, or nobody knows yet.
    #[serde(default)]
    pub registered: Option<bool>,
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
    /// Up to where it has been passed through, s: to any time before that it is sought in a moment.
    pub passed_s: f64,
}

/// Something that is wrong now.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Problem {
    /// For programs, and for who says it in another language.
    pub code: String,
    /// For people: what to do, in one sentence of English.
    pub message: String,
    /// What the sentence names, by name: all that another language needs to say the same. Empty where only `message` has it.
    #[serde(default)]
    pub values: BTreeMap<String, String>,
}

impl Problem {
    /// Something that is wrong, by its code and in a sentence.
    pub fn new(code: &str, message: impl Into<String>) -> Self {
        Self { code: code.to_owned(), message: message.into(), values: BTreeMap::new() }
    }

    /// The same with something that the sentence names.
    #[must_use]
    pub fn with(mut self, name: &str, value: impl ToString) -> Self {
        self.values.insert(name.to_owned(), value.to_string());
        self
    }
}
