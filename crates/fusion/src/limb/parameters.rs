//! What does not move in a limb and is known to some degrees and centimetres only: how its sensors sit, where they sit, where the limb hangs, and how long its
//! upper segment is.
//!
//! In: what the limb's filter could not predict, and how it depends on these parameters. Out: corrections of the [`LimbGeometry`], and how well it is known.
//! It never changes what was given as exact.
//!
//! Friedland, "Treatment of bias in recursive filtering" (1969): the limb's filter goes on as if the parameters were right, and beside it runs how wrong each of
//! its states is by each of them, so that what it cannot predict shows them. The parameters believe a sample for every [`CORRELATED_S`] only: a soft strap
//! and a joint that is no exact hinge are wrong in the same way throughout a movement, and are no noise that the next sample makes good.

use nalgebra::{Matrix3, Matrix6, SMatrix, SVector, UnitQuaternion, Vector3};
use posed_geometry::so3::{exp, hat};
use posed_state::Plain;

use super::covariance::{Innovation, inverse_of};
use super::slip::{Held, Slips};
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
/// So long after a strap has slipped the limb's states are still on their way, and show not yet which one it was, s.
const DECIDED_S: f64 = 3.0;
/// A strap that slips is noticed sooner than this, s: before it the geometry was as it should be.
const KEPT_S: f64 = 5.0;

/// How a measurement depends on the parameters: one row each, one column per measured number.
pub(super) type ByParameters<const M: usize> = SMatrix<f64, PARAMETERS, M>;

/// Where the mounting of a sensor begins, and its place.
pub(super) fn mount(which: Which) -> usize {
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
    /// Whether the lower segment turns about itself, as a forearm does: how its sensor is turned about it never shows.
    turns: bool,
    /// Since a sample was looked at, s.
    since_s: f64,
    /// Whether a strap has slipped.
    slips: Slips,
    /// How the sensors sat before one slipped, until it is known which, and since when, s.
    before: Option<Held>,
    loose_s: f64,
    /// Which of the sensors may have slipped.
    slipped: [bool; 2],
    /// The geometry of some seconds ago, older and newer, and when that was kept, s.
    kept: [LimbGeometry; 2],
    kept_s: f64,
}

impl Learning {
    /// Of a geometry whose mountings are known to `mount_sigma_rad`; `None` where they are exact, as all else is then.
    pub(super) fn of(geometry: &LimbGeometry, turns: bool) -> Option<Self> {
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
        Some(Self {
            p,
            turns,
            since_s: 0.0,
            slips: Slips::default(),
            before: None,
            loose_s: 0.0,
            slipped: [false; 2],
            kept: [*geometry; 2],
            kept_s: 0.0,
        })
    }

    /// Moves on by `dt_s`; whether the samples of this time are looked at.
    pub(super) fn predict(&mut self, geometry: &LimbGeometry, dt_s: f64) -> bool {
        self.kept_s += dt_s;
        if self.kept_s >= KEPT_S {
            (self.kept, self.kept_s) = ([self.kept[1], *geometry], 0.0);
        }
        for i in 0..6 {
            // What was given as exact stays so.
            if self.p[(i, i)] > 0.0 {
                self.p[(i, i)] += WALK_RAD_PER_SQRT_S * WALK_RAD_PER_SQRT_S * dt_s;
            }
        }
        self.slips.forget(dt_s);
        self.loose_s += dt_s;
        self.since_s += dt_s;
        let due = self.since_s >= PERIOD_S;
        if due {
            self.since_s = 0.0;
        }
        due
    }

    /// A strap has slipped, and nobody knows which: nothing is known any more of how either sensor sits, but that straps turn about the segment sooner than they tilt.
    /// What was learnt while it slipped is forgotten.
    pub(super) fn loosen(&mut self, geometry: &mut LimbGeometry) {
        *geometry = self.kept[0];
        self.before.get_or_insert_with(|| Held::of(geometry, &self.p));
        (self.loose_s, self.slipped) = (0.0, [true; 2]);
        self.p.fixed_rows_mut::<6>(0).fill(0.0);
        self.p.fixed_columns_mut::<6>(0).fill(0.0);
        for (i, sigma_rad) in SLIPPED_RAD.into_iter().cycle().take(6).enumerate() {
            self.p[(i, i)] = sigma_rad * sigma_rad;
        }
        self.slips = Slips::default();
    }

    /// Once the movements since a strap slipped show which one held: its mounting is again what it was. The correction.
    pub(super) fn decide(&mut self, geometry: &LimbGeometry) -> Option<SVector<f64, PARAMETERS>> {
        let before = self.before.as_ref().filter(|_| self.loose_s > DECIDED_S)?;
        let (which, by, noise) = before.held(geometry, &self.p)?;
        self.before = None;
        self.slipped[which as usize] = false;
        let cross = self.p.fixed_columns::<3>(mount(which)).into_owned();
        let covariance = cross.fixed_rows::<3>(mount(which)) + noise;
        let gain = cross * inverse_of(covariance)?;
        let half = cross - gain * (covariance * 0.5);
        subtract_both(&mut self.p, &gain, &half);
        self.slips = Slips::default();
        Some(gain * by)
    }

    /// How well it would be known how the sensors sit if nothing had been seen since a strap slipped, rad: where they sit now was found by steps that were linear
    /// in what they began with, far from it, and made believe too much.
    pub(super) fn anew(&self) -> [Vector3<f64>; 2] {
        let now = self.mount_sigmas_rad();
        [0, 1].map(|k| if self.slipped[k] { Vector3::from(SLIPPED_RAD) } else { now[k] })
    }

    /// Whether a strap has slipped, as far as what could not be predicted shows it: asked after a sample was looked at, for between two nothing is added to the evidence.
    pub(super) fn slipped(&self) -> bool {
        if self.since_s > 0.0 {
            return false;
        }
        let known: Matrix6<f64> = self.p.fixed_view::<6, 6>(0, 0).into_owned();
        let slipped = Vector3::from(SLIPPED_RAD.map(|sigma_rad| sigma_rad * sigma_rad));
        self.slips.found(&known, &slipped)
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
        let own = innovation.covariance(noise) * (CORRELATED_S / PERIOD_S);
        let covariance = own + by.transpose() * cross;
        let Some(inverse) = inverse_of(covariance) else { return SVector::zeros() };
        if let Some(own) = inverse_of(own) {
            self.slips.add(&by.fixed_rows::<6>(0).into_owned(), &own, residual);
        }
        let mut gain = cross * inverse;
        if self.turns {
            // It is one with how far the segment has turned: what seems to show it is the error of something else (Schmidt's consider update).
            gain.row_mut(mount(Which::Lower) + 1).fill(0.0);
        }
        let half = cross - gain * (covariance * 0.5);
        subtract_both(&mut self.p, &gain, &half);
        let moved = gain * residual;
        self.slips.moved(&moved.fixed_rows::<6>(0).into_owned());
        moved
    }

    /// What they make the covariance of some states larger by, of which these are the sensitivities.
    pub(super) fn spread<const K: usize>(&self, by: &SMatrix<f64, PARAMETERS, K>) -> SMatrix<f64, K, K> {
        by.transpose() * self.p * by
    }

    /// Standard deviations of both mountings about the segment's axes, rad.
    pub(super) fn mount_sigmas_rad(&self) -> [Vector3<f64>; 2] {
        [Which::Upper, Which::Lower].map(|which| {
            let at = mount(which);
            Vector3::from_fn(|i, _| self.p[(at + i, at + i)].max(0.0).sqrt())
        })
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
