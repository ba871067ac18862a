//! Which sensors of a recording are elsewhere, found from the whole of it.
//!
//! What comes in: a recording's positions on the clean side, the jumps in them, and the ranges of distances as far as they
//! are known. What goes out: per frame and sensor whether it is away from where it belongs. What it never does: run live.
//!
//! A sensor leaves with a jump and comes back with one, so jumps cut its track into pieces, and each jump would rather
//! change its state than not. A piece away costs its time, one at home the time in which the others do not allow it, but
//! never more than [`STRANGEST`]: a long piece is an unusual movement rather than a fault. The states of least cost are
//! found by the Viterbi algorithm, sensor by sensor, and then again with what is known of the others.

use super::memory::Point;
use super::pairs::Pairs;

/// Costs: a large jump that changes nothing; a change behind a gap; an end away; being away, at first and when it has lasted, and being
/// at home where the others do not allow it, a second; and the most that the latter can cost.
const IDLE_JUMP: f64 = 3.0;
const CHANGE_IN_GAP: f64 = 1.0;
const AWAY_AT_THE_END: f64 = 1.5;
const AWAY_PER_S: f64 = 0.5;
const LONG_S: f64 = 5.0;
const LONG_AWAY_PER_S: f64 = 3.0;
const STRANGE_PER_S: f64 = 6.0;
const STRANGEST: f64 = 9.0;
const ROUNDS: usize = 3;

/// What separates a position from the one before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Step {
    /// A motion.
    Steady,
    /// A jump, so many times as large as the smallest one.
    Jump(f64),
    /// The sensor was missing, or stuck.
    Gap,
}

/// A recording, frame by frame in the order of its sensors: `None` where one is missing or stuck.
pub(super) struct Recording<'a> {
    pub(super) sensors: usize,
    pub(super) frame_s: f64,
    pub(super) positions: &'a [Option<Point>],
    pub(super) steps: &'a [Step],
}

impl Recording<'_> {
    /// Which positions are away, by ranges that `learn` makes of those that are not.
    pub(super) fn away(&self, mut learn: impl FnMut(usize, &[bool]) -> Pairs) -> (Vec<bool>, Pairs) {
        let mut away = vec![false; self.positions.len()];
        let mut pairs = learn(0, &away);
        for round in 0..ROUNDS {
            let columns: Vec<Vec<bool>> =
                (0..self.sensors).map(|sensor| self.follow(sensor, &pairs, &away)).collect();
            for (at, away) in away.iter_mut().enumerate() {
                *away = columns[at % self.sensors][at / self.sensors];
            }
            pairs = learn(round + 1, &away);
        }
        (away, pairs)
    }

    /// The states of least cost of one sensor, frame by frame.
    fn follow(&self, sensor: usize, pairs: &Pairs, away: &[bool]) -> Vec<bool> {
        let frames = self.positions.len() / self.sensors;
        let mut pieces: Vec<Piece> = Vec::new();
        for k in 0..frames {
            let at = k * self.sensors + sensor;
            let Some(p) = self.positions[at] else { continue };
            let there = |other: usize| {
                let at = k * self.sensors + other;
                self.positions[at].filter(|_| !away[at])
            };
            let doubt = pairs.doubt(sensor, p, there) * self.frame_s;
            match pieces.last_mut() {
                Some(piece) if self.steps[at] == Step::Steady => piece.grow(k, doubt, self.frame_s),
                _ => pieces.push(Piece {
                    step: self.steps[at],
                    first: k,
                    last: k,
                    doubt_s: doubt,
                    time_s: self.frame_s,
                }),
            }
        }
        // A recording begins and ends at home, if in doubt.
        let mut costs = [0.0, IDLE_JUMP];
        let mut from = Vec::with_capacity(pieces.len());
        for piece in &pieces {
            let (stay, change) = match piece.step {
                // Noise and quick movements make small ones.
                Step::Jump(size) => ((size - 0.5).min(IDLE_JUMP), (0.5 * (IDLE_JUMP - size)).max(0.0)),
                Step::Steady | Step::Gap => (0.0, CHANGE_IN_GAP),
            };
            let [home, gone] = costs;
            from.push([home + stay > gone + change, gone + stay <= home + change]);
            costs = [
                f64::min(home + stay, gone + change) + f64::min(STRANGE_PER_S * piece.doubt_s, STRANGEST),
                f64::min(gone + stay, home + change)
                    + AWAY_PER_S * piece.time_s
                    + LONG_AWAY_PER_S * (piece.time_s - LONG_S).max(0.0),
            ];
        }
        let mut state = costs[1] + AWAY_AT_THE_END < costs[0];
        let mut states = vec![false; frames];
        for (piece, from) in pieces.iter().zip(from).rev() {
            states[piece.first..=piece.last].fill(state);
            state = from[usize::from(state)];
        }
        states
    }
}

/// A sensor's track between two jumps.
struct Piece {
    /// What is before it.
    step: Step,
    first: usize,
    last: usize,
    /// How long the others did not allow it, and how long it is there.
    doubt_s: f64,
    time_s: f64,
}

impl Piece {
    fn grow(&mut self, frame: usize, doubt_s: f64, time_s: f64) {
        self.last = frame;
        self.doubt_s += doubt_s;
        self.time_s += time_s;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME_S: f64 = 1.0 / 60.0;

    /// Three sensors at rest in a triangle; the first is moved by `by` where it is said to be.
    fn positions(frames: usize, by: impl Fn(usize) -> f64) -> Vec<Option<Point>> {
        let row = |k| [Some([by(k), 0.0, 0.0]), Some([0.0, 1.0, 0.0]), Some([1.0, 1.0, 0.0])];
        (0..frames).flat_map(row).collect()
    }

    /// Steady but for jumps of the first sensor at these frames, of these sizes.
    fn steps(frames: usize, jumps: &[(usize, f64)]) -> Vec<Step> {
        let mut steps = vec![Step::Steady; 3 * frames];
        jumps.iter().for_each(|(k, size)| steps[3 * k] = Step::Jump(*size));
        steps
    }

    fn away(positions: &[Option<Point>], steps: &[Step]) -> Vec<usize> {
        let frames = positions.len() / 3;
        let recording = Recording { sensors: 3, frame_s: FRAME_S, positions, steps };
        let learn = |_, away: &[bool]| {
            Pairs::learn(3, frames, 0.02, |k, sensor| {
                positions[3 * k + sensor].filter(|_| !away[3 * k + sensor])
            })
        };
        let (away, _) = recording.away(learn);
        assert!((0..frames).all(|k| !away[3 * k + 1] && !away[3 * k + 2]));
        (0..frames).filter(|k| away[3 * k]).collect()
    }

    #[test]
    fn a_sensor_is_away_between_two_jumps_even_where_distances_hardly_tell() {
        let moved = |k: usize| if (200..300).contains(&k) { 0.1 } else { 0.0 };
        let found = away(&positions(1000, moved), &steps(1000, &[(200, 4.0), (300, 4.0)]));
        assert_eq!(found, (200..300).collect::<Vec<_>>());
    }

    #[test]
    fn a_return_that_was_no_jump_is_identified_by_the_others() {
        // It drifts back over the last 40 frames.
        let moved = |k: usize| match k {
            500..560 => 0.8,
            560..600 => 0.02 * (600 - k) as f64,
            _ => 0.0,
        };
        let found = away(&positions(1000, moved), &steps(1000, &[(500, 9.0), (900, 1.1)]));
        assert!(found.len() < 10, "half a recording would be lost: {}", found.len());
    }

    #[test]
    fn one_small_jump_of_a_quick_movement_changes_nothing() {
        assert!(away(&positions(1000, |_| 0.0), &steps(1000, &[(500, 1.3)])).is_empty());
    }
}
