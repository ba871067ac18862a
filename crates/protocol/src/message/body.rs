//! Topic `body`: segments and joint angles of who wears sensors; one message for each body.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use posed_fusion::faults::Cause;
use posed_stage::output::{PositionSource, SegmentState};

/// Body of `body`: one time of the whole figure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Figure {
    /// Capture time of the newest sample in it, s; rises strictly from one message of this body to the next.
    pub t_s: f64,
    /// Which body it is, by its name in the stage file.
    #[serde(default)]
    pub name: String,
    /// Where the heading comes from.
    pub heading: HeadingSource,
    /// For how long it has been held without a field that is believed, s; 0 otherwise.
    pub heading_held_s: f64,
    /// Standard deviation of the heading, degrees: a calibrated magnetometer's, or how far calibrated gyros drift since a field last identified it, or since
    /// `heading.reset`; null where it is not known.
    #[serde(default)]
    pub heading_sigma_deg: Option<f64>,
    /// Where the position comes from.
    pub position_source: PositionSource,
    /// Standard deviation of the position along each level axis, m: by trackers, or from where they were heard last, or where it began, by the feet; null
    /// where nobody knows how far it has gone.
    #[serde(default)]
    pub position_sigma_m: Option<f64>,
    /// How likely each foot stands; null unless sensors show the pelvis and both legs now.
    #[serde(default)]
    pub contacts: Option<Contacts>,
    /// The segments, parents and children by the skeleton of the stage.
    pub segments: Vec<SegmentEntry>,
    /// The joints between them.
    pub joints: Vec<JointEntry>,
}

/// How likely each foot stands on the floor, 0 to 1: any part of it, or without a sensor on it, all of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Contacts {
    /// The right foot.
    pub foot_r: f64,
    /// The left foot.
    pub foot_l: f64,
    /// Heel and toes of the right foot; null where it wears no sensor.
    #[serde(default)]
    pub sole_r: Option<Sole>,
    /// Heel and toes of the left foot; null where it wears no sensor.
    #[serde(default)]
    pub sole_l: Option<Sole>,
}

/// How likely the two ends of a sole stand on the floor, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Sole {
    /// The heel.
    pub heel: f64,
    /// The toes, which stand by the ball of the foot.
    pub toe: f64,
}

/// Where a body's heading comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum HeadingSource {
    /// Nothing was measured yet.
    Unknown,
    /// From the magnetic field, or from magnetic trackers.
    Field,
    /// Held by the gyros: there is no field, or none that is believed.
    Held,
}

/// A segment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SegmentEntry {
    /// Its name.
    pub name: String,
    /// How far to trust it.
    pub state: SegmentState,
    /// Its origin in the room, m; null where nothing shows it.
    pub position_m: Option<[f64; 3]>,
    /// Segment to room, unit quaternion, scalar first; null where nothing shows it.
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Root mean square of its expected error about an axis, degrees; of limbs, against the trunk.
    pub sigma_deg: f64,
    /// Its sensor; null where it wears none.
    pub sensor: Option<String>,
    /// What is wrong with that sensor; null where nothing is.
    pub fault: Option<Cause>,
    /// What its movements have shown of a limb's segment since its sensor was calibrated; null for other segments, and where the stage file says how it sits.
    #[serde(default)]
    pub learnt: Option<LearntEntry>,
}

/// What movements have shown of a segment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LearntEntry {
    /// How well it is known how its sensor sits, root mean square about an axis, degrees.
    pub mounting_sigma_deg: f64,
    /// By how much its sensor sits otherwise than the calibration found, degrees: a strap has slipped, or a pose was not held so well.
    pub turned_deg: f64,
    /// Length of a thigh, an upper arm or a shank, m; null for a forearm.
    pub length_m: Option<f64>,
    /// Its standard deviation, m.
    pub length_sigma_m: Option<f64>,
}

/// A joint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct JointEntry {
    /// Its name.
    pub name: String,
    /// How far to trust it: as the worse of the segments beside it.
    pub state: SegmentState,
    /// The segment whose sensor is faulty or missing, if any: why the joint is not `ok`.
    pub limited_by: Option<String>,
    /// Its angles by name, degrees; null where a segment beside it is not known.
    pub angles_deg: BTreeMap<String, Option<f64>>,
    /// Root mean square of the expected error of one angle, degrees.
    pub sigma_deg: f64,
    /// Standard deviation of each angle, degrees, by the same names; null where the angle is.
    pub angle_sigmas_deg: BTreeMap<String, Option<f64>>,
    /// Covariance of the angles in `covariance_of`, rad²: the upper triangle row by row; null where they are.
    pub covariance_rad2: Option<Vec<f64>>,
    /// The independent angles, in the order of the covariance's rows: a shoulder's flexion and abduction follow from the others.
    pub covariance_of: Vec<String>,
}
