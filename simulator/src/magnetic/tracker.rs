//! One measurement: from the true pose, through nine noisy signals, to the pose that a device reports.

use nalgebra::{Isometry3, Matrix3, Vector3};

use super::dipole::{Solution, signal_matrix, solve};
use super::metal::{Environment, Sphere};
use crate::random::Random;

/// A stray field of the mains: a sine, the same at all places and in the signals of all three source axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hum {
    /// Mains frequency, Hz.
    pub frequency_hz: f64,
    /// Amplitude and direction in the transmitter frame, in units of mu0 m / 4 pi (1/m^3).
    pub amplitude: Vector3<f64>,
    /// Phase at t = 0, rad.
    pub phase_rad: f64,
    /// From when on, s of the stage's clock.
    pub from_s: f64,
    /// Until when, s of the stage's clock, excluded; infinite: for good.
    pub until_s: f64,
}

/// A metal object that is there for a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passing {
    /// The object.
    pub sphere: Sphere,
    /// From when on, s of the stage's clock.
    pub from_s: f64,
    /// Until when, s of the stage's clock, excluded; infinite: for good.
    pub until_s: f64,
}

/// The physical part of a tracker: source, metal, noise, limits; all in the transmitter frame.
///
/// Modelled: the dipole field, metal as dipoles and an image, white noise on each signal, hum, clipping and loss of range. Not
/// modelled: the motion of a sensor during a cycle, the device's filters, and calibration errors of its coils.
#[derive(Clone, Debug, PartialEq)]
pub struct Tracker {
    /// Metal around the transmitter.
    pub environment: Environment,
    /// Metal that comes and goes.
    pub passing: Vec<Passing>,
    /// Standard deviation of each of the nine signals, in units of mu0 m / 4 pi (1/m^3).
    ///
    /// It gives a position noise of r^4 s / sqrt(54) along the ray and sqrt(5) / 3 r^4 s across it, m, at r metres.
    pub sigma_signal: f64,
    /// Stray field of the mains; absent: none.
    pub hum: Option<Hum>,
    /// Beyond this distance from the transmitter the signals are too weak, m.
    pub max_range_m: f64,
    /// Nearer than this to the transmitter the amplifiers saturate, m: each signal is clipped at 2 / r^3 of it.
    pub min_range_m: f64,
}

/// How usable the signals were.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signal {
    /// A pose was solved.
    Good,
    /// Too far away, or signals that hold no pose: the device repeats its last words.
    Weak,
    /// Too near: signals were clipped, the pose is wrong; within 1 mm there is none.
    Saturated,
}

/// What one sensor measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// The pose that the device solves, in the transmitter frame; absent when `signal` is `Weak`, and within 1 mm of the
    /// transmitter.
    pub solution: Option<Solution>,
    /// The position that it would solve without noise, on the true side of the transmitter, minus the true one; transmitter
    /// frame, m. Metal, hum and clipping are in it. Zero where there is none.
    pub distortion_m: Vector3<f64>,
    /// Whether the solution lies on the other side of the transmitter than the sensor.
    pub mirrored: bool,
    /// How usable the signals were.
    pub signal: Signal,
}

impl Tracker {
    /// Measures a sensor at `pose` (sensor to transmitter, m) at `t_s` seconds.
    ///
    /// `hemisphere` is the axis of the half-space that the device was set to, in the transmitter frame.
    /// Draws the same amount of noise whatever happens, so that sensors and cycles stay independent.
    pub(crate) fn measure(
        &self,
        t_s: f64,
        pose: &Isometry3<f64>,
        hemisphere: &Vector3<f64>,
        random: &mut Random,
    ) -> Reading {
        let noise = Matrix3::from_fn(|_, _| self.sigma_signal * random.normal());
        let p_m = pose.translation.vector;
        let r_m = p_m.norm();
        let mirrored = p_m.dot(hemisphere) < 0.0;
        let too_near = r_m < 1e-3;
        if too_near || r_m > self.max_range_m || r_m.is_nan() {
            let signal = if too_near { Signal::Saturated } else { Signal::Weak };
            return Reading { solution: None, distortion_m: Vector3::zeros(), mirrored, signal };
        }
        let mut field = self.environment.field(&p_m);
        for passing in self.passing.iter().filter(|passing| (passing.from_s..passing.until_s).contains(&t_s))
        {
            field += passing.sphere.field(&p_m);
        }
        let mut signals = signal_matrix(&field, &pose.rotation);
        if let Some(hum) = self.hum.filter(|hum| (hum.from_s..hum.until_s).contains(&t_s)) {
            let phase = std::f64::consts::TAU * hum.frequency_hz * t_s + hum.phase_rad;
            let stray = pose.rotation.inverse() * (hum.amplitude * libm::sin(phase));
            signals += stray * nalgebra::RowVector3::repeat(1.0);
        }
        let limit = 2.0 / self.min_range_m.powi(3);
        let saturated = signals.iter().any(|s| s.abs() > limit) || r_m < self.min_range_m;
        let clip = |m: Matrix3<f64>| m.map(|s| s.clamp(-limit, limit));
        let distortion_m =
            solve(&clip(signals), &p_m).map_or_else(Vector3::zeros, |solution| solution.position_m - p_m);
        let solution = solve(&clip(signals + noise), hemisphere);
        let signal = match (saturated, solution) {
            (true, _) => Signal::Saturated,
            (false, Some(_)) => Signal::Good,
            (false, None) => Signal::Weak,
        };
        Reading { solution, distortion_m, mirrored, signal }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Purpose;

    fn tracker() -> Tracker {
        Tracker {
            environment: Environment::default(),
            passing: Vec::new(),
            sigma_signal: 0.0,
            hum: None,
            max_range_m: 1.2,
            min_range_m: 0.15,
        }
    }

    fn measure(tracker: &Tracker, t_s: f64, p: [f64; 3]) -> Reading {
        let pose = Isometry3::translation(p[0], p[1], p[2]);
        tracker.measure(t_s, &pose, &Vector3::x(), &mut Random::new(1, Purpose::Signals(0)))
    }

    #[test]
    fn crossing_the_plane_mirrors_the_position_at_unchanged_orientation() {
        let near = measure(&tracker(), 0.0, [0.01, 0.5, 0.2]);
        let beyond = measure(&tracker(), 0.0, [-0.01, 0.5, 0.2]);
        assert!(!near.mirrored && beyond.mirrored);
        let (a, b) = (near.solution.unwrap(), beyond.solution.unwrap());
        assert!((a.position_m - Vector3::new(0.01, 0.5, 0.2)).norm() < 1e-9);
        assert!((b.position_m - Vector3::new(0.01, -0.5, -0.2)).norm() < 1e-9);
        assert!(a.orientation.angle_to(&b.orientation) < 1e-6);
        assert!(beyond.distortion_m.norm() < 1e-9, "being mirrored is no distortion");
    }

    #[test]
    fn passing_metal_bends_the_field_only_while_it_is_there() {
        let sphere = Sphere { center_m: Vector3::new(0.8, 0.4, 0.0), radius_m: 0.1, response: 2.0 };
        let passing = vec![Passing { sphere, from_s: 2.0, until_s: 3.0 }];
        let tracker = Tracker { passing, ..tracker() };
        let off_m =
            [1.9, 2.0, 2.9, 3.0].map(|t_s| measure(&tracker, t_s, [0.9, 0.0, 0.0]).distortion_m.norm());
        assert!(off_m[0] == off_m[3] && off_m[1] == off_m[2], "{off_m:?}");
        assert!(off_m[0] < 1e-9 && off_m[1] > 1e-3, "{off_m:?}");
    }

    #[test]
    fn too_far_is_weak_and_too_near_saturates() {
        assert_eq!(measure(&tracker(), 0.0, [1.21, 0.0, 0.0]).signal, Signal::Weak);
        assert_eq!(measure(&tracker(), 0.0, [1.19, 0.0, 0.0]).signal, Signal::Good);
        let near = measure(&tracker(), 0.0, [0.1, 0.0, 0.0]);
        assert_eq!(near.signal, Signal::Saturated);
        assert!(near.solution.unwrap().position_m.norm() > 0.12, "clipped signals look farther away");
        assert_eq!(measure(&tracker(), 0.0, [0.0; 3]).signal, Signal::Saturated);
        assert_eq!(measure(&tracker(), 0.0, [f64::NAN; 3]).signal, Signal::Weak);
    }

    #[test]
    fn hum_shows_at_the_aliased_frequency() {
        let mut tracker = tracker();
        tracker.hum = Some(Hum {
            frequency_hz: 50.0,
            amplitude: Vector3::new(0.0, 0.01, 0.0),
            phase_rad: 0.3,
            from_s: 0.0,
            until_s: f64::INFINITY,
        });
        // Sampled at 30 Hz, 50 Hz shows at |50 - 2 * 30| = 10 Hz: every third sample is alike.
        let x: Vec<f64> =
            (0..9).map(|i| measure(&tracker, f64::from(i) / 30.0, [0.8, 0.0, 0.0]).distortion_m.y).collect();
        assert!(x.iter().any(|v| v.abs() > 1e-3), "{x:?}");
        for i in 0..6 {
            assert!((x[i] - x[i + 3]).abs() < 1e-9, "{x:?}");
        }
        assert!((x[0] - x[1]).abs() > 1e-4, "{x:?}");
    }
}
