//! What a stage file reports about the tracker's field: who watches over it.

use serde::{Deserialize, Serialize};

/// Sensors that tell when metal or the mains disturb the field.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FieldWatch {
    /// Names of sensors that never move.
    #[serde(default)]
    pub reference_sensors: Vec<String>,
    /// Pairs of names of sensors that are fixed to each other.
    #[serde(default)]
    pub rigid_pairs: Vec<[String; 2]>,
    /// Frequency of the mains, Hz; absent: 50.
    #[schemars(range(min = 10.0, max = 1000.0))]
    pub mains_hz: Option<f64>,
}
