//! Topic `segments`: events of what a motion shows.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use posed_stage::output::SegmentEvent;

/// Body of `segments`: an event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "MotionSegment")]
pub struct SegmentBody {
    /// Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame).
    pub t_s: f64,
    /// Stage-wide number of the event, from 1.
    pub event_id: u64,
    /// Capture time at which the segment begins, s; of a confirmed one it may differ a little from the provisional one's.
    pub t_valid_s: f64,
    /// Whose motion it is, by the name of the body; null on a stage without one.
    #[serde(default)]
    pub body: Option<String>,
    /// What is said of the segment.
    pub event: SegmentEvent,
    /// Number of the segment, from 1, body by body: all events of one segment carry it. It ends where the next confirmed one of the body begins.
    pub segment: u64,
    /// What it shows.
    pub label: String,
    /// The network's probability of the label at the segment's first frame, 0 to 1; 0 of a withdrawn one.
    pub confidence: f64,
    /// How long after its beginning a segment is confirmed at the latest, s.
    pub delay_s: f64,
}
