//! Topic `faults`: events of sensors' faults, and the map that tells them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use posed_fusion::faults::{Cause, Class};

/// Body of `faults`: an event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Fault {
    /// Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame).
    pub t_s: f64,
    /// Stage-wide number of the event, from 1.
    pub event_id: u64,
    /// Capture time it speaks of, s.
    pub t_valid_s: f64,
    /// What happened.
    #[serde(flatten)]
    pub change: FaultChange,
}

/// What happened to a sensor, or to the fault map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum FaultChange {
    /// A fault began or ended.
    Fault {
        /// Which sensor.
        sensor: String,
        /// What is wrong with it.
        cause: Cause,
        /// Whether it began or ended.
        active: bool,
    },
    /// A fault map was swapped in, or one of its cells has another name.
    Map {
        /// Counted up by `faults.train` and `faults.name_cell`.
        revision: u32,
        /// The sensors that it knows.
        sensors: Vec<String>,
        /// Rows of the map.
        rows: usize,
        /// Columns of the map.
        columns: usize,
        /// Class of each cell, row by row.
        cells: Vec<Class>,
        /// A frame that is farther from its cell than this is unusual.
        usual_distance: f64,
    },
}
