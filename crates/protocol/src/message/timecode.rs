//! Topic `timecode`: where time code lies on the stage's clock.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use posed_timecode::{Rate, State};

/// Body of `timecode`: with each frame of the code that was read, and once a second while it is carried on without.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Timecode {
    /// When this is so, s; rises strictly.
    pub t_s: f64,
    /// How the code is known.
    pub state: State,
    /// Rate of the pictures; null while the pace does not tell yet, which takes a MIDI source some seconds.
    pub rate: Option<Rate>,
    /// Standard deviation of the code, s: it grows while the code is carried on.
    pub sigma_s: f64,
    /// By how much the code is faster than its rate on the host's clock, ppm; null with `rate`.
    pub drift_ppm: Option<f64>,
    /// How often the code has gone on somewhere else since the stage's beginning.
    pub jumps: u64,
}
