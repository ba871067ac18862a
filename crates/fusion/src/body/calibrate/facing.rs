//! Which way a body faces, from the axes of its movements and from arms that were raised sideways.
//!
//! In: poses and axes as the sensors saw them. Out: level directions, each with what shows it, and their weighted mean.

use nalgebra::{UnitQuaternion, Vector3};

use super::super::block::BlockKind;
use super::super::skeleton::{BodySegment, upright};
use super::super::{joint_rotation, yaw_from_upright};
use super::CalibrationError;
use super::session::{Held, ONE_WAY, Seen};

/// How well people raise their arms just sideways, and stand straight ahead, degrees.
pub(super) const FACING_DEG: f64 = 5.0;
/// An arm whose direction has a shorter level part was not raised.
const RAISED: f64 = 0.7;
/// Upper arm and forearm of each side.
pub(super) const ARMS: [[BodySegment; 2]; 2] =
    [[BodySegment::UpperArmR, BodySegment::ForearmR], [BodySegment::UpperArmL, BodySegment::ForearmL]];

/// The direction that one movement or pose shows in one sensor.
pub(super) struct Faced {
    pub(super) segment: BodySegment,
    pub(super) kind: BlockKind,
    /// Level, in the room or the sensor's level frame; short where what shows it is steep.
    pub(super) forward: Vector3<f64>,
    pub(super) sigma_deg: f64,
    /// Whether it may as well be the other way: of a movement that went both ways alike.
    pub(super) open: bool,
}

/// Which way the body faced in the N-pose, or in the T-pose where none was held, by all that shows it.
pub(super) fn faced(seen: &Seen) -> impl Iterator<Item = Faced> {
    let by_axis = seen.axes.iter().filter_map(|axis| {
        let sensor = seen.reference()?[axis.segment.index()]?;
        // Forward is where the axis would point if the body looked along the room's x, turned with it.
        let nominal = upright() * posture(axis.segment, seen.low().is_none()) * axis.in_segment;
        let forward = forward(&(sensor * axis.sensor), &nominal);
        let open = axis.one_way < ONE_WAY;
        Some(Faced { segment: axis.segment, kind: axis.block.kind, forward, sigma_deg: axis.sigma_deg, open })
    });
    // From the N-pose to the T-pose an arm goes to the body's side, however it turns about its own length.
    let by_arms = BodySegment::ARMS.into_iter().filter_map(|segment| {
        let (low, high) = (seen.low()?, seen.high()?);
        let rotation = high[segment.index()]? * low[segment.index()]?.inverse();
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -turned_between(low, high));
        let arm = turned * raised_to(&rotation);
        let forward = Vector3::new(-arm.y, arm.x, 0.0) * segment.side();
        let faced = Faced { segment, kind: BlockKind::TPose, forward, sigma_deg: FACING_DEG, open: false };
        (forward.norm() > RAISED).then_some(faced)
    });
    by_axis.chain(by_arms)
}

/// Where a segment that hung points after a rotation.
pub(super) fn raised_to(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    rotation * -Vector3::z()
}

/// Which way the body faces.
pub(super) struct Facing<'a> {
    pub(super) magnetic: bool,
    pub(super) seen: &'a Seen,
}

impl Facing<'_> {
    /// Turn of the body about the vertical in a segment's room or level frame, rad.
    pub(super) fn of(&self, segment: BodySegment) -> Result<f64, CalibrationError> {
        let sum: Vector3<f64> = faced(self.seen)
            .filter(|faced| self.magnetic || faced.segment == segment)
            .map(|faced| faced.forward / faced.sigma_deg)
            .sum();
        if sum.norm() < 1e-6 {
            return Err(self.missing(segment));
        }
        Ok(libm::atan2(sum.y, sum.x))
    }

    fn missing(&self, segment: BodySegment) -> CalibrationError {
        if self.magnetic {
            let fix = "a `t_pose`, or a movement such as `elbow_flexion_r` or `knee_flexion_r`";
            return CalibrationError::Facing { of: "the body", fix };
        }
        let fix = match segment {
            BodySegment::Torso | BodySegment::Pelvis | BodySegment::ShoulderR | BodySegment::ShoulderL => {
                "a `bow` (without magnetometers each sensor needs a movement)"
            }
            BodySegment::UpperArmR | BodySegment::ForearmR => "a `t_pose` or `elbow_flexion_r`",
            BodySegment::UpperArmL | BodySegment::ForearmL => "a `t_pose` or `elbow_flexion_l`",
            BodySegment::ThighR => "`hip_flexion_r`",
            BodySegment::ThighL => "`hip_flexion_l`",
            BodySegment::ShankR => "`knee_flexion_r`",
            BodySegment::ShankL => "`knee_flexion_l`",
            BodySegment::Head => "`neck_flexion`",
            BodySegment::HandR => "a `t_pose` or `wrist_flexion_r`",
            BodySegment::HandL => "a `t_pose` or `wrist_flexion_l`",
            BodySegment::FootR => "`ankle_flexion_r`",
            BodySegment::FootL => "`ankle_flexion_l`",
        };
        CalibrationError::Facing { of: segment.name(), fix }
    }
}

/// The body's forward direction, level, from a direction that was `seen` where `nominal` is that of a body which looks along x;
/// short where the direction is steep.
pub(super) fn forward(seen: &Vector3<f64>, nominal: &Vector3<f64>) -> Vector3<f64> {
    let (s, n) = (Vector3::new(seen.x, seen.y, 0.0), Vector3::new(nominal.x, nominal.y, 0.0));
    Vector3::new(s.dot(&n), n.x * s.y - n.y * s.x, 0.0)
}

/// A segment's rotation in a pose against the N-pose.
pub(in super::super) fn posture(segment: BodySegment, raised: bool) -> UnitQuaternion<f64> {
    if !raised || !BodySegment::ARMS.contains(&segment) {
        return UnitQuaternion::identity();
    }
    let upper = if segment.side() > 0.0 { BodySegment::UpperArmR } else { BodySegment::UpperArmL };
    joint_rotation(upper, &[0.0, std::f64::consts::FRAC_PI_2, 0.0])
}

/// By how much the body turned about the vertical from one pose to another, as the trunk and legs show it, rad.
pub(super) fn turned_between(first: &Held, second: &Held) -> f64 {
    let trunk = [BodySegment::Torso, BodySegment::Pelvis].into_iter();
    trunk
        .chain(BodySegment::LEGS)
        .chain([BodySegment::Head])
        .find_map(|segment| {
            let (a, b) = (first[segment.index()]?, second[segment.index()]?);
            Some(yaw_from_upright(&(b * a.inverse() * upright())))
        })
        .unwrap_or(0.0)
}
