//! Counting: samples in, repetitions out, live.
//!
//! What comes in: taught exercises and samples of a stream. What goes out: events. What it never does: count before the
//! movement began, count one repetition twice, or take back a count: what is not certain is provisional.
//!
//! Sample -> frame -> `counting`. Nothing is allocated per sample once it runs.

use posed_state::Plain;

use super::channels::Binding;
use super::counting::Counting;
use super::event::Event;
use super::exercise::Exercise;
use super::frames::Resampler;
use super::hint::Hint;

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

/// Counts repetitions of taught exercises in one stream, all exercises at once.
///
/// A count is final: it only rises. It never counts before the movement began. Method: `docs/methods/exercise.md`,
/// after Weber et al. 2011 (section III) and Bloit & Rodet 2008; miscounts and delay: `docs/exercise.md`.
#[derive(Clone, Debug, Plain)]
pub struct Counter {
    binding: Binding,
    resampler: Resampler,
    counting: Counting,
}

impl Counter {
    /// Counts `exercises` in a stream with these columns, all at once: they compete for every frame.
    ///
    /// # Errors
    /// There is no exercise, a channel is missing, or the exercises were taught at different frame rates.
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

    /// Takes a row of the stream at `t_s` (s, not negative), in the order of the columns, `None` where there is no
    /// value; `each` hears what happened. Rows need no even spacing: a frame of the model takes their mean. A row that
    /// is older than the frame being filled is left out and counted by `late`.
    pub fn push(&mut self, t_s: f64, row: &[Option<f64>], each: &mut impl FnMut(Event)) {
        let counting = &mut self.counting;
        self.resampler.push(t_s, self.binding.values(row), &mut |frame| counting.push(frame, t_s, each));
    }

    /// Ends the stream; `each` hears what is certain now, a repetition that ended with the stream too.
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

    /// Repetitions of the exercise of this index counted so far, or since `reset`.
    pub fn count(&self, exercise: usize) -> u64 {
        self.counting.count(exercise)
    }

    /// Begins to count from 0. A repetition that is going on is kept and counts when it ends.
    pub fn reset(&mut self) {
        self.counting.reset();
    }

    /// What deviates just now; `None` where no repetition seems to be going on. It is low-passed and rests on the path
    /// as it looks now; the feedback of a complete repetition is more exact.
    pub fn hint(&self) -> Option<Hint> {
        self.counting.hint()
    }

    /// Samples left out because they came too late or had no time.
    pub fn late(&self) -> u64 {
        self.resampler.late()
    }
}
