//! Topic `marks`: moments that somebody noted.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Body of `marks`: an event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Mark {
    /// Stream time at which it was noted, s; rises strictly (by 1 µs between events of one frame).
    pub t_s: f64,
    /// Stage-wide number of the event, from 1.
    pub event_id: u64,
    /// Capture time of the frame before it, s.
    pub t_valid_s: f64,
    /// What happened, in the words of whoever noted it; may be empty.
    pub label: String,
}
