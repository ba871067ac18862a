//! How noisy a signal really is, from the signal itself.

use nalgebra::{Matrix3, Vector3};
use posed_state::Plain;

use crate::faults::squared_distance;

/// Fourth differences of white noise of variance 1 have variance `1 + 16 + 36 + 16 + 1`.
const FOURTH_DIFFERENCE: f64 = 70.0;
/// Weight of one record.
const WEIGHT: f64 = 1.0 / 50.0;
/// A record that exceeds the level by more than this factor counts as just that.
const CLIP: f64 = 9.0;
/// Least level: words of a still sensor may not change at all.
const LEAST: f64 = 0.25;

/// Ratio of a signal's variance to the noise model's.
///
/// By fourth differences of equally spaced records: smooth motion vanishes from them (30 m/s^2 at 10 rad/s
/// and 100 Hz leaves 4 um), so that noise is distinguished from motion without the filter's help. Innovations would not
/// do: a filter that believes in much motion never sees them too large.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub(super) struct NoiseLevel {
    scale: f64,
    /// First, second and third difference at the latest record, and how many of them are there.
    differences: [Vector3<f64>; 3],
    records: u8,
}

impl NoiseLevel {
    pub(super) fn new() -> Self {
        Self { scale: 1.0, differences: [Vector3::zeros(); 3], records: 0 }
    }

    /// Factor on the noise model's variance.
    pub(super) fn scale(&self) -> f64 {
        self.scale
    }

    /// Forgets the latest records, after a gap.
    pub(super) fn interrupt(&mut self) {
        self.records = 0;
    }

    /// Takes the step from the record before to this one.
    pub(super) fn push(&mut self, step: &Vector3<f64>, model: &Matrix3<f64>, max: f64) {
        let mut difference = *step;
        for held in &mut self.differences {
            let next = difference - *held;
            *held = difference;
            difference = next;
        }
        self.records = (self.records + 1).min(4);
        if self.records == 4 && max > 1.0 {
            let level = squared_distance(model, &difference) / (3.0 * FOURTH_DIFFERENCE);
            self.scale += WEIGHT * (level.min(CLIP * self.scale) - self.scale);
            self.scale = self.scale.clamp(LEAST, max);
        }
    }
}
