//! A recording stood upright: z up, right-handed, in metres of the height that it is to have.
//!
//! In: points in any axes and unit. Out: the same in the room's; hips where the file has none. What points up is found by where shoulders and ankles are,
//! what is right and left by the names and by where the toes and the knees point to, the unit by the lengths of thighs, shanks and trunk.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::fit::upward;
use super::median;
use super::names::Joint;
use super::recording::{Frame, Recording, TakeError};
use crate::body::Build;
use crate::body::kinematics::quaternion;

/// Thigh, shank and trunk together, of the height.
const LONG: f64 = 0.245 + 0.246 + 0.288;
/// Where hips that a file does not have are from its root, of the trunk's length: forward, up, right of the right one; and how well that is known.
const HIPS: [f64; 3] = [0.0, -0.17, 0.174];
const HIPS_KNOWN: f64 = 0.1;
/// How well the pelvis's orientation is known by spine, shoulders and feet, rad, and a thigh's length, of the trunk's.
const PELVIS_RAD: f64 = 0.15;
const THIGH_KNOWN: f64 = 0.01;

impl Recording {
    /// Stands it upright and gives it that height, m; returns its lengths.
    pub(super) fn stand(&mut self, height_m: f64) -> Result<Build, TakeError> {
        let wrong = |recording: &Self, problem: &str| TakeError::Figure {
            path: recording.path.clone(),
            problem: problem.to_owned(),
        };
        let up: Vector3<f64> =
            self.frames().map(|frame| frame.middle(Joint::Shoulder) - frame.middle(Joint::Ankle)).sum();
        if up.norm() == 0.0 || up.norm().is_nan() {
            return Err(wrong(self, "shoulders and ankles are in the same place"));
        }
        let axis = up.iamax();
        let upright = match (axis, up[axis] > 0.0) {
            (0, true) => Matrix3::new(0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0),
            (0, false) => Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, 1.0, -1.0, 0.0, 0.0),
            (1, true) => Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0),
            (1, false) => Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0),
            (_, true) => Matrix3::identity(),
            (_, false) => Matrix3::new(1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0),
        };
        let rotation = quaternion(upright);
        for frame in self.frames_mut() {
            frame.points = frame.points.map(|point| upright * point);
            frame.turns = frame.turns.map(|turns| turns.map(|turn| rotation * turn));
        }
        let toes = self.has(Joint::Ball(0)) && self.has(Joint::Ball(1));
        let ahead: f64 = self.frames().map(|frame| ahead(frame, toes)).sum();
        if ahead < 0.0 {
            // Left-handed axes.
            for frame in self.frames_mut() {
                frame.points.iter_mut().for_each(|point| point.x = -point.x);
                frame.turns = frame.turns.map(|turns| turns.map(mirrored));
            }
        }
        if !(self.has(Joint::Hip(0)) && self.has(Joint::Hip(1))) {
            self.find_hips(toes);
        }
        let median = |length: &dyn Fn(&Frame) -> f64| median(self.frames().map(length));
        let pair = |from: fn(usize) -> Joint, to: fn(usize) -> Joint| {
            let length = |side| median(&|frame: &Frame| (frame.at(to(side)) - frame.at(from(side))).norm());
            0.5 * (length(0) + length(1))
        };
        let (thigh, shank) = (pair(Joint::Hip, Joint::Knee), pair(Joint::Knee, Joint::Ankle));
        let trunk =
            median(&|frame: &Frame| (frame.middle(Joint::Shoulder) - frame.middle(Joint::Hip)).norm());
        let scale = LONG * height_m / (thigh + shank + trunk);
        let usual = Build::of_height(height_m);
        let build = Build {
            shoulder_width_m: scale * median(&|frame: &Frame| frame.across(Joint::Shoulder).norm()),
            hip_width_m: scale * median(&|frame: &Frame| frame.across(Joint::Hip).norm()),
            trunk_m: scale * trunk,
            upper_arm_m: scale * pair(Joint::Shoulder, Joint::Elbow),
            forearm_m: scale * pair(Joint::Elbow, Joint::Wrist),
            thigh_m: scale * thigh,
            shank_m: scale * shank,
            ..usual
        };
        for (name, found_m, usual_m) in [
            ("thighs", build.thigh_m, usual.thigh_m),
            ("shanks", build.shank_m, usual.shank_m),
            ("the trunk", build.trunk_m, usual.trunk_m),
            ("upper arms", build.upper_arm_m, usual.upper_arm_m),
            ("forearms", build.forearm_m, usual.forearm_m),
        ] {
            if !(0.4..2.5).contains(&(found_m / usual_m)) {
                let problem = format!(
                    "of a body {height_m} m high {name} would be {found_m:.2} m long, not about {usual_m:.2}: are the joints what they are called?"
                );
                return Err(wrong(self, &problem));
            }
        }
        self.frames_mut().for_each(|frame| frame.points.iter_mut().for_each(|point| *point *= scale));
        Ok(build)
    }

    /// Hips for a file that has a root in their place: by knees that keep their distance, from a pelvis that is turned as spine, shoulders and feet are.
    fn find_hips(&mut self, toes: bool) {
        let has_spine = self.has(Joint::Spine);
        let frames: Vec<&Frame> = self.frames().collect();
        let trunk =
            frames.iter().map(|f| (f.middle(Joint::Shoulder) - f.at(Joint::Root)).norm()).sum::<f64>()
                / frames.len() as f64;
        let mut axes: Vec<Matrix3<f64>> = frames.iter().map(|frame| pelvis(frame, toes, has_spine)).collect();
        let mut hip = Vector3::from(HIPS) * trunk;
        // A thigh is as long as a shank.
        let shank =
            |frame: &&Frame, side| (frame.at(Joint::Knee(side)) - frame.at(Joint::Ankle(side))).norm();
        let thigh = frames.iter().map(|frame| 0.5 * (shank(frame, 0) + shank(frame, 1))).sum::<f64>()
            / frames.len() as f64;
        // Pelvis by pelvis, then the place in all of them, in turns.
        let every = frames.len().div_ceil(500);
        for _ in 0..15 {
            let mut normal = nalgebra::Matrix3::from_diagonal_element((trunk * HIPS_KNOWN).powi(-2));
            let mut right = (Vector3::from(HIPS) * trunk - hip) * (trunk * HIPS_KNOWN).powi(-2);
            let lines = |axes: &Matrix3<f64>, frame: &Frame, hip: Vector3<f64>| {
                [(0, 1.0), (1, -1.0)].map(|(side, sign)| {
                    let own = Vector3::new(hip.x, hip.y, sign * hip.z);
                    let leg = axes.transpose() * (frame.at(Joint::Knee(side)) - frame.at(Joint::Root)) - own;
                    (own, leg, Vector3::new(1.0, 1.0, sign))
                })
            };
            let sampled: Vec<usize> = (0..frames.len()).step_by(every).collect();
            for at in &sampled {
                for (_, leg, sign) in lines(&axes[*at], frames[*at], hip) {
                    // The distance falls as the hip comes nearer.
                    let slope = -leg.normalize().component_mul(&sign);
                    let weight = (trunk * THIGH_KNOWN).powi(-2) / sampled.len() as f64 * 20.0;
                    normal += slope * slope.transpose() * weight;
                    right += slope * (thigh - leg.norm()) * weight;
                }
            }
            if let Some(inverse) = normal.try_inverse() {
                hip += inverse * right;
            }
            for (axes, frame) in axes.iter_mut().zip(&frames) {
                // The smallest turn that brings both knees to their distance.
                let [(own_r, leg_r, _), (own_l, leg_l, _)] = lines(axes, frame, hip);
                // The own axes turn by a small rotation vector: the hip goes along with it.
                let slopes = [own_r.cross(&-leg_r.normalize()), own_l.cross(&-leg_l.normalize())];
                let misses = [thigh - leg_r.norm(), thigh - leg_l.norm()];
                let spread = (trunk * THIGH_KNOWN / PELVIS_RAD).powi(2);
                let gram = nalgebra::Matrix2::new(
                    slopes[0].norm_squared() + spread,
                    slopes[0].dot(&slopes[1]),
                    slopes[0].dot(&slopes[1]),
                    slopes[1].norm_squared() + spread,
                );
                if let Some(inverse) = gram.try_inverse() {
                    let weights = inverse * nalgebra::Vector2::from(misses);
                    let turn = slopes[0] * weights[0] + slopes[1] * weights[1];
                    let start = pelvis(frame, toes, has_spine);
                    let turned = *axes * Rotation3::new(0.5 * turn).matrix();
                    // And no further from where spine, shoulders and feet say it is than they may be wrong.
                    let off = quaternion(start.transpose() * turned).scaled_axis();
                    let kept = off * (1.0 / (1.0 + (off.norm() / (3.0 * PELVIS_RAD)).powi(4)));
                    *axes = start * Rotation3::new(kept).matrix();
                }
            }
        }
        drop(frames);
        for (frame, axes) in self.frames_mut().zip(&axes) {
            for (side, sign) in [(0, 1.0), (1, -1.0)] {
                frame.points[Joint::Hip(side).index()] =
                    frame.at(Joint::Root) + axes * Vector3::new(hip.x, hip.y, sign * hip.z);
            }
        }
        for side in 0..2 {
            self.has[Joint::Hip(side).index()] = true;
        }
    }
}

/// How far ahead of the body toes and knees point, if right is right; z is up.
fn ahead(frame: &Frame, toes: bool) -> f64 {
    let forward = Vector3::z().cross(&frame.across(Joint::Shoulder));
    let feet = if toes { frame.middle(Joint::Ball) - frame.middle(Joint::Ankle) } else { Vector3::zeros() };
    let knees = [0, 1].map(|side| {
        let root =
            if frame.at(Joint::Hip(side)) == Vector3::zeros() { Joint::Root } else { Joint::Hip(side) };
        frame.at(Joint::Knee(side)) - 0.5 * (frame.at(root) + frame.at(Joint::Ankle(side)))
    });
    forward.dot(&(feet + 0.5 * (knees[0] + knees[1])))
}

/// Axes (forward, up, right) of a pelvis by spine, shoulders and feet; z is up.
fn pelvis(frame: &Frame, toes: bool, has_spine: bool) -> Matrix3<f64> {
    let root = frame.at(Joint::Root);
    let trunk = frame.middle(Joint::Shoulder) - root;
    let spine = if has_spine { (frame.at(Joint::Spine) - root).normalize() } else { Vector3::zeros() };
    let up = (trunk.normalize() + 2.0 * spine).normalize();
    let mut right = frame.across(Joint::Shoulder).normalize();
    if toes {
        for side in 0..2 {
            let foot = (frame.at(Joint::Ball(side)) - frame.at(Joint::Ankle(side))).normalize();
            right += foot.cross(&Vector3::z());
        }
    }
    upward(up, right)
}

/// A rotation in axes of which x is turned round.
fn mirrored(turn: UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let q = turn.into_inner();
    UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(q.w, q.i, -q.j, -q.k))
}
