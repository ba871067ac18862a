//! Replies to requests.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Answer;
use crate::RequestId;

/// Reply to a request that was carried out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct OkReply {
    /// The request's.
    pub id: Option<RequestId>,
    /// What was asked for, where the request asks for something: see `Answers`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub result: Option<Answer>,
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
    /// Which sentence, for who says it in another language; null where only `message` has it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<RefusalReason>,
    /// What the sentence names, by name: all that another language needs to say `reason`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub values: BTreeMap<String, String>,
}

impl ErrorReply {
    /// A refusal that only the sentence tells.
    pub fn new(id: Option<RequestId>, code: &str, message: impl Into<String>) -> Self {
        Self { id, code: code.to_owned(), message: message.into(), reason: None, values: BTreeMap::new() }
    }
}

/// Why a request was not carried out, as far as other languages than English say it. Words in backquotes are names of `values`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RefusalReason {
    /// A recording cannot be called so.
    BadName,
    /// The stage file was changed by somebody else meanwhile.
    FileChanged,
    /// A hub shows its stages, and changes nothing at them.
    Hub,
    /// A job reads the recording.
    IsRead,
    /// The recording has not ended yet.
    IsRecorded,
    /// Somebody watches the recording.
    IsWatched,
    /// Another program writes the recording.
    IsWritten,
    /// The stage changes once a job has ended: `job`.
    JobRuns,
    /// As many jobs as may run do: `count`.
    JobsRun,
    /// No IMU is attached to the sensor `name`, and fewer than three points are given.
    NoAttachedImu,
    /// The stage has no body.
    NoBody,
    /// The daemon was not started on a stage file of its own.
    NoFile,
    /// The stage has no IMU.
    NoImu,
    /// The stage has no magnetic sensor.
    NoMagnetic,
    /// The stage has no sensor `name`.
    NoSensor,
    /// There is no recording `name`.
    NoTake,
    /// The sensor `name` is none that measures positions.
    NotMagnetic,
    /// No sensor of the pole was seen.
    NothingCollected,
    /// Fewer than three sensors of the pole are named, or one of them twice.
    PoleSensors,
    /// The distance of the sensors along the pole is not given.
    PoleSpacing,
    /// An exercise is taught by 2 to 100 repetitions.
    Repetitions,
    /// Too many requests wait.
    RequestsWait,
    /// A session of `person` goes on.
    SessionRuns,
    /// There is a recording `name` already.
    TakeExists,
    /// The token lets its client watch, and change nothing.
    Watches,
}
