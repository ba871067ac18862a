//! How a joint moves: a ball on SO(3), or a chain of single axes.
//!
//! In: time and corrections. Out: the rotation of the next frame and the prediction of its covariance. Every joint
//! has position, angular velocity and acceleration; the acceleration forgets itself (Singer's model) and is driven by
//! white jerk.

use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};
use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::chain::Motion;
use super::covariance::Covariance;
use posed_geometry::so3;

/// How freely joints move: Singer's model (1970), an angular acceleration that dies away and is driven by white jerk.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct JointNoise {
    /// White jerk, rad/s³ per sqrt(Hz): more follows faster and smooths less.
    pub jerk_rad_s3: f64,
    /// Time in which an acceleration dies away, s; infinite: a constant acceleration.
    pub accel_tau_s: f64,
}

/// A joint with N error states around it; its own begin at column `at`.
pub(super) trait Joint<const N: usize> {
    /// Into the frame behind the joint.
    fn rotate(&self, motion: &mut Motion<N>, at: usize);
    /// Moves on by `tau` seconds, and the covariance with it.
    fn predict(&mut self, p: &mut Covariance<N>, noise: &JointNoise, tau: f64, at: usize);
    /// Adds a correction of the error states.
    fn correct(&mut self, dx: &SVector<f64, N>, at: usize);
    /// Columns of the joint's angular velocities.
    fn angular_velocity_columns(&self, at: usize) -> std::ops::Range<usize>;
    /// The angular velocity of a column of [`Self::angular_velocity_columns`], rad/s.
    fn angular_velocity_of(&self, column: usize, at: usize) -> f64;
}

/// Ball joint: orientation on SO(3), so that no posture is singular. Nine states: rotation, angular velocity, acceleration,
/// each in the axes of the frame behind the joint; the error is local, `q <- q exp(rotation)`.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct Ball {
    /// Frame behind the joint to the one before it.
    pub q: UnitQuaternion<f64>,
    /// Relative angular velocity, axes of the frame behind the joint, rad/s.
    pub angular_velocity_rad_s: Vector3<f64>,
    /// Relative angular acceleration, axes of the frame behind the joint, rad/s².
    pub accel_rad_s2: Vector3<f64>,
}

impl<const N: usize> Joint<N> for Ball {
    fn rotate(&self, motion: &mut Motion<N>, at: usize) {
        motion.rotate_ball(&self.q, &self.angular_velocity_rad_s, &self.accel_rad_s2, at);
    }

    fn predict(&mut self, p: &mut Covariance<N>, noise: &JointNoise, tau: f64, at: usize) {
        let angle = self.angular_velocity_rad_s * tau + self.accel_rad_s2 * (0.5 * tau * tau);
        let step = so3::exp(&angle);
        let keep = libm::exp(-tau / noise.accel_tau_s);
        self.q = UnitQuaternion::new_normalize((self.q * step).into_inner());
        self.angular_velocity_rad_s += self.accel_rad_s2 * tau;
        self.accel_rad_s2 *= keep;

        let back = step.to_rotation_matrix().into_inner().transpose();
        let by_angular_velocity = so3::right_jacobian(&angle) * tau;
        p.combine_blocks(
            at,
            &[(at, back), (at + 3, by_angular_velocity), (at + 6, by_angular_velocity * (0.5 * tau))],
        );
        for i in 0..3 {
            p.combine(at + 3 + i, 1.0, &[(at + 6 + i, tau)]);
        }
        for i in 0..3 {
            p.combine(at + 6 + i, keep, &[]);
            add_jerk(p, [at + i, at + 3 + i, at + 6 + i], noise.jerk_rad_s3, tau);
        }
    }

    fn correct(&mut self, dx: &SVector<f64, N>, at: usize) {
        let part = |i: usize| Vector3::new(dx[at + i], dx[at + i + 1], dx[at + i + 2]);
        self.q = UnitQuaternion::new_normalize((self.q * so3::exp(&part(0))).into_inner());
        self.angular_velocity_rad_s += part(3);
        self.accel_rad_s2 += part(6);
    }

    fn angular_velocity_columns(&self, at: usize) -> std::ops::Range<usize> {
        at + 3..at + 6
    }

    fn angular_velocity_of(&self, column: usize, at: usize) -> f64 {
        self.angular_velocity_rad_s[column - at - 3]
    }
}

/// A chain of K single axes. States: K angles, K angular velocities, K angular accelerations, each about its own axis.
///
/// Three axes make a ball joint with a singularity: two of its axes fall together when the middle angle is 90 degrees (or 0,
/// where the first and last axis are the same).
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct Axes<const K: usize> {
    /// Unit axes, one a column, each in the frame behind the ones before it.
    pub axes: SMatrix<f64, 3, K>,
    /// Angles, rad, not wrapped; within the limits of the limb but for what noise makes.
    pub angle_rad: SVector<f64, K>,
    /// Angular velocities, rad/s.
    pub angular_velocity_rad_s: SVector<f64, K>,
    /// Angular accelerations, rad/s².
    pub accel_rad_s2: SVector<f64, K>,
}

impl<const K: usize> Axes<K> {
    /// At rest, all angles zero; `axes` are unit vectors, each in the frame behind the ones before it, from the base
    /// outwards.
    pub fn new(axes: [Vector3<f64>; K]) -> Self {
        Self {
            axes: SMatrix::from_columns(&axes),
            angle_rad: SVector::zeros(),
            angular_velocity_rad_s: SVector::zeros(),
            accel_rad_s2: SVector::zeros(),
        }
    }

    /// Frame behind the joint to the one before it, at the present angles.
    pub fn orientation(&self) -> UnitQuaternion<f64> {
        (0..K)
            .fold(UnitQuaternion::identity(), |q, i| q * so3::exp(&(self.axes.column(i) * self.angle_rad[i])))
    }
}

impl<const K: usize> Axes<K> {
    /// Covariance of the joint's rotation, in the axes of the frame behind it, rad², from that of its angles.
    pub(super) fn rotation_rad2(&self, angles_rad2: &SMatrix<f64, K, K>) -> Matrix3<f64> {
        let rotation_axes = self.rotation_axes();
        rotation_axes * angles_rad2 * rotation_axes.transpose()
    }

    /// How the frame behind the joint turns with each angle, in its own axes: one a column.
    fn rotation_axes(&self) -> SMatrix<f64, 3, K> {
        let mut rotation_axes = self.axes;
        let mut behind = UnitQuaternion::identity();
        for i in (0..K).rev() {
            let axis: Vector3<f64> = self.axes.column(i).into_owned();
            rotation_axes.set_column(i, &(behind * axis));
            behind *= so3::exp(&(axis * -self.angle_rad[i]));
        }
        rotation_axes
    }
}

impl<const K: usize, const N: usize> Joint<N> for Axes<K> {
    fn rotate(&self, motion: &mut Motion<N>, at: usize) {
        for i in 0..K {
            let state = [self.angle_rad[i], self.angular_velocity_rad_s[i], self.accel_rad_s2[i]];
            motion.rotate_axis(
                &self.axes.column(i).into_owned(),
                state,
                [at + i, at + K + i, at + 2 * K + i],
            );
        }
    }

    fn predict(&mut self, p: &mut Covariance<N>, noise: &JointNoise, tau: f64, at: usize) {
        let keep = libm::exp(-tau / noise.accel_tau_s);
        for i in 0..K {
            let columns = [at + i, at + K + i, at + 2 * K + i];
            self.angle_rad[i] += tau * (self.angular_velocity_rad_s[i] + 0.5 * tau * self.accel_rad_s2[i]);
            self.angular_velocity_rad_s[i] += tau * self.accel_rad_s2[i];
            self.accel_rad_s2[i] *= keep;
            p.combine(columns[0], 1.0, &[(columns[1], tau), (columns[2], 0.5 * tau * tau)]);
            p.combine(columns[1], 1.0, &[(columns[2], tau)]);
            p.combine(columns[2], keep, &[]);
            add_jerk(p, columns, noise.jerk_rad_s3, tau);
        }
    }

    fn correct(&mut self, dx: &SVector<f64, N>, at: usize) {
        for i in 0..K {
            self.angle_rad[i] += dx[at + i];
            self.angular_velocity_rad_s[i] += dx[at + K + i];
            self.accel_rad_s2[i] += dx[at + 2 * K + i];
        }
    }

    fn angular_velocity_columns(&self, at: usize) -> std::ops::Range<usize> {
        at + K..at + 2 * K
    }

    fn angular_velocity_of(&self, column: usize, at: usize) -> f64 {
        self.angular_velocity_rad_s[column - at - K]
    }
}

/// Adds what white jerk does in `tau` seconds to angle, angular velocity and acceleration.
fn add_jerk<const N: usize>(p: &mut Covariance<N>, columns: [usize; 3], jerk_rad_s3: f64, tau: f64) {
    let q = jerk_rad_s3 * jerk_rad_s3 * tau;
    let (t1, t2) = (tau, tau * tau);
    let block = Matrix3::new(
        t2 * t2 / 20.0,
        t1 * t2 / 8.0,
        t2 / 6.0,
        t1 * t2 / 8.0,
        t2 / 3.0,
        t1 / 2.0,
        t2 / 6.0,
        t1 / 2.0,
        1.0,
    );
    for (i, row) in columns.into_iter().enumerate() {
        for (j, column) in columns.into_iter().enumerate() {
            p.own[(row, column)] += q * block[(i, j)];
        }
    }
}
