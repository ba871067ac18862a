//! When a unit lies at rest, and which ways are up then.
//!
//! In: samples with their times. Out: a rest for each second in which nothing moves. Single samples may be noisy: what
//! tells a slow rotation from a rest are the means over quarters of the second. An even rotation about the vertical alone
//! cannot be distinguished from a gyro's bias.

use nalgebra::Vector3;

use super::super::ahrs::ImuSample;

/// A rest lasts at least this long, s.
pub(super) const MIN_REST_S: f64 = 1.0;
/// Means over a quarter of a rest depart from its mean by less, rad/s and m/s².
const REST_GYRO_RAD_S: f64 = 0.03;
const REST_ACCEL_M_S2: f64 = 0.12;
/// Single samples do by less.
const SAMPLE_GYRO_RAD_S: f64 = 0.15;
const SAMPLE_ACCEL_M_S2: f64 = 1.0;
/// Fewer samples in a second show nothing.
const MIN_SAMPLES: usize = 8;
/// Samples further apart than this do not belong to one rest, s.
const GAP_S: f64 = 0.25;
/// Two rests count as two directions from this angle on, degrees.
const NEW_DIRECTION_DEG: f64 = 20.0;
/// A direction this near to an axis is the side of that axis, degrees.
const NEAR_AXIS_DEG: f64 = 40.0;

/// The six sides of a unit, named after the sensor axis that is up.
pub const SIDES: [&str; 6] = ["+x", "-x", "+y", "-y", "+z", "-z"];

/// One rest: means over a second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rest {
    pub(super) gyro: Vector3<f64>,
    pub(super) accel: Vector3<f64>,
}

/// Finds rests in samples as they come.
#[derive(Clone, Debug, Default)]
pub(super) struct RestFinder {
    window: Vec<(f64, ImuSample)>,
    sum: (Vector3<f64>, Vector3<f64>),
}

impl RestFinder {
    /// Takes a sample; the rest that it ends, if it ends one.
    pub(super) fn push(&mut self, t_s: f64, sample: &ImuSample) -> Option<Rest> {
        let mut found = None;
        let last_s = self.window.last().map(|(t_s, _)| *t_s);
        if last_s.is_some_and(|last_s| t_s - last_s > GAP_S || t_s <= last_s) || self.departs(sample) {
            self.clear();
        } else if self.window.first().is_some_and(|(first_s, _)| t_s - first_s >= MIN_REST_S) {
            found = self.rest();
            match found {
                Some(_) => self.clear(),
                // It may have been turned at the beginning of the second.
                None => self.drop_quarter(),
            }
        }
        self.window.push((t_s, *sample));
        self.sum.0 += sample.gyro_rad_s;
        self.sum.1 += sample.accel_m_s2;
        found
    }

    /// How long nothing has moved, s.
    pub(super) fn resting_s(&self) -> f64 {
        self.window.first().zip(self.window.last()).map_or(0.0, |((first, _), (last, _))| last - first)
    }

    fn clear(&mut self) {
        self.window.clear();
        self.sum = Default::default();
    }

    fn drop_quarter(&mut self) {
        let part = self.window.len().div_ceil(4);
        for (_, sample) in self.window.drain(..part) {
            self.sum.0 -= sample.gyro_rad_s;
            self.sum.1 -= sample.accel_m_s2;
        }
    }

    fn departs(&self, sample: &ImuSample) -> bool {
        let count = self.window.len() as f64;
        count > 0.0
            && ((sample.gyro_rad_s - self.sum.0 / count).norm() > SAMPLE_GYRO_RAD_S
                || (sample.accel_m_s2 - self.sum.1 / count).norm() > SAMPLE_ACCEL_M_S2)
    }

    /// The rest that the window is, unless something moves slowly in it.
    fn rest(&self) -> Option<Rest> {
        if self.window.len() < MIN_SAMPLES {
            return None;
        }
        let mean = |part: &[(f64, ImuSample)]| {
            let count = part.len() as f64;
            Rest {
                gyro: part.iter().map(|(_, sample)| sample.gyro_rad_s).sum::<Vector3<f64>>() / count,
                accel: part.iter().map(|(_, sample)| sample.accel_m_s2).sum::<Vector3<f64>>() / count,
            }
        };
        let whole = mean(&self.window);
        let still = self.window.chunks(self.window.len().div_ceil(4)).map(mean).all(|quarter| {
            (quarter.gyro - whole.gyro).norm() < REST_GYRO_RAD_S
                && (quarter.accel - whole.accel).norm() < REST_ACCEL_M_S2
        });
        still.then_some(whole)
    }
}

/// Directions that were held, sensor axes: what was up.
#[derive(Clone, Debug, Default)]
pub(super) struct Directions(Vec<Vector3<f64>>);

impl Directions {
    pub(super) fn of(rests: &[Rest]) -> Self {
        let mut all = Self::default();
        rests.iter().for_each(|rest| {
            all.push(rest);
        });
        all
    }

    /// Whether a rest shows one that was not held before.
    pub(super) fn push(&mut self, rest: &Rest) -> bool {
        let new = self.0.iter().all(|known| known.angle(&rest.accel).to_degrees() > NEW_DIRECTION_DEG);
        if new {
            self.0.push(rest.accel);
        }
        new
    }

    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// Which of [`SIDES`] were up.
    pub(super) fn sides(&self) -> [bool; 6] {
        std::array::from_fn(|side| {
            let mut axis = Vector3::zeros();
            axis[side / 2] = if side % 2 == 0 { 1.0 } else { -1.0 };
            self.0.iter().any(|held| held.angle(&axis).to_degrees() <= NEAR_AXIS_DEG)
        })
    }
}
