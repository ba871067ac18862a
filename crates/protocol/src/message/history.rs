//! What `health.history` tells: how sensors were in the last hour.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The last hour in equal steps, the oldest first. All lists have the same length, 360 at most; null where nothing is known of a
/// step.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HealthHistory {
    /// Length of a step, s.
    pub bin_s: f64,
    /// Host time at which the newest step ends, s; null before the first.
    pub newest_t_s: Option<f64>,
    /// Sensors, in the stage file's order.
    pub sensors: Vec<SensorHistory>,
}

/// A sensor in the last hour.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SensorHistory {
    /// Its name.
    pub name: String,
    /// Samples per second.
    pub rate_hz: Vec<Option<f64>>,
    /// Share of the expected samples that were lost, as in `status`: 0 to 1.
    pub lost: Vec<Option<f64>>,
    /// Share of the frames in which its record was suspect, stuck, or repaired: 0 to 1.
    pub faulty: Vec<Option<f64>>,
    /// Noise of its measured position, m: from the median of how far each one is from the middle of its neighbours. Motion adds to it: that of a sensor at rest is
    /// the tracker's own. Null for one that measures no position.
    pub noise_m: Vec<Option<f64>>,
    /// Standard deviation of the capture times of its device, s, at the end of the step.
    pub clock_sigma_s: Vec<Option<f64>>,
    /// Charge of its battery at the end of the step, 0 to 1; null where its device reports none.
    pub battery: Vec<Option<f64>>,
    /// Strength of its radio signal at the end of the step, dBm; null where its device reports none.
    pub signal_dbm: Vec<Option<f64>>,
}
