//! Exercises.
mod align;
mod channels;
mod counter;
mod exercise;
mod feedback;
mod frames;
mod hmm;
mod judge;
mod material;
mod motif;
mod network;
mod psd;
mod teach;
mod viterbi;

pub use channels::{Binding, all_channels};
pub use counter::{Counter, CounterError, Event, EventKind};
pub use exercise::{Durations, Exercise, ExerciseError, Gate};
pub use feedback::Feedback;
pub use frames::{Differentiator, Frame, Resampler};
pub use judge::{Measures, Reason};
pub use material::Stream;
pub use teach::{Lesson, Options, Refusal, Report, Seen, teach};
pub use viterbi::{ShortTimeViterbi, Topology};
