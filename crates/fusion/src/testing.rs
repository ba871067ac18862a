//! What the tests of filters share: chance, and whether errors are as large as a filter reports.

use std::ops::Range;

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Seeded chance.
pub(super) struct Random(ChaCha8Rng);

impl Random {
    pub(super) fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub(super) fn uniform(&mut self) -> f64 {
        self.0.random()
    }

    pub(super) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * libm::log(1.0 - self.uniform())).sqrt();
        radius * libm::cos(std::f64::consts::TAU * self.uniform())
    }

    pub(super) fn vector(&mut self) -> Vector3<f64> {
        Vector3::new(self.normal(), self.normal(), self.normal())
    }
}

/// Share of the steps at which the normalised squared error, averaged over `runs`, lies within `bounds`; `run` has the errors
/// of one run, step by step. Steps of a run are not independent: few runs give a share that is chance.
pub(super) fn consistency(runs: u64, bounds: &Range<f64>, mut run: impl FnMut(Random) -> Vec<f64>) -> f64 {
    let mut sums: Vec<f64> = Vec::new();
    for number in 0..runs {
        let errors = run(Random::new(number));
        sums.resize(errors.len(), 0.0);
        sums.iter_mut().zip(&errors).for_each(|(sum, error)| *sum += error / runs as f64);
    }
    sums.iter().filter(|sum| bounds.contains(*sum)).count() as f64 / sums.len() as f64
}
