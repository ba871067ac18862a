//! What does not move in a limb and is known to some degrees and centimetres only: how its sensors sit, where they sit, where the limb hangs, and how long its
//! upper segment is.
//!
//! In: what the limb's filter could not predict, and how it depends on these parameters. Out: corrections of the [`LimbGeometry`], and how well it is known.
//! It never changes what was given as exact.
//!
//! Friedland, "Treatment of bias in recursive filtering" (1969): the limb's filter goes on as if the parameters were right, and beside it runs how wrong each of
//! its states is by each of them, so that what it cannot predict shows them. The parameters believe a sample for every [`CORRELATED_S`] only: a soft strap
//! and a joint that is no exact hinge are wrong in the same way throughout a movement, and are no noise that the next sample makes good.

use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};
use posed_geometry::so3::{exp, hat};
use posed_state::Plain;

use super::covariance::{Innovation, inverse_of};
use super::wide::subtract_both;
use super::{LimbGeometry, Which};

/// Mounting of the upper and the lower sensor 3 and 3 (rotation of the sensor in its segment's axes, rad), place of both 3 and 3 (segment's axes, m), of the upper
/// joint in the base 3 (base's axes, m), length of the upper segment 1 (m).
pub(super) const PARAMETERS: usize = 16;
const JOINT: usize = 12;
const LENGTH: usize = 15;

/// How well it is known before anything has moved where a sensor sits and where a limb hangs, per axis, m, and how long a segment is, as a part of it.
const PLACE_M: f64 = 0.03;
const LENGTH_SHARE: f64 = 0.05;
/// Correlation of what both mountings are wrong by: they were found in the same pose, in which one segment leans as the other does.
const POSE_SHARED: f64 = 0.5;
/// What a residual is wrong by for so long is one error, s.
const CORRELATED_S: f64 = 0.5;
/// The parameters look at one sample in so long, s.
const PERIOD_S: f64 = 0.1;
/// Part of an angular velocity by which skin and straps falsify it.
pub(super) const GYRO_SHARE: f64 = 0.05;
/// Below this angular velocity a sensor shows nothing but what its accelerometer is wrong by, rad/s.
pub(super) const SLOW_RAD_S: f64 = 0.5;
/// A strap goes on turning by so much, rad per square root of a second: half a degree in a minute.
const WALK_RAD_PER_SQRT_S: f64 = 1.1e-3;

/// How far a strap that slips turns a sensor about the segment's axes, standard deviation, rad: y runs along the segment.
const SLIPPED_RAD: [f64; 3] = [0.26, 0.7, 0.26];

/// How a measurement depends on the parameters: one row each, one column per measured number.
pub(super) type ByParameters<const M: usize> = SMatrix<f64, PARAMETERS, M>;

/// Where the mounting of a sensor begins, and its place.
fn mount(which: Which) -> usize {
    3 * which as usize
}
fn place(which: Which) -> usize {
    6 + 3 * which as usize
}

/// How well the parameters of a limb are known.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Learning {
    /// Covariance of their errors.
    p: SMatrix<f64, PARAMETERS, PARAMETERS>,
    /// Since a sample was looked at, s.
    since_s: f64,
}

impl Learning {
    /// Of a geometry whose mountings are known to `mount_sigma_rad`; `None` where they are exact, as all else is then.
    pub(super) fn of(geometry: &LimbGeometry) -> Option<Self> {
        if geometry.mount_sigma_rad.iter().all(|sigma| sigma.norm() == 0.0) {
            return None;
        }
        let mut sigmas = SVector::<f64, PARAMETERS>::repeat(PLACE_M);
        for (which, sigma_rad) in [Which::Upper, Which::Lower].into_iter().zip(&geometry.mount_sigma_rad) {
            sigmas.fixed_rows_mut::<3>(mount(which)).copy_from(sigma_rad);
        }
        sigmas[LENGTH] = LENGTH_SHARE * geometry.upper_to_lower_m.norm();
        let mut p = SMatrix::from_diagonal(&sigmas.component_mul(&sigmas));
        for (upper, lower) in (0..3).zip(3..6) {
            let shared = POSE_SHARED * sigmas[upper] * sigmas[lower];
            (p[(upper, lower)], p[(lower, upper)]) = (shared, shared);
        }
        Some(Self { p, since_s: 0.0 })
    }

    /// Moves on by `dt_s`; whether the samples of this time are looked at.
    pub(super) fn predict(&mut self, dt_s: f64) -> bool {
        for i in 0..6 {
            // What was given as exact stays so.
            if self.p[(i, i)] > 0.0 {
                self.p[(i, i)] += WALK_RAD_PER_SQRT_S * WALK_RAD_PER_SQRT_S * dt_s;
            }
        }
        self.since_s += dt_s;
        let due = self.since_s >= PERIOD_S;
        if due {
            self.since_s = 0.0;
        }
        due
    }

    /// A strap has slipped: nothing is known any more of how the sensor sits, but that straps turn about the segment sooner than they tilt.
    pub(super) fn loosen(&mut self, which: Which) {
        let at = mount(which);
        self.p.fixed_rows_mut::<3>(at).fill(0.0);
        self.p.fixed_columns_mut::<3>(at).fill(0.0);
        for (i, sigma_rad) in SLIPPED_RAD.into_iter().enumerate() {
            self.p[(at + i, at + i)] = sigma_rad * sigma_rad;
        }
    }

    /// The correction that a residual shows.
    pub(super) fn update<const M: usize, const N: usize>(
        &mut self,
        innovation: &Innovation<M, N>,
        residual: &SVector<f64, M>,
        noise: &SVector<f64, M>,
    ) -> SVector<f64, PARAMETERS> {
        let by = &innovation.by_parameters;
        let cross = self.p * by;
        let covariance = innovation.covariance(noise) * (CORRELATED_S / PERIOD_S) + by.transpose() * cross;
        let Some(inverse) = inverse_of(covariance) else { return SVector::zeros() };
        let gain = cross * inverse;
        let half = cross - gain * (covariance * 0.5);
        subtract_both(&mut self.p, &gain, &half);
        gain * residual
    }

    /// What they make the covariance of some states larger by, of which these are the sensitivities.
    pub(super) fn spread<const K: usize>(&self, by: &SMatrix<f64, PARAMETERS, K>) -> SMatrix<f64, K, K> {
        by.transpose() * self.p * by
    }

    /// Standard deviation of a mounting about the segment's axes, rad.
    pub(super) fn mount_sigma_rad(&self, which: Which) -> Vector3<f64> {
        let at = mount(which);
        Vector3::from_fn(|i, _| self.p[(at + i, at + i)].max(0.0).sqrt())
    }

    /// Standard deviation of the length of the upper segment, m.
    pub(super) fn length_sigma_m(&self) -> f64 {
        self.p[(LENGTH, LENGTH)].max(0.0).sqrt()
    }
}

impl LimbGeometry {
    /// With the parameters moved by `by`.
    pub(super) fn correct(&mut self, by: &SVector<f64, PARAMETERS>) {
        let part = |at: usize| Vector3::new(by[at], by[at + 1], by[at + 2]);
        let turned = |q: &UnitQuaternion<f64>, at: usize| {
            UnitQuaternion::new_normalize((exp(&part(at)) * q).into_inner())
        };
        self.upper_mount = turned(&self.upper_mount, mount(Which::Upper));
        self.lower_mount = turned(&self.lower_mount, mount(Which::Lower));
        self.upper_imu_m += part(place(Which::Upper));
        self.lower_imu_m += part(place(Which::Lower));
        self.base_to_joint_m += part(JOINT);
        self.upper_to_lower_m += self.along() * by[LENGTH];
    }

    fn along(&self) -> Vector3<f64> {
        self.upper_to_lower_m.try_normalize(1e-9).unwrap_or_else(Vector3::zeros)
    }
}

/// How one sensor's prediction depends on the parameters, row by row as the walk along the limb finds it: all in the sensor's axes.
#[derive(Clone, Debug)]
pub(super) struct Dependence {
    pub(super) gyro: ByParameters<3>,
    pub(super) accel: ByParameters<3>,
    /// Of the azimuth, by a rotation about the vertical and by a tilt.
    pub(super) azimuth: [ByParameters<1>; 2],
}

impl Dependence {
    pub(super) fn none() -> Self {
        Self { gyro: SMatrix::zeros(), accel: SMatrix::zeros(), azimuth: [SMatrix::zeros(); 2] }
    }

    /// Of the sensor `which`, whose frame's angular velocity is `omega` and which feels `specific_force_m_s2`; `back` turns the segment's axes into the sensor's.
    pub(super) fn mount(
        &mut self,
        which: Which,
        back: &Matrix3<f64>,
        omega: &Vector3<f64>,
        specific_force_m_s2: &Vector3<f64>,
    ) {
        set(&mut self.gyro, mount(which), &(back * hat(omega)));
        set(&mut self.accel, mount(which), &(back * hat(specific_force_m_s2)));
    }

    /// Of the azimuth that the sensor `which` shows: a mounting turns the field as the segment itself does. `about` are the room's vertical and the tilt that moves
    /// the azimuth, segment's axes.
    pub(super) fn azimuth(&mut self, which: Which, about: [Vector3<f64>; 2]) {
        for (by, about) in self.azimuth.iter_mut().zip(about) {
            by.fixed_view_mut::<3, 1>(mount(which), 0).copy_from(&about);
        }
    }

    /// Of the place of the sensor; `lever` is that of its frame ([`posed_geometry::so3::lever`]).
    pub(super) fn place(&mut self, which: Which, back: &Matrix3<f64>, lever: &Matrix3<f64>) {
        set(&mut self.accel, place(which), &(back * lever));
    }

    /// Of the upper joint's place in the base, whose axes `back` turns into the sensor's.
    pub(super) fn joint(&mut self, back: &Matrix3<f64>, lever: &Matrix3<f64>) {
        set(&mut self.accel, JOINT, &(back * lever));
    }

    /// Of the upper segment's length.
    pub(super) fn length(&mut self, geometry: &LimbGeometry, back: &Matrix3<f64>, lever: &Matrix3<f64>) {
        let column = back * (lever * geometry.along());
        for i in 0..3 {
            self.accel[(LENGTH, i)] = column[i];
        }
    }
}

fn set(by: &mut ByParameters<3>, at: usize, block: &Matrix3<f64>) {
    by.fixed_view_mut::<3, 3>(at, 0).copy_from(&block.transpose());
}
