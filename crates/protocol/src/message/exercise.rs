//! Topic `exercise`: repetitions and what was off.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use posed_motion::exercise::Reason;
use posed_stage::output::ExerciseState;

/// Body of `exercise`: an event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ExerciseEvent {
    /// Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame).
    pub t_s: f64,
    /// Stage-wide number of the event, from 1.
    pub event_id: u64,
    /// Capture time it speaks of, s: of a repetition its end.
    pub t_valid_s: f64,
    /// Who moves; null where it concerns all.
    pub subject: Option<String>,
    /// What happened.
    #[serde(flatten)]
    pub change: ExerciseChange,
}

/// What happened with an exercise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum ExerciseChange {
    /// An exercise was loaded or taught, and can be selected.
    Loaded {
        /// Its name.
        exercise: String,
        /// How often an exercise of this name was taught.
        revision: u32,
        /// The channels it looks at.
        channels: Vec<String>,
        /// Median duration of a repetition, s.
        duration_s: f64,
    },
    /// Exercises were selected or reset, a set was completed, or a rest is over.
    State {
        /// How far the subject is.
        state: ExerciseState,
    },
    /// A repetition has begun.
    Started(Begun),
    /// A repetition seems to be complete; `counted`, `rejected` or `withdrawn` follows.
    Provisional(Begun),
    /// What was provisional was none.
    Withdrawn(Begun),
    /// A repetition is complete and counts.
    Counted(Judged),
    /// A repetition is complete and does not count.
    Rejected(Judged),
    /// What deviates just now; may still turn out otherwise.
    Hint {
        /// Its name; null, like the rest: what was said before is over.
        exercise: Option<String>,
        /// Where in the movement: 0 is the beginning, 1 the end.
        phase: Option<f64>,
        /// For half a second the movement has been likelier to be something else.
        anomaly: bool,
        /// In words.
        sentence: Option<String>,
    },
}

/// A repetition that is not judged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Begun {
    /// The exercise.
    pub exercise: String,
    /// Repetitions counted since it was selected or reset; only rises.
    pub count: u64,
    /// Repetitions of the set.
    pub set_count: u32,
    /// Beginning of the repetition, s.
    pub t_start_s: f64,
}

/// A repetition that is judged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Judged {
    /// The exercise.
    pub exercise: String,
    /// Repetitions counted since it was selected or reset, with this one; only rises.
    pub count: u64,
    /// Repetitions of the set, with this one.
    pub set_count: u32,
    /// Beginning of the repetition, s.
    pub t_start_s: f64,
    /// Why it does not count; null where it does.
    pub reason: Option<Reason>,
    /// What deviated most, in words; null where all was as taught.
    pub sentence: Option<String>,
    /// The numbers behind the sentence.
    pub deviation: Option<Deviation>,
}

/// How a repetition differed from the taught ones.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Deviation {
    /// The channel that deviated most.
    pub channel: String,
    /// Its deviation, in the channel's unit; positive is more than taught.
    pub size: f64,
    /// The same in standard deviations of the taught movement.
    pub size_sd: f64,
    /// Where in the movement: 0 is the beginning, 1 the end.
    pub phase: f64,
    /// Range of the channel, the taught one being 1.
    pub range: f64,
    /// Duration, the taught median being 1.
    pub tempo: f64,
    /// Duration of each fifth of the movement, the taught one being 1.
    pub fifth_tempo: [f64; 5],
    /// Log dimensionless jerk above the taught one; 0.7 is twice the jerk.
    pub jerk: f64,
}
