//! From segments in the room to bones relative to their parents.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

use super::{unity_rotation, unity_vector};
use posed_fusion::body::{BodySegment, Skeleton, WHOLE, WholeSegment};
use posed_fusion::body::{completed, t_pose, whole, whole_t_pose};
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

/// The bone's name. The torso is the spine, unless all bones are sent: models may lack chest and upper chest.
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
        BodySegment::ShoulderR => "RightShoulder",
        BodySegment::ShoulderL => "LeftShoulder",
    }
}

/// A segment's rotation since the T-pose `rest` of a body that looks along the room's x, for a figure that rests looking along its y, which is Unity's z.
fn since(rest: UnitQuaternion<f64>, orientation: UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let to_y = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), FRAC_PI_2);
    orientation * (to_y * rest).inverse()
}

/// A segment's place in the room, where a sensor shows it.
fn shown(body: &Body, segment: BodySegment) -> Option<Isometry3<f64>> {
    let of = body.segments.get(segment.index())?;
    // Where a head, a hand, a foot or a shoulder is not shown, another program may know better.
    let guessed = of.sensor.is_none() && BodySegment::LEAVES.contains(&segment);
    let good = of.state.is_shown() && !guessed;
    isometry(of.position_m.filter(|_| good)?, of.orientation_wxyz?)
}

/// Bones as they are put together, each on its parent.
struct Figure {
    heading: UnitQuaternion<f64>,
    scale: f64,
    bones: Vec<Bone>,
}

/// Joint and rotation from the T-pose, Unity's axes.
type Placed = (Vector3<f64>, UnitQuaternion<f64>);

impl Figure {
    /// Adds a bone with its joint in the room, m, and its rotation since the T-pose; the hips have no parent.
    fn add(
        &mut self,
        name: &'static str,
        parent: Option<Placed>,
        joint_m: Vector3<f64>,
        rotation: UnitQuaternion<f64>,
    ) -> Placed {
        let placed =
            (unity_vector(self.heading * joint_m) * self.scale, unity_rotation(self.heading * rotation));
        let (origin_m, above) = parent.unwrap_or((Vector3::zeros(), UnitQuaternion::identity()));
        let (offset_m, rotation) = (above.inverse() * (placed.0 - origin_m), above.inverse() * placed.1);
        self.bones.push(Bone { name, offset_m, rotation });
        placed
    }
}

/// The bones that sensors show, parents first; a bone whose parent is not shown cannot be reported.
pub(super) fn of(body: &Body, skeleton: &Skeleton, heading: UnitQuaternion<f64>, scale: f64) -> Vec<Bone> {
    let mut figure = Figure { heading, scale, bones: Vec::with_capacity(BodySegment::ALL.len()) };
    let mut placed = [None; BodySegment::ALL.len()];
    for segment in Skeleton::PARENTS_FIRST {
        let shoulder = segment.shoulder().and_then(|shoulder| placed[shoulder.index()]);
        let parent = segment.parent().map(|parent| shoulder.or(placed[parent.index()]));
        let Some(pose) = shown(body, segment).filter(|_| parent != Some(None)) else { continue };
        let joint_m = (pose * Point3::from(skeleton.joint_in_segment_m(segment))).coords;
        let rotation = since(t_pose(segment), pose.rotation);
        placed[segment.index()] = Some(figure.add(name(segment), parent.flatten(), joint_m, rotation));
    }
    figure.bones
}

/// The bone of one of the 23 segments, and what must be shown for it. The lowest piece of the spine has none: an avatar's begins above it.
fn bone_of(segment: WholeSegment) -> Option<(&'static str, [BodySegment; 2])> {
    use BodySegment as B;
    use WholeSegment as W;
    Some(match segment {
        W::L5 => return None,
        W::L3 => ("Spine", [B::Pelvis, B::Torso]),
        W::T12 => ("Chest", [B::Pelvis, B::Torso]),
        W::T8 => ("UpperChest", [B::Pelvis, B::Torso]),
        W::Neck => ("Neck", [B::Torso, B::Head]),
        W::ShoulderR => (name(B::ShoulderR), [B::Torso; 2]),
        W::ShoulderL => (name(B::ShoulderL), [B::Torso; 2]),
        W::ToeR => ("RightToes", [B::FootR; 2]),
        W::ToeL => ("LeftToes", [B::FootL; 2]),
        _ => {
            let measured = segment.measured_as()?;
            (name(measured), [measured; 2])
        }
    })
}

/// The same with what lies between them, as [`whole`] infers it.
pub(super) fn all(body: &Body, skeleton: &Skeleton, heading: UnitQuaternion<f64>, scale: f64) -> Vec<Bone> {
    let poses = BodySegment::ALL.map(|segment| shown(body, segment));
    let Some(pelvis) = poses[BodySegment::Pelvis.index()] else { return Vec::new() };
    let orientations = whole(&completed(&poses.map(|pose| Some(pose?.rotation))));
    let joints_m = skeleton.whole_origins_m(&orientations, pelvis.translation.vector);
    let mut figure = Figure { heading, scale, bones: Vec::with_capacity(WHOLE) };
    let mut placed = [None; WHOLE];
    for segment in WholeSegment::ALL {
        let Some((name, needed)) = bone_of(segment) else { continue };
        let above =
            std::iter::successors(segment.parent(), |at| at.parent()).find(|at| bone_of(*at).is_some());
        let parent = above.map(|above| placed[above.index()]);
        if needed.iter().any(|needed| poses[needed.index()].is_none()) || parent == Some(None) {
            continue;
        }
        let rotation = since(whole_t_pose(segment), orientations[segment.index()]);
        placed[segment.index()] =
            Some(figure.add(name, parent.flatten(), joints_m[segment.index()], rotation));
    }
    figure.bones
}
