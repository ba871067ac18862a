//! Topic `faults`: events of sensors' faults.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::output::FaultCause;

/// Body of `faults`: an event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Fault {
    /// Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame).
    pub t_s: f64,
    /// Stage-wide number of the event, from 1.
    pub event_id: u64,
    /// Capture time it speaks of, s.
    pub t_valid_s: f64,
    /// Which sensor.
    pub sensor: String,
    /// What is wrong with it.
    pub cause: FaultCause,
    /// Whether it began or ended.
    pub active: bool,
}
