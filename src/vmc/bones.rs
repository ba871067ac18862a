//! From segments in the room to bones relative to their parents.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

use super::{unity_rotation, unity_vector};
use crate::fusion::body::{Segment, Skeleton};
use crate::geometry::isometry;
use crate::output::Body;

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
pub(super) fn name(segment: Segment) -> &'static str {
    match segment {
        Segment::Torso => "Spine",
        Segment::Pelvis => "Hips",
        Segment::UpperArmR => "RightUpperArm",
        Segment::ForearmR => "RightLowerArm",
        Segment::ThighR => "RightUpperLeg",
        Segment::ShankR => "RightLowerLeg",
        Segment::UpperArmL => "LeftUpperArm",
        Segment::ForearmL => "LeftLowerArm",
        Segment::ThighL => "LeftUpperLeg",
        Segment::ShankL => "LeftLowerLeg",
    }
}

/// Segment to room in the T-pose of a figure that looks along the room's y, which is Unity's z.
fn rest(segment: Segment) -> UnitQuaternion<f64> {
    // Forward (x) is the room's y, up (y) its z, right (z) its x.
    let upright = UnitQuaternion::new_unchecked(Quaternion::new(0.5, 0.5, 0.5, 0.5));
    let arm =
        matches!(segment, Segment::UpperArmR | Segment::ForearmR | Segment::UpperArmL | Segment::ForearmL);
    // Raised sideways, about the axis that points forward.
    let raised_rad = if arm { -segment.side() * FRAC_PI_2 } else { 0.0 };
    upright * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), raised_rad)
}

/// The bones that sensors show, parents first; a bone whose parent is not shown cannot be told.
pub(super) fn of(body: &Body, skeleton: &Skeleton, turn: UnitQuaternion<f64>, scale: f64) -> Vec<Bone> {
    let place = |segment: Segment| -> Option<Isometry3<f64>> {
        let shown = body.segments.get(segment.index())?;
        let good = shown.state.is_shown();
        isometry(shown.position_m.filter(|_| good)?, shown.orientation_wxyz?)
    };
    // Joint and rotation from the T-pose, Unity's axes.
    let whole = |segment: Segment| {
        let place = place(segment)?;
        let joint_m = place * nalgebra::Point3::from(skeleton.joint_in_segment_m(segment));
        let rotation = turn * place.rotation * rest(segment).inverse();
        Some((unity_vector(turn * joint_m.coords) * scale, unity_rotation(rotation)))
    };
    let mut told = [None; Segment::ALL.len()];
    let mut bones = Vec::with_capacity(told.len());
    for segment in Skeleton::PARENTS_FIRST {
        let Some((joint_m, rotation)) = whole(segment) else { continue };
        let (origin_m, parent) = match segment.parent() {
            None => (Vector3::zeros(), UnitQuaternion::identity()),
            Some(parent) => match told[parent.index()] {
                Some(parent) => parent,
                None => continue,
            },
        };
        told[segment.index()] = Some((joint_m, rotation));
        bones.push(Bone {
            name: name(segment),
            offset_m: parent.inverse() * (joint_m - origin_m),
            rotation: parent.inverse() * rotation,
        });
    }
    bones
}
