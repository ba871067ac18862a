//! Topic `exercise`: repetitions and what was off.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use posed_motion::exercise::{DeviationKind, MovementPhase, Reason, Score, Side};
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
        /// The same in German.
        sentence_de: Option<String>,
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
    /// The one thing to say of it; null where all was as taught.
    pub remark: Option<Spoken>,
    /// The same in words of the body; of one that does not count, why; null too of a movement that was not meant: another one, outside of a set.
    pub sentence: Option<String>,
    /// The same in German.
    pub sentence_de: Option<String>,
    /// The repetition in points; null of one that does not count, and where it was not measured.
    pub score: Option<Score>,
    /// What deviated most, worth a word or not.
    pub deviation: Option<Deviation>,
}

/// A remark for programs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "about", rename_all = "snake_case")]
pub enum Spoken {
    /// A joint, somewhere in the movement.
    Joint {
        /// `elbow`, as in the name of the angle.
        joint: String,
        /// Its side; null of the trunk, and where the name has none.
        side: Option<Side>,
        /// `flexion`, as in the name of the angle; empty where the name has none.
        movement: String,
        /// The angle less the taught one, degrees; at a turning point that of its way, beside how far the other joints went.
        deviation_deg: f64,
        /// In which way it deviates.
        kind: DeviationKind,
        /// Where in the movement; `top` is the turning point of this joint.
        place: MovementPhase,
    },
    /// The whole movement is smaller or larger.
    Size {
        /// The taught one being 1.
        size: f64,
    },
    /// It was slower or faster.
    Tempo {
        /// Duration, the taught median being 1.
        tempo: f64,
    },
    /// It was less smooth.
    Smoothness,
}

/// How a repetition differed from the taught ones.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Deviation {
    /// The channel that deviated most.
    pub channel: String,
    /// Its deviation, in the channel's unit; positive is more than taught. At a turning point that of its way, beside how far the other
    /// joints went.
    pub size: f64,
    /// The same, the least that is worth a word being 1; 0 of a channel that no word is said of.
    pub worth: f64,
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
