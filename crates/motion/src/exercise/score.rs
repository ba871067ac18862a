//! A repetition in points, each part of which a therapist can explain to a patient.
//!
//! What comes in: how far joints went beside the lesson, how long it took, how smooth it was. What goes out: 0 to 100 for each part,
//! and their weighted mean. What it never does: decide whether a repetition counts, or what is said of it.

use serde::{Deserialize, Serialize};

use super::exercise::Durations;

/// Weight of each part where all are there.
const AMPLITUDE: f64 = 0.5;
const TEMPO: f64 = 0.2;
const SMOOTHNESS: f64 = 0.15;
const SYMMETRY: f64 = 0.15;
/// Points that twice the jerk takes.
const PER_DOUBLING: f64 = 15.0;

/// A repetition beside the lesson, in points from 0 to 100: 100 is as taught.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Score {
    /// The parts below, weighted 0.5, 0.2, 0.15 and 0.15; without symmetry the others in the same proportion.
    pub total: f64,
    /// How far the joints went, in percent of the lesson, each weighted by its way; farther is 100. Without joints the size of the
    /// whole movement.
    pub amplitude: f64,
    /// 100 between the shortest and the longest repetition of the lesson; beyond, their ratio in percent.
    pub tempo: f64,
    /// 100 as smooth as the lesson (log dimensionless jerk, Hogan & Sternad 2009); twice the jerk costs 15.
    pub smoothness: f64,
    /// The lesser of left and right in percent of the other, each beside its own way in the lesson; null where the exercise does not
    /// move the same joint on both sides.
    pub symmetry: Option<f64>,
}

impl Score {
    /// From the ratio of the ways to the lesson's, the duration, the log jerk above the lesson's, and the ratio of the two sides.
    pub(super) fn new(
        way: f64,
        duration_s: f64,
        durations: &Durations,
        jerk: f64,
        symmetry: Option<f64>,
    ) -> Self {
        let points = |share: f64| if share.is_finite() { (100.0 * share).clamp(0.0, 100.0) } else { 0.0 };
        let amplitude = points(way);
        let tempo = points((duration_s / durations.shortest_s).min(durations.longest_s / duration_s));
        let smoothness = points(1.0 - PER_DOUBLING / 100.0 * jerk.max(0.0) / std::f64::consts::LN_2);
        let symmetry = symmetry.map(points);
        let parts = [
            (AMPLITUDE, Some(amplitude)),
            (TEMPO, Some(tempo)),
            (SMOOTHNESS, Some(smoothness)),
            (SYMMETRY, symmetry),
        ];
        let there = parts.into_iter().filter_map(|(weight, part)| Some((weight, part?)));
        let (weights, sum) =
            there.fold((0.0, 0.0), |(w, sum), (weight, part)| (w + weight, sum + weight * part));
        Self { total: sum / weights, amplitude, tempo, smoothness, symmetry }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_taught_is_a_hundred_and_each_part_falls_by_itself() {
        let durations = Durations { shortest_s: 2.0, median_s: 2.5, longest_s: 3.0, interval_s: 0.0 };
        let score = |way, duration_s, jerk, symmetry| Score::new(way, duration_s, &durations, jerk, symmetry);
        assert_eq!(score(1.1, 2.9, -0.3, None).total, 100.0);
        let short = score(0.8, 6.0, std::f64::consts::LN_2, Some(0.5));
        assert_eq!((short.amplitude.round(), short.tempo.round()), (80.0, 50.0));
        assert_eq!((short.smoothness.round(), short.symmetry), (85.0, Some(50.0)));
        assert!((short.total - (40.0 + 10.0 + 12.75 + 7.5)).abs() < 1e-9);
        assert_eq!(score(f64::NAN, 2.5, 0.0, None).amplitude, 0.0);
    }
}
