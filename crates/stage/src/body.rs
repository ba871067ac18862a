//! The `[[body]]` tables: who wears the sensors, and how.

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};

/// Names of the segments of the `human` skeleton, in the order of [`posed_fusion::body::BodySegment::ALL`]; a sensor with such a
/// name, or such a `segment`, sits there.
pub const SEGMENTS: [&str; 17] = [
    "torso",
    "pelvis",
    "upper_arm_r",
    "forearm_r",
    "thigh_r",
    "shank_r",
    "upper_arm_l",
    "forearm_l",
    "thigh_l",
    "shank_l",
    "head",
    "hand_r",
    "foot_r",
    "hand_l",
    "foot_l",
    "shoulder_r",
    "shoulder_l",
];

/// The static poses that a calibration can hold.
pub(super) const POSES: [&str; 2] = ["n_pose", "t_pose"];
/// The movements that concern both sides.
pub(super) const TRUNK_MOVEMENTS: [&str; 3] = ["bow", "trunk_rotation", "neck_flexion"];
/// The movements of the `human` skeleton that a calibration can hold; each with `_r` or `_l` behind it.
pub(super) const MOVEMENTS: [&str; 12] = [
    "elbow_flexion",
    "elbow_pronation",
    "shoulder_flexion",
    "shoulder_abduction",
    "shoulder_rotation",
    "knee_flexion",
    "hip_flexion",
    "hip_abduction",
    "hip_rotation",
    "wrist_flexion",
    "ankle_flexion",
    "shrug",
];

/// Index of a body in [`Stage::bodies`](crate::Stage::bodies).
pub type BodyIndex = u8;

/// Bodies of a stage at most.
pub const MOST_BODIES: usize = 16;

/// A body that wears sensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Unique name, of letters, digits, `-` and `_`; must be given where there are several.
    #[serde(default = "default_name")]
    #[schemars(length(min = 1, max = 64))]
    pub name: String,
    /// Colour on the page, `#rrggbb`; absent: one of its own by its place among the bodies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub color: Option<String>,
    /// Which segments there are and how they hang together.
    #[serde(default)]
    pub skeleton: Skeleton,
    /// Height of the person, m; gives the segments' lengths where they are not measured.
    #[schemars(range(min = 0.3, max = 2.6))]
    pub height_m: Option<f64>,
    /// Where the person stands at first, room x and y, m: from there IMUs go by the feet, until trackers say where it is. Absent: above the room's origin, several people
    /// side by side along y, 1 m apart.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start_m: Option<[f64; 2]>,
    /// Lengths that were measured, each in place of the height's.
    pub lengths_m: Option<Lengths>,
    /// Where the sensors sit on their segments.
    #[serde(default)]
    pub mounting: Mounting,
    /// Whether the button of a tracker means: I look ahead, begin the headings anew.
    #[serde(default)]
    pub reset_by_button: bool,
    /// The segment whose IMU means the same where it is tapped twice, and twice only, by somebody who keeps still; absent: none.
    pub reset_by_double_tap: Option<String>,
    /// Segments of a custom skeleton, parents first.
    #[serde(default)]
    pub segments: Vec<SegmentSpec>,
    /// For a recorded file: when which pose or movement was held.
    #[serde(default)]
    pub calibration: Vec<Calibration>,
}

/// Why it can't be said which body is meant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum WhichBody {
    /// There is none of that name.
    Unknown(String),
    /// None was named, and there are several.
    Several,
}

/// The body of that name, or the only one; 0 where none is named and there is none.
///
/// # Errors
/// There is none of that name, or several and none was named.
pub fn body_named<'a>(
    names: impl ExactSizeIterator<Item = &'a str>,
    name: Option<&str>,
) -> Result<BodyIndex, WhichBody> {
    let Some(name) = name else {
        return if names.len() > 1 { Err(WhichBody::Several) } else { Ok(0) };
    };
    let mut names = names;
    let at = names.position(|known| known == name);
    at.map(|at| at as BodyIndex).ok_or_else(|| WhichBody::Unknown(name.to_owned()))
}

/// The body whose joints count for a subject: that of this name, else the one that is called as the subject, else the first.
///
/// # Errors
/// [`WhichBody::Unknown`]: there is none of that name.
pub fn body_counted<'a>(
    names: impl ExactSizeIterator<Item = &'a str> + Clone,
    name: Option<&str>,
    subject: Option<&str>,
) -> Result<BodyIndex, WhichBody> {
    if name.is_some() {
        return body_named(names, name);
    }
    Ok(subject.and_then(|subject| body_named(names, Some(subject)).ok()).unwrap_or(0))
}

fn default_name() -> String {
    "person".to_owned()
}

/// A single body may stand as a table of its own.
pub(super) fn one_or_several<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Body>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Written {
        One(Box<Body>),
        Several(Vec<Body>),
    }
    Ok(match Written::deserialize(from)? {
        Written::One(body) => vec![*body],
        Written::Several(bodies) => bodies,
    })
}

/// Measured lengths of the human skeleton, between joint centres; absent ones follow from the height.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Lengths {
    /// Between the shoulders, m.
    #[schemars(range(min = 0.05, max = 1.0))]
    pub shoulders: Option<f64>,
    /// Between the hips, m.
    #[schemars(range(min = 0.05, max = 1.0))]
    pub hips: Option<f64>,
    /// From the hips' mid-point to the shoulders', m.
    #[schemars(range(min = 0.05, max = 1.0))]
    pub trunk: Option<f64>,
    /// Shoulder to elbow, m.
    #[schemars(range(min = 0.05, max = 1.0))]
    pub upper_arm: Option<f64>,
    /// Elbow to wrist, m.
    #[schemars(range(min = 0.05, max = 1.0))]
    pub forearm: Option<f64>,
    /// Hip to knee, m.
    #[schemars(range(min = 0.05, max = 1.0))]
    pub thigh: Option<f64>,
    /// Knee to ankle, m.
    #[schemars(range(min = 0.05, max = 1.0))]
    pub shank: Option<f64>,
    /// Ankle to floor, m.
    #[schemars(range(min = 0.01, max = 0.5))]
    pub ankle: Option<f64>,
    /// From the height of the shoulders to the top of the head, m.
    #[schemars(range(min = 0.05, max = 1.0))]
    pub head: Option<f64>,
    /// Wrist to finger tips, m.
    #[schemars(range(min = 0.02, max = 0.5))]
    pub hand: Option<f64>,
    /// Ankle to tip of the toes along the floor, m.
    #[schemars(range(min = 0.02, max = 0.5))]
    pub toes: Option<f64>,
}

/// Which segments a body has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Skeleton {
    /// Torso, pelvis, arms and legs, head, hands, feet and shoulders.
    #[default]
    Human,
    /// What `[[body.segments]]` says.
    Custom,
}

/// How it is known where the sensors sit on their segments.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Mounting {
    /// From poses and movements; without any, from the movement alone.
    #[default]
    Calibrate,
    /// Each sensor on the body says `segment` and `mount_quat_wxyz`.
    Given,
}

/// A segment of a custom skeleton.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SegmentSpec {
    /// Unique name.
    #[schemars(length(min = 1, max = 64))]
    pub name: String,
    /// Name of the segment it hangs on; absent for the root.
    pub parent: Option<String>,
    /// Name of the joint to its parent; absent for the root.
    pub joint: Option<String>,
    /// How the joint moves; absent for the root.
    pub kind: Option<JointKind>,
}

/// How a joint moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum JointKind {
    /// About one axis.
    Hinge,
    /// About two axes.
    TwoAxis,
    /// About all three.
    Ball,
}

/// When which pose or movement was held, in a recorded file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// A pose (`n_pose`, `t_pose`) or a movement (`elbow_flexion_r`, ...; `JOINT_flexion` in a custom skeleton).
    pub kind: String,
    /// Its begin in the file's time, s.
    pub start_s: f64,
    /// Its end in the file's time, s.
    pub end_s: f64,
}
