//! Two taps on a sensor, which mean something to who wears it.
//!
//! In: samples of one IMU. Out: whether somebody who kept still has tapped it twice, and once only twice. A tap is over in some hundredths of a second and turns
//! nothing; steps, gestures and blows are longer, turn the sensor, or do not stop after two.

use posed_state::Plain;

use crate::ahrs::ImuSample;

/// The specific force departs by more than this from its mean in a tap, and by less in between, m/s².
const TAP_M_S2: f64 = 6.5;
const CALM_M_S2: f64 = 2.0;
/// And the sensor turns less than this, rad/s.
const TURNS_RAD_S: f64 = 3.0;
/// The mean is that of so long, s.
const MEAN_S: f64 = 0.5;
/// No tap is longer, s; two follow each other within these, from begin to begin, s.
const LONGEST_S: f64 = 0.1;
const APART_S: [f64; 2] = [0.12, 0.6];
/// It is calm for so long before the first, and after the second, s: longer than taps are apart.
const AROUND_S: f64 = 0.7;

/// Detects two taps, as they come.
#[derive(Clone, Debug, Default, PartialEq, Plain)]
pub struct DoubleTap {
    /// Low-passed norm of the specific force, m/s²; `None` before the first sample.
    mean_m_s2: Option<f64>,
    /// For how long it has been calm, s.
    calm_s: f64,
    /// What may be a tap: for how long it has lasted, s, and how large it became, m/s².
    knock: Option<(f64, f64)>,
    /// Taps so far, and the time since the last began, s.
    taps: u32,
    since_s: f64,
}

impl DoubleTap {
    /// Takes a sample, `dt_s` after the one before, s; true 0.7 s after the second tap, once.
    pub fn push(&mut self, sample: &ImuSample, dt_s: f64) -> bool {
        let norm_m_s2 = sample.accel_m_s2.norm();
        if !norm_m_s2.is_finite() || !sample.gyro_rad_s.norm().is_finite() || dt_s <= 0.0 {
            return false;
        }
        let mean_m_s2 = self.mean_m_s2.get_or_insert(norm_m_s2);
        let departs_m_s2 = (norm_m_s2 - *mean_m_s2).abs();
        *mean_m_s2 += (dt_s / MEAN_S).min(1.0) * (norm_m_s2 - *mean_m_s2).clamp(-CALM_M_S2, CALM_M_S2);
        self.since_s += dt_s;
        let is_calm = departs_m_s2 < CALM_M_S2;
        if sample.gyro_rad_s.norm() > TURNS_RAD_S {
            self.begin_anew();
        } else if let Some((lasts_s, most_m_s2)) = self.knock {
            let (lasts_s, most_m_s2) = (lasts_s + dt_s, most_m_s2.max(departs_m_s2));
            self.knock = Some((lasts_s, most_m_s2));
            if lasts_s > LONGEST_S {
                // What does not end is no tap, nor is a touch.
                if is_calm && most_m_s2 > TAP_M_S2 {
                    (self.knock, self.taps, self.calm_s) = (None, self.taps + 1, 0.0);
                } else {
                    self.begin_anew();
                }
            }
        } else if is_calm {
            self.calm_s += dt_s;
            if self.taps == 2 && self.calm_s >= AROUND_S {
                self.taps = 0;
                return true;
            }
        } else {
            let in_time = match self.taps {
                0 => self.calm_s >= AROUND_S,
                1 => (APART_S[0]..=APART_S[1]).contains(&self.since_s),
                _ => false,
            };
            if in_time {
                (self.knock, self.since_s) = (Some((0.0, departs_m_s2)), 0.0);
            } else {
                self.begin_anew();
            }
        }
        false
    }

    /// It was none. Calm has to come again.
    fn begin_anew(&mut self) {
        (self.taps, self.knock, self.calm_s) = (0, None, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use posed_geometry::GRAVITY_M_S2;

    const DT_S: f64 = 0.01;

    /// How often it is heard where taps begin at these times, s, on somebody who sways and breathes.
    fn heard(taps_s: &[f64], until_s: f64) -> usize {
        let mut detector = DoubleTap::default();
        let samples = (until_s / DT_S) as usize;
        (0..samples)
            .filter(|k| {
                let t_s = *k as f64 * DT_S;
                let taps = taps_s.iter().filter(|at_s| t_s >= **at_s).map(|at_s| {
                    let since_s = t_s - at_s;
                    35.0 * libm::exp(-since_s / 0.015) * libm::cos(220.0 * since_s)
                });
                let sample = ImuSample {
                    gyro_rad_s: Vector3::new(0.1 * libm::sin(1.5 * t_s), 0.0, 0.02),
                    accel_m_s2: Vector3::new(
                        0.3 * libm::sin(2.0 * t_s),
                        0.0,
                        GRAVITY_M_S2 + taps.sum::<f64>(),
                    ),
                    mag: None,
                };
                detector.push(&sample, DT_S)
            })
            .count()
    }

    #[test]
    fn two_taps_are_heard_once_and_one_or_three_or_slow_ones_are_not() {
        for phase in 0..10 {
            let at_s = 2.0 + 0.001 * f64::from(phase);
            assert_eq!(heard(&[at_s, at_s + 0.25], 5.0), 1, "{at_s}");
            assert_eq!(heard(&[at_s, at_s + 0.45], 5.0), 1, "{at_s}");
            assert_eq!(heard(&[at_s, at_s + 0.25, at_s + 3.0, at_s + 3.3], 8.0), 2, "{at_s}");
            assert_eq!(heard(&[at_s], 5.0), 0);
            assert_eq!(heard(&[at_s, at_s + 0.25, at_s + 0.5], 5.0), 0, "{at_s}");
            assert_eq!(heard(&[at_s, at_s + 0.9], 5.0), 0);
            // Steps.
            let steps: Vec<f64> = (0..20).map(|k| at_s + 0.55 * f64::from(k)).collect();
            assert_eq!(heard(&steps, 15.0), 0);
        }
    }
}
