//! A body at one time, by numbers that can be mixed: where the pelvis is, how segments are turned against those they hang on, and the angles of hinges.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

use super::fit::{yxz, yzx, zxy};
use crate::body::kinematics::{Posture, about_x, about_y, quaternion, upright};

/// Rotations of three degrees of freedom: pelvis (to the room), spine, neck, shoulders, hips, ankles; right before left.
const TURNS: usize = 9;
/// Knees; flexion and pronation of the elbows; flexion and deviation of the wrists.
const ANGLES: usize = 10;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Knot {
    pub(super) pelvis_m: Vector3<f64>,
    turns: [Quaternion<f64>; TURNS],
    angles: [f64; ANGLES],
}

/// A turn about the vertical through the room's origin and then a way along the floor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Move {
    turn: UnitQuaternion<f64>,
    way_m: Vector3<f64>,
}

impl Knot {
    pub(super) fn new(pelvis_m: Vector3<f64>, turns: [Matrix3<f64>; TURNS], angles: [f64; ANGLES]) -> Self {
        Self { pelvis_m, turns: turns.map(|axes| quaternion(axes).into_inner()), angles }
    }

    /// Somebody in the N-pose with the hips there, who looks along the room's x.
    pub(super) fn standing(pelvis_m: Vector3<f64>) -> Self {
        let mut turns = [Matrix3::identity(); TURNS];
        turns[0] = upright(0.0);
        Self::new(pelvis_m, turns, [0.0; ANGLES])
    }

    /// The mean of several with these weights, whose sum is 1; rotations that are near one another.
    pub(super) fn mean<'a>(knots: impl IntoIterator<Item = (f64, &'a Self)>) -> Self {
        let mut sum = Self {
            pelvis_m: Vector3::zeros(),
            turns: [Quaternion::new(0.0, 0.0, 0.0, 0.0); TURNS],
            angles: [0.0; ANGLES],
        };
        for (weight, knot) in knots {
            sum.pelvis_m += knot.pelvis_m * weight;
            for (sum, turn) in sum.turns.iter_mut().zip(&knot.turns) {
                // A rotation is two quaternions.
                let same = if sum.dot(turn) < 0.0 { -weight } else { weight };
                *sum += turn * same;
            }
            for (sum, angle) in sum.angles.iter_mut().zip(&knot.angles) {
                *sum += angle * weight;
            }
        }
        sum.turns.iter_mut().for_each(|turn| *turn = turn.normalize());
        sum
    }

    /// Which way the pelvis faces, by its right side, rad to the left of the room's x.
    pub(super) fn heading_rad(&self) -> f64 {
        let right = UnitQuaternion::new_unchecked(self.turns[0]) * Vector3::z();
        libm::atan2(right.x, -right.y)
    }

    pub(super) fn posture(&self) -> Posture {
        let m =
            |index: usize| UnitQuaternion::new_unchecked(self.turns[index]).to_rotation_matrix().into_inner();
        let a = &self.angles;
        let pelvis = yzx(&(upright(0.0).transpose() * m(0)));
        let mut posture = Posture {
            pelvis_m: self.pelvis_m,
            pelvis: [pelvis[0], -pelvis[1], pelvis[2]],
            knee: [a[0], a[1]],
            elbow: [[a[2], a[3]], [a[4], a[5]]],
            wrist: [[a[6], a[7]], [a[8], a[9]]],
            ..Posture::default()
        };
        let bend = |index| {
            let [flexion, lateral, rotation] = zxy(&m(index));
            [-flexion, lateral, rotation]
        };
        (posture.spine, posture.neck) = (bend(1), bend(2));
        for (side, sign) in [(0, 1.0), (1, -1.0)] {
            posture.shoulder[side] = shoulder(&m(3 + side), sign);
            let [flexion, adduction, rotation] = zxy(&m(5 + side));
            posture.hip[side] = [flexion, sign * adduction, sign * rotation];
            let [flexion, inversion, rotation] = zxy(&m(7 + side));
            posture.ankle[side] = [flexion, sign * inversion, sign * rotation];
        }
        posture
    }
}

/// Plane, elevation and rotation of an arm; where it hangs the plane is 0.
fn shoulder(m: &Matrix3<f64>, sign: f64) -> [f64; 3] {
    let aside = libm::hypot(m[(0, 1)], m[(2, 1)]);
    let plane = if aside < 1e-9 { 0.0 } else { libm::atan2(-sign * m[(0, 1)], -sign * m[(2, 1)]) };
    let rest = about_y(-plane) * m;
    let elevation = libm::atan2(-sign * rest[(2, 1)], rest[(1, 1)]);
    let [rotation, ..] = yxz(&(about_x(sign * elevation) * rest));
    [sign * plane, elevation, sign * rotation]
}

impl Move {
    fn none() -> Self {
        Self { turn: UnitQuaternion::identity(), way_m: Vector3::zeros() }
    }

    /// What brings the one's pelvis over the other's on the floor, facing the same way.
    pub(super) fn between(from: &Knot, to: &Knot) -> Self {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), to.heading_rad() - from.heading_rad());
        let way_m = to.pelvis_m - turn * from.pelvis_m;
        Self { turn, way_m: way_m.xy().push(0.0) }
    }

    pub(super) fn then(&self, next: &Self) -> Self {
        Self { turn: next.turn * self.turn, way_m: next.turn * self.way_m + next.way_m }
    }

    pub(super) fn inverse(&self) -> Self {
        let turn = self.turn.inverse();
        Self { turn, way_m: -(turn * self.way_m) }
    }

    /// So many times one after the other.
    pub(super) fn repeated(&self, mut times: u64) -> Self {
        let (mut power, mut whole) = (*self, Self::none());
        while times > 0 {
            if times % 2 == 1 {
                whole = whole.then(&power);
            }
            power = power.then(&power);
            times /= 2;
        }
        whole
    }

    pub(super) fn of(&self, knot: &Knot) -> Knot {
        let mut knot = *knot;
        knot.pelvis_m = self.turn * knot.pelvis_m + self.way_m;
        knot.turns[0] = self.turn.into_inner() * knot.turns[0];
        knot
    }
}
