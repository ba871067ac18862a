//! Motion along a limb, from one body frame to the next, with its derivatives.
//!
//! In: angular velocity, angular acceleration and specific force of a frame. Out: the same for the next frame, after
//! a rotation or a shift, and their derivatives with respect to the filter's N error states. It never
//! leaves the body frames, so gravity needs no mention: it is in the specific force.
//!
//! Model: Weber, Bleser, Hendeby, Reiss & Stricker, "Unsupervised model generation for motion monitoring"
//! (2011), eq. (1), as a recursion in body frames. Their lower IMU lacks a rotation (`R_TG' R_LU'` must read
//! `R_TG' R_UT'`), and the acceleration of the shoulder and the rotation of the torso are missing; both are here.

use nalgebra::{Matrix3, SMatrix, UnitQuaternion, Vector3};

use posed_geometry::so3::{hat, lever};

/// Derivative of a vector with respect to N error states.
pub(super) type Rows<const N: usize> = SMatrix<f64, 3, N>;

/// One frame of a limb.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    /// To base.
    pub(super) q: UnitQuaternion<f64>,
    /// Derivative of the specific force with respect to the place at which it is felt, 1/s².
    pub(super) lever: Matrix3<f64>,
}

/// Motion of one frame, in its own axes.
#[derive(Clone, Debug)]
pub(super) struct Motion<const N: usize> {
    /// Angular velocity, rad/s.
    pub(super) omega: Vector3<f64>,
    /// Angular acceleration, rad/s².
    pub(super) alpha: Vector3<f64>,
    /// Specific force at the frame's current point, m/s².
    pub(super) specific_force_m_s2: Vector3<f64>,
    /// Derivative of `omega`.
    pub(super) d_omega: Rows<N>,
    /// Derivative of `alpha`.
    pub(super) d_alpha: Rows<N>,
    /// Derivative of `specific_force_m_s2`.
    pub(super) d_specific_force: Rows<N>,
    /// Small rotation of the frame, in its own axes, per error state.
    pub(super) d_rotation: Rows<N>,
    /// Frame to base.
    pub(super) q_base_frame: UnitQuaternion<f64>,
    /// Columns from here on are zero.
    columns: usize,
}

impl<const N: usize> Motion<N> {
    /// The base's own motion, which depends on no state.
    pub(super) fn of_base(
        omega: Vector3<f64>,
        alpha: Vector3<f64>,
        specific_force_m_s2: Vector3<f64>,
    ) -> Self {
        Self {
            omega,
            alpha,
            specific_force_m_s2,
            d_omega: Rows::zeros(),
            d_alpha: Rows::zeros(),
            d_specific_force: Rows::zeros(),
            d_rotation: Rows::zeros(),
            q_base_frame: UnitQuaternion::identity(),
            columns: 0,
        }
    }

    /// Into a frame that turns freely: `q` (new frame to this one), relative angular velocity and acceleration in the new
    /// frame. Its error states are the nine columns from `at` on: rotation, angular velocity, acceleration.
    pub(super) fn rotate_ball(
        &mut self,
        q: &UnitQuaternion<f64>,
        angular_velocity_rad_s: &Vector3<f64>,
        accel: &Vector3<f64>,
        at: usize,
    ) {
        let (omega, alpha) = self.rotate(q, angular_velocity_rad_s, accel);
        self.columns = self.columns.max(at + 9);
        set(&mut self.d_rotation, at, &Matrix3::identity());
        set(&mut self.d_omega, at, &hat(&omega));
        set(&mut self.d_omega, at + 3, &Matrix3::identity());
        set(&mut self.d_alpha, at, &(hat(&alpha) - hat(angular_velocity_rad_s) * hat(&omega)));
        set(&mut self.d_alpha, at + 3, &hat(&omega));
        set(&mut self.d_alpha, at + 6, &Matrix3::identity());
        set(&mut self.d_specific_force, at, &hat(&self.specific_force_m_s2));
    }

    /// Into a frame that turns about one axis by `[angle, angular velocity, acceleration]`; `at` gives their columns.
    pub(super) fn rotate_axis(&mut self, axis: &Vector3<f64>, motion: [f64; 3], at: [usize; 3]) {
        let (angular_velocity_rad_s, accel) = (axis * motion[1], axis * motion[2]);
        let (sin, cos) = libm::sincos(0.5 * motion[0]);
        let q = UnitQuaternion::new_unchecked(nalgebra::Quaternion::from_parts(cos, axis * sin));
        let (omega, alpha) = self.rotate(&q, &angular_velocity_rad_s, &accel);
        self.columns = self.columns.max(at[2] + 1);
        let across = omega.cross(axis);
        self.d_rotation.set_column(at[0], axis);
        self.d_omega.set_column(at[0], &across);
        self.d_omega.set_column(at[1], axis);
        self.d_alpha.set_column(at[0], &(alpha.cross(axis) - angular_velocity_rad_s.cross(&across)));
        self.d_alpha.set_column(at[1], &across);
        self.d_alpha.set_column(at[2], axis);
        self.d_specific_force.set_column(at[0], &self.specific_force_m_s2.cross(axis));
    }

    /// The frame itself: to the base, and how the specific force depends on the place in it.
    pub(super) fn frame(&self) -> Frame {
        Frame { q: self.q_base_frame, lever: lever(&self.omega, &self.alpha) }
    }

    /// Moves the point at which the specific force is felt by `r`, m, within the frame.
    pub(super) fn shift(&mut self, r: &Vector3<f64>) {
        let across = self.omega.cross(r);
        self.specific_force_m_s2 += self.alpha.cross(r) + self.omega.cross(&across);
        let by_omega = hat(&across) + hat(&self.omega) * hat(r);
        for j in 0..self.columns {
            let d_alpha = self.d_alpha.column(j).into_owned();
            let d_omega = self.d_omega.column(j).into_owned();
            let change = d_alpha.cross(r) - by_omega * d_omega;
            let mut column = self.d_specific_force.column_mut(j);
            column += change;
        }
    }

    /// Turns values and the derivatives so far; returns the base's share of angular velocity and acceleration.
    fn rotate(
        &mut self,
        q: &UnitQuaternion<f64>,
        angular_velocity_rad_s: &Vector3<f64>,
        accel: &Vector3<f64>,
    ) -> (Vector3<f64>, Vector3<f64>) {
        let back = q.to_rotation_matrix().into_inner().transpose();
        let omega = back * self.omega;
        let alpha = back * self.alpha;
        self.specific_force_m_s2 = back * self.specific_force_m_s2;
        for j in 0..self.columns {
            let d_omega = back * self.d_omega.column(j);
            let d_alpha = back * self.d_alpha.column(j) - angular_velocity_rad_s.cross(&d_omega);
            self.d_omega.set_column(j, &d_omega);
            self.d_alpha.set_column(j, &d_alpha);
            let d_specific_force = back * self.d_specific_force.column(j);
            self.d_specific_force.set_column(j, &d_specific_force);
            let d_rotation = back * self.d_rotation.column(j);
            self.d_rotation.set_column(j, &d_rotation);
        }
        self.omega = omega + angular_velocity_rad_s;
        self.alpha = alpha + accel - angular_velocity_rad_s.cross(&omega);
        self.q_base_frame *= q;
        (omega, alpha)
    }
}

fn set<const N: usize>(rows: &mut Rows<N>, at: usize, block: &Matrix3<f64>) {
    rows.fixed_view_mut::<3, 3>(0, at).copy_from(block);
}
