//! Records of an IMU that no body makes: damage of a line without a checksum.
//!
//! In: angular velocity and specific force of a record, and how long after the one before it came. Out: whether it is to be left out.
//! One such record turns an orientation by as much as it says for as long as it stands for, and gravity takes half a minute to bring
//! it back. So an angular velocity that leaps is doubted until the next record confirms it: a blow is one record late, damage never
//! comes in.

use nalgebra::Vector3;
use posed_fusion::ahrs::ImuSample;
use posed_state::Plain;

/// Beyond what any gyro or accelerometer that a body wears can measure: 4000 degrees a second, and 100 g.
const MOST_RAD_S: f64 = 80.0;
const MOST_M_S2: f64 = 1000.0;
/// Angular acceleration that a body does not have from one record to the next, rad/s²; a blow on a shin has half of it.
const LEAP_RAD_S2: f64 = 1500.0;
/// Angle by which a leap must turn the orientation in one interval to be worth a doubt, rad.
const LEAP_RAD: f64 = 0.05;
/// By how much the usual interval follows a longer one.
const FOLLOWS: f64 = 1.1;

#[derive(Clone, Copy, Debug, Default, Plain)]
pub(super) struct Spikes {
    /// The latest angular velocity that was taken, and the one after it that is doubted, rad/s.
    taken_rad_s: Option<Vector3<f64>>,
    doubted_rad_s: Option<Vector3<f64>>,
    /// Interval of the records without their gaps, s.
    usual_s: f64,
}

impl Spikes {
    /// Whether a record, `since_s` after the one before, is to be left out.
    pub(super) fn leave_out(&mut self, sample: &ImuSample, since_s: f64) -> bool {
        let gyro_rad_s = sample.gyro_rad_s;
        let is_measured = gyro_rad_s.amax() <= MOST_RAD_S && sample.accel_m_s2.amax() <= MOST_M_S2;
        if !is_measured {
            return true;
        }
        self.usual_s = if self.usual_s > 0.0 { since_s.min(FOLLOWS * self.usual_s) } else { since_s };
        let most_rad_s = (LEAP_RAD_S2 * self.usual_s).max(LEAP_RAD / self.usual_s);
        let is_near = |other: &Vector3<f64>| (gyro_rad_s - other).norm() <= most_rad_s;
        let leaps = self.taken_rad_s.is_some_and(|taken| !is_near(&taken));
        let is_confirmed = self.doubted_rad_s.take().is_some_and(|doubted| is_near(&doubted));
        if leaps && !is_confirmed {
            self.doubted_rad_s = Some(gyro_rad_s);
            return true;
        }
        self.taken_rad_s = Some(gyro_rad_s);
        false
    }
}
