//! What it costs to count exercises, before any memory is taken for it.
//!
//! What comes in: exercises that are to be counted in one stream. What goes out: states, bytes and work. What it never does:
//! reserve anything. An exercise may come from a stranger, and every number of it is within its own range where the product of
//! all is not.

use posed_state::Plain;

use super::exercise::Exercise;

/// Least bound on the delay of the path, s; below, background wins before the movement has shown itself.
const LEAST_DELAY_S: f64 = 0.8;
/// Bound on the delay as a share of the longest exercise: half a repetition costs no exactness.
const DELAY_SHARE: f64 = 0.5;

/// What counting some exercises in one stream takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Plain)]
pub struct CountingCost {
    /// States of the joint model: those of every exercise in every manner, and the background.
    pub states: usize,
    /// Memory of the decoder, the models and their observations, bytes; right to a factor of two.
    pub bytes: u64,
    /// Gaussians evaluated per second of the stream.
    pub evaluations_per_s: f64,
}

impl CountingCost {
    /// Most that one counter may cost: ten times what 32 exercises on all channels of a body take, or one whose repetitions last
    /// three minutes.
    pub const LIMIT: Self = Self { states: 16_384, bytes: 32 << 20, evaluations_per_s: 1e8 };

    /// The cost of counting these at once; they have passed [`Exercise::check`].
    pub fn of(exercises: &[Exercise]) -> Self {
        let spans = Spans::of(exercises);
        let mut cost = Self { states: 1, ..Self::default() };
        for exercise in exercises {
            let states = exercise.states() * exercise.chains();
            let width = 2 * exercise.channels.len();
            cost.states += states;
            cost.bytes += 8 * (exercise.still.len() * spans.capacity_frames) as u64;
            // Mean and deviation of a state, for the movement and for its ratio to the background.
            cost.bytes += 8 * (width * spans.capacity_frames) as u64 + 32 * (width * states) as u64;
            cost.evaluations_per_s += (states * width) as f64 * exercise.rate_hz;
        }
        // Predecessor and children of every state in every frame that waits.
        cost.bytes += 4 * (spans.bound_frames + 2).next_power_of_two() as u64 * cost.states as u64;
        cost
    }

    /// Both at once.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            states: self.states + other.states,
            bytes: self.bytes + other.bytes,
            evaluations_per_s: self.evaluations_per_s + other.evaluations_per_s,
        }
    }

    /// Whether this is within `limit` in every respect.
    pub fn within(&self, limit: &Self) -> bool {
        self.states <= limit.states
            && self.bytes <= limit.bytes
            && self.evaluations_per_s <= limit.evaluations_per_s
    }
}

/// For how long counting looks back.
pub(super) struct Spans {
    /// Frames that may wait for the path to be certain.
    pub(super) bound_frames: usize,
    /// Frames that are kept, for a repetition that is judged; one that does not fit is too slow to count.
    pub(super) capacity_frames: usize,
}

impl Spans {
    /// For exercises of one rate.
    pub(super) fn of(exercises: &[Exercise]) -> Self {
        let most = |of: fn(&Exercise) -> f64, least: f64| exercises.iter().map(of).fold(least, f64::max);
        let rate_hz = most(|exercise| exercise.rate_hz, 0.0);
        let longest_s = most(|exercise| exercise.durations.longest_s, 0.0);
        let median_s = most(|exercise| exercise.durations.median_s, 0.0);
        let slowest = most(|exercise| exercise.gate.duration[1], 1.0);
        let bound_frames = (LEAST_DELAY_S.max(DELAY_SHARE * median_s) * rate_hz).ceil() as usize;
        let capacity_frames = (slowest * longest_s * rate_hz).ceil() as usize + 2 * bound_frames + 8;
        Self { bound_frames, capacity_frames }
    }
}
