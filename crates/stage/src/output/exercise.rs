//! What happens with exercises, live.

use serde::{Deserialize, Serialize};

use crate::name::Name;
use posed_motion::exercise::{EventKind, Feedback, Reason, Remark};

/// Something happened with the exercises of a subject.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExerciseOutcome {
    /// Who moves.
    pub subject: Name,
    /// What happened.
    pub what: ExerciseWhat,
}

/// What happened with an exercise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ExerciseWhat {
    /// Exercises were selected or reset, a set was completed, or a rest is over.
    State(ExerciseState),
    /// A repetition began, seems complete, counts, or does not.
    Repetition(Repetition),
    /// What deviates while it happens; none: what was said before is over.
    Hint(Option<LiveHint>),
}

/// A repetition.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Repetition {
    /// Name of the exercise.
    pub exercise: Name,
    /// What happened with it.
    pub kind: EventKind,
    /// Repetitions since the exercise was selected or reset; only rises.
    pub count: u64,
    /// Repetitions of the set.
    pub set_count: u32,
    /// Beginning, s.
    pub t_start_s: f64,
    /// Why it does not count.
    pub reason: Option<Reason>,
    /// What deviated most, with the name of its channel.
    pub feedback: Option<(Name, Feedback)>,
    /// The same in words.
    pub remark: Option<Remark>,
}

/// What deviates while a repetition happens; provisional by nature.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LiveHint {
    /// Name of the exercise.
    pub exercise: Name,
    /// Where in the movement: 0 is the beginning, 1 the end.
    pub phase: f64,
    /// For half a second the movement has been likelier to be something else.
    pub anomaly: bool,
    /// The channel that deviates and what it does.
    pub remark: Option<(Name, Remark)>,
}

/// Exercises of a subject, and how far it is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct ExerciseState {
    /// The exercises that are counted.
    pub exercises: Vec<ExerciseProgress>,
    /// Repetitions of a set; null: one set without end.
    pub repetitions: Option<u32>,
    /// Sets of each exercise; null: no end.
    pub sets: Option<u32>,
    /// Rest after a set, s.
    pub rest_s: f64,
}

/// How far a subject is with an exercise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct ExerciseProgress {
    /// Name of the exercise.
    pub exercise: String,
    /// Repetitions since it was selected or reset.
    pub count: u64,
    /// Number of the set, from 1.
    pub set: u32,
    /// Repetitions of that set.
    pub set_count: u32,
    /// End of the rest that goes on, s; null: none.
    pub rest_until_s: Option<f64>,
    /// All sets are complete.
    pub done: bool,
}
