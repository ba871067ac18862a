//! Is a worn sensor to be believed, and if not, why?
//!
//! In: its samples or their absence, and how its own orientation agrees with the body's. Out: a [`Cause`]. It never
//! takes a sensor out of the filters: those gate by themselves.

use nalgebra::{UnitQuaternion, Vector3};
use posed_state::Plain;

use crate::ahrs::ImuSample;
use crate::faults::{Cause, Evidence, ImuWords, Repeats, Repetition};
use posed_geometry::GRAVITY_M_S2;

/// Without a sample for so long, a sensor is silent, s.
const SILENT_S: f64 = 0.5;
/// For so long after it a number that is none, a saturated one or a misfit is reported, s.
pub(super) const TOLD_S: f64 = 1.0;
/// 98 % of 16 g and of 2000 deg/s, the widest ranges of the usual units.
const ACCEL_RANGE_M_S2: f64 = 0.98 * 16.0 * GRAVITY_M_S2;
const GYRO_RANGE_RAD_S: f64 = 0.98 * 34.9;
/// Tilt between the sensor's own orientation and the body's that no healthy strap shows, rad.
const TILT_RAD: f64 = 0.26;
/// The same of the heading, where there is a magnetometer, rad.
const HEADING_RAD: f64 = 0.7;
/// Part of the squared angular velocity that no joint allows: above it the sensor turns in ways its segment cannot. Skin and
/// blows make some; a strap turned by 30 degrees makes a quarter.
const IMPOSSIBLE: f64 = 0.15;
/// Part of the specific forces that no healthy sensor has disbelieved: steps and blows are over sooner.
const GATED: f64 = 0.35;
/// Time over which these parts are taken, s.
const IMPOSSIBLE_TAU_S: f64 = 0.4;
/// Below this angular velocity it says nothing, rad/s.
const SLOW_RAD_S: f64 = 0.3;
/// For so long must a disagreement last, s.
const MISFIT_S: f64 = 0.2;
/// Without a sample for so long, the filters go on by guess, s; what does not fit for so long after is laid to that, s.
const GAP_S: f64 = 0.15;
const AFTER_GAP_S: f64 = 3.0;

/// What is remembered of a sensor's health.
#[derive(Clone, Copy, Debug, Default, PartialEq, Plain)]
pub(super) struct Watch {
    silent_s: f64,
    words: Repetition<ImuWords>,
    stuck: bool,
    misfit_s: f64,
    /// Squared angular velocities, low-passed: what no joint allows, and all.
    impossible: f64,
    turning: f64,
    /// Part of the specific forces that was not believed, low-passed.
    gated: f64,
    /// Time since the last such sample; starts as long ago as can be.
    since_broken_s: Option<f64>,
    since_saturated_s: Option<f64>,
    since_misfit_s: Option<f64>,
    /// Time since samples were missing.
    since_gap_s: Option<f64>,
}

/// All numbers that every filter needs are finite.
pub(super) fn usable(sample: &ImuSample) -> bool {
    sample.gyro_rad_s.iter().chain(sample.accel_m_s2.iter()).all(|value| value.is_finite())
}

impl Watch {
    /// One sample, or none.
    pub(super) fn sample(&mut self, sample: Option<&ImuSample>, dt_s: f64) {
        for since in [&mut self.since_broken_s, &mut self.since_saturated_s, &mut self.since_misfit_s] {
            *since = since.map(|s| s + dt_s).filter(|s| *s < TOLD_S);
        }
        self.since_gap_s = self.since_gap_s.map(|s| s + dt_s).filter(|s| *s < AFTER_GAP_S);
        let Some(sample) = sample else {
            self.silent_s += dt_s;
            if self.silent_s >= GAP_S {
                self.since_gap_s = Some(0.0);
            }
            return;
        };
        self.silent_s = 0.0;
        if !usable(sample) {
            self.since_broken_s = Some(0.0);
            return;
        }
        self.stuck = self.words.take(sample.words(), Evidence::Certain) == Repeats::Stuck;
        if sample.accel_m_s2.amax() > ACCEL_RANGE_M_S2 || sample.gyro_rad_s.amax() > GYRO_RANGE_RAD_S {
            self.since_saturated_s = Some(0.0);
        }
    }

    /// What the limb made of a sample: the angular velocity, rad/s, the part of it that the joints do not allow, and whether
    /// the specific force was not believed.
    pub(super) fn innovation(
        &mut self,
        angular_velocity_rad_s: f64,
        impossible_rad_s: f64,
        gated: bool,
        dt_s: f64,
    ) {
        let gain = dt_s / (IMPOSSIBLE_TAU_S + dt_s);
        self.gated += gain * (f64::from(gated) - self.gated);
        self.impossible += gain * (impossible_rad_s.min(angular_velocity_rad_s).powi(2) - self.impossible);
        self.turning += gain * (angular_velocity_rad_s.powi(2) - self.turning);
    }

    /// The segment's orientation by the sensor alone and by the body; nothing where they cannot be compared yet.
    pub(super) fn agrees(
        &mut self,
        own: Option<UnitQuaternion<f64>>,
        body: Option<UnitQuaternion<f64>>,
        magnetometer: bool,
        dt_s: f64,
    ) {
        let Some((own, body)) = own.zip(body) else {
            self.misfit_s = 0.0;
            return;
        };
        let tilt_rad = (own.inverse() * Vector3::z()).angle(&(body.inverse() * Vector3::z()));
        let apart = tilt_rad > TILT_RAD
            || (magnetometer && own.angle_to(&body) > HEADING_RAD)
            || self.gated > GATED
            || self.impossible > IMPOSSIBLE * self.turning.max(SLOW_RAD_S * SLOW_RAD_S);
        self.misfit_s = if apart { self.misfit_s + dt_s } else { (self.misfit_s - dt_s).max(0.0) }.min(1.0);
        if self.misfit_s >= MISFIT_S {
            self.since_misfit_s = Some(0.0);
        }
    }

    /// The gravest of what is wrong.
    pub(super) fn fault(&self) -> Option<Cause> {
        if self.since_broken_s.is_some() {
            Some(Cause::NotFinite)
        } else if self.silent_s >= SILENT_S {
            Some(Cause::Missing)
        } else if self.stuck {
            Some(Cause::Stuck)
        } else if self.since_saturated_s.is_some() {
            Some(Cause::Saturated)
        } else if self.since_misfit_s.is_some() {
            // A strap that holds is not to be blamed for samples that did not come.
            Some(if self.since_gap_s.is_some() { Cause::Missing } else { Cause::Misfit })
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f64 = 0.01;

    /// The cause after a second in which sensor and body are 30 degrees apart; of every `each` samples only one comes.
    fn apart(each: usize) -> Option<Cause> {
        let mut watch = Watch::default();
        let body = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.52);
        for k in 0..100 {
            let turned = k as f64 * 1e-3;
            let sample = ImuSample {
                gyro_rad_s: Vector3::new(turned, 0.0, 0.0),
                accel_m_s2: Vector3::new(0.0, turned, GRAVITY_M_S2),
                mag: None,
            };
            watch.sample((k % each == 0).then_some(&sample), DT_S);
            watch.agrees(Some(UnitQuaternion::identity()), Some(body), false, DT_S);
        }
        watch.fault()
    }

    #[test]
    fn what_does_not_fit_for_want_of_samples_is_not_laid_to_a_strap() {
        assert_eq!(apart(1), Some(Cause::Misfit));
        assert_eq!(apart(20), Some(Cause::Missing));
    }
}
