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
    /// How clear the change is: without unit, comparable between sensors; with `method = "paper"`, m a frame.
    pub score: f64,
    /// Whether the velocity changes at once rather than gently.
    pub corner: bool,
    /// Where it is for good: what the sensor did since the key pose before it, as one screw motion; null where nothing moved, or nobody knows where the sensor is.
    pub screw: Option<ScrewMotion>,
}

/// A rotation about an axis and a translation along it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ScrewMotion {
    /// Capture time at which it began, s: that of the key pose before, or of the first pose.
    pub since_s: f64,
    /// Where the sensor was then, room frame, m.
    pub from_m: [f64; 3],
    /// The point of the axis that is nearest to where the sensor began, room frame, m.
    pub axis_point_m: [f64; 3],
    /// Direction of the axis, room frame: a unit vector; the rotation is positive about it.
    pub axis_direction: [f64; 3],
    /// How far it turned, degrees; 0 for a translation.
    pub angle_deg: f64,
    /// How far it went along the axis, m.
    pub advance_m: f64,
}
