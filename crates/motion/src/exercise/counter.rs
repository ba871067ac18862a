//! Counting: samples in, repetitions out, live.
//!
//! What comes in: taught exercises and samples of a stream. What goes out: events. What it never does: count before the
//! movement began, count one repetition twice, or take back a count: what is not certain is provisional.
//!
//! Sample -> frame -> `counting`. Nothing is allocated per sample once it runs.

use posed_state::Plain;

use super::channels::Binding;
use super::cost::CountingCost;
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
    /// Counting them would take more memory or time than a stage has for it ([`CountingCost::LIMIT`]).
    #[error(
        "counting {} takes {states} states, {mebibytes} MiB and {millions} million comparisons a second, where {} states, {} MiB and \
         {:.0} million are the most: select fewer exercises, or teach shorter ones",
        .names.join(", "), CountingCost::LIMIT.states, CountingCost::LIMIT.bytes >> 20,
        1e-6 * CountingCost::LIMIT.evaluations_per_s
    )]
    TooCostly {
        /// Names of the exercises.
        names: Vec<String>,
        /// States of their joint model.
        states: usize,
        /// Memory, MiB.
        mebibytes: u64,
        /// Gaussians evaluated per second, in millions.
        millions: u64,
    },
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
    cost: CountingCost,
}

impl Counter {
    /// Counts `exercises` in a stream with these columns, all at once: they compete for every frame.
    ///
    /// # Errors
    /// As [`Self::check`]; no memory was taken then.
    pub fn new(exercises: Vec<Exercise>, columns: &[String]) -> Result<Self, CounterError> {
        let cost = Self::check(&exercises, columns)?;
        let mut all: Vec<String> = Vec::new();
        for channel in exercises.iter().flat_map(|exercise| &exercise.channels) {
            if !all.contains(channel) {
                all.push(channel.clone());
            }
        }
        // Joints that keep still are looked at where they are there.
        for still in exercises.iter().flat_map(|exercise| &exercise.still) {
            let is_there = Binding::new(std::slice::from_ref(&still.channel), columns).is_ok();
            if is_there && !all.contains(&still.channel) {
                all.push(still.channel.clone());
            }
        }
        let rate_hz = exercises.first().map_or(0.0, |first| first.rate_hz);
        // Every channel was found above.
        let binding = Binding::new(&all, columns)
            .map_err(|channel| CounterError::NoChannel { exercise: String::new(), channel })?;
        let resampler = Resampler::new(rate_hz, all.len());
        Ok(Self { binding, resampler, counting: Counting::new(exercises, &all, rate_hz), cost })
    }

    /// Whether `exercises` can be counted at once in a stream with these columns, and what it would cost.
    ///
    /// # Errors
    /// There is no exercise, a channel is missing, the exercises were taught at different frame rates, or they cost more than
    /// [`CountingCost::LIMIT`].
    pub fn check(exercises: &[Exercise], columns: &[String]) -> Result<CountingCost, CounterError> {
        let first = exercises.first().ok_or(CounterError::None)?;
        for exercise in exercises {
            if exercise.rate_hz != first.rate_hz {
                return Err(CounterError::Rates(first.name.clone(), exercise.name.clone()));
            }
            Binding::new(&exercise.channels, columns)
                .map_err(|channel| CounterError::NoChannel { exercise: exercise.name.clone(), channel })?;
        }
        let cost = CountingCost::of(exercises);
        if cost.within(&CountingCost::LIMIT) {
            return Ok(cost);
        }
        Err(CounterError::TooCostly {
            names: exercises.iter().map(|exercise| exercise.name.clone()).collect(),
            states: cost.states,
            mebibytes: cost.bytes >> 20,
            millions: (1e-6 * cost.evaluations_per_s) as u64,
        })
    }

    /// Takes a row of the stream at `t_s` (s, not negative), in the order of the columns, `None` where there is no
    /// value; `each` hears what happened. Rows need no even spacing: a frame of the model takes their mean. A row that
    /// is older than the frame being filled is left out and counted by `late`.
    pub fn push(&mut self, t_s: f64, row: &[Option<f64>], each: &mut dyn FnMut(Event)) {
        let counting = &mut self.counting;
        self.resampler.push(t_s, self.binding.values(row), &mut |frame| counting.push(frame, t_s, each));
    }

    /// Ends the stream; `each` hears what is certain now, a repetition that ended with the stream too.
    pub fn finish(&mut self, each: &mut dyn FnMut(Event)) {
        let counting = &mut self.counting;
        self.resampler.finish(&mut |frame| {
            let t_s = counting.end_s(frame.index);
            counting.push(frame, t_s, each);
        });
        counting.finish(each);
    }

    /// What it costs to count these.
    pub fn cost(&self) -> CountingCost {
        self.cost
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
