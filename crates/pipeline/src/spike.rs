//! Records of an IMU that no body makes: damage of a line without a checksum.
//!
//! In: angular velocity, specific force and magnetic field of a record, and how long after the one before it came. Out: whether the
//! record, or its field, is to be left out. One such record turns an orientation by as much as it says for as long as it stands for,
//! and gravity takes half a minute to bring it back; an orientation that begins with such a specific force, or such a field, holds the
//! earth's field for a disturbed one, and its heading is wrong for good. So what leaps, and what is first, is doubted until the next
//! one confirms it: a blow is one record late, damage never comes in.

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
/// Share of itself by which gravity at the beginning, or a field, may change beside what the sensor's turning makes of it.
const LEAP: f64 = 0.5;

#[derive(Clone, Copy, Debug, Default, Plain)]
pub(super) struct Spikes {
    /// rad/s.
    angular_velocity: Values,
    /// Interval of the records without their gaps, s.
    usual_s: f64,
    /// m/s²; of the beginning only.
    specific_force: Values,
    /// Any unit.
    field: Values,
    /// What the sensor may have turned since the latest field, rad.
    turned_rad: f64,
}

/// The latest value that was taken, and the one after it that is doubted.
#[derive(Clone, Copy, Debug, Default, Plain)]
struct Values {
    taken: Option<Vector3<f64>>,
    doubted: Option<Vector3<f64>>,
}

impl Values {
    /// Takes a value that is near the one before, or near one that was doubted; else it is doubted itself, as the first one is.
    fn take(&mut self, value: Vector3<f64>, is_near: impl Fn(&Vector3<f64>) -> bool) -> bool {
        let follows = self.taken.as_ref().is_some_and(&is_near);
        let is_confirmed = self.doubted.take().as_ref().is_some_and(is_near);
        let is_taken = follows || is_confirmed;
        *if is_taken { &mut self.taken } else { &mut self.doubted } = Some(value);
        is_taken
    }

    /// Takes one that the room keeps, of a sensor that turned by so much.
    fn take_turned(&mut self, value: Vector3<f64>, turned_rad: f64) -> bool {
        let share = LEAP + turned_rad;
        self.take(value, |other| (value - other).norm() <= share * value.norm().min(other.norm()))
    }
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
        let turned_rad = gyro_rad_s.norm() * since_s;
        self.turned_rad += turned_rad;
        let begins = self.specific_force.taken.is_none();
        let is_level = !begins || self.specific_force.take_turned(sample.accel_m_s2, turned_rad);
        let is_smooth =
            self.angular_velocity.take(gyro_rad_s, |other| (gyro_rad_s - other).norm() <= most_rad_s);
        !(is_level && is_smooth)
    }

    /// The field of a record that was not left out, if it is to be believed.
    pub(super) fn field(&mut self, field: Vector3<f64>) -> Option<Vector3<f64>> {
        let turned_rad = std::mem::take(&mut self.turned_rad);
        self.field.take_turned(field, turned_rad).then_some(field)
    }
}
