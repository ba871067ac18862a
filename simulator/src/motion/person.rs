//! The simulated wearer of [`crate::body`] as a body that any device's sensors can ride on.

use std::path::PathBuf;

use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};

use crate::body::take::Take;
use crate::body::{Activity, Build, Mistake, SEGMENT_NAMES, Script};

/// A whole person who stands, calibrates, moves.
///
/// Segments: `torso`, `pelvis`, `upper_arm_r`, `forearm_r`, `thigh_r`, `shank_r` and `_l`, `head`, `hand_r`, `foot_r`, `shoulder_r` and `_l`, with the axes and origins of the stage
/// file's human skeleton.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Person {
    /// What the person does: `walking`, `reaching`, `curls`, `squats`, `sitting` (on a chair a quarter of the height high), `lying`, `jumping`, `waving`, what a calibration asks for (`poses`: N-pose and T-pose in
    /// turn, 3 s each, for `how = "quick"`; `bends`: a T-pose, then elbows, knees, hips and a bow, for `full`; `movements`: a T-pose,
    /// then limb after limb and the trunk, for `assign`), or `workout` (three sets of five curls,
    /// reaches, three sets of five squats, with rests between, and a `lap` about the room: two minutes and a quarter).
    pub activity: Activity,
    /// Whether a calibration comes first: poses and movements, 88 s.
    pub calibration: bool,
    /// Body height, m.
    pub height_m: f64,
    /// Where the person stands at first: the floor between the feet, room, m.
    pub position_m: [f64; 3],
    /// Where the person looks at first: 0 is along room x, counter-clockwise positive, degrees.
    pub heading_deg: f64,
    /// What the person does wrong in the first round of `poses`, `bends` and `movements`.
    pub mistake: Option<Mistake>,
    /// Files of recorded people whom the person follows in place of `activity`, one after the other, again and again; relative to the stage file: BVH, or CSV tables
    /// of joint centres (`left_knee_x`, ...), any unit, any axis up. In the recorded proportions, of the height `height_m`.
    pub follows: Vec<PathBuf>,
    /// How far straps wander: each turns its sensor on the segment slowly, within a minute or two, by this about each axis, root mean square over time, degrees.
    pub strap_deg: f64,
    /// How far the skin turns sensors while it follows accelerations: standard deviation about each segment axis for each direction of the acceleration, drawn once per segment, degrees
    /// per m/s². Soft tissue that gives by half a millimetre per m/s² and turns a sensor by 2 rad per metre: 0.06.
    pub skin_deg_per_m_s2: f64,
    /// Whether collar bones and shoulder blades move: with arms that are raised, and in `movements` by themselves. Without, they go with the chest.
    pub girdle: bool,
    /// Frames per second of tables that have no column of times (`t`, `time_s`, `t_ms`).
    pub follows_rate_hz: Option<f64>,
}

impl Default for Person {
    fn default() -> Self {
        Self {
            activity: Activity::Curls,
            calibration: false,
            height_m: 1.75,
            position_m: [0.0; 3],
            heading_deg: 0.0,
            mistake: None,
            follows: Vec::new(),
            follows_rate_hz: None,
            strap_deg: 0.0,
            skin_deg_per_m_s2: 0.0,
            girdle: false,
        }
    }
}

impl Person {
    pub(crate) const SEGMENTS: [&'static str; crate::body::SEGMENTS] = SEGMENT_NAMES;

    pub(super) fn pose(&self, take: Option<&Take>, segment: usize, t_s: f64) -> Isometry3<f64> {
        let build = take.map_or_else(|| Build::of_height(self.height_m), Take::build);
        let build = Build { girdle: self.girdle, ..build };
        let script = Script {
            activity: self.activity,
            calibration: self.calibration,
            facing: self.heading_deg.to_radians(),
            mistake: self.mistake,
        };
        let followed_s = t_s - script.activity_s();
        let mut posture = match take {
            Some(take) if followed_s >= 0.0 => take.facing(script.facing, followed_s),
            _ => script.at(t_s, &build),
        };
        posture.pelvis_m += Vector3::from(self.position_m);
        let placement = posture.place(&build)[segment];
        Isometry3::from_parts(placement.origin_m.into(), placement.orientation())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_person_stands_where_it_is_put_and_looks_where_it_is_directed() {
        let person = Person { position_m: [1.0, 2.0, 0.5], heading_deg: 90.0, ..Person::default() };
        let pelvis = person.pose(None, 1, -1.0);
        assert!((pelvis.rotation * Vector3::x() - Vector3::y()).norm() < 1e-12, "forward");
        assert!((pelvis.rotation * Vector3::y() - Vector3::z()).norm() < 1e-12, "upright");
        assert!((pelvis.translation.vector.xy() - nalgebra::Vector2::new(1.0, 2.0)).norm() < 1e-12);
        // Ankles at their height over the floor.
        let shank = person.pose(None, 5, -1.0) * nalgebra::Point3::new(0.0, -0.246 * 1.75, 0.0);
        assert!((shank.z - 0.5 - 0.039 * 1.75).abs() < 0.005, "{shank}");
    }

    #[test]
    fn poses_take_turns() {
        let person = Person { activity: Activity::Poses, ..Person::default() };
        let hangs = |t_s: f64| (person.pose(None, 2, t_s).rotation * Vector3::y()).z;
        for round in [0.0, 10.0, 20.0] {
            assert!(hangs(round + 1.5) > 0.999_999 && hangs(round + 6.5).abs() < 1e-6, "{round}");
        }
    }
}
