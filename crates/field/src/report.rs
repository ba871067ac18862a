//! What a calibration reports about itself: accepted or not and why, and the three figures.

use serde::{Deserialize, Serialize};

/// Held-out improvement (of the root of the loss) below which a map is not worth having.
const LEAST_IMPROVEMENT: f64 = 0.2;

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
    /// Readings taken out as outliers.
    pub rejected: usize,
    /// Share of the 20 cm cells inside the hull that the pole came near, 0 to 1.
    pub covered: f64,
    /// Candidates in the order in which they were tried.
    pub tried: Vec<CandidateModel>,
}

impl Report {
    /// Refuses a map that makes too little better: mean square errors with and without it, and of what they are.
    pub(super) fn judge_improvement(&mut self, with_map: f64, without: f64, what: &str) {
        let improvement = 1.0 - (with_map / without).sqrt();
        if improvement.is_nan() || improvement < LEAST_IMPROVEMENT {
            let text = format!(
                "held-out {what} only {:.0} % better (less than {:.0} %): there is little to correct here",
                100.0 * improvement.max(0.0),
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
