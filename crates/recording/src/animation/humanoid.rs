//! The figure of 23 segments in the axes of programs for animation: y up, looking along +z, its left along +x, at rest in a T-pose.
//!
//! In: frames of the body. Out: what each bone of such a figure is turned by from its rest, and where the hips are. A bone's rest has no rotation of its
//! own, so that a bone's rotation is that of its segment since the T-pose.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::Frame;
use posed_fusion::body::{Skeleton, WHOLE, WholeSegment, whole, whole_t_pose};
use posed_geometry::so3::{exp, log};

/// A bone: the segment whose rotation it has, its parent among the bones, and from the parent's joint to its own in the rest pose, m; of the hips, from the
/// floor below them.
pub(super) struct Bone {
    pub(super) name: String,
    pub(super) segment: WholeSegment,
    pub(super) parent: Option<usize>,
    pub(super) offset_m: Vector3<f64>,
    /// From its joint to its end, m, where no bone hangs on it.
    pub(super) end_m: Option<Vector3<f64>>,
    /// The piece of the spine above it that has no bone of its own, and its share of the bone's length.
    with: Option<(WholeSegment, f64)>,
}

/// Bones, parents first; those for which `name` has none are left out: what hangs on them hangs on the next above, which then takes their mean direction, so
/// that the joints beyond stay where they are.
pub(super) fn bones(skeleton: &Skeleton, name: impl Fn(WholeSegment) -> Option<String>) -> Vec<Bone> {
    let rest = rest_m(skeleton);
    let mut places = [None; WHOLE];
    let mut bones: Vec<Bone> = Vec::with_capacity(WHOLE);
    for segment in WholeSegment::ALL {
        let parent =
            std::iter::successors(segment.parent(), |at| at.parent()).find_map(|at| places[at.index()]);
        let Some(name) = name(segment) else {
            if let (Some(parent), Some(end)) =
                (parent, WholeSegment::ALL.into_iter().find(|at| at.parent() == Some(segment)))
            {
                let above: &mut Bone = &mut bones[parent];
                let length_m = |from: WholeSegment| (rest[end.index()] - rest[from.index()]).norm();
                above.with = Some((segment, length_m(segment) / length_m(above.segment)));
            }
            continue;
        };
        let stands_m = Vector3::y() * (skeleton.thigh_m + skeleton.shank_m + skeleton.foot_m);
        let offset_m =
            parent.map_or(stands_m, |at: usize| rest[segment.index()] - rest[bones[at].segment.index()]);
        let end_m = skeleton.whole_end_m(segment).map(|end_m| into_figure(&(whole_t_pose(segment) * end_m)));
        places[segment.index()] = Some(bones.len());
        bones.push(Bone { name, segment, parent, offset_m, end_m, with: None });
    }
    bones
}

/// The bones that hang on one.
pub(super) fn below(bones: &[Bone], at: usize) -> impl Iterator<Item = usize> {
    (0..bones.len()).filter(move |child| bones[*child].parent == Some(at))
}

/// Where the bones' joints are in the rest pose, m, the soles at height 0.
pub(super) fn joints_m(bones: &[Bone]) -> Vec<Vector3<f64>> {
    let mut joints_m: Vec<Vector3<f64>> = Vec::with_capacity(bones.len());
    for bone in bones {
        let above_m = bone.parent.map_or_else(Vector3::zeros, |parent| joints_m[parent]);
        joints_m.push(above_m + bone.offset_m);
    }
    joints_m
}

/// Joint centres in the T-pose from the hips' mid-point, m, the figure's axes.
fn rest_m(skeleton: &Skeleton) -> [Vector3<f64>; WHOLE] {
    let pose = WholeSegment::ALL.map(whole_t_pose);
    skeleton.whole_origins_m(&pose, Vector3::zeros()).map(|at_m| into_figure(&at_m))
}

/// A body at one time: where the hips are, m, and how every segment is turned since the T-pose, both in the figure's axes.
pub(super) struct Pose {
    pub(super) hips_m: Vector3<f64>,
    turned: [UnitQuaternion<f64>; WHOLE],
}

impl Pose {
    pub(super) fn of(frame: &Frame) -> Self {
        let all = whole(&frame.orientations);
        let turned = WholeSegment::ALL.map(|segment| {
            let q = all[segment.index()] * whole_t_pose(segment).inverse();
            let v = into_figure(&q.imag());
            UnitQuaternion::new_unchecked(Quaternion::from_parts(q.w, v))
        });
        Self { hips_m: into_figure(&frame.pelvis_m), turned }
    }

    /// How a bone is turned against its parent.
    pub(super) fn local(&self, bones: &[Bone], at: usize) -> UnitQuaternion<f64> {
        let own = self.global(&bones[at]);
        bones[at].parent.map_or(own, |parent| self.global(&bones[parent]).inverse() * own)
    }

    fn global(&self, bone: &Bone) -> UnitQuaternion<f64> {
        let own = self.turned[bone.segment.index()];
        bone.with.map_or(own, |(above, share)| {
            own * exp(&(log(&(own.inverse() * self.turned[above.index()])) * share))
        })
    }
}

/// From the room (x ahead of a body that is not turned, y to its left, z up) to the figure's axes.
fn into_figure(v: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(v.y, v.z, v.x)
}
