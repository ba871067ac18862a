//! What a stage file says of the tracker's field: who watches over it, and with which map it begins.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// Sensors that tell when metal or the mains disturb the field.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FieldWatch {
    /// Names of sensors that never move.
    #[serde(default)]
    pub witnesses: Vec<String>,
    /// Pairs of names of sensors that are fixed to each other.
    #[serde(default)]
    pub rigid_pairs: Vec<[String; 2]>,
    /// Frequency of the mains, Hz; absent: 50.
    #[schemars(range(min = 10.0, max = 1000.0))]
    pub mains_hz: Option<f64>,
}

/// Files of models; relative paths begin at the stage file's folder.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Models {
    /// A map of the field, as `posed field solve` writes it; used until `field.accept` has brought a newer one.
    pub field: Option<PathBuf>,
}
