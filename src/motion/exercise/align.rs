//! Offline decoding: where in a recording an exercise's repetitions are.
//!
//! What comes in: observations and a movement in one or several sizes. What goes out: repetitions, frame by frame with their states. The
//! decoder is the live one, without a bound on its delay.

use super::hmm::LogRatio;
use super::network::{Network, Place};
use super::viterbi::ShortTimeViterbi;

/// One repetition on the path.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Repetition {
    /// Frames and states, every frame from the first to the last.
    pub(super) path: Vec<(usize, usize)>,
    /// In which of the sizes it was found.
    pub(super) size: usize,
}

impl Repetition {
    /// First frame, and the one after the last; see [`trim`].
    pub(super) fn range(&self, states: usize) -> std::ops::Range<usize> {
        let first = self.path.first().map_or(0, |(frame, _)| *frame);
        let trimmed = trim(self.path.iter().map(|(_, state)| *state), states);
        first + trimmed.start..first + trimmed.end
    }

    /// The frames of that range, with their states.
    pub(super) fn moving(&self, states: usize) -> impl Iterator<Item = &(usize, usize)> + Clone {
        let range = self.range(states);
        self.path.iter().filter(move |(frame, _)| range.contains(frame))
    }
}

/// The part of a path in which the movement happens: a path may wait in the first and in the last state, which
/// look like rest. At most two frames in the first state and two in the last are kept.
pub(super) fn trim(
    path: impl ExactSizeIterator<Item = usize> + Clone,
    states: usize,
) -> std::ops::Range<usize> {
    let length = path.len();
    let waiting = path.clone().take_while(|state| *state == 0).count();
    let moving = path.take_while(|state| *state + 1 < states).count();
    waiting.saturating_sub(2).min(moving)..(moving + 2).min(length)
}

/// All repetitions, of any of the sizes of a movement, on the best path through a recording with `width` values per
/// frame.
pub(super) fn repetitions(observations: &[f64], width: usize, sizes: &[LogRatio]) -> Vec<Repetition> {
    let states = sizes.first().map_or(0, LogRatio::states);
    let network = Network::new(std::iter::once((states, sizes.len())));
    let mut viterbi = ShortTimeViterbi::new(network.topology(), None);
    let mut path = Vec::with_capacity(observations.len() / width);
    let mut log_density = vec![0.0; network.states()];
    let mut note = |_: u64, state: usize| path.push(state);
    for observation in observations.chunks_exact(width) {
        for (size, ratio) in sizes.iter().enumerate() {
            ratio.write(observation, &mut log_density[network.range(0, size)]);
        }
        viterbi.push(&log_density, &mut note);
    }
    viterbi.finish(&mut note);
    let mut found: Vec<Repetition> = Vec::new();
    let mut open = false;
    for (frame, state) in path.iter().enumerate() {
        let before = if frame > 0 { path[frame - 1] } else { 0 };
        let Place::Within { size, state: within, .. } = network.place(*state) else {
            open = false;
            continue;
        };
        if !open || network.is_boundary(before, *state) {
            found.push(Repetition { path: Vec::new(), size });
            open = true;
        }
        if let Some(repetition) = found.last_mut() {
            repetition.path.push((frame, within));
        }
    }
    let last = path.last().map(|state| network.place(*state));
    if let Some(Place::Within { state, .. }) = last
        && open
        && state + 2 < states
    {
        found.pop(); // the recording ends within it
    }
    found
}
