//! Topic `jobs`: what takes its time.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

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
    /// 0 to 1; null where it has no known end, as a recording.
    pub progress: Option<f64>,
    /// Expected time to its end, s; null where unknown.
    pub remaining_s: Option<f64>,
    /// Outcome or reason of failure, in one sentence.
    pub message: Option<String>,
    /// What came of it, where it is more than a sentence: of `exercise.teach` where the repetitions were seen.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub result: Option<serde_json::Value>,
}

/// How a job stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// At work.
    Running,
    /// Ended well.
    Done,
    /// Ended badly; the message reports why.
    Failed,
    /// Ended by `job.cancel`.
    Cancelled,
}
