//! A body from magnetic poses alone: inverse kinematics onto the same skeleton.
//!
//! In: poses of trackers worn on segments, as few or as many as there are. Out: all segments and the hips' mid-point, so
//! that positions and orientations of the trackers fit best. What no tracker shows stays as it was in the frame before, and
//! straight at first. Joints keep their axes: knees do not twist, elbows do not bend sideways. Head, hands, feet and shoulders are turned as their trackers are, and their
//! places say where neck, wrists, ankles and the roots of the shoulders are.
//!
//! Levenberg's method on 27 numbers: position and rotation of the pelvis, three angles of the spine, and per limb three of the
//! ball joint and two or one of the hinge; ball joints step on SO(3). Derivatives by differences: a tracker moves only with
//! the joints above it, and a frame takes a few steps from the one before.

use nalgebra::{Isometry3, SMatrix, SVector, UnitQuaternion, Vector3};
use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::joint_rotation;
use super::skeleton::{BodySegment, SEGMENTS, Skeleton, upright};
use posed_geometry::so3;

/// Unknowns: pelvis 6, spine 3, per limb 3 + 2 (arm) or 3 + 1 (leg).
const N: usize = 27;
/// Standard deviations that weigh trackers: position, m, and rotation, rad; skin more than sensor.
const POSITION_M: f64 = 0.01;
const ROTATION_RAD: f64 = 0.05;
/// Departure from the frame before where nothing else speaks, rad and m.
const STAY: f64 = 0.5;
/// Step of the differences.
const STEP: f64 = 1e-6;
/// Most steps per frame.
const ROUNDS: usize = 12;

/// A magnetic tracker on a segment at one time; all numbers must be finite.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Tracked {
    /// Which segment.
    pub segment: BodySegment,
    /// Sensor to room, m.
    pub room_from_sensor: Isometry3<f64>,
    /// Sensor to segment, m: how it sits, segment frame.
    pub segment_from_sensor: Isometry3<f64>,
}

/// A whole body at one time, room frame. It has no covariance: `residual` is what it is judged by.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// Segment to room, by [`BodySegment::index`]; what no tracker shows is as it was before.
    pub orientations: [UnitQuaternion<f64>; SEGMENTS],
    /// The hips' mid-point, room, m.
    pub pelvis_m: Vector3<f64>,
    /// Root mean square per tracker of what is left: position, m, and rotation, rad. Small with few trackers whatever the
    /// posture.
    pub residual: (f64, f64),
}

/// Joint by joint: relative rotations, with hinges as angles.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
struct Joints {
    pelvis_m: Vector3<f64>,
    pelvis: UnitQuaternion<f64>,
    /// Torso, then both shoulders and hips.
    balls: [UnitQuaternion<f64>; 5],
    /// Elbows.
    elbows: [[f64; 2]; 2],
    knees: [f64; 2],
    /// [`BodySegment::LEAVES`] against their parents; where a tracker shows one, by that in [`Self::shown`].
    leaves: [UnitQuaternion<f64>; BodySegment::LEAVES.len()],
    /// To the room, as a tracker on it shows it now.
    shown: [Option<UnitQuaternion<f64>>; BodySegment::LEAVES.len()],
}

const BALLS: [BodySegment; 5] = [
    BodySegment::Torso,
    BodySegment::UpperArmR,
    BodySegment::UpperArmL,
    BodySegment::ThighR,
    BodySegment::ThighL,
];

/// Follows a body by its magnetic trackers, frame by frame: inverse kinematics by Levenberg's method, at most 12 steps a
/// frame. Equations: `docs/methods/body.md`; figures: `docs/body.md`.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct Follower {
    skeleton: Skeleton,
    joints: Joints,
    started: bool,
}

impl Follower {
    /// Nothing seen yet; the first frame begins upright, turned and placed as the tracker on the pelvis, else the torso, else
    /// the first.
    pub fn new(skeleton: Skeleton) -> Self {
        let joints = Joints {
            pelvis_m: Vector3::zeros(),
            pelvis: upright(),
            balls: [UnitQuaternion::identity(); 5],
            elbows: [[0.1, 0.0]; 2],
            knees: [0.1; 2],
            leaves: [UnitQuaternion::identity(); BodySegment::LEAVES.len()],
            shown: [None; BodySegment::LEAVES.len()],
        };
        Self { skeleton, joints, started: false }
    }

    /// Takes the trackers of one time, any number on any segments, and returns the body that fits them best near the frame
    /// before. `None` without any: the body then stays as it was.
    pub fn push(&mut self, trackers: &[Tracked]) -> Option<Figure> {
        let first = trackers.first()?;
        if !self.started {
            self.start(trackers, first);
        }
        self.joints.shown = BodySegment::LEAVES.map(|leaf| {
            let tracker = trackers.iter().find(|tracker| tracker.segment == leaf)?;
            Some(tracker.room_from_sensor.rotation * tracker.segment_from_sensor.rotation.inverse())
        });
        let before = self.joints;
        let mut cost = self.cost(&self.joints, &before, trackers);
        let mut damping = 1e-4;
        for _ in 0..ROUNDS {
            let (gradient, curvature) = self.linearise(&before, trackers);
            let damped = curvature + SMatrix::<f64, N, N>::identity() * damping;
            let Some(step) = damped.cholesky().map(|c| -c.solve(&gradient)) else { break };
            let moved = self.joints.moved(&step);
            let next = self.cost(&moved, &before, trackers);
            if next < cost {
                let gained = cost - next;
                self.joints = moved;
                cost = next;
                damping = (damping * 0.1).max(1e-9);
                if gained < 1e-9 * (1.0 + cost) {
                    break;
                }
            } else {
                damping *= 100.0;
                if damping > 1e8 {
                    break;
                }
            }
        }
        // Without its tracker it stays as it is against its parent.
        let all = self.joints.orientations();
        for (k, segment) in BodySegment::LEAVES.into_iter().enumerate() {
            if self.joints.shown[k].is_some() {
                self.joints.leaves[k] = all[above(segment).index()].inverse() * all[segment.index()];
            }
        }
        Some(self.figure(trackers))
    }

    /// From the tracker nearest to the hips, so that the first step is a small one.
    fn start(&mut self, trackers: &[Tracked], first: &Tracked) {
        let trunk = [BodySegment::Pelvis, BodySegment::Torso];
        let near =
            trunk.iter().find_map(|segment| trackers.iter().find(|t| t.segment == *segment)).unwrap_or(first);
        let room_from_segment = near.room_from_sensor * near.segment_from_sensor.inverse();
        // Upright, turned as that segment is.
        let yaw = super::yaw_from_upright(&room_from_segment.rotation);
        self.joints.pelvis = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw) * upright();
        let origins = self.skeleton.origins_m(&self.joints.orientations(), Vector3::zeros());
        self.joints.pelvis_m = room_from_segment.translation.vector - origins[near.segment.index()];
        self.started = true;
    }

    fn figure(&self, trackers: &[Tracked]) -> Figure {
        let (mut position, mut rotation) = (0.0, 0.0);
        for (p, r) in self.residuals(&self.joints, trackers) {
            position += p.norm_squared();
            rotation += r.norm_squared();
        }
        let n = trackers.len() as f64;
        Figure {
            orientations: self.joints.orientations(),
            pelvis_m: self.joints.pelvis_m,
            residual: ((position / n).sqrt(), (rotation / n).sqrt()),
        }
    }

    /// Position, m, and rotation, rad, by which each tracker is off.
    fn residuals<'a>(
        &self,
        joints: &Joints,
        trackers: &'a [Tracked],
    ) -> impl Iterator<Item = (Vector3<f64>, Vector3<f64>)> + use<'a> {
        let orientations = joints.orientations();
        let origins = self.skeleton.origins_m(&orientations, joints.pelvis_m);
        trackers.iter().map(move |tracker| {
            let q = orientations[tracker.segment.index()];
            let position_m =
                origins[tracker.segment.index()] + q * tracker.segment_from_sensor.translation.vector;
            let rotation =
                tracker.room_from_sensor.rotation.inverse() * q * tracker.segment_from_sensor.rotation;
            (position_m - tracker.room_from_sensor.translation.vector, so3::log(&rotation))
        })
    }

    fn cost(&self, joints: &Joints, before: &Joints, trackers: &[Tracked]) -> f64 {
        let fit: f64 = self
            .residuals(joints, trackers)
            .map(|(p, r)| p.norm_squared() / POSITION_M.powi(2) + r.norm_squared() / ROTATION_RAD.powi(2))
            .sum();
        fit + joints.since(before).norm_squared() / (STAY * STAY)
    }

    fn linearise(&self, before: &Joints, trackers: &[Tracked]) -> (SVector<f64, N>, SMatrix<f64, N, N>) {
        let stay = 1.0 / (STAY * STAY);
        let mut gradient = self.joints.since(before) * stay;
        let mut curvature = SMatrix::<f64, N, N>::identity() * stay;
        let moved: [Joints; N] = std::array::from_fn(|i| {
            let mut step = SVector::<f64, N>::zeros();
            step[i] = STEP;
            self.joints.moved(&step)
        });
        for tracker in trackers {
            let one = std::slice::from_ref(tracker);
            let weighed = |joints: &Joints| {
                let mut out = SVector::<f64, 6>::zeros();
                for (p, r) in self.residuals(joints, one) {
                    out.fixed_rows_mut::<3>(0).copy_from(&(p / POSITION_M));
                    out.fixed_rows_mut::<3>(3).copy_from(&(r / ROTATION_RAD));
                }
                out
            };
            let here = weighed(&self.joints);
            let mut rows = SMatrix::<f64, 6, N>::zeros();
            for (i, moved) in moved.iter().enumerate() {
                rows.set_column(i, &((weighed(moved) - here) / STEP));
            }
            gradient += rows.transpose() * here;
            curvature += rows.transpose() * rows;
        }
        (gradient, curvature)
    }
}

impl Joints {
    fn orientations(&self) -> [UnitQuaternion<f64>; SEGMENTS] {
        let mut all = [self.pelvis; SEGMENTS];
        for (segment, ball) in BALLS.into_iter().zip(&self.balls) {
            all[segment.index()] = all[above(segment).index()] * ball;
        }
        let hinges: [(BodySegment, BodySegment, &[f64]); 4] = [
            (BodySegment::ForearmR, BodySegment::UpperArmR, &self.elbows[0]),
            (BodySegment::ForearmL, BodySegment::UpperArmL, &self.elbows[1]),
            (BodySegment::ShankR, BodySegment::ThighR, &self.knees[..1]),
            (BodySegment::ShankL, BodySegment::ThighL, &self.knees[1..]),
        ];
        for (segment, parent, angles) in hinges {
            all[segment.index()] = all[parent.index()] * joint_rotation(segment, angles);
        }
        for (k, segment) in BodySegment::LEAVES.into_iter().enumerate() {
            all[segment.index()] = self.shown[k].unwrap_or(all[above(segment).index()] * self.leaves[k]);
        }
        all
    }

    fn moved(&self, step: &SVector<f64, N>) -> Self {
        let part = |at: usize| Vector3::new(step[at], step[at + 1], step[at + 2]);
        let mut out = *self;
        out.pelvis_m += part(0);
        out.pelvis *= so3::exp(&part(3));
        for (i, ball) in out.balls.iter_mut().enumerate() {
            *ball *= so3::exp(&part(6 + 3 * i));
        }
        for side in 0..2 {
            out.elbows[side][0] += step[21 + 2 * side];
            out.elbows[side][1] += step[22 + 2 * side];
            out.knees[side] += step[25 + side];
        }
        out
    }

    fn since(&self, before: &Self) -> SVector<f64, N> {
        let mut out = SVector::<f64, N>::zeros();
        let mut set = |at: usize, v: Vector3<f64>| out.fixed_rows_mut::<3>(at).copy_from(&v);
        set(0, self.pelvis_m - before.pelvis_m);
        set(3, so3::log(&(before.pelvis.inverse() * self.pelvis)));
        for i in 0..5 {
            set(6 + 3 * i, so3::log(&(before.balls[i].inverse() * self.balls[i])));
        }
        for side in 0..2 {
            for i in 0..2 {
                out[21 + 2 * side + i] = self.elbows[side][i] - before.elbows[side][i];
            }
            out[25 + side] = self.knees[side] - before.knees[side];
        }
        out
    }
}

/// The segment that another hangs on.
fn above(segment: BodySegment) -> BodySegment {
    segment.parent().unwrap_or(BodySegment::Pelvis)
}

/// Elbow and knee angles, for a test of the hinges.
#[cfg(test)]
pub(super) fn hinge_angle(figure: &Figure, segment: BodySegment) -> f64 {
    let parent = above(segment);
    let q = figure.orientations[parent.index()].inverse() * figure.orientations[segment.index()];
    super::joint_angles(segment, &q)[0]
}
