//! The body at one time, as the pipeline estimates it.

use posed_drivers::Timestamp;
use posed_state::Plain;
use serde::{Deserialize, Serialize};

use crate::input::SensorIndex;
use posed_fusion::body::{ANGLES, AngleSpread, Heading};
use posed_fusion::faults::Cause;

/// Segments and joint angles at one time; the order of both is that of [`crate::layout::BodyLayout`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct Body {
    /// Capture time of the newest sample in it.
    pub t_valid: Timestamp,
    /// Where its heading comes from.
    pub heading: Heading,
    /// Where its position comes from.
    pub position_source: PositionSource,
    /// One per segment.
    pub segments: Vec<SegmentEstimate>,
    /// Joint angles, rad; `None` where a segment beside the joint is not known.
    pub angles_rad: [Option<f64>; ANGLES],
    /// How uncertain they are.
    pub spread: AngleSpread,
}

/// One segment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Plain)]
pub struct SegmentEstimate {
    /// How far to trust it.
    pub state: SegmentState,
    /// What is wrong with its sensor.
    pub fault: Option<Cause>,
    /// Its sensor: of several, the one that is asked first.
    #[serde(default)]
    pub sensor: Option<SensorIndex>,
    /// Its origin in the room, m.
    pub position_m: Option<[f64; 3]>,
    /// Segment to room.
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Root mean square of its expected error about an axis, rad; of limbs, relative to the trunk.
    pub sigma_rad: f64,
}

/// How far a segment can be trusted; the later, the less.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Serialize,
    Deserialize,
    schemars::JsonSchema,
    Plain,
)]
#[serde(rename_all = "snake_case")]
pub enum SegmentState {
    /// Its sensor shows it.
    Ok,
    /// No sensor of its own: it follows from its neighbours.
    Inferred,
    /// Its sensor is faulty: the segment goes on by its neighbours and by what was last measured.
    Suspect,
    /// Nothing shows it.
    #[default]
    Missing,
}

impl SegmentState {
    /// Sensors tell where it is, its own or those around it.
    pub fn is_shown(self) -> bool {
        matches!(self, Self::Ok | Self::Inferred)
    }
}

/// Where a body's position comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema, Plain)]
#[serde(rename_all = "snake_case")]
pub enum PositionSource {
    /// From nothing: it stands above the room's origin.
    #[default]
    Origin,
    /// From magnetic trackers on the body.
    Trackers,
    /// From trackers that are silent now: it stands where they last were.
    Held,
}
