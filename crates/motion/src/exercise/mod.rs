//! Exercises: taught from a few repetitions, counted live, with a word on what was off.
//!
//! What comes in: streams of named channels (joint angles, a watch's raw signals, poses) and taught exercises. What
//! goes out: exercises from [`teach()`]; from a [`Counter`] events: a repetition started, is provisional, was
//! counted, rejected or withdrawn, with [`Feedback`]. What it never does: count before the movement began, take a count
//! back, or learn from a demonstration in which it does not see what was announced.
//!
//! ```text
//! samples -> channels -> frames (25 Hz) + velocities -> log ratio per state (hmm) -> short-time Viterbi
//!         -> path -> measures, gate (judge) -> Event (counter) -> Feedback
//! teach:  material -> periods (psd) -> motifs (DTW) -> hypotheses refined by decoding (align) -> Exercise
//! ```
//! Weber et al. 2011, section III; Bloit & Rodet 2008. `docs/exercise.md` has the figures.

mod align;
mod channels;
mod choice;
mod cost;
mod counter;
mod counting;
mod event;
#[expect(
    clippy::module_inception,
    reason = "the file is about the taught exercise, the folder about exercises"
)]
mod exercise;
mod exercise_topology;
mod feedback;
mod frames;
mod frozen;
mod hint;
mod hmm;
mod hypothesis;
mod joint;
mod judge;
mod kinds;
mod material;
mod motif;
mod passage;
mod posture;
mod psd;
mod ranges;
mod remark;
mod report;
mod rest;
mod score;
mod smaller;
mod still;
mod teach;
#[cfg(test)]
mod tests;
mod turns;
mod viterbi;
mod words;

pub use channels::{all_channels, columns_of};
pub use choice::TriedChannels;
pub use cost::CountingCost;
pub use counter::{Counter, CounterError};
pub use event::{Event, EventKind};
pub use exercise::{Durations, Exercise, ExerciseError, Gate};
pub use feedback::Feedback;
pub use hint::Hint;
pub use hmm::{Gaussians, Movement};
pub use joint::{Joint, Side};
pub use judge::{Measures, Reason};
pub use kinds::has_unit;
pub use material::Stream;
pub use ranges::{RepeatingRange, repeating_ranges};
pub use remark::{DeviationKind, MovementPhase, Remark};
pub use report::{Report, TaughtRepetition};
pub use rest::rests;
pub use score::Score;
pub use still::Still;
pub use teach::{AsPublished, Lesson, Options, Refusal, teach};
pub use turns::Turn;
pub use viterbi::{ShortTimeViterbi, Topology};
pub use words::{Language, joint_name, sentence};
