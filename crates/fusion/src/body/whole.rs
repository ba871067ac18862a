//! The 23 rigid bodies that programs for animation and gait know, from those that can wear a sensor here.
//!
//! In: a [`Skeleton`] and the orientations of its segments. Out: orientations and joint centres of pelvis, four pieces of the spine, neck and head,
//! shoulders, arms, hands, legs, feet and toes, as in MVN (names, order and parents). It measures nothing: what lies between two segments follows from
//! them. The bend between pelvis and chest is shared out over the spine in proportion to its pieces' lengths; the neck takes half of what the head is
//! turned against the chest; the toes stay on the floor while the heel rises.
//!
//! Joint centres are those of [`Skeleton::origins_m`] but for what hangs on a bent spine: the ten-segment trunk is one straight line, this one is an arc of
//! the same length.

use nalgebra::{UnitQuaternion, Vector3};

use super::angles::joint_angles;
use super::calibrate::posture;
use super::skeleton::{BodySegment, SEGMENTS, SHOULDER_ROOT, Skeleton, upright};
use posed_geometry::so3::{exp, log};

/// Length of arrays over [`WholeSegment`].
pub const WHOLE: usize = 23;

/// One of the 23, in MVN's order. Axes as those of [`BodySegment`]; the origin is the joint above it, the hips' mid-point for the pelvis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WholeSegment {
    /// Hip bones.
    Pelvis,
    /// Lower lumbar spine, above L5-S1.
    L5,
    /// Upper lumbar spine, above L4-L3.
    L3,
    /// Lower chest, above L1-T12.
    T12,
    /// Upper chest, above T9-T8; it goes with [`BodySegment::Torso`].
    T8,
    /// Neck, above T1-C7.
    Neck,
    /// Head, above C1.
    Head,
    /// Right collar bone and shoulder blade.
    ShoulderR,
    /// Right upper arm.
    UpperArmR,
    /// Right forearm.
    ForearmR,
    /// Right hand.
    HandR,
    /// Left collar bone and shoulder blade.
    ShoulderL,
    /// Left upper arm.
    UpperArmL,
    /// Left forearm.
    ForearmL,
    /// Left hand.
    HandL,
    /// Right thigh.
    UpperLegR,
    /// Right shank.
    LowerLegR,
    /// Right foot up to its ball.
    FootR,
    /// Right toes.
    ToeR,
    /// Left thigh.
    UpperLegL,
    /// Left shank.
    LowerLegL,
    /// Left foot up to its ball.
    FootL,
    /// Left toes.
    ToeL,
}

use WholeSegment as W;

impl WholeSegment {
    /// All, parents first, in the order in which arrays over them hold them.
    pub const ALL: [Self; WHOLE] = [
        W::Pelvis,
        W::L5,
        W::L3,
        W::T12,
        W::T8,
        W::Neck,
        W::Head,
        W::ShoulderR,
        W::UpperArmR,
        W::ForearmR,
        W::HandR,
        W::ShoulderL,
        W::UpperArmL,
        W::ForearmL,
        W::HandL,
        W::UpperLegR,
        W::LowerLegR,
        W::FootR,
        W::ToeR,
        W::UpperLegL,
        W::LowerLegL,
        W::FootL,
        W::ToeL,
    ];

    /// Its name in files of ours: `l5`, `upper_leg_r`.
    pub fn name(self) -> &'static str {
        match self {
            W::Pelvis => "pelvis",
            W::L5 => "l5",
            W::L3 => "l3",
            W::T12 => "t12",
            W::T8 => "t8",
            W::Neck => "neck",
            W::Head => "head",
            W::ShoulderR => "shoulder_r",
            W::UpperArmR => "upper_arm_r",
            W::ForearmR => "forearm_r",
            W::HandR => "hand_r",
            W::ShoulderL => "shoulder_l",
            W::UpperArmL => "upper_arm_l",
            W::ForearmL => "forearm_l",
            W::HandL => "hand_l",
            W::UpperLegR => "upper_leg_r",
            W::LowerLegR => "lower_leg_r",
            W::FootR => "foot_r",
            W::ToeR => "toe_r",
            W::UpperLegL => "upper_leg_l",
            W::LowerLegL => "lower_leg_l",
            W::FootL => "foot_l",
            W::ToeL => "toe_l",
        }
    }

    /// Its place in arrays, 0 to 22.
    pub fn index(self) -> usize {
        self as usize
    }

    /// The segment it hangs on; `None` for the pelvis.
    pub fn parent(self) -> Option<Self> {
        Some(match self {
            W::Pelvis => return None,
            W::L5 | W::UpperLegR | W::UpperLegL => W::Pelvis,
            W::L3 => W::L5,
            W::T12 => W::L3,
            W::T8 => W::T12,
            W::Neck | W::ShoulderR | W::ShoulderL => W::T8,
            W::Head => W::Neck,
            W::UpperArmR => W::ShoulderR,
            W::ForearmR => W::UpperArmR,
            W::HandR => W::ForearmR,
            W::UpperArmL => W::ShoulderL,
            W::ForearmL => W::UpperArmL,
            W::HandL => W::ForearmL,
            W::LowerLegR => W::UpperLegR,
            W::FootR => W::LowerLegR,
            W::ToeR => W::FootR,
            W::LowerLegL => W::UpperLegL,
            W::FootL => W::LowerLegL,
            W::ToeL => W::FootL,
        })
    }

    /// 1 on the right, -1 on the left, 0 in the middle.
    pub fn side(self) -> f64 {
        match self {
            W::ShoulderR | W::UpperArmR | W::ForearmR | W::HandR => 1.0,
            W::UpperLegR | W::LowerLegR | W::FootR | W::ToeR => 1.0,
            W::ShoulderL | W::UpperArmL | W::ForearmL | W::HandL => -1.0,
            W::UpperLegL | W::LowerLegL | W::FootL | W::ToeL => -1.0,
            _ => 0.0,
        }
    }

    /// The segment whose sensor shows it; `None` where it follows from its neighbours.
    pub fn measured_as(self) -> Option<BodySegment> {
        Some(match self {
            W::Pelvis => BodySegment::Pelvis,
            W::T8 => BodySegment::Torso,
            W::Head => BodySegment::Head,
            W::UpperArmR => BodySegment::UpperArmR,
            W::ForearmR => BodySegment::ForearmR,
            W::HandR => BodySegment::HandR,
            W::UpperArmL => BodySegment::UpperArmL,
            W::ForearmL => BodySegment::ForearmL,
            W::HandL => BodySegment::HandL,
            W::UpperLegR => BodySegment::ThighR,
            W::LowerLegR => BodySegment::ShankR,
            W::FootR => BodySegment::FootR,
            W::UpperLegL => BodySegment::ThighL,
            W::LowerLegL => BodySegment::ShankL,
            W::FootL => BodySegment::FootL,
            W::ShoulderR => BodySegment::ShoulderR,
            W::ShoulderL => BodySegment::ShoulderL,
            W::L5 | W::L3 | W::T12 | W::Neck | W::ToeR | W::ToeL => return None,
        })
    }
}

/// Of the way from the hips to the height of the shoulders: to L5-S1, L4-L3, L1-T12, T9-T8 and the roots of the shoulders. In proportion to the fractions of
/// a 23-segment model of the literature (pelvis 0.058, L5 0.065, L3 and T12 0.059, then 0.047 of the body's height).
const SPINE: [f64; 4] = [0.058 / 0.288, 0.123 / 0.288, 0.182 / 0.288, 0.241 / 0.288];
/// Shares of a bend from pelvis to chest that the joints below L5, L3, T12 and T8 take: by the lengths above them.
const BEND: [f64; 4] = [0.244, 0.223, 0.223, 0.31];
/// Of the head's turn against the chest, what the neck takes.
const NECK_BEND: f64 = 0.5;
/// Above the height of the shoulders: C7, and C1, of the length from there to the top of the head.
const C7: f64 = 0.036 / 0.182;
const C1: f64 = 0.091 / 0.182;
/// From the ankle to the ball of the foot along the floor, of the way to the toes' tip, and its height, of the ankle's.
const BALL: f64 = 0.776;
const BALL_HEIGHT: f64 = 0.23;

impl Skeleton {
    /// The joint between a segment of the 23 and its parent, in the parent's frame, m; zero for the pelvis.
    pub fn whole_joint_m(&self, segment: WholeSegment) -> Vector3<f64> {
        let up = |m: f64| Vector3::new(0.0, m, 0.0);
        let side = segment.side();
        match segment {
            W::Pelvis => Vector3::zeros(),
            W::L5 => up(SPINE[0] * self.trunk_m),
            W::L3 => up((SPINE[1] - SPINE[0]) * self.trunk_m),
            W::T12 => up((SPINE[2] - SPINE[1]) * self.trunk_m),
            W::T8 => up((SPINE[3] - SPINE[2]) * self.trunk_m),
            W::Neck => up((1.0 - SPINE[3]) * self.trunk_m + C7 * self.head_m),
            W::Head => up((C1 - C7) * self.head_m),
            W::ShoulderR | W::ShoulderL => {
                up((1.0 - SPINE[3]) * self.trunk_m)
                    + Vector3::z() * (side * SHOULDER_ROOT * self.shoulder_half_m)
            }
            W::UpperArmR | W::UpperArmL => {
                Vector3::z() * (side * (1.0 - SHOULDER_ROOT) * self.shoulder_half_m)
            }
            W::ForearmR | W::ForearmL => up(-self.upper_arm_m),
            W::HandR | W::HandL => up(-self.forearm_m),
            W::UpperLegR | W::UpperLegL => Vector3::z() * (side * self.hip_half_m),
            W::LowerLegR | W::LowerLegL => up(-self.thigh_m),
            W::FootR | W::FootL => up(-self.shank_m),
            W::ToeR | W::ToeL => Vector3::new(BALL * self.toes_m, -(1.0 - BALL_HEIGHT) * self.foot_m, 0.0),
        }
    }

    /// Where a segment ends on which nothing hangs, its own frame, m: top of the head, finger tips, tip of the toes. `None` for all others.
    pub fn whole_end_m(&self, segment: WholeSegment) -> Option<Vector3<f64>> {
        match segment {
            W::Head => Some(Vector3::new(0.0, (1.0 - C1) * self.head_m, 0.0)),
            W::HandR | W::HandL => Some(Vector3::new(0.0, -self.hand_m, 0.0)),
            W::ToeR | W::ToeL => {
                Some(Vector3::new((1.0 - BALL) * self.toes_m, -BALL_HEIGHT * self.foot_m, 0.0))
            }
            _ => None,
        }
    }

    /// Joint centres of the 23 in the room, m, by [`WholeSegment::index`], from their orientations (segment to room) and the hips' mid-point.
    pub fn whole_origins_m(
        &self,
        orientations: &[UnitQuaternion<f64>; WHOLE],
        pelvis_m: Vector3<f64>,
    ) -> [Vector3<f64>; WHOLE] {
        let mut origins = [pelvis_m; WHOLE];
        for segment in WholeSegment::ALL {
            if let Some(parent) = segment.parent() {
                origins[segment.index()] =
                    origins[parent.index()] + orientations[parent.index()] * self.whole_joint_m(segment);
            }
        }
        origins
    }
}

/// Orientations of the 23, segment to room, by [`WholeSegment::index`], from those of all segments that can wear a sensor, by [`BodySegment::index`].
pub fn whole(orientations: &[UnitQuaternion<f64>; SEGMENTS]) -> [UnitQuaternion<f64>; WHOLE] {
    let of = |segment: BodySegment| orientations[segment.index()];
    let (pelvis, torso) = (of(BodySegment::Pelvis), of(BodySegment::Torso));
    let bend = log(&(pelvis.inverse() * torso));
    let nod = log(&(torso.inverse() * of(BodySegment::Head)));
    let mut all = [pelvis; WHOLE];
    for segment in WholeSegment::ALL {
        let bent = |share: f64| pelvis * exp(&(bend * share));
        all[segment.index()] = match segment {
            W::L5 => bent(BEND[0]),
            W::L3 => bent(BEND[0] + BEND[1]),
            W::T12 => bent(BEND[0] + BEND[1] + BEND[2]),
            W::Neck => torso * exp(&(nod * NECK_BEND)),
            W::ToeR => toes(&of(BodySegment::FootR)),
            W::ToeL => toes(&of(BodySegment::FootL)),
            _ => segment.measured_as().map_or(pelvis, of),
        };
    }
    all
}

/// The joints of the 23 that lie within a segment which can wear a sensor, or between two such: their names, the segment below, and the two that they follow from.
const INNER: [(&str, WholeSegment, [BodySegment; 2]); 8] = [
    ("l5s1", W::L5, [BodySegment::Pelvis, BodySegment::Torso]),
    ("l4l3", W::L3, [BodySegment::Pelvis, BodySegment::Torso]),
    ("l1t12", W::T12, [BodySegment::Pelvis, BodySegment::Torso]),
    ("t9t8", W::T8, [BodySegment::Pelvis, BodySegment::Torso]),
    ("t1c7", W::Neck, [BodySegment::Torso, BodySegment::Head]),
    ("c1head", W::Head, [BodySegment::Torso, BodySegment::Head]),
    ("ball_r", W::ToeR, [BodySegment::FootR; 2]),
    ("ball_l", W::ToeL, [BodySegment::FootL; 2]),
];

/// Those between a shoulder and its arm, by the arm; [`super::angles()`] has the arm against the torso.
const GLENOHUMERAL: [(&str, BodySegment); 2] =
    [("glenohumeral_r", BodySegment::UpperArmR), ("glenohumeral_l", BodySegment::UpperArmL)];

/// Angles of the joints of the 23 which no sensor shows by itself: of the spine's, flexion, lateral and rotation as those of `spine`; of the ball of a foot its
/// flexion, positive where the toes bend up; of arms below a shoulder that is `shown` those against the shoulder, as the arm's against the torso. Names and angles, rad; `None` where a segment that it follows from is not `shown`, by [`BodySegment::index`].
/// All other joints are those of [`super::angles()`].
pub fn inner_angles(
    orientations: &[UnitQuaternion<f64>; SEGMENTS],
    shown: &[bool; SEGMENTS],
) -> impl Iterator<Item = (&'static str, &'static str, Option<f64>)> + use<> {
    let all = whole(orientations);
    let shown = *shown;
    let inner = INNER.into_iter().flat_map(move |(joint, segment, from)| {
        let above = segment.parent().map_or(0, WholeSegment::index);
        let rotation = all[above].inverse() * all[segment.index()];
        let known = from.iter().all(|from| shown[from.index()]);
        let [flexion, lateral, turn, ..] = joint_angles(BodySegment::Torso, &rotation);
        let ball = segment.side() != 0.0;
        // The toes bend about z, upwards.
        let of =
            [("flexion", if ball { -flexion } else { flexion }), ("lateral", lateral), ("rotation", turn)];
        let count = if ball { 1 } else { 3 };
        of.into_iter().take(count).map(move |(angle, value)| (joint, angle, known.then_some(value)))
    });
    let arms = GLENOHUMERAL.into_iter().filter(move |(_, arm)| {
        arm.shoulder().is_some_and(|shoulder| shown[shoulder.index()]) && shown[arm.index()]
    });
    inner.chain(arms.flat_map(move |(joint, below)| {
        let arm = if below.side() > 0.0 { W::UpperArmR } else { W::UpperArmL };
        let above = arm.parent().map_or(0, WholeSegment::index);
        let rotation = all[above].inverse() * all[arm.index()];
        let [plane, elevation, rotation, ..] = joint_angles(below, &rotation);
        [("plane", plane), ("elevation", elevation), ("rotation", rotation)]
            .map(|(angle, value)| (joint, angle, Some(value)))
    }))
}

/// Toes of a foot that rolls over its ball stay level; of any other they go with it.
fn toes(foot: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    // Toes bend upwards by 60 degrees at most, and not downwards.
    const BENT_RAD: f64 = 1.05;
    let forward = foot * Vector3::x();
    let down_rad = -libm::asin(forward.z.clamp(-1.0, 1.0));
    foot * exp(&(Vector3::z() * down_rad.clamp(0.0, BENT_RAD)))
}

/// The T-pose that programs for animation begin with: segment to room of a body that looks along the room's x, arms level to the sides, palms down.
pub fn t_pose(segment: BodySegment) -> UnitQuaternion<f64> {
    upright() * posture(segment, true)
}

/// [`t_pose`] of the 23.
pub fn whole_t_pose(segment: WholeSegment) -> UnitQuaternion<f64> {
    segment.measured_as().map_or_else(upright, t_pose)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::{joint_rotation, of_joint};

    fn body(bent: &[(BodySegment, [f64; 3])]) -> [UnitQuaternion<f64>; SEGMENTS] {
        let mut all = [upright(); SEGMENTS];
        for segment in Skeleton::PARENTS_FIRST {
            let Some(parent) = segment.parent() else { continue };
            let angles = bent.iter().find(|(at, _)| *at == segment).map_or([0.0; 3], |(_, angles)| *angles);
            assert!(!of_joint(segment).is_empty());
            all[segment.index()] = all[parent.index()] * joint_rotation(segment, &angles);
        }
        all
    }

    #[test]
    fn parents_come_first_and_lengths_make_up_the_height() {
        for (k, segment) in WholeSegment::ALL.into_iter().enumerate() {
            assert!(segment.index() == k && segment.parent().is_none_or(|parent| parent.index() < k));
        }
        let skeleton = Skeleton::from_height(1.8);
        let all = whole(&body(&[]));
        let origins = skeleton.whole_origins_m(&all, Vector3::new(0.0, 0.0, 0.53 * 1.8));
        let end = |segment: WholeSegment| {
            origins[segment.index()] + all[segment.index()] * skeleton.whole_end_m(segment).unwrap()
        };
        assert!((end(W::Head).z - 1.8).abs() < 1e-9, "{}", end(W::Head));
        assert!(end(W::ToeR).z.abs() < 1e-9 && end(W::ToeL).z.abs() < 1e-9);
        // Upright it is the body of those that can wear a sensor.
        let measured = skeleton.origins_m(&body(&[]), Vector3::new(0.0, 0.0, 0.53 * 1.8));
        for segment in WholeSegment::ALL {
            let Some(as_measured) = segment.measured_as() else { continue };
            if !matches!(segment, W::T8 | W::Head) {
                let off_m = (origins[segment.index()] - measured[as_measured.index()]).norm();
                assert!(off_m < 1e-9, "{segment:?} {off_m}");
            }
        }
    }

    #[test]
    fn a_bow_bends_the_spine_evenly_and_a_nod_the_neck_half() {
        let all =
            whole(&body(&[(BodySegment::Torso, [1.0, 0.0, 0.0]), (BodySegment::Head, [0.6, 0.0, 0.0])]));
        let between = |a: W, b: W| all[a.index()].angle_to(&all[b.index()]);
        for (pair, share) in
            [(W::Pelvis, W::L5), (W::L5, W::L3), (W::L3, W::T12), (W::T12, W::T8)].iter().zip(BEND)
        {
            assert!((between(pair.0, pair.1) - share).abs() < 1e-9, "{pair:?}");
        }
        assert!(
            (between(W::T8, W::Neck) - 0.3).abs() < 1e-9 && (between(W::Neck, W::Head) - 0.3).abs() < 1e-9
        );
        assert!((BEND.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_spine_s_angles_make_up_its_bend_and_the_ball_s_is_the_heel_s_rise() {
        let bent = body(&[
            (BodySegment::Torso, [1.0, 0.0, 0.0]),
            (BodySegment::Head, [0.0, 0.0, 0.6]),
            (BodySegment::FootL, [-0.5, 0.0, 0.0]),
        ]);
        let mut shown = [true; SEGMENTS];
        let sum = |of: &[&str], angle: &str, shown: &[bool; SEGMENTS]| -> Option<f64> {
            let all = inner_angles(&bent, shown);
            all.filter(|(joint, of_it, _)| of.contains(joint) && *of_it == angle)
                .map(|(.., value)| value)
                .sum()
        };
        let spine = ["l5s1", "l4l3", "l1t12", "t9t8"];
        assert!((sum(&spine, "flexion", &shown).unwrap() - 1.0).abs() < 1e-9);
        assert!((sum(&["l5s1"], "flexion", &shown).unwrap() - BEND[0]).abs() < 1e-9);
        assert!((sum(&["t1c7", "c1head"], "rotation", &shown).unwrap() - 0.6).abs() < 1e-9);
        assert!((sum(&["ball_l"], "flexion", &shown).unwrap() - 0.5).abs() < 1e-9);
        assert!(sum(&["ball_r"], "flexion", &shown).unwrap().abs() < 1e-9);
        shown[BodySegment::Pelvis.index()] = false;
        assert_eq!(sum(&spine, "flexion", &shown), None);
        assert_eq!(inner_angles(&bent, &shown).count(), 26);
    }

    #[test]
    fn toes_stay_on_the_floor_while_the_heel_rises_and_go_with_a_foot_that_points_up() {
        for (dorsiflexion, toe_up) in [(-0.6, 0.0), (0.4, 0.4), (-1.4, -0.35)] {
            let all = whole(&body(&[(BodySegment::FootR, [dorsiflexion, 0.0, 0.0])]));
            let forward = all[W::ToeR.index()] * Vector3::x();
            assert!((libm::asin(forward.z) - toe_up).abs() < 1e-9, "{dorsiflexion} {forward}");
        }
    }

    #[test]
    fn a_t_pose_is_one() {
        let reaches = |segment: W| whole_t_pose(segment) * -Vector3::y();
        assert!((reaches(W::HandR) - -Vector3::y()).norm() < 1e-12, "to the right");
        assert!((reaches(W::ForearmL) - Vector3::y()).norm() < 1e-12, "to the left");
        assert!((reaches(W::LowerLegL) - -Vector3::z()).norm() < 1e-12);
    }
}
