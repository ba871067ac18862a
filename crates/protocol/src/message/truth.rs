//! Topic `truth`: the ground truth, on a simulated stage.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use posed_stage::output::SensorState;

/// Body of `truth`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Truths {
    /// Capture time, exact, s; rises strictly.
    pub t_s: f64,
    /// The simulated sensors.
    pub sensors: Vec<TruthEntry>,
}

/// Ground truth of one sensor. `name`, `state` and `class` are always there; the others as `fields` asks for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TruthEntry {
    /// Its name.
    pub name: String,
    /// Its device's name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// Always `ok`.
    pub state: SensorState,
    /// Position in the room, m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_m: Option<[f64; 3]>,
    /// Sensor to room.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Always 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_m: Option<f64>,
    /// What the simulator did to the record: `clean`, `inverted`, `stuck`, `jump`, `disturbed`.
    pub class: String,
}
