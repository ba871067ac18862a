//! How a stage's clock stands to the hub's, from questions and answers over a network whose delays nobody knows.
//!
//! In: when a question left, what the stage's clock said, when the answer came. Out: an offset and how wrong it may be at most. Never:
//! a clock of its own.
//!
//! The reading was taken between leaving and coming, so hub time minus stage time lies in `[left - t, came - t]`, however
//! the round trip was shared between its two ways. Every such interval holds still later, widened by what two clocks can drift apart. The offset is in all of them:
//! quick round trips make it narrow, slow ones do no harm.

use std::collections::VecDeque;

/// How fast two clocks may drift apart: 50 ppm each.
const DRIFT: f64 = 1e-4;
/// Intervals that are remembered.
const REMEMBERED: usize = 128;
/// Readings after which few tell more.
const SETTLED: usize = 16;

/// See the module. All times in ns.
#[derive(Debug, Default)]
pub(super) struct Relation {
    intervals: VecDeque<Interval>,
}

#[derive(Clone, Copy, Debug)]
struct Interval {
    /// Hub time at which it was measured.
    at: i64,
    low: i64,
    high: i64,
}

/// An offset and its bound.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Related {
    /// Hub time minus stage time.
    pub(super) offset: i64,
    /// The offset is wrong by no more than this.
    pub(super) uncertainty: i64,
    /// Shortest round trip that is remembered.
    pub(super) round_trip: i64,
}

impl Relation {
    /// Takes a reading of the stage's clock that was asked for at `left` and was here at `came`.
    pub(super) fn push(&mut self, left: i64, reading: i64, came: i64) {
        if came < left {
            return;
        }
        let new = Interval { at: came, low: left - reading, high: came - reading };
        if self.intervals.len() == REMEMBERED {
            self.intervals.pop_front();
        }
        self.intervals.push_back(new);
        if self.at(came).is_none() {
            // A clock was set or a computer slept: what was known before is worth nothing.
            self.intervals.clear();
            self.intervals.push_back(new);
        }
    }

    /// Whether further readings need not be taken in a hurry.
    pub(super) fn is_settled(&self) -> bool {
        self.intervals.len() >= SETTLED
    }

    /// What is known at hub time `now`; `None` before the first reading.
    pub(super) fn at(&self, now: i64) -> Option<Related> {
        let drift = |interval: &Interval| ((now - interval.at).max(0) as f64 * DRIFT) as i64;
        let low = self.intervals.iter().map(|interval| interval.low - drift(interval)).max()?;
        let high = self.intervals.iter().map(|interval| interval.high + drift(interval)).min()?;
        let round_trip = self.intervals.iter().map(|interval| interval.high - interval.low).min()?;
        let uncertainty = (high - low + 1) / 2;
        (low <= high).then_some(Related { offset: low + (high - low) / 2, uncertainty, round_trip })
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const MS: i64 = 1_000_000;

    /// A stage's clock that runs `ppm` fast, read over a network with delays of 1 ms and up, more on the way there.
    fn simulated(ppm: f64, seed: u64, mut look: impl FnMut(i64, Option<Related>)) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut relation = Relation::default();
        let stage_at = |hub: i64| hub + (hub as f64 * ppm * 1e-6) as i64 - 3_600_000 * MS;
        for second in 0..600 {
            let left = second * 1000 * MS;
            let mut way = |usual_ms: f64| ((usual_ms + 20.0 * random.random::<f64>().powi(4)) * 1e6) as i64;
            let read = left + way(3.0);
            let came = read + way(1.0);
            relation.push(left, stage_at(read), came);
            let truth = came - stage_at(came);
            look(truth, relation.at(came));
        }
    }

    #[test]
    fn the_truth_is_always_within_the_uncertainty_and_that_is_small() {
        for (seed, ppm) in [(1, 0.0), (2, 45.0), (3, -95.0)] {
            let (mut worst, mut last) = (0, 0);
            simulated(ppm, seed, |truth, related| {
                let related = related.unwrap();
                assert!((related.offset - truth).abs() <= related.uncertainty, "{truth} {related:?}");
                worst = worst.max(related.uncertainty);
                last = related.uncertainty;
            });
            assert!(
                worst < 25 * MS && last < 3 * MS,
                "half of the quickest round trip and little more: {worst} {last}"
            );
        }
    }

    #[test]
    fn a_clock_that_was_set_is_followed_at_once() {
        let mut relation = Relation::default();
        relation.push(0, 50 * MS, 4 * MS);
        relation.push(1000 * MS, 9050 * MS, 1004 * MS);
        let related = relation.at(1004 * MS).unwrap();
        assert_eq!(related, Related { offset: -8048 * MS, uncertainty: 2 * MS, round_trip: 4 * MS });
        assert!(
            relation.at(11_004 * MS).unwrap().uncertainty > 2 * MS,
            "and nobody knows what it does later"
        );
        relation.push(5, 1, 4);
        assert_eq!(relation.at(1004 * MS), Some(related), "an answer before its question is none");
    }
}
