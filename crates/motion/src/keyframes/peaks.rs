//! Peaks of a statistic: said early as provisional, confirmed when nothing near exceeds them.

use posed_state::Plain;

use super::window::Window;

/// A statistic has turned when it is below this share of its latest peak.
const TURNED: f64 = 0.7;

/// One value of a statistic, and what the method makes of it.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Score {
    /// The statistic itself, in its own unit; not negative.
    pub value: f64,
    /// What an accepted value exceeds, in the unit of the value.
    pub threshold: f64,
    /// Whether the method takes a peak here for a change.
    pub accepted: bool,
    /// Whether the velocity changes at once, within a frame or two.
    pub corner: bool,
}

/// What became of a peak; `at` is the index of its value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Peak {
    Provisional { at: u64, score: Score },
    Confirmed { at: u64, score: Score },
    Withdrawn { at: u64, score: Score },
}

/// Finds the values that exceed all others within `reach`, of equal ones the first.
///
/// Merckel and Nishida (2010) want a value that strictly exceeds its neighbours, which loses a single jump: it
/// makes two equal maxima. At most one value at a time can still become a peak, so the state is one candidate.
#[derive(Clone, Debug, Plain)]
pub(super) struct Peaks {
    reach: usize,
    before: Window<f64>,
    count: u64,
    candidate: Option<Candidate>,
}

#[derive(Clone, Copy, Debug, Plain)]
struct Candidate {
    at: u64,
    score: Score,
    reported: bool,
}

impl Peaks {
    pub(super) fn new(reach: usize) -> Self {
        Self { reach: reach.max(1), before: Window::new(reach.max(1)), count: 0, candidate: None }
    }

    pub(super) fn reach(&self) -> usize {
        self.reach
    }

    /// Takes the next value.
    pub(super) fn push(&mut self, score: Score, event: &mut dyn FnMut(Peak)) {
        let at = self.count;
        self.count += 1;
        if let Some(candidate) = &mut self.candidate {
            if score.value > candidate.score.value {
                if candidate.reported {
                    event(Peak::Withdrawn { at: candidate.at, score: candidate.score });
                }
                self.candidate = None;
            } else if at - candidate.at >= self.reach as u64 {
                if candidate.score.accepted {
                    event(Peak::Confirmed { at: candidate.at, score: candidate.score });
                }
                self.candidate = None;
            } else if candidate.score.accepted
                && !candidate.reported
                && score.value < TURNED * candidate.score.value
            {
                candidate.reported = true;
                event(Peak::Provisional { at: candidate.at, score: candidate.score });
            }
        }
        // The very first value has no left neighbour and is no peak.
        let before = self.before.latest();
        if self.candidate.is_none() && !before.is_empty() && before.iter().all(|old| score.value > *old) {
            self.candidate = Some(Candidate { at, score, reported: false });
        }
        self.before.push(score.value);
    }

    /// Ends the stream: a peak whose right neighbours are not all there is believed if the statistic has turned.
    pub(super) fn finish(&mut self, event: &mut dyn FnMut(Peak)) {
        let Some(candidate) = self.candidate.take() else { return };
        if candidate.score.accepted && candidate.at + 1 < self.count {
            event(Peak::Confirmed { at: candidate.at, score: candidate.score });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(values: &[f64], reach: usize) -> Vec<Peak> {
        let mut events = Vec::new();
        let mut peaks = Peaks::new(reach);
        for value in values {
            let score = Score { value: *value, threshold: 0.0, accepted: true, corner: false };
            peaks.push(score, &mut |event| events.push(event));
        }
        peaks.finish(&mut |event| events.push(event));
        events
    }

    fn confirmed(values: &[f64], reach: usize) -> Vec<u64> {
        let confirmed = |event| match event {
            Peak::Confirmed { at, .. } => Some(at),
            _ => None,
        };
        run(values, reach).into_iter().filter_map(confirmed).collect()
    }

    #[test]
    fn the_first_of_a_plateau_is_the_peak() {
        assert_eq!(confirmed(&[0.0, 1.0, 3.0, 3.0, 1.0, 0.0, 0.0, 0.0], 3), [2]);
    }

    #[test]
    fn a_higher_value_within_reach_withdraws_what_was_said() {
        let events = run(&[0.0, 5.0, 1.0, 6.0, 1.0, 0.0, 0.0, 0.0], 3);
        assert!(matches!(
            events[..],
            [
                Peak::Provisional { at: 1, .. },
                Peak::Withdrawn { at: 1, .. },
                Peak::Provisional { at: 3, .. },
                Peak::Confirmed { at: 3, .. }
            ]
        ));
    }

    #[test]
    fn it_agrees_with_the_definition_on_any_series() {
        let mut state = 1u64;
        let values: Vec<f64> = (0..2000)
            .map(|_| {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                ((state >> 33) % 50) as f64
            })
            .collect();
        for reach in [1, 2, 7, 30] {
            let is_peak = |i: &u64| {
                let i = *i as usize;
                let (low, high) = (i.saturating_sub(reach), (i + reach).min(values.len() - 1));
                (low..i).all(|j| values[i] > values[j]) && (i + 1..=high).all(|j| values[i] >= values[j])
            };
            let expected: Vec<u64> = (1..values.len() as u64 - 1).filter(is_peak).collect();
            assert_eq!(confirmed(&values, reach), expected, "reach {reach}");
        }
    }
}
