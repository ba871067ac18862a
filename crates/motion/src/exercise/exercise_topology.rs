//! The states of several exercises and the background in one model, and what a path through it means.
//!
//! What comes in: the number of states of each exercise, and in how many manners (sizes, tempi) it is looked for: each is a chain of
//! states of its own. What goes out: the topology, and for pairs of states whether
//! a repetition begins or ends between them. State 0 is the background, which all exercises share: their
//! states are scored relative to their own background, so that exercises on different channels can compete.

use posed_state::Plain;

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
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct ExerciseTopology {
    /// First state of each chain, and the number of all states at the end.
    offsets: Vec<usize>,
    /// First chain of each exercise, and the number of all chains at the end.
    chains: Vec<usize>,
}

/// What a path is doing in a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PathState {
    Background,
    /// In the `state`-th state of an exercise, in its `chain`-th manner.
    Within {
        exercise: usize,
        chain: usize,
        state: usize,
    },
}

impl ExerciseTopology {
    /// Network of exercises with these numbers of states and of manners.
    pub(super) fn new(exercises: impl Iterator<Item = (usize, usize)>) -> Self {
        let (mut offsets, mut chains) = (vec![1], vec![0]);
        for (states, manners) in exercises {
            for _ in 0..manners {
                offsets.push(offsets[offsets.len() - 1] + states);
            }
            chains.push(offsets.len() - 1);
        }
        Self { offsets, chains }
    }

    /// Number of states, the background among them.
    pub(super) fn states(&self) -> usize {
        self.offsets[self.offsets.len() - 1]
    }

    /// States of an exercise in one of its manners.
    pub(super) fn range(&self, exercise: usize, chain: usize) -> std::ops::Range<usize> {
        let chain = self.chains[exercise] + chain;
        self.offsets[chain]..self.offsets[chain + 1]
    }

    /// Number of manners of an exercise.
    fn manners(&self, exercise: usize) -> usize {
        self.chains[exercise + 1] - self.chains[exercise]
    }

    /// The chain of a state that is not the background.
    fn chain(&self, state: usize) -> usize {
        self.offsets.partition_point(|offset| *offset <= state) - 1
    }

    pub(super) fn place(&self, state: usize) -> PathState {
        if state == 0 {
            return PathState::Background;
        }
        let chain = self.chain(state);
        let exercise = self.chains.partition_point(|first| *first <= chain) - 1;
        PathState::Within {
            exercise,
            chain: chain - self.chains[exercise],
            state: state - self.offsets[chain],
        }
    }

    /// Whether a repetition ends between two states that follow each other on a path.
    pub(super) fn is_boundary(&self, from: usize, to: usize) -> bool {
        // Within a chain a path never goes back: a lower state is the next repetition's, as is one of another chain.
        from != 0 && (to == 0 || to < from || self.chain(to) != self.chain(from))
    }

    /// The transitions; every path begins in the background.
    pub(super) fn topology(&self) -> Topology {
        let mut initial = vec![f64::NEG_INFINITY; self.states()];
        initial[0] = 0.0;
        let exercises = self.chains.len() - 1;
        let mut transitions = vec![(0, 0, if exercises > 0 { 1.0 - BEGIN } else { 1.0 })];
        for (exercise, chain) in
            (0..exercises).flat_map(|e| (0..self.manners(e)).map(move |chain| (e, chain)))
        {
            let manners = self.manners(exercise);
            let range = self.range(exercise, chain);
            let (first, last) = (range.start, range.end - 1);
            for (step, probability) in ENTRY.into_iter().enumerate() {
                transitions.push((0, first + step, BEGIN / (exercises * manners) as f64 * probability));
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
                    for next in 0..manners {
                        let first = self.range(exercise, next).start;
                        for (step, probability) in ENTRY.into_iter().enumerate() {
                            transitions.push((
                                state,
                                first + step,
                                leave * AGAIN / manners as f64 * probability,
                            ));
                        }
                    }
                }
            }
        }
        let logarithms: Vec<_> = transitions
            .into_iter()
            .map(|(from, to, probability)| (from, to, libm::log(probability)))
            .collect();
        Topology::new(initial, &logarithms)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_and_boundaries_are_distinguished() {
        let exercise_topology = ExerciseTopology::new([(6, 1), (8, 2)].into_iter());
        assert_eq!(exercise_topology.states(), 23);
        assert_eq!(exercise_topology.place(0), PathState::Background);
        assert_eq!(exercise_topology.place(6), PathState::Within { exercise: 0, chain: 0, state: 5 });
        assert_eq!(exercise_topology.place(7), PathState::Within { exercise: 1, chain: 0, state: 0 });
        assert_eq!(exercise_topology.place(22), PathState::Within { exercise: 1, chain: 1, state: 7 });
        // The next repetition may be of another manner.
        assert!(
            exercise_topology.is_boundary(14, 15)
                && exercise_topology.is_boundary(22, 7)
                && !exercise_topology.is_boundary(15, 16)
        );
        assert!(
            exercise_topology.is_boundary(6, 0)
                && exercise_topology.is_boundary(6, 1)
                && exercise_topology.is_boundary(14, 8)
        );
        assert!(
            !exercise_topology.is_boundary(0, 0)
                && !exercise_topology.is_boundary(0, 7)
                && !exercise_topology.is_boundary(3, 4)
        );
    }
}
