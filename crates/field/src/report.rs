//! What a calibration reports about itself: accepted or not and why, and the three figures.

use serde::{Deserialize, Serialize};

/// Held-out improvement, of the root of what the known noise does not explain, below which a map is not worth having.
const LEAST_IMPROVEMENT: f64 = 0.2;
/// An improvement that is no larger than this share of the whole loss, or than so many standard errors over the blocks, may be none.
const LEAST_SHARE: f64 = 0.02;
const LEAST_ERRORS: f64 = 2.0;

/// Why a calibration is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Code {
    /// The pole was not everywhere.
    Coverage,
    /// It was not held in all directions.
    Excitation,
    /// The map does not make held-out readings clearly better.
    Improvement,
    /// The stated spacing contradicts the anchors.
    Spacing,
}

/// A reason and what to do about it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reason {
    /// For programs.
    pub code: Code,
    /// For the operator: what is wrong and what to do, with numbers.
    pub text: String,
}

/// A candidate for the map, and how well it fits blocks that it was not fitted to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CandidateModel {
    /// Its parts in words, as `Model::describe` gives them.
    pub what: String,
    /// Number of its parameters, those of the poses of the pole not counted.
    pub parameters: usize,
    /// Loss per number on held-out blocks, in units of the noise; below 1 nothing but noise is left.
    pub score: f64,
    /// The same on blocks that were held out, m: the fairest figure that a recording gives about itself.
    pub heldout_m: f64,
}

/// The summary of a calibration: whether the map may be used, and its figures. A figure that is not known is NaN.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Whether the map may be used.
    pub accepted: bool,
    /// Why not; empty when accepted.
    pub reasons: Vec<Reason>,
    /// What the operator should know all the same.
    pub warnings: Vec<String>,
    /// Rms distance of corrected readings from their fitted pole (at joints: from their joint), m. It says how well the
    /// model fits, not how accurate the map is.
    pub residual_m: f64,
    /// The same on blocks that were held out, m.
    pub heldout_m: f64,
    /// The same without correction, m.
    pub raw_m: f64,
    /// What noise alone would leave, m; of a body, the typical gap at a joint, per axis.
    pub noise_m: f64,
    /// Rms distance of corrected readings on the anchors from the surveyed points, m; absent without three anchors.
    pub anchors_m: Option<f64>,
    /// Parts of the map in words, as `Model::describe` gives them.
    pub model: String,
    /// Readings used, those taken out as outliers not counted.
    pub readings: usize,
    /// Readings taken out as outliers; of a body, looks at joints beyond their range.
    pub rejected: usize,
    /// Share of the 20 cm cells inside the hull that the pole came near, 0 to 1.
    pub covered: f64,
    /// Candidates in the order in which they were tried.
    pub tried: Vec<CandidateModel>,
}

impl Report {
    /// Refuses a map that makes too little better: the loss of each held-out block with and without it, what noise that is known
    /// leaves of it in any case (0 where none is known), and of what they are.
    pub(super) fn judge_improvement(&mut self, with_map: &[f64], without: &[f64], noise: f64, what: &str) {
        let improvement = improvement(with_map, without, noise);
        if improvement < LEAST_IMPROVEMENT {
            let text = format!(
                "held-out {what} only {:.0} % better (less than {:.0} %): there is little to correct here",
                100.0 * improvement,
                100.0 * LEAST_IMPROVEMENT
            );
            self.reasons.push(Reason { code: Code::Improvement, text });
        }
    }

    /// Of a calibration of which nothing is known yet.
    pub(crate) fn unknown() -> Self {
        let unknown = f64::NAN;
        Self {
            residual_m: unknown,
            heldout_m: unknown,
            raw_m: unknown,
            noise_m: unknown,
            model: "identity".into(),
            ..Self::default()
        }
    }
}

/// What share of the error a map takes away that noise does not explain, 0 to 1; 0 where it may be none.
fn improvement(with_map: &[f64], without: &[f64], noise: f64) -> f64 {
    let blocks = with_map.len().min(without.len()) as f64;
    let mean = |losses: &[f64]| losses.iter().sum::<f64>() / losses.len() as f64;
    let (with, raw) = (mean(with_map), mean(without));
    let gains = || without.iter().zip(with_map).map(|(raw, with)| raw - with);
    let gain = gains().sum::<f64>() / blocks;
    let variance = gains().map(|one| (one - gain).powi(2)).sum::<f64>() / (blocks - 1.0);
    let certain = (LEAST_ERRORS * (variance / blocks).sqrt()).max(LEAST_SHARE * raw);
    // No more noise than is left with the map.
    let noise = noise.min(with);
    if gain > certain { 1.0 - ((with - noise) / (raw - noise)).sqrt() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_hides_no_gain_and_makes_none() {
        let blocks = |mean: f64| [-0.02, 0.01, 0.0, 0.02, -0.01].map(|off| mean + off);
        // Without noise, the root of the loss.
        assert!((improvement(&blocks(0.64), &blocks(1.0), 0.0) - 0.2).abs() < 1e-9);
        // 0.13 above the noise, of which all is gone; 0.09, of which 0.04 are left.
        assert_eq!(improvement(&blocks(0.99), &blocks(1.13), 1.0), 1.0);
        assert!((improvement(&blocks(1.04), &blocks(1.09), 1.0) - 1.0 / 3.0).abs() < 1e-9);
        // A little of nearly nothing is nothing.
        assert_eq!(improvement(&blocks(1.0), &blocks(1.01), 1.0), 0.0);
        // Nor what some blocks have and others have not.
        assert_eq!(improvement(&[1.0; 4], &[0.9, 1.3, 0.95, 1.25], 1.0), 0.0);
        assert_eq!(improvement(&[], &[], 1.0), 0.0);
    }
}
