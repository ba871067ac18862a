//! The body at one time, as the pipeline estimates it.

use posed_drivers::Timestamp;
use posed_state::Plain;
use serde::{Deserialize, Serialize};
use serde_big_array::BigArray;

use crate::BodyIndex;
use crate::input::SensorIndex;
use posed_fusion::body::{ANGLES, AngleSpread, FootContact, Heading, Learnt};
use posed_fusion::faults::Cause;

/// Segments and joint angles at one time, an estimate without delay; the order of both is that of [`crate::layout::BodyLayout`].
/// What it is worth: `docs/body.md`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct Body {
    /// Which of the stage's bodies it is.
    #[serde(default)]
    pub index: BodyIndex,
    /// Time that it belongs to: with IMUs on the human skeleton the capture time of the newest sample in it, else the frame's.
    pub t_valid: Timestamp,
    /// Where its heading comes from.
    pub heading: Heading,
    /// Its standard deviation, rad, if it is known at all.
    pub heading_sigma_rad: Option<f64>,
    /// Where its position comes from.
    pub position_source: PositionSource,
    /// Its standard deviation along each level axis, m: by trackers, or from where they were heard last, or where it began, by the feet. Absent where nobody
    /// knows how far it has gone.
    pub position_sigma_m: Option<f64>,
    /// How likely the right and the left foot stand; absent unless sensors show the pelvis and both legs now.
    pub contacts: Option<[FootContact; 2]>,
    /// One per segment.
    pub segments: Vec<SegmentEstimate>,
    /// Joint angles, rad, in the order of [`posed_fusion::body::ANGLE_NAMES`], of a chain the flexions by segment; `None` where a
    /// segment beside the joint is not known.
    #[serde(with = "BigArray")]
    pub angles_rad: [Option<f64>; ANGLES],
    /// How uncertain the angles are; of a chain by segment too.
    pub spread: AngleSpread,
}

impl Body {
    /// One of which nothing is known yet, with so many segments.
    pub fn unknown(index: BodyIndex, segments: usize) -> Self {
        Self {
            index,
            t_valid: Timestamp::default(),
            heading: Heading::Unknown,
            heading_sigma_rad: None,
            position_source: PositionSource::Origin,
            position_sigma_m: None,
            contacts: None,
            segments: vec![SegmentEstimate::default(); segments],
            angles_rad: [None; ANGLES],
            spread: AngleSpread::default(),
        }
    }
}

/// One segment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Plain)]
pub struct SegmentEstimate {
    /// How far to trust it.
    pub state: SegmentState,
    /// What is wrong with its sensor, the gravest alone; absent where nothing is known against it, and on a chain of hinges.
    pub fault: Option<Cause>,
    /// Its sensor: of several, the one that is asked first, an IMU before a tracker; absent where it wears none.
    #[serde(default)]
    pub sensor: Option<SensorIndex>,
    /// Its origin in the room, m: for a limb's segment the joint above it. Absent where nothing shows the segment, and on a chain
    /// of hinges, which has no lengths.
    pub position_m: Option<[f64; 3]>,
    /// Segment to room, unit, scalar first; absent where nothing shows the segment.
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Root mean square of its expected error about an axis, rad; of limbs that IMUs show, relative to the trunk; of a chain's
    /// segment, of the angle to its parent, of its root, of the tilt. Soft tissue is not in it. Pi where it is missing.
    pub sigma_rad: f64,
    /// What movements have shown of it since its sensor was calibrated; absent for segments that are no limb's, and where the mounting was given.
    #[serde(default)]
    pub learnt: Option<Learnt>,
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
    /// Whether sensors show it, its own or those around it: `Ok` and `Inferred`.
    pub fn is_shown(self) -> bool {
        matches!(self, Self::Ok | Self::Inferred)
    }
}

/// Where a body's position comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema, Plain)]
#[serde(rename_all = "snake_case")]
pub enum PositionSource {
    /// From nothing: it stands where it began, by the stage file or above the room's origin.
    #[default]
    Origin,
    /// From magnetic trackers on the body.
    Trackers,
    /// From trackers that are silent now, or feet that are not seen: it stands where they last were.
    Held,
    /// From the feet that stand, since it began, or trackers last said where it is.
    Feet,
}
