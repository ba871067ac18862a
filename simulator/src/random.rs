//! Seeded randomness: one independent stream per purpose, so that adding a sensor or a fault never
//! changes the noise of another.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What a stream of random numbers is for.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Purpose {
    /// Noise on the signals of the n-th sensor of the stage.
    Signals(usize),
    /// Faults of the n-th device: times, bytes, bits.
    Faults(usize),
    /// Behaviour of the n-th device: phase of its cycle, garbage at a wrong baud rate, settling after a start.
    Device(usize),
    /// Mounting and errors of the n-th sensor that a person wears.
    Wearer(usize),
    /// How the strap of the n-th sensor that a person wears wanders.
    Strap(usize),
    /// How the skin below the n-th sensor that a person wears turns it.
    Skin(usize),
    /// A sequence of actions.
    Actions,
    /// A sequence of motion primitives.
    Primitives,
}

/// A seeded generator of uniform and normal numbers.
#[derive(Clone, Debug)]
pub(crate) struct Random {
    generator: ChaCha8Rng,
    /// The second number of the last pair of normal numbers.
    spare: Option<f64>,
}

impl Random {
    /// The stream of `purpose` under `seed`.
    pub(crate) fn new(seed: u64, purpose: Purpose) -> Self {
        let (kind, index) = match purpose {
            Purpose::Signals(n) => (1, n),
            Purpose::Faults(n) => (2, n),
            Purpose::Device(n) => (3, n),
            Purpose::Wearer(n) => (32, n),
            Purpose::Strap(n) => (35, n),
            Purpose::Skin(n) => (36, n),
            Purpose::Actions => (33, 0),
            Purpose::Primitives => (34, 0),
        };
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        generator.set_stream((kind << 32) | index as u64);
        Self { generator, spare: None }
    }

    /// Uniform in [0, 1).
    pub(crate) fn uniform(&mut self) -> f64 {
        self.generator.random()
    }

    /// Uniform in `low..high`.
    pub(crate) fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Uniform in `low..=high`.
    pub(crate) fn integer(&mut self, low: u64, high: u64) -> u64 {
        self.generator.random_range(low..=high)
    }

    /// Any byte.
    pub(crate) fn byte(&mut self) -> u8 {
        self.generator.random()
    }

    /// Normal with mean 0 and variance 1 (Box and Muller, 1958).
    pub(crate) fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        let radius = (-2.0 * libm::log(1.0 - self.uniform())).sqrt();
        let (sin, cos) = libm::sincos(std::f64::consts::TAU * self.uniform());
        self.spare = Some(radius * sin);
        radius * cos
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_numbers_have_mean_zero_and_variance_one() {
        let mut random = Random::new(1, Purpose::Signals(0));
        let numbers: Vec<f64> = (0..20_000).map(|_| random.normal()).collect();
        let mean = numbers.iter().sum::<f64>() / 2e4;
        let variance = numbers.iter().map(|x| x * x).sum::<f64>() / 2e4;
        assert!(mean.abs() < 0.03, "{mean}");
        assert!((variance - 1.0).abs() < 0.05, "{variance}");
    }

    #[test]
    fn streams_are_independent_of_each_other_and_repeat() {
        let first = |purpose| Random::new(5, purpose).uniform();
        assert_eq!(first(Purpose::Signals(3)), first(Purpose::Signals(3)));
        assert_ne!(first(Purpose::Signals(3)), first(Purpose::Signals(4)));
        assert_ne!(first(Purpose::Signals(3)), first(Purpose::Faults(3)));
    }
}
