//! The states of several exercises and the background in one model, and what a path through it means.
//!
//! What comes in: the number of states of each exercise. What goes out: the topology, and for pairs of states whether
//! a repetition begins or ends between them. State 0 is the background, which all exercises share: their
//! states are scored relative to their own background, so that exercises on different channels can compete.

use serde::{Deserialize, Serialize};

use super::viterbi::Topology;

/// Probability per frame that a repetition begins.
const BEGIN: f64 = 0.02;
/// Staying in a state, going to the next, skipping one.
const STEPS: [f64; 3] = [0.5, 0.4, 0.1];
/// Share of repetitions that the next one follows at once.
const AGAIN: f64 = 0.5;
/// A repetition begins in the first or in the second state.
const ENTRY: [f64; 2] = [0.8, 0.2];

/// Where each exercise's states are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Network {
    /// First state of each exercise, and the number of all states at the end.
    offsets: Vec<usize>,
}

/// What a path is doing in a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    Background,
    /// In the `state`-th state of an exercise.
    Within {
        exercise: usize,
        state: usize,
    },
}

impl Network {
    /// Network of exercises with these numbers of states.
    pub(super) fn new(states: impl Iterator<Item = usize>) -> Self {
        let mut offsets = vec![1];
        for states in states {
            offsets.push(offsets[offsets.len() - 1] + states);
        }
        Self { offsets }
    }

    /// Number of states, the background among them.
    pub(super) fn states(&self) -> usize {
        self.offsets[self.offsets.len() - 1]
    }

    /// States of an exercise.
    pub(super) fn range(&self, exercise: usize) -> std::ops::Range<usize> {
        self.offsets[exercise]..self.offsets[exercise + 1]
    }

    pub(super) fn place(&self, state: usize) -> Place {
        if state == 0 {
            return Place::Background;
        }
        let exercise = self.offsets.partition_point(|offset| *offset <= state) - 1;
        Place::Within { exercise, state: state - self.offsets[exercise] }
    }

    /// Whether a repetition ends between two states that follow each other on a path.
    pub(super) fn is_boundary(&self, from: usize, to: usize) -> bool {
        // Within an exercise a path never goes back: a lower state is the next repetition's.
        from != 0 && (to == 0 || to < from)
    }

    /// The transitions; every path begins in the background.
    pub(super) fn topology(&self) -> Topology {
        let mut initial = vec![f64::NEG_INFINITY; self.states()];
        initial[0] = 0.0;
        let exercises = self.offsets.len() - 1;
        let mut transitions = vec![(0, 0, if exercises > 0 { 1.0 - BEGIN } else { 1.0 })];
        for exercise in 0..exercises {
            let range = self.range(exercise);
            let (first, last) = (range.start, range.end - 1);
            for (step, probability) in ENTRY.into_iter().enumerate() {
                transitions.push((0, first + step, BEGIN / exercises as f64 * probability));
            }
            for state in range {
                let mut leave = 0.0;
                for (step, probability) in STEPS.into_iter().enumerate() {
                    if state + step <= last {
                        transitions.push((state, state + step, probability));
                    } else {
                        leave += probability;
                    }
                }
                if leave > 0.0 {
                    transitions.push((state, 0, leave * (1.0 - AGAIN)));
                    for (step, probability) in ENTRY.into_iter().enumerate() {
                        transitions.push((state, first + step, leave * AGAIN * probability));
                    }
                }
            }
        }
        let logarithms: Vec<_> =
            transitions.into_iter().map(|(from, to, probability)| (from, to, probability.ln())).collect();
        Topology::new(initial, &logarithms)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_and_boundaries_are_told_apart() {
        let network = Network::new([6, 8].into_iter());
        assert_eq!(network.states(), 15);
        assert_eq!(network.place(0), Place::Background);
        assert_eq!(network.place(6), Place::Within { exercise: 0, state: 5 });
        assert_eq!(network.place(7), Place::Within { exercise: 1, state: 0 });
        assert!(network.is_boundary(6, 0) && network.is_boundary(6, 1) && network.is_boundary(14, 8));
        assert!(!network.is_boundary(0, 0) && !network.is_boundary(0, 7) && !network.is_boundary(3, 4));
    }
}
