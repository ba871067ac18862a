//! What can be subscribed to.

use serde::{Deserialize, Serialize};

/// A topic; its name is the `type` of its messages.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, schemars::JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Topic {
    /// Health of devices, sensors and daemon; at 1 Hz and on change.
    Status,
    /// Poses of all subscribed sensors; one message per frame.
    Sensors,
    /// Segment poses and joint angles.
    Body,
    /// Beginning and end of sensor faults; events.
    Faults,
    /// Key poses; events.
    Keyframes,
    /// Segment labels; events.
    Segments,
    /// Repetitions and feedback; events.
    Exercise,
    /// Models of the magnetic field and of the transmitter's pose; events.
    Field,
    /// Long jobs and their progress.
    Jobs,
    /// Ground truth of a simulated stage, in the form of `sensors`.
    Truth,
    /// Who trains now, and how far the plan is.
    Session,
    /// Moments that somebody noted; events.
    Marks,
    /// Where time code lies.
    Timecode,
}

impl Topic {
    /// Number of topics.
    pub const COUNT: usize = 13;
    /// All topics, in the order of their indices.
    pub const ALL: [Self; Self::COUNT] = [
        Self::Status,
        Self::Sensors,
        Self::Body,
        Self::Faults,
        Self::Keyframes,
        Self::Segments,
        Self::Exercise,
        Self::Field,
        Self::Jobs,
        Self::Truth,
        Self::Session,
        Self::Marks,
        Self::Timecode,
    ];

    /// Name on the wire.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Status => "status",
            Self::Sensors => "sensors",
            Self::Body => "body",
            Self::Faults => "faults",
            Self::Keyframes => "keyframes",
            Self::Segments => "segments",
            Self::Exercise => "exercise",
            Self::Field => "field",
            Self::Jobs => "jobs",
            Self::Truth => "truth",
            Self::Session => "session",
            Self::Marks => "marks",
            Self::Timecode => "timecode",
        }
    }

    /// Position in [`Topic::ALL`].
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Whether its messages are events, which no client may miss, rather than states, of which the newest counts.
    pub const fn is_event(self) -> bool {
        matches!(
            self,
            Self::Faults | Self::Keyframes | Self::Segments | Self::Exercise | Self::Field | Self::Marks
        )
    }

    /// Whether its messages come many times a second: a stage sends them to a hub only where somebody there has asked for them.
    pub const fn is_frequent(self) -> bool {
        matches!(self, Self::Sensors | Self::Body | Self::Truth | Self::Timecode)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_serde_and_indices_those_of_all() {
        for (index, topic) in Topic::ALL.into_iter().enumerate() {
            assert_eq!(topic.index(), index);
            assert_eq!(serde_json::to_value(topic).unwrap(), topic.name());
        }
    }
}
