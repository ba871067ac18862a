//! What a body does at known times for its calibration: poses that are held and movements.
//!
//! In: names as stage files and recordings have them. Out: [`BlockKind`]s, and back. It never says how anything was done.

use serde::{Deserialize, Serialize};

use super::BodySamples;
use super::skeleton::BodySegment;

/// What can be held or done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum BlockKind {
    /// Upright, arms hanging, thumbs forward.
    NPose,
    /// Upright, arms sideways, thumbs forward.
    TPose,
    /// Torso and pelvis bend forward and back.
    Bow,
    /// The torso turns to the left and back over a pelvis that stands still.
    TrunkRotation,
    /// Walks about, with arms that swing: nothing is held.
    Walk,
    /// One joint moves in one way from the N-pose, the positive way first.
    Move(BodySegment, Movement),
}

/// How the joint above a segment moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Movement {
    /// Bends.
    Flexion,
    /// Sideways.
    Abduction,
    /// About the segment's own axis, inwards first.
    Rotation,
    /// Forearm about its own axis, palm down first.
    Pronation,
    /// Shoulder up, towards the ear.
    Elevation,
}

impl BlockKind {
    /// From its name in a stage file, such as `n_pose` or `elbow_flexion_r`; `None` where there is no such pose or movement.
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "n_pose" => return Some(Self::NPose),
            "t_pose" => return Some(Self::TPose),
            "bow" => return Some(Self::Bow),
            "walk" => return Some(Self::Walk),
            "trunk_rotation" => return Some(Self::TrunkRotation),
            "neck_flexion" => return Some(Self::Move(BodySegment::Head, Movement::Flexion)),
            _ => {}
        }
        let (rest, right) = match name.strip_suffix("_r") {
            Some(rest) => (rest, true),
            None => (name.strip_suffix("_l")?, false),
        };
        let side = |r, l| if right { r } else { l };
        if rest == "shrug" {
            let shoulder = side(BodySegment::ShoulderR, BodySegment::ShoulderL);
            return Some(Self::Move(shoulder, Movement::Elevation));
        }
        let (joint, movement) = rest.split_once('_')?;
        let segment = match joint {
            "elbow" => side(BodySegment::ForearmR, BodySegment::ForearmL),
            "shoulder" => side(BodySegment::UpperArmR, BodySegment::UpperArmL),
            "knee" => side(BodySegment::ShankR, BodySegment::ShankL),
            "hip" => side(BodySegment::ThighR, BodySegment::ThighL),
            "wrist" => side(BodySegment::HandR, BodySegment::HandL),
            "ankle" => side(BodySegment::FootR, BodySegment::FootL),
            _ => return None,
        };
        let movement = match movement {
            "flexion" => Movement::Flexion,
            "abduction" if matches!(joint, "shoulder" | "hip") => Movement::Abduction,
            "rotation" if matches!(joint, "shoulder" | "hip") => Movement::Rotation,
            "pronation" if joint == "elbow" => Movement::Pronation,
            _ => return None,
        };
        Some(Self::Move(segment, movement))
    }

    /// Its name in a stage file; the inverse of [`Self::named`].
    pub fn name(self) -> String {
        let (segment, movement) = match self {
            Self::NPose => return "n_pose".into(),
            Self::TPose => return "t_pose".into(),
            Self::Bow => return "bow".into(),
            Self::Walk => return "walk".into(),
            Self::TrunkRotation => return "trunk_rotation".into(),
            Self::Move(BodySegment::Head, _) => return "neck_flexion".into(),
            Self::Move(BodySegment::ShoulderR, _) => return "shrug_r".into(),
            Self::Move(BodySegment::ShoulderL, _) => return "shrug_l".into(),
            Self::Move(segment, movement) => (segment, movement),
        };
        let joint = match segment {
            BodySegment::ForearmR | BodySegment::ForearmL => "elbow",
            BodySegment::ShankR | BodySegment::ShankL => "knee",
            BodySegment::ThighR | BodySegment::ThighL => "hip",
            BodySegment::HandR | BodySegment::HandL => "wrist",
            BodySegment::FootR | BodySegment::FootL => "ankle",
            _ => "shoulder",
        };
        let movement = match movement {
            Movement::Flexion => "flexion",
            Movement::Abduction => "abduction",
            Movement::Rotation => "rotation",
            Movement::Pronation => "pronation",
            Movement::Elevation => "elevation",
        };
        format!("{joint}_{movement}_{}", if segment.side() > 0.0 { "r" } else { "l" })
    }
}

/// When something known was done, on the clock of the recording.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Block {
    /// What.
    pub kind: BlockKind,
    /// Its begin, s.
    pub start_s: f64,
    /// Its end, s.
    pub end_s: f64,
}

/// One time of a recording of the body: time, s, and samples. Times of a recording rise.
pub type Recorded = (f64, BodySamples);
