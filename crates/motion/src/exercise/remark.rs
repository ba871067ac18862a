//! The one thing that is said of a repetition, before it is put in words.

use serde::{Deserialize, Serialize};

use super::feedback::TURN;

/// A deviation in words, as far as they do not depend on the channel's name.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Remark {
    /// A channel deviates somewhere in the movement.
    Deviation {
        /// Index of the channel.
        channel: usize,
        /// How much, in the channel's unit; positive is more than taught.
        deviation: f64,
        /// In which way.
        kind: DeviationKind,
        /// Where in the movement.
        place: MovementPhase,
    },
    /// The whole movement is smaller or larger; its size, the taught one being 1.
    Size(f64),
    /// Slower or faster; the duration, the taught one being 1.
    Tempo(f64),
    /// Less smooth.
    Jerky,
}

/// In which way a channel deviates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum DeviationKind {
    /// Beyond the turning point.
    TooFar,
    /// Not as far as the turning point.
    Short,
    /// A larger value elsewhere.
    TooHigh,
    /// A smaller value elsewhere.
    TooLow,
    /// A joint that was to keep still moved with the movement: a compensation.
    Moved,
}

impl DeviationKind {
    /// Of a deviation that is not at a turning point.
    pub(super) fn on_the_way(deviation: f64) -> Self {
        if deviation > 0.0 { Self::TooHigh } else { Self::TooLow }
    }
}

/// Where in the movement, relative to the turning point of the channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum MovementPhase {
    /// Its first tenth.
    Start,
    /// Before the turning point.
    WayUp,
    /// Around the turning point.
    Top,
    /// After the turning point.
    WayBack,
    /// Its last tenth.
    End,
}

impl MovementPhase {
    /// Of a phase of the movement, where the channel turns at another one; both from 0 to 1.
    pub(super) fn of(phase: f64, turn: f64) -> Self {
        if (phase - turn).abs() <= TURN {
            Self::Top
        } else if phase < 0.1 {
            Self::Start
        } else if phase > 0.9 {
            Self::End
        } else if phase < turn {
            Self::WayUp
        } else {
            Self::WayBack
        }
    }
}
