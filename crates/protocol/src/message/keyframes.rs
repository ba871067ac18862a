//! Topic `keyframes`: frames at which a sensor's motion changes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use posed_stage::output::Phase;

/// Body of `keyframes`: an event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct KeyPose {
    /// Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame).
    pub t_s: f64,
    /// Stage-wide number of the event, from 1.
    pub event_id: u64,
    /// Capture time of the key pose, s: the same in all events about one key pose.
    pub t_valid_s: f64,
    /// Which sensor.
    pub sensor: String,
    /// Whether it is for good.
    pub phase: Phase,
    /// How clear the change is: without unit, comparable between sensors.
    pub score: f64,
    /// Whether the velocity changes at once rather than gently.
    pub corner: bool,
}
