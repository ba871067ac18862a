//! Offline decoding: where in a recording an exercise's repetitions are.
//!
//! What comes in: observations and a movement in one or several sizes. What goes out: repetitions, frame by frame with their states. The
//! decoder is the live one, without a bound on its delay.

use super::exercise_topology::{ExerciseTopology, PathState};
use super::hmm::{LogRatio, Movement};
use super::material::Material;
use super::viterbi::ShortTimeViterbi;

/// More frames than these in one of the first or last states are waiting: five times as long as at the taught pace.
const WAITING: u64 = 10;
/// The first and the last states are one part in so many.
const ENDS: usize = 5;

/// Whether a state is one of the first of a movement.
pub(super) fn is_first(state: usize, states: usize) -> bool {
    ENDS * (state + 1) <= states
}

/// Whether a state is one of the last of a movement.
pub(super) fn is_last(state: usize, states: usize) -> bool {
    ENDS * (states - state) <= states
}

/// Whether a path that is for `dwell` frames in a state waits for the movement to begin.
pub(super) fn waits_before(state: usize, states: usize, dwell: u64) -> bool {
    dwell > WAITING && is_first(state, states)
}

/// Whether a path that is for `dwell` frames in a state waits after the movement.
pub(super) fn waits_after(state: usize, states: usize, dwell: u64) -> bool {
    dwell > WAITING && is_last(state, states)
}

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

/// The part of a path in which the movement happens: a path may wait in the first and in the last states, which
/// look like rest. At most two frames of waiting are kept on either side.
pub(super) fn trim(path: impl Iterator<Item = usize>, states: usize) -> std::ops::Range<usize> {
    let (mut from, mut to, mut length) = (0, None, 0);
    let (mut state, mut entered) = (usize::MAX, 0);
    for (frame, next) in path.enumerate() {
        if next != state {
            (state, entered) = (next, frame);
        }
        length = frame + 1;
        let dwell = (length - entered) as u64;
        if state == 0 || waits_before(state, states, dwell) {
            from = length.saturating_sub(2).max(from);
        }
        if to.is_none() && (state + 1 >= states || waits_after(state, states, dwell)) {
            to = Some(entered + 2);
        }
    }
    let to = to.unwrap_or(length).min(length);
    from.min(to)..to
}

/// All repetitions, of any of the sizes of a movement, on the best path through a recording with `width` values per
/// frame.
pub(super) fn repetitions(observations: &[f64], width: usize, sizes: &[LogRatio]) -> Vec<Repetition> {
    let states = sizes.first().map_or(0, LogRatio::states);
    let exercise_topology = ExerciseTopology::new(std::iter::once((states, sizes.len())));
    let mut viterbi = ShortTimeViterbi::new(exercise_topology.topology(), None);
    let mut path = Vec::with_capacity(observations.len() / width);
    let mut log_density = vec![0.0; exercise_topology.states()];
    let mut note = |_: u64, state: usize| path.push(state);
    for observation in observations.chunks_exact(width) {
        for (size, ratio) in sizes.iter().enumerate() {
            ratio.write(observation, &mut log_density[exercise_topology.range(0, size)]);
        }
        viterbi.push(&log_density, &mut note);
    }
    viterbi.finish(&mut note);
    let mut found: Vec<Repetition> = Vec::new();
    let mut open = false;
    for (frame, state) in path.iter().enumerate() {
        let before = if frame > 0 { path[frame - 1] } else { 0 };
        let PathState::Within { chain: size, state: within, .. } = exercise_topology.place(*state) else {
            open = false;
            continue;
        };
        if !open || exercise_topology.is_boundary(before, *state) {
            found.push(Repetition { path: Vec::new(), size });
            open = true;
        }
        if let Some(repetition) = found.last_mut() {
            repetition.path.push((frame, within));
        }
    }
    let last = path.last().map(|state| exercise_topology.place(*state));
    if let Some(PathState::Within { state, .. }) = last
        && open
        && state + 2 < states
    {
        found.pop(); // the recording ends within it
    }
    found
}

/// The same with each channel decoded by itself, as published: repetitions of one channel that half of all channels see, of the
/// channel that has most of them.
pub(super) fn repetitions_per_channel(material: &Material, movement: &Movement) -> Vec<Repetition> {
    let width = material.width();
    let states = movement.states.mean.first().map_or(0, Vec::len);
    let by_channel: Vec<Vec<Repetition>> = (0..width)
        .map(|channel| {
            let rows = material.observations.chunks_exact(2 * width);
            let observations: Vec<f64> = rows.flat_map(|row| [row[channel], row[channel + width]]).collect();
            let name = std::slice::from_ref(&material.channels[channel]);
            repetitions(&observations, 2, &[LogRatio::new(&movement.of_channel(channel), name)])
        })
        .collect();
    let is_seen = |repetition: &Repetition| {
        let range = repetition.range(states);
        let is_same = |other: &Repetition| {
            let other = other.range(states);
            let both = range.end.min(other.end).saturating_sub(range.start.max(other.start));
            2 * both > range.len().max(other.len())
        };
        2 * by_channel.iter().filter(|found| found.iter().any(is_same)).count() >= width
    };
    let seen = by_channel.iter().map(|found| found.iter().filter(|one| is_seen(one)).cloned().collect());
    // Of equal ones the first.
    seen.reduce(|best: Vec<_>, next| if next.len() > best.len() { next } else { best }).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A path through ten states that stays so long in each.
    fn path(dwells: [usize; 10]) -> Vec<usize> {
        dwells.into_iter().enumerate().flat_map(|(state, dwell)| std::iter::repeat_n(state, dwell)).collect()
    }

    #[test]
    fn waiting_in_the_first_and_the_last_states_is_cut_to_two_frames() {
        let cut = |dwells| trim(path(dwells).into_iter(), 10);
        assert_eq!(cut([2; 10]), 0..20);
        assert_eq!(cut([30, 2, 2, 2, 2, 2, 2, 2, 2, 30]), 28..48);
        // Noise may let it wait in the second or the last but one just as well.
        assert_eq!(cut([1, 40, 2, 2, 2, 2, 2, 2, 40, 1]), 39..55);
        // Slow on the way is no waiting.
        assert_eq!(cut([2, 2, 40, 2, 2, 2, 2, 2, 2, 2]), 0..58);
        assert_eq!(cut([30, 0, 0, 0, 0, 0, 0, 0, 0, 0]), 28..30);
    }
}
