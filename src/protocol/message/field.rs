//! Topic `field`: events of the field's models.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::input::Model;

/// Body of `field`: an event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FieldEvent {
    /// Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame).
    pub t_s: f64,
    /// Stage-wide number of the event, from 1.
    pub event_id: u64,
    /// Capture time it speaks of, s.
    pub t_valid_s: f64,
    /// What happened.
    #[serde(flatten)]
    pub change: FieldChange,
}

/// What happened to the field's models.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum FieldChange {
    /// A model was swapped in between two frames.
    ModelSwapped {
        /// The model, in full.
        model: Model,
    },
}
