//! What happens with exercises, live.

use serde::{Deserialize, Serialize};

use crate::name::Name;
use posed_motion::exercise::{EventKind, Feedback, Language, Reason, Remark, sentence};

/// Something happened with the exercises of a subject. Of a repetition, the outcome's `t_valid` is its end, or its beginning
/// where it has only begun.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExerciseOutcome {
    /// Who moves: as in `Request::ExerciseSelect`, or `posed_pipeline::DEFAULT_SUBJECT`.
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
    /// What deviates while it happens; `None`: what was reported before is over. Four a second at most.
    Hint(Option<LiveHint>),
}

/// A repetition of an exercise. A count is final; what is provisional is counted, rejected or withdrawn later.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Repetition {
    /// Name of the exercise.
    pub exercise: Name,
    /// What happened with it.
    pub kind: EventKind,
    /// Repetitions counted since the exercise was selected or reset, with this one if it counts; until then it only rises.
    pub count: u64,
    /// Repetitions counted in the present set, with this one if it counts.
    pub set_count: u32,
    /// Beginning of the repetition, s since the stage's epoch, as capture times are.
    pub t_start_s: f64,
    /// Why it does not count; absent unless it is rejected.
    pub reason: Option<Reason>,
    /// Whether it was meant: false of a rejected movement that is another one, outside of a set; true of every other kind.
    pub is_attempt: bool,
    /// What deviated most, with the name of its channel; absent unless it is counted or rejected, and where nothing can be
    /// compared.
    pub feedback: Option<(Name, Feedback)>,
    /// What to say of it; absent where all was as taught.
    pub remark: Option<Remark>,
}

impl Repetition {
    /// What to say of it to the person who moves; `None` where all was as taught, and of a movement that was not meant.
    pub fn sentence(&self, language: Language) -> Option<String> {
        let channel = self.feedback.as_ref().map_or("", |(channel, _)| channel);
        sentence(self.remark, self.reason.filter(|_| self.is_attempt), channel, language)
    }
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
    /// The name of the channel that deviates, and what it does; absent where only the anomaly is worth a word.
    pub remark: Option<(Name, Remark)>,
}

/// Exercises of a subject, and how far it is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct ExerciseState {
    /// The body whose joints are counted, by name; null on a stage without bodies.
    #[serde(default)]
    pub body: Option<String>,
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
