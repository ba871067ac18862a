//! Angles of joints, by the names of their channels.
//!
//! What comes in: names of channels (`elbow_r_flexion_deg`). What goes out: which of them are angles, of which joint, side and
//! movement, and where they are defined. What it never does: look at anything but the name: a channel that ends in `_deg` or `_rad`
//! is an angle, and no other.

use posed_state::Plain;
use serde::{Deserialize, Serialize};

/// The plane and the rotation of a shoulder are defined while the arm is lifted by so much, degrees: they fall together where it hangs
/// and where it points up (Wu et al. 2005, the sequence Y-X-Y).
const LIFTED_DEG: std::ops::Range<f64> = 30.0..150.0;

/// Side of the body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// Left.
    Left,
    /// Right.
    Right,
}

/// A part of the body whose joints hang together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Part {
    Trunk,
    Arm,
    Leg,
}

/// An angle of a joint, from the name of its channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint<'a> {
    /// `elbow`.
    pub joint: &'a str,
    /// Of which side; `None` of the middle of the body.
    pub side: Option<Side>,
    /// `flexion`; empty where the name is the joint's alone.
    pub movement: &'a str,
    /// Degrees per unit of the channel.
    pub degrees: f64,
}

impl<'a> Joint<'a> {
    /// The angle that a channel is; `None` of any other quantity.
    pub fn of(channel: &'a str) -> Option<Self> {
        let (name, degrees) = channel
            .strip_suffix("_deg")
            .map(|name| (name, 1.0))
            .or_else(|| channel.strip_suffix("_rad").map(|name| (name, 180.0 / std::f64::consts::PI)))?;
        let side = |part: &str| match part {
            "l" | "left" => Some(Side::Left),
            "r" | "right" => Some(Side::Right),
            _ => None,
        };
        let (joint, rest) = name.split_once('_').unwrap_or((name, ""));
        if let Some(first) = side(joint) {
            // `left_knee_flexion`
            let (joint, movement) = rest.split_once('_').unwrap_or((rest, ""));
            return Some(Self { joint, side: Some(first), movement, degrees });
        }
        let (first, movement) = rest.split_once('_').unwrap_or((rest, ""));
        Some(match side(first) {
            Some(side) => Self { joint, side: Some(side), movement, degrees },
            None => Self { joint, side: None, movement: rest, degrees },
        })
    }

    /// Whether both are angles of one joint of one side.
    pub(super) fn is_beside(&self, other: &Joint<'_>) -> bool {
        (self.joint, self.side) == (other.joint, other.side)
    }

    /// The part of the body that it belongs to; `None` of a joint without a part, as the neck is.
    pub(super) fn part(&self) -> Option<Part> {
        match self.joint {
            "spine" | "trunk" | "torso" => Some(Part::Trunk),
            "shoulder" | "elbow" | "wrist" => Some(Part::Arm),
            "hip" | "knee" | "ankle" => Some(Part::Leg),
            _ => None,
        }
    }

    /// Whether it is lost where the arm hangs: plane and rotation of a shoulder.
    pub fn needs_a_lifted_arm(&self) -> bool {
        self.joint == "shoulder" && matches!(self.movement, "plane" | "rotation")
    }
}

/// One channel of an exercise as far as it may be spoken of.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub(super) struct Spoken {
    /// Degrees per unit of the channel.
    pub(super) degrees: f64,
    /// The channel that must show a lifted arm.
    elevation: Option<usize>,
}

impl Spoken {
    /// Of each channel: `None` where nobody would understand a word about it.
    pub(super) fn of(channels: &[String]) -> Vec<Option<Self>> {
        let angle = |channel: &String| {
            let joint = Joint::of(channel)?;
            let lifts = |other: &String| {
                Joint::of(other).is_some_and(|other| other.movement == "elevation" && other.is_beside(&joint))
            };
            let elevation =
                if joint.needs_a_lifted_arm() { Some(channels.iter().position(lifts)?) } else { None };
            Some(Self { degrees: joint.degrees, elevation })
        };
        channels.iter().map(angle).collect()
    }

    /// Whether the angle is defined both just now and in that state of the lesson, whose means these are.
    pub(super) fn is_defined_in(&self, observation: &[f64], mean: &[Vec<f64>], state: usize) -> bool {
        self.is_defined(|channel| observation[channel]) && self.is_defined(|channel| mean[channel][state])
    }

    /// Whether the angle is defined where the channels have these values.
    pub(super) fn is_defined(&self, values: impl Fn(usize) -> f64) -> bool {
        self.elevation.is_none_or(|elevation| LIFTED_DEG.contains(&(values(elevation) * self.degrees)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_names_of_a_body_and_of_others_are_understood() {
        let parts =
            |channel| Joint::of(channel).map(|of| (of.joint, of.side, of.movement, of.degrees.round()));
        assert_eq!(parts("elbow_r_flexion_deg"), Some(("elbow", Some(Side::Right), "flexion", 1.0)));
        assert_eq!(parts("left_knee_rad"), Some(("knee", Some(Side::Left), "", 57.0)));
        assert_eq!(parts("trunk_flexion_deg"), Some(("trunk", None, "flexion", 1.0)));
        for channel in ["wrist_up_x", "hand_x_m", "watch_gx", "knee"] {
            assert_eq!(parts(channel), None, "{channel}");
        }
    }

    #[test]
    fn a_plane_is_spoken_of_with_the_arm_lifted_only() {
        let channels =
            ["shoulder_r_plane_deg", "shoulder_r_elevation_deg", "shoulder_l_plane_deg", "imu_up_x"];
        let spoken = Spoken::of(&channels.map(str::to_owned));
        let plane = spoken[0].expect("its elevation is there");
        assert!(plane.is_defined(|_| 60.0) && !plane.is_defined(|_| 10.0) && !plane.is_defined(|_| f64::NAN));
        assert!(spoken[1].is_some_and(|elevation| elevation.is_defined(|_| 10.0)));
        assert!(spoken[2].is_none() && spoken[3].is_none());
    }
}
