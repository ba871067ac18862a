//! Sharp peaks of acceleration: hands, or a slate with a sensor on it, that meet.
//!
//! By what IMUs measure alone: of a magnetic sensor's positions a second derivative is noise, and its filter's velocity jumps where
//! records were missing.

use posed_geometry::GRAVITY_M_S2;
use posed_stage::output::Estimate;
use serde::Serialize;

/// Least height of a peak, m/s²: brisk movements of an arm stay below, clapping hands reach several times that.
const LEAST_M_S2: f64 = 25.0;
/// How many times the usual acceleration around it a peak is, and how far around is looked, s: in movement that is brisk all the
/// time no peak is a clap.
const OVER_USUAL: f64 = 5.0;
const AROUND_S: f64 = 1.0;
/// Two claps are further apart, s.
const APART_S: f64 = 0.25;
/// Peaks of several sensors this near are one clap, s.
const TOGETHER_S: f64 = 0.03;

/// A clap.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Clap {
    /// Capture time, s since the stage's epoch.
    pub(super) t_s: f64,
    /// Time code then; null where there is none.
    pub(super) timecode: Option<String>,
    /// The strongest peak, m/s².
    pub(super) peak_m_s2: f64,
    /// The sensors that show it, the strongest first.
    pub(super) sensors: Vec<String>,
}

/// A sensor's acceleration over time.
#[derive(Default)]
struct Course {
    name: String,
    /// Capture time, s, and acceleration without gravity, m/s².
    samples: Vec<(f64, f64)>,
}

/// The accelerations of all sensors.
pub(super) struct Motion(Vec<Course>);

fn length([x, y, z]: [f64; 3]) -> f64 {
    (x * x + y * y + z * z).sqrt()
}

impl Motion {
    pub(super) fn new(sensors: impl Iterator<Item = String>) -> Self {
        Self(sensors.map(|name| Course { name, ..Course::default() }).collect())
    }

    /// Takes a frame.
    pub(super) fn push(&mut self, estimate: &Estimate) {
        for (course, sensor) in self.0.iter_mut().zip(&estimate.sensors) {
            let Some(measured) = &sensor.measured else { continue };
            let Some(inertial) = &measured.inertial else { continue };
            let linear = inertial.linear_acceleration_m_s2.map(length);
            // A peak is many times gravity: how the sensor is turned hardly counts.
            let force = inertial.specific_force_m_s2.map(|force| (length(force) - GRAVITY_M_S2).abs());
            if let Some(acceleration) = linear.or(force) {
                course.push(measured.t_valid.as_secs_f64(), acceleration);
            }
        }
    }

    /// Whether any sensor has measured acceleration.
    pub(super) fn is_known(&self) -> bool {
        self.0.iter().any(|course| !course.samples.is_empty())
    }

    /// The claps, in order of time.
    pub(super) fn claps(&self) -> Vec<Clap> {
        let mut peaks: Vec<(f64, f64, &str)> = self
            .0
            .iter()
            .flat_map(|course| {
                peaks(&course.samples).into_iter().map(|(t_s, height)| (t_s, height, course.name.as_str()))
            })
            .collect();
        // The strongest say where a clap is; what is near joins them.
        peaks.sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut claps = Vec::<Clap>::new();
        for (t_s, peak_m_s2, name) in peaks {
            match claps.iter_mut().find(|clap| (clap.t_s - t_s).abs() < TOGETHER_S) {
                Some(clap) => clap.sensors.push(name.to_owned()),
                None => claps.push(Clap { t_s, timecode: None, peak_m_s2, sensors: vec![name.to_owned()] }),
            }
        }
        claps.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
        claps
    }
}

impl Course {
    fn push(&mut self, t_s: f64, acceleration: f64) {
        // The newest record of a frame may be that of the one before.
        if self.samples.last().is_none_or(|(last_s, _)| t_s > *last_s) {
            self.samples.push((t_s, acceleration));
        }
    }
}

/// Time and height of each sharp peak of a course.
fn peaks(samples: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut found = Vec::<(f64, f64)>::new();
    for at in 1..samples.len().saturating_sub(1) {
        let [(_, before), (t_s, height), (_, after)] = [samples[at - 1], samples[at], samples[at + 1]];
        if height < LEAST_M_S2 || height < before || height <= after {
            continue;
        }
        let from = samples.partition_point(|(other_s, _)| *other_s < t_s - AROUND_S);
        let to = samples.partition_point(|(other_s, _)| *other_s <= t_s + AROUND_S);
        let mut around: Vec<f64> = samples[from..to].iter().map(|(_, acceleration)| *acceleration).collect();
        let middle = around.len() / 2;
        let (_, usual, _) = around.select_nth_unstable_by(middle, f64::total_cmp);
        if height < OVER_USUAL * *usual {
            continue;
        }
        // Between the samples, by the parabola through the three.
        let curve = before - 2.0 * height + after;
        let shift = if curve < 0.0 { 0.5 * (before - after) / curve } else { 0.0 };
        let step_s = 0.5 * (samples[at + 1].0 - samples[at - 1].0);
        let peak = (t_s + shift * step_s, height - 0.25 * (before - after) * shift);
        match found.last_mut().filter(|(last_s, _)| peak.0 - *last_s < APART_S) {
            Some(last) if last.1 < peak.1 => *last = peak,
            Some(_) => {}
            None => found.push(peak),
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 100 samples a second of slow movement, with peaks of 8 ms at these times.
    fn course(claps: &[f64]) -> Vec<(f64, f64)> {
        let samples = (0..600).map(|n| {
            let t_s = f64::from(n) * 0.01;
            let clap: f64 = claps.iter().map(|at| 150.0 * libm::exp(-((t_s - at) / 0.008).powi(2))).sum();
            (t_s, 2.0 + libm::sin(3.0 * t_s).abs() + clap)
        });
        samples.collect()
    }

    #[test]
    fn a_clap_is_found_between_samples_and_its_echo_is_none() {
        let claps = [1.234, 4.567];
        let found = peaks(&course(&[claps[0], claps[0] + 0.1, claps[1]]));
        assert_eq!(found.len(), 2, "{found:?}");
        for ((t_s, height), clap_s) in found.into_iter().zip(claps) {
            assert!((t_s - clap_s).abs() < 2e-3 || (t_s - clap_s - 0.1).abs() < 2e-3, "{t_s} {clap_s}");
            assert!(height > 60.0);
        }
    }

    #[test]
    fn brisk_movement_is_no_clap() {
        let brisk: Vec<(f64, f64)> =
            (0..600).map(|n| (f64::from(n) * 0.01, 30.0 * libm::sin(f64::from(n) * 0.2).abs())).collect();
        assert_eq!(peaks(&brisk), []);
        assert_eq!(peaks(&course(&[])), []);
        assert_eq!(peaks(&[]), []);
    }

    #[test]
    fn several_sensors_that_show_one_clap_are_named_together() {
        let mut motion = Motion::new(["left", "right", "foot"].map(str::to_owned).into_iter());
        for (course_of, claps) in motion.0.iter_mut().zip([&[2.0][..], &[2.004], &[]]) {
            course_of.samples = course(claps);
        }
        let claps = motion.claps();
        assert_eq!(claps.len(), 1);
        assert_eq!(claps[0].sensors.len(), 2, "{claps:?}");
    }
}
