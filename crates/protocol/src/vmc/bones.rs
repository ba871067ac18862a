//! From segments in the room to bones relative to their parents.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

use super::{unity_rotation, unity_vector};
use posed_fusion::body::{BodySegment, Skeleton};
use posed_geometry::isometry;
use posed_stage::output::Body;

/// A bone of the Unity humanoid, in Unity's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bone {
    pub(super) name: &'static str,
    /// From the parent's joint to its own, the parent's axes, m; of the hips, place in the room.
    pub(super) offset_m: Vector3<f64>,
    /// Relative to the parent; of the hips, to the room.
    pub(super) rotation: UnitQuaternion<f64>,
}

/// The bone's name. The torso is the spine: models may lack chest and upper chest.
pub(super) fn name(segment: BodySegment) -> &'static str {
    match segment {
        BodySegment::Torso => "Spine",
        BodySegment::Pelvis => "Hips",
        BodySegment::UpperArmR => "RightUpperArm",
        BodySegment::ForearmR => "RightLowerArm",
        BodySegment::ThighR => "RightUpperLeg",
        BodySegment::ShankR => "RightLowerLeg",
        BodySegment::UpperArmL => "LeftUpperArm",
        BodySegment::ForearmL => "LeftLowerArm",
        BodySegment::ThighL => "LeftUpperLeg",
        BodySegment::ShankL => "LeftLowerLeg",
        BodySegment::Head => "Head",
        BodySegment::HandR => "RightHand",
        BodySegment::FootR => "RightFoot",
        BodySegment::HandL => "LeftHand",
        BodySegment::FootL => "LeftFoot",
    }
}

/// Segment to room in the T-pose of a figure that looks along the room's y, which is Unity's z.
fn rest(segment: BodySegment) -> UnitQuaternion<f64> {
    // Forward (x) is the room's y, up (y) its z, right (z) its x.
    let upright = UnitQuaternion::new_unchecked(Quaternion::new(0.5, 0.5, 0.5, 0.5));
    let arm = BodySegment::ARMS.contains(&segment);
    // Raised sideways, about the axis that points forward.
    let raised_rad = if arm { -segment.side() * FRAC_PI_2 } else { 0.0 };
    upright * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), raised_rad)
}

/// The bones that sensors show, parents first; a bone whose parent is not shown cannot be reported.
pub(super) fn of(body: &Body, skeleton: &Skeleton, heading: UnitQuaternion<f64>, scale: f64) -> Vec<Bone> {
    let pose = |segment: BodySegment| -> Option<Isometry3<f64>> {
        let shown = body.segments.get(segment.index())?;
        // Where a head, a hand or a foot is not shown, another program may know better.
        let guessed = shown.sensor.is_none() && BodySegment::EXTREMITIES.contains(&segment);
        let good = shown.state.is_shown() && !guessed;
        isometry(shown.position_m.filter(|_| good)?, shown.orientation_wxyz?)
    };
    // Joint and rotation from the T-pose, Unity's axes.
    let whole = |segment: BodySegment| {
        let pose = pose(segment)?;
        let joint_m = pose * nalgebra::Point3::from(skeleton.joint_in_segment_m(segment));
        let rotation = heading * pose.rotation * rest(segment).inverse();
        Some((unity_vector(heading * joint_m.coords) * scale, unity_rotation(rotation)))
    };
    let mut reported = [None; BodySegment::ALL.len()];
    let mut bones = Vec::with_capacity(reported.len());
    for segment in Skeleton::PARENTS_FIRST {
        let Some((joint_m, rotation)) = whole(segment) else { continue };
        let (origin_m, parent) = match segment.parent() {
            None => (Vector3::zeros(), UnitQuaternion::identity()),
            Some(parent) => match reported[parent.index()] {
                Some(parent) => parent,
                None => continue,
            },
        };
        reported[segment.index()] = Some((joint_m, rotation));
        bones.push(Bone {
            name: name(segment),
            offset_m: parent.inverse() * (joint_m - origin_m),
            rotation: parent.inverse() * rotation,
        });
    }
    bones
}
