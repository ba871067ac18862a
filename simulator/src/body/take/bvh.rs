//! A person out of a BVH file: joints by their names, head and hands by how they are turned since the rest pose.

use std::path::Path;

use nalgebra::{Isometry3, Matrix3, UnitQuaternion, Vector3};

use super::names::{JOINTS, Joint, find, words};
use super::recording::{Clip, Frame, Recording, TakeError, spine};
use crate::body::kinematics::quaternion;
use crate::bvh::Bvh;
use crate::motion_file::FileError;

/// A rest pose is upright whose shoulders are over its ankles within this (cosine).
const UPRIGHT: f64 = 0.95;

impl Recording {
    /// A person out of the text of a BVH file; `path` names it in errors. A first frame in the rest pose, which some programs want, is left out.
    ///
    /// # Errors
    /// Line and column of what is wrong, or the joint that is missing.
    pub fn of_bvh(path: &Path, text: &str) -> Result<Self, TakeError> {
        let bvh = Bvh::parse(text).map_err(|source| FileError::Bvh { path: path.to_owned(), source })?;
        let mut names: Vec<Vec<String>> = bvh.names().map(words).collect();
        let bones = names.len();
        // The end of the head's bone and of the toes' are points as joints are.
        for (joint, _) in bvh.ends() {
            names.push([names[*joint].as_slice(), &["end".to_owned()]].concat());
        }
        let found = find(&names, false).map_err(|joint| TakeError::Joint {
            path: path.to_owned(),
            joint,
            names: bvh.names().collect::<Vec<_>>().join(", "),
        })?;
        let points = |poses: &[Isometry3<f64>]| -> Vec<Vector3<f64>> {
            let joints = poses.iter().map(|pose| pose.translation.vector);
            let ends =
                bvh.ends().iter().map(|(joint, at)| poses[*joint].transform_point(&(*at).into()).coords);
            joints.chain(ends).collect()
        };
        let rest = points(&bvh.rest());
        let mut chosen: [Option<usize>; JOINTS] = std::array::from_fn(|index| found[index].first().copied());
        let hips = chosen[Joint::Hip(0).index()].zip(chosen[Joint::Hip(1).index()]);
        let middle = hips.map_or_else(
            || chosen[Joint::Root.index()].map_or_else(Vector3::zeros, |root| rest[root]),
            |(r, l)| 0.5 * (rest[r] + rest[l]),
        );
        let of = |joint: Joint| chosen[joint.index()].map_or_else(Vector3::zeros, |index| rest[index]);
        let shoulders = 0.5 * (of(Joint::Shoulder(0)) + of(Joint::Shoulder(1)));
        let trunk = (shoulders - middle).norm();
        let axes = facing(&of);
        chosen[Joint::Spine.index()] = spine(&found[Joint::Spine.index()], |at| rest[at], middle, trunk);
        // A head without an end of its own begins at the neck.
        let head = found[Joint::Head.index()].iter().copied().find(|at| *at < bones);
        if chosen[Joint::Head.index()] != head {
            chosen[Joint::Neck.index()] = head;
        }
        let turned = axes.and_then(|axes| {
            let hand = |side| {
                let (wrist, elbow) =
                    (chosen[Joint::Wrist(side).index()]?, chosen[Joint::Elbow(side).index()]?);
                hanging(rest[elbow] - rest[wrist], axes.column(0).into_owned()).map(|axes| (wrist, axes))
            };
            let head = head.or(chosen[Joint::Neck.index()])?;
            Some([(head, quaternion(axes)), hand(0)?, hand(1)?])
        });
        let begins = usize::from(bvh.frames() > 1 && bvh.rests(0));
        let mut clip = Clip::default();
        for number in begins..bvh.frames() {
            let poses = bvh.poses(number);
            let all = points(&poses);
            clip.t_s.push(number as f64 * bvh.frame_time_s);
            clip.frames.push(Frame {
                points: chosen.map(|index| index.map_or_else(Vector3::zeros, |index| all[index])),
                turns: turned.map(|turned| turned.map(|(joint, axes)| poses[joint].rotation * axes)),
            });
        }
        Ok(Self { path: path.to_owned(), has: chosen.map(|index| index.is_some()), clips: vec![clip] })
    }
}

/// Axes (forward, up, right) of a figure that stands upright at rest; `None` where it does not.
fn facing(of: &impl Fn(Joint) -> Vector3<f64>) -> Option<Matrix3<f64>> {
    let middle = |joint: fn(usize) -> Joint| 0.5 * (of(joint(0)) + of(joint(1)));
    let long = (middle(Joint::Shoulder) - middle(Joint::Ankle)).try_normalize(0.0)?;
    let up = Vector3::from_fn(|axis, _| if axis == long.iamax() { long[axis].signum() } else { 0.0 });
    let across = of(Joint::Shoulder(0)) - of(Joint::Shoulder(1));
    let right = (across - up * up.dot(&across)).try_normalize(0.0)?;
    (long.dot(&up) > UPRIGHT).then(|| Matrix3::from_columns(&[up.cross(&right), up, right]))
}

/// Axes of a hand in line with a forearm that goes up this way, its thumb forward as in the N-pose and the T-pose.
fn hanging(up: Vector3<f64>, forward: Vector3<f64>) -> Option<UnitQuaternion<f64>> {
    let up = up.try_normalize(0.0)?;
    let forward = (forward - up * up.dot(&forward)).try_normalize(0.1)?;
    Some(quaternion(Matrix3::from_columns(&[forward, up, forward.cross(&up)])))
}
