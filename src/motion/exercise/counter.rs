//! Counting: samples in, repetitions out, live.
//!
//! What comes in: taught exercises and samples of a stream. What goes out: events. What it never does: count before the
//! movement began, count one repetition twice, or take back a count: what is not certain is provisional.
//!
//! Sample -> frame -> `counting`. Nothing is allocated per sample once it runs.

use serde::{Deserialize, Serialize};

use super::channels::Binding;
use super::counting::Counting;
use super::exercise::Exercise;
use super::feedback::{Feedback, Remark};
use super::frames::Resampler;
use super::hint::Hint;
use super::judge::{Measures, Reason};

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EventKind {
    /// A repetition has begun.
    Started,
    /// It seems to be complete; `Counted`, `Rejected` or `Withdrawn` follows.
    Provisional,
    /// It is complete and counts.
    Counted,
    /// It is complete and does not count.
    Rejected,
    /// What was provisional was none.
    Withdrawn,
}

impl EventKind {
    /// The word in files and messages.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Started => "started",
            Self::Provisional => "provisional",
            Self::Counted => "counted",
            Self::Rejected => "rejected",
            Self::Withdrawn => "withdrawn",
        }
    }
}

/// Something happened with an exercise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// End of the repetition, s; its beginning where it has only begun.
    pub t_s: f64,
    /// Beginning of the repetition, s.
    pub t_start_s: f64,
    /// Time of the sample with which it was decided, s.
    pub t_decided_s: f64,
    /// Index of the exercise.
    pub exercise: usize,
    /// What happened.
    pub kind: EventKind,
    /// Repetitions of this exercise counted so far, with this one; it only rises.
    pub count: u64,
    /// Why it was rejected.
    pub reason: Option<Reason>,
    /// Measures of a complete repetition.
    pub measures: Option<Measures>,
    /// What deviated most, of a counted or rejected repetition.
    pub feedback: Option<Feedback>,
    /// What to say of it; none where all was as taught.
    pub remark: Option<Remark>,
}

/// Why exercises cannot be counted on a stream.
#[derive(Debug, thiserror::Error)]
pub enum CounterError {
    /// There is nothing to count.
    #[error("no exercise to count")]
    None,
    /// The stream lacks a channel.
    #[error("exercise `{exercise}` needs the channel `{channel}`, which this stream has not")]
    NoChannel {
        /// Name of the exercise.
        exercise: String,
        /// Name of the channel.
        channel: String,
    },
    /// Two exercises cannot be counted at once.
    #[error("exercises `{0}` and `{1}` were taught at different frame rates and cannot be counted at once")]
    Rates(String, String),
}

/// Counts exercises. See the module.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Counter {
    binding: Binding,
    resampler: Resampler,
    counting: Counting,
}

impl Counter {
    /// Counts `exercises` in a stream with these columns, all at once: they compete.
    ///
    /// # Errors
    /// A channel is missing, or the exercises cannot be counted at once.
    pub fn new(exercises: Vec<Exercise>, columns: &[String]) -> Result<Self, CounterError> {
        let Some(first) = exercises.first() else { return Err(CounterError::None) };
        let rate_hz = first.rate_hz;
        let mut all: Vec<String> = Vec::new();
        for exercise in &exercises {
            if exercise.rate_hz != rate_hz {
                return Err(CounterError::Rates(first.name.clone(), exercise.name.clone()));
            }
            Binding::new(&exercise.channels, columns)
                .map_err(|channel| CounterError::NoChannel { exercise: exercise.name.clone(), channel })?;
            for channel in &exercise.channels {
                if !all.contains(channel) {
                    all.push(channel.clone());
                }
            }
        }
        // Checked for each exercise above.
        let binding = Binding::new(&all, columns)
            .map_err(|channel| CounterError::NoChannel { exercise: first.name.clone(), channel })?;
        let resampler = Resampler::new(rate_hz, all.len());
        Ok(Self { binding, resampler, counting: Counting::new(exercises, &all, rate_hz) })
    }

    /// Takes a row of the stream and says what happened.
    pub fn push(&mut self, t_s: f64, row: &[Option<f64>], each: &mut impl FnMut(Event)) {
        let counting = &mut self.counting;
        self.resampler.push(t_s, self.binding.values(row), &mut |frame| counting.push(frame, t_s, each));
    }

    /// Ends the stream and says what is certain now.
    pub fn finish(&mut self, each: &mut impl FnMut(Event)) {
        let counting = &mut self.counting;
        self.resampler.finish(&mut |frame| {
            let t_s = counting.end_s(frame.index);
            counting.push(frame, t_s, each);
        });
        counting.finish(each);
    }

    /// The exercises, in the order of their index.
    pub fn exercises(&self) -> impl Iterator<Item = &Exercise> {
        self.counting.exercises()
    }

    /// Repetitions of an exercise counted so far.
    pub fn count(&self, exercise: usize) -> u64 {
        self.counting.count(exercise)
    }

    /// Begins to count from 0.
    pub fn reset(&mut self) {
        self.counting.reset();
    }

    /// What deviates just now, where a repetition seems to be going on.
    pub fn hint(&self) -> Option<Hint> {
        self.counting.hint()
    }

    /// Samples left out because they came too late or had no time.
    pub fn late(&self) -> u64 {
        self.resampler.late()
    }
}
