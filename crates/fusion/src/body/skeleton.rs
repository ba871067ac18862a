//! The rigid bodies that can wear a sensor: which there are, how long they are, and where their joints sit.
//!
//! In: a height, or measured lengths. Out: joint centres in segment frames, and points of the whole body from its
//! segments' orientations. It never decides an orientation. The table that both this file and `angles.rs`
//! follow is `docs/body.md`; the simulator follows it too and shares no code with them.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use posed_state::Plain;
use serde::{Deserialize, Serialize};

/// Body segments: the length of all arrays over them.
pub const SEGMENTS: usize = 17;

/// One of the rigid bodies: the ten of Weber et al. (2011), then what ends the chains, then the shoulders. Axes of each in the N-pose: x forward, y up, z to the
/// right; the origin of a limb's segment, of the head, of hands and feet, and of shoulders is the joint above it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, Plain)]
pub enum BodySegment {
    /// Chest and everything that moves with it.
    Torso,
    /// Hip bones.
    Pelvis,
    /// Right upper arm.
    UpperArmR,
    /// Right forearm and hand.
    ForearmR,
    /// Right thigh.
    ThighR,
    /// Right shank and foot.
    ShankR,
    /// Left upper arm.
    UpperArmL,
    /// Left forearm and hand.
    ForearmL,
    /// Left thigh.
    ThighL,
    /// Left shank and foot.
    ShankL,
    /// Head and neck.
    Head,
    /// Right hand.
    HandR,
    /// Right foot.
    FootR,
    /// Left hand.
    HandL,
    /// Left foot.
    FootL,
    /// Right collar bone and shoulder blade, as one.
    ShoulderR,
    /// Left collar bone and shoulder blade, as one.
    ShoulderL,
}

impl BodySegment {
    /// All, in the order in which arrays over segments hold them.
    pub const ALL: [Self; SEGMENTS] = [
        Self::Torso,
        Self::Pelvis,
        Self::UpperArmR,
        Self::ForearmR,
        Self::ThighR,
        Self::ShankR,
        Self::UpperArmL,
        Self::ForearmL,
        Self::ThighL,
        Self::ShankL,
        Self::Head,
        Self::HandR,
        Self::FootR,
        Self::HandL,
        Self::FootL,
        Self::ShoulderR,
        Self::ShoulderL,
    ];

    /// How many of [`Self::ALL`] come before the shoulders, which few people wear sensors on: where nobody does, messages and tables have so many.
    pub const BEFORE_SHOULDERS: usize = SEGMENTS - Self::SHOULDERS.len();

    /// What ends the chains of the others.
    pub const EXTREMITIES: [Self; 5] = [Self::Head, Self::HandR, Self::FootR, Self::HandL, Self::FootL];

    /// What the arms hang on: it moves where they begin, and no arm is turned against it, but against the torso.
    pub const SHOULDERS: [Self; 2] = [Self::ShoulderR, Self::ShoulderL];

    /// The leaves of the tree of segments that no limb's filter knows: each goes by its own sensor, and with its parent without one.
    pub const LEAVES: [Self; 7] =
        [Self::Head, Self::HandR, Self::FootR, Self::HandL, Self::FootL, Self::ShoulderR, Self::ShoulderL];

    /// Of the arms, hands included.
    pub const ARMS: [Self; 6] =
        [Self::UpperArmR, Self::ForearmR, Self::UpperArmL, Self::ForearmL, Self::HandR, Self::HandL];

    /// Of the legs, feet included, from above.
    pub const LEGS: [Self; 6] =
        [Self::ThighR, Self::ThighL, Self::ShankR, Self::ShankL, Self::FootR, Self::FootL];

    /// Its name in files and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Torso => "torso",
            Self::Pelvis => "pelvis",
            Self::UpperArmR => "upper_arm_r",
            Self::ForearmR => "forearm_r",
            Self::ThighR => "thigh_r",
            Self::ShankR => "shank_r",
            Self::UpperArmL => "upper_arm_l",
            Self::ForearmL => "forearm_l",
            Self::ThighL => "thigh_l",
            Self::ShankL => "shank_l",
            Self::Head => "head",
            Self::HandR => "hand_r",
            Self::FootR => "foot_r",
            Self::HandL => "hand_l",
            Self::FootL => "foot_l",
            Self::ShoulderR => "shoulder_r",
            Self::ShoulderL => "shoulder_l",
        }
    }

    /// The segment of that name, as [`Self::name`] gives it; `None` where there is none.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|segment| segment.name() == name)
    }

    /// Its place in arrays over segments, from 0 to 16, in the order of [`Self::ALL`].
    pub fn index(self) -> usize {
        self as usize
    }

    /// The segment that it is turned against; `None` for the pelvis, the root of the body.
    pub fn parent(self) -> Option<Self> {
        match self {
            Self::Pelvis => None,
            Self::Torso | Self::ThighR | Self::ThighL => Some(Self::Pelvis),
            Self::UpperArmR | Self::UpperArmL | Self::Head => Some(Self::Torso),
            Self::ShoulderR | Self::ShoulderL => Some(Self::Torso),
            Self::ForearmR => Some(Self::UpperArmR),
            Self::ForearmL => Some(Self::UpperArmL),
            Self::ShankR => Some(Self::ThighR),
            Self::ShankL => Some(Self::ThighL),
            Self::HandR => Some(Self::ForearmR),
            Self::HandL => Some(Self::ForearmL),
            Self::FootR => Some(Self::ShankR),
            Self::FootL => Some(Self::ShankL),
        }
    }

    /// The shoulder that an upper arm hangs on; `None` of all other segments.
    pub fn shoulder(self) -> Option<Self> {
        match self {
            Self::UpperArmR => Some(Self::ShoulderR),
            Self::UpperArmL => Some(Self::ShoulderL),
            _ => None,
        }
    }

    /// The same on the other side; itself in the middle.
    pub fn mirrored(self) -> Self {
        match self {
            Self::Torso | Self::Pelvis | Self::Head => self,
            Self::UpperArmR => Self::UpperArmL,
            Self::UpperArmL => Self::UpperArmR,
            Self::ForearmR => Self::ForearmL,
            Self::ForearmL => Self::ForearmR,
            Self::HandR => Self::HandL,
            Self::HandL => Self::HandR,
            Self::ThighR => Self::ThighL,
            Self::ThighL => Self::ThighR,
            Self::ShankR => Self::ShankL,
            Self::ShankL => Self::ShankR,
            Self::FootR => Self::FootL,
            Self::FootL => Self::FootR,
            Self::ShoulderR => Self::ShoulderL,
            Self::ShoulderL => Self::ShoulderR,
        }
    }

    /// 1 on the right, -1 on the left, 0 in the middle.
    pub fn side(self) -> f64 {
        match self {
            Self::Torso | Self::Pelvis | Self::Head => 0.0,
            Self::UpperArmR | Self::ForearmR | Self::ThighR | Self::ShankR => 1.0,
            Self::HandR | Self::FootR | Self::ShoulderR => 1.0,
            Self::UpperArmL | Self::ForearmL | Self::ThighL | Self::ShankL => -1.0,
            Self::HandL | Self::FootL | Self::ShoulderL => -1.0,
        }
    }
}

/// A limb: two segments below a ball joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Plain)]
pub enum Limb {
    /// Right arm.
    ArmR,
    /// Right leg.
    LegR,
    /// Left arm.
    ArmL,
    /// Left leg.
    LegL,
}

impl Limb {
    /// All, in the order in which arrays over limbs hold them.
    pub const ALL: [Self; 4] = [Self::ArmR, Self::LegR, Self::ArmL, Self::LegL];

    /// The segment that it hangs on, its upper and its lower segment, in this order.
    pub fn segments(self) -> [BodySegment; 3] {
        match self {
            Self::ArmR => [BodySegment::Torso, BodySegment::UpperArmR, BodySegment::ForearmR],
            Self::LegR => [BodySegment::Pelvis, BodySegment::ThighR, BodySegment::ShankR],
            Self::ArmL => [BodySegment::Torso, BodySegment::UpperArmL, BodySegment::ForearmL],
            Self::LegL => [BodySegment::Pelvis, BodySegment::ThighL, BodySegment::ShankL],
        }
    }

    /// The hand or the foot at its end.
    pub fn end(self) -> BodySegment {
        match self {
            Self::ArmR => BodySegment::HandR,
            Self::LegR => BodySegment::FootR,
            Self::ArmL => BodySegment::HandL,
            Self::LegL => BodySegment::FootL,
        }
    }
}

/// From the middle to the root of a shoulder, of half the distance between the arms' joints.
pub(super) const SHOULDER_ROOT: f64 = 0.14;

/// Lengths of a body, m: rigid segments with fixed joint centres.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Skeleton {
    /// Half the distance between the shoulders' centres, m.
    pub shoulder_half_m: f64,
    /// Half the distance between the hips' centres, m.
    pub hip_half_m: f64,
    /// From the hips' mid-point to the shoulders', m.
    pub trunk_m: f64,
    /// Shoulder to elbow, m.
    pub upper_arm_m: f64,
    /// Elbow to wrist, m.
    pub forearm_m: f64,
    /// Hip to knee, m.
    pub thigh_m: f64,
    /// Knee to ankle, m.
    pub shank_m: f64,
    /// Ankle to floor, m.
    pub foot_m: f64,
    /// From the shoulders' mid-point, where head and neck turn, to the top of the head, m.
    pub head_m: f64,
    /// Wrist to finger tips, m.
    pub hand_m: f64,
    /// Ankle to tip of the toes along the floor, m.
    pub toes_m: f64,
}

impl Skeleton {
    /// Lengths in proportion to the height, m: Drillis & Contini 1966, as Winter 2009 prints them. Their 0.191 for the hips is the breadth over the
    /// bones; the joints' centres lie 0.1 of the height apart (Bell et al. 1990: each 14 % of the distance between the front iliac spines from its side, which
    /// is some 0.14 of the height). Head, neck and shoulders make up what is left of the height; the toes' tip lies 0.125 of it ahead of the ankle (foot 0.152
    /// of it, of which a fifth is heel).
    pub fn from_height(height_m: f64) -> Self {
        Self {
            shoulder_half_m: 0.129 * height_m,
            hip_half_m: 0.05 * height_m,
            trunk_m: 0.288 * height_m,
            upper_arm_m: 0.186 * height_m,
            forearm_m: 0.146 * height_m,
            thigh_m: 0.245 * height_m,
            shank_m: 0.246 * height_m,
            foot_m: 0.039 * height_m,
            head_m: 0.182 * height_m,
            hand_m: 0.108 * height_m,
            toes_m: 0.125 * height_m,
        }
    }

    /// The joint between a segment and its parent, in the parent's frame, m; zero for the pelvis, which has none. That of an upper arm is where it is while the shoulder
    /// goes with the torso.
    pub fn joint_in_parent_m(&self, segment: BodySegment) -> Vector3<f64> {
        let side = segment.side();
        match segment {
            BodySegment::Pelvis | BodySegment::Torso => Vector3::zeros(),
            BodySegment::UpperArmR | BodySegment::UpperArmL => {
                Vector3::new(0.0, 0.5 * self.trunk_m, side * self.shoulder_half_m)
            }
            BodySegment::ThighR | BodySegment::ThighL => Vector3::new(0.0, 0.0, side * self.hip_half_m),
            BodySegment::ForearmR | BodySegment::ForearmL => Vector3::new(0.0, -self.upper_arm_m, 0.0),
            BodySegment::ShankR | BodySegment::ShankL => Vector3::new(0.0, -self.thigh_m, 0.0),
            BodySegment::Head => Vector3::new(0.0, 0.5 * self.trunk_m, 0.0),
            BodySegment::HandR | BodySegment::HandL => Vector3::new(0.0, -self.forearm_m, 0.0),
            BodySegment::FootR | BodySegment::FootL => Vector3::new(0.0, -self.shank_m, 0.0),
            BodySegment::ShoulderR | BodySegment::ShoulderL => {
                Vector3::new(0.0, 0.5 * self.trunk_m, side * SHOULDER_ROOT * self.shoulder_half_m)
            }
        }
    }

    /// The same joint in the segment's own frame, m: zero but for the torso, whose origin is midway between the hips' and
    /// the shoulders' mid-points.
    pub fn joint_in_segment_m(&self, segment: BodySegment) -> Vector3<f64> {
        match segment {
            BodySegment::Torso => Vector3::new(0.0, -0.5 * self.trunk_m, 0.0),
            _ => Vector3::zeros(),
        }
    }

    /// The segment's far end in its own frame, m: shoulders' mid-point (torso), elbow, wrist, knee, ankle, top of the
    /// head, finger tips, tip of the toes, the arm's joint (shoulder); zero for the pelvis.
    pub fn end_in_segment_m(&self, segment: BodySegment) -> Vector3<f64> {
        match segment {
            BodySegment::Torso => Vector3::new(0.0, 0.5 * self.trunk_m, 0.0),
            BodySegment::Pelvis => Vector3::zeros(),
            BodySegment::UpperArmR | BodySegment::UpperArmL => Vector3::new(0.0, -self.upper_arm_m, 0.0),
            BodySegment::ForearmR | BodySegment::ForearmL => Vector3::new(0.0, -self.forearm_m, 0.0),
            BodySegment::ThighR | BodySegment::ThighL => Vector3::new(0.0, -self.thigh_m, 0.0),
            BodySegment::ShankR | BodySegment::ShankL => Vector3::new(0.0, -self.shank_m, 0.0),
            BodySegment::Head => Vector3::new(0.0, self.head_m, 0.0),
            BodySegment::HandR | BodySegment::HandL => Vector3::new(0.0, -self.hand_m, 0.0),
            BodySegment::FootR | BodySegment::FootL => Vector3::new(self.toes_m, -self.foot_m, 0.0),
            BodySegment::ShoulderR | BodySegment::ShoulderL => {
                Vector3::z() * (segment.side() * (1.0 - SHOULDER_ROOT) * self.shoulder_half_m)
            }
        }
    }

    /// Where a sensor counts as sitting if that is not given, segment frame, m: in the middle of a limb's segment, half
    /// way to the end of head, hand, foot and shoulder, at the origin of the trunk's.
    pub fn usual_sensor_m(&self, segment: BodySegment) -> Vector3<f64> {
        0.5 * self.joint_in_segment_m(segment) + 0.5 * self.end_in_segment_m(segment)
    }

    /// Takes what movements have shown of the lengths of segments, m, of both sides the mean; those that are not learnt stay.
    pub fn learn(&mut self, length_m: impl Fn(BodySegment) -> Option<f64>) {
        let mean = |right: BodySegment, left: BodySegment| match (length_m(right), length_m(left)) {
            (Some(right_m), Some(left_m)) => Some(0.5 * (right_m + left_m)),
            (one, other) => one.or(other),
        };
        let pairs = [
            (&mut self.thigh_m, BodySegment::ThighR, BodySegment::ThighL),
            (&mut self.upper_arm_m, BodySegment::UpperArmR, BodySegment::UpperArmL),
            (&mut self.shank_m, BodySegment::ShankR, BodySegment::ShankL),
        ];
        for (own_m, right, left) in pairs {
            *own_m = mean(right, left).unwrap_or(*own_m);
        }
    }

    /// From an ankle back to the heel and ahead to the ball of the foot, along the floor, m: of a foot's length its last fifth, and 0.72 less that (the heads of the
    /// metatarsal bones).
    pub fn sole_m(&self) -> [f64; 2] {
        let heel_m = self.toes_m * 0.25;
        [heel_m, 0.72 * (self.toes_m + heel_m) - heel_m]
    }

    /// Origins of all segments in the room, m, by [`BodySegment::index`], from their orientations (segment to room) and the
    /// hips' mid-point in the room.
    pub fn origins_m(
        &self,
        orientations: &[UnitQuaternion<f64>; SEGMENTS],
        pelvis_m: Vector3<f64>,
    ) -> [Vector3<f64>; SEGMENTS] {
        let mut origins = [pelvis_m; SEGMENTS];
        // Parents first: the pelvis, then the torso, then shoulders and limbs from above.
        for segment in Self::PARENTS_FIRST {
            if let Some(parent) = segment.parent() {
                origins[segment.index()] = origins[parent.index()]
                    + orientations[parent.index()] * self.joint_in_parent_m(segment)
                    - orientations[segment.index()] * self.joint_in_segment_m(segment);
            }
            if let Some(shoulder) = segment.shoulder() {
                // Nothing where the shoulder goes with the torso.
                let girdle_m = self.end_in_segment_m(shoulder);
                origins[segment.index()] += orientations[shoulder.index()] * girdle_m
                    - orientations[BodySegment::Torso.index()] * girdle_m;
            }
        }
        origins
    }

    /// The right and the left ankle in the room, m, as [`Self::origins_m`].
    pub fn ankles_m(
        &self,
        orientations: &[UnitQuaternion<f64>; SEGMENTS],
        pelvis_m: Vector3<f64>,
    ) -> [Vector3<f64>; 2] {
        let origins = self.origins_m(orientations, pelvis_m);
        [BodySegment::ShankR, BodySegment::ShankL]
            .map(|shank| origins[shank.index()] + orientations[shank.index()] * self.end_in_segment_m(shank))
    }

    /// The hips' mid-point, room, m, if the body stands on its lower ankle above the origin: x and y are zero, z is the
    /// height.
    pub fn standing_m(&self, orientations: &[UnitQuaternion<f64>; SEGMENTS]) -> Vector3<f64> {
        let [right, left] = self.ankles_m(orientations, Vector3::zeros());
        Vector3::new(0.0, 0.0, self.foot_m - right.z.min(left.z))
    }

    /// All segments, each after its parent, and arms after the shoulders that they hang on.
    pub const PARENTS_FIRST: [BodySegment; SEGMENTS] = [
        BodySegment::Pelvis,
        BodySegment::Torso,
        BodySegment::ShoulderR,
        BodySegment::ShoulderL,
        BodySegment::UpperArmR,
        BodySegment::ForearmR,
        BodySegment::UpperArmL,
        BodySegment::ForearmL,
        BodySegment::ThighR,
        BodySegment::ShankR,
        BodySegment::ThighL,
        BodySegment::ShankL,
        BodySegment::Head,
        BodySegment::HandR,
        BodySegment::FootR,
        BodySegment::HandL,
        BodySegment::FootL,
    ];
}

/// Segment to room in the N-pose of a body that looks along the room's x: x forward, y up, z right.
pub fn upright() -> UnitQuaternion<f64> {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    UnitQuaternion::new_unchecked(Quaternion::new(half, half, 0.0, 0.0))
}
