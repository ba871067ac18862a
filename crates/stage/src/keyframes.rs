//! The `[keyframes]` table: where key poses are looked for, live.

use serde::{Deserialize, Serialize};

/// Key poses, live: the frames at which a sensor's motion changes its velocity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Keyframes {
    /// Sensors that are watched, by name; absent: all.
    pub sensors: Option<Vec<String>>,
    /// Frames on either side of a change that are looked at; a change is confirmed twice as many later.
    #[serde(default = "default_window")]
    #[schemars(range(min = 5, max = 500))]
    pub window_frames: u16,
    /// False alarms per minute and sensor that noise may cause.
    #[serde(default = "default_rate")]
    #[schemars(range(min = 0.001, max = 60.0))]
    pub false_alarms_per_min: f64,
}

fn default_window() -> u16 {
    30
}

fn default_rate() -> f64 {
    1.0
}
