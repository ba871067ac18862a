//! What a hub reports about its stages: on its own websocket, once a second and on change.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Problem;

/// All stages that a hub has heard of.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Stages {
    /// The hub's own time, s since it was started.
    pub t_s: f64,
    /// In the order of their names.
    pub stages: Vec<StageEntry>,
}

/// One of them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StageEntry {
    /// Its name at this hub: its page is at `/ID/`, its websocket at `/ID/ws`.
    pub id: String,
    /// Its own name, from the stage file; empty until it is known.
    pub name: String,
    /// Whether it is there.
    pub state: StagePresence,
    /// Since when, s of the hub's time.
    pub since_s: f64,
    /// How often it has vanished so far.
    pub vanished: u32,
    /// Its epoch: UTC of its own computer in RFC 3339 with nanoseconds; null until it is known.
    pub epoch_utc: Option<String>,
    /// How its clock stands to the hub's; null until it is known.
    pub clock: Option<RelatedClock>,
    /// Frames per second that arrive here.
    pub frames_hz: f64,
    /// Newest event that has arrived here.
    pub last_event_id: u64,
    /// Events that are lost for good: the hub was cut off for longer than the stage keeps them.
    pub events_lost: u64,
    /// Whether this hub fuses it from its input log.
    pub fused: bool,
    /// Devices, and how many of them stream.
    pub devices: u32,
    /// Of them.
    pub streaming: u32,
    /// What is wrong there, as in its `status`.
    pub problems: Vec<Problem>,
}

/// Whether a stage is there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum StagePresence {
    /// It has been heard of, and is being asked what it is.
    #[default]
    Joining,
    /// It is there.
    Present,
    /// It has vanished: ended, crashed, or cut off.
    Gone,
}

/// How a stage's clock stands to the hub's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RelatedClock {
    /// Hub time minus stage time, s: add it to the times of the stage's messages.
    pub offset_s: f64,
    /// The offset is wrong by no more than this, s, whatever the network does, as long as neither clock is wrong by more than 50 ppm.
    pub uncertainty_s: f64,
    /// The shortest of the round trips that it is known from, s.
    pub round_trip_s: f64,
}
