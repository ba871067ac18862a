//! Topic `session`: who trains now.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use posed_sessions::SessionId;

/// Body of `session`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Sessions {
    /// Host time, s; rises strictly.
    pub t_s: f64,
    /// Sessions that go on, one per subject at most.
    pub sessions: Vec<RunningSession>,
}

/// A session that goes on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RunningSession {
    /// Its number, for `session.show` and others.
    pub session: SessionId,
    /// Who trains.
    pub person: String,
    /// The subject of the exercises.
    pub subject: String,
    /// When it began, s.
    pub begun_s: f64,
    /// Repetitions counted since.
    pub counted: u32,
    /// How far its plan is; null: it follows none.
    pub plan: Option<PlanProgress>,
    /// What stands against it, in one sentence; null: nothing.
    pub problem: Option<String>,
}

/// How far a plan is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PlanProgress {
    /// Its name.
    pub name: String,
    /// The step that is at hand or comes after the rest, from 1.
    pub step: u32,
    /// How many it has.
    pub steps: u32,
    /// The exercise of that step; how far it is with its sets: topic `exercise`.
    pub exercise: String,
    /// End of the rest between two steps that goes on, s; null: none. Rests between sets: topic `exercise`.
    pub rest_until_s: Option<f64>,
}
