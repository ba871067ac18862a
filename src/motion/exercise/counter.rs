//! Counting: samples in, repetitions out, live.
//!
//! What comes in: taught exercises and samples of a stream. What goes out: events. What it never does: count before the
//! movement began, count one repetition twice, or take back a count: what is not certain is provisional.
//!
//! Sample -> frame -> observation -> log ratio per state -> short-time Viterbi -> path -> gate -> event. Nothing is
//! allocated per sample once it runs.

use serde::{Deserialize, Serialize};

use super::align::trim;
use super::channels::Binding;
use super::exercise::Exercise;
use super::feedback::{Feedback, Remark, describe};
use super::frames::{Differentiator, Frame, Resampler};
use super::hint::{Follower, Hint};
use super::hmm::LogRatio;
use super::judge::{Measures, Reason, judge, measure};
use super::network::{Network, Place};
use super::viterbi::ShortTimeViterbi;

/// Least bound on the delay of the path, s; below, background wins before the movement has shown itself.
const LEAST_DELAY_S: f64 = 0.3;
/// Bound on the delay as a share of the longest exercise: half a repetition costs no exactness.
const DELAY_SHARE: f64 = 0.5;
/// Repetitions nearer than this share of the shortest taught one are one.
const REFRACTORY: f64 = 0.4;

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

/// One exercise with what it sees.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Watched {
    exercise: Exercise,
    ratio: LogRatio,
    /// Where its channels are among all.
    channels: Vec<usize>,
    values: Vec<f64>,
    differentiator: Differentiator,
    /// Ring of observations, a frame per slot.
    observations: Vec<f64>,
    count: u64,
    /// A repetition that was said to be provisional: its first and last frame.
    pending: Option<[u64; 2]>,
    /// Last frame of the repetition that was counted last.
    counted_until: Option<u64>,
    follower: Follower,
}

/// Counts exercises. See the module.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Counter {
    binding: Binding,
    resampler: Resampler,
    counting: Counting,
}

/// All behind the grid of frames.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Counting {
    rate_hz: f64,
    watched: Vec<Watched>,
    network: Network,
    viterbi: ShortTimeViterbi,
    log_density: Vec<f64>,
    /// Number on the grid of the decoder's first frame.
    origin: Option<u64>,
    /// Ring of states that are certain, a frame per slot, and number of frames in it ever.
    states: Vec<u16>,
    certain: u64,
    /// First frame of the repetition that the certain path is in.
    open: Option<u64>,
    /// Frames and states that a push made certain.
    emitted: Vec<(u64, u16)>,
    /// Path of the repetition that is judged.
    path: Vec<u16>,
    hint: Option<Hint>,
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
            let t_s = (frame.index + 1) as f64 / counting.rate_hz;
            counting.push(frame, t_s, each);
        });
        counting.finish(each);
    }

    /// The exercises, in the order of their index.
    pub fn exercises(&self) -> impl Iterator<Item = &Exercise> {
        self.counting.watched.iter().map(|watched| &watched.exercise)
    }

    /// Repetitions of an exercise counted so far.
    pub fn count(&self, exercise: usize) -> u64 {
        self.counting.watched.get(exercise).map_or(0, |watched| watched.count)
    }

    /// Begins to count from 0.
    pub fn reset(&mut self) {
        for watched in &mut self.counting.watched {
            watched.count = 0;
        }
    }

    /// What deviates just now, where a repetition seems to be going on.
    pub fn hint(&self) -> Option<Hint> {
        self.counting.hint
    }

    /// Samples left out because they came too late or had no time.
    pub fn late(&self) -> u64 {
        self.resampler.late()
    }
}

impl Counting {
    fn new(exercises: Vec<Exercise>, all: &[String], rate_hz: f64) -> Self {
        let network = Network::new(exercises.iter().map(Exercise::states));
        let longest_s = exercises.iter().map(|exercise| exercise.durations.longest_s).fold(0.0, f64::max);
        let median_s = exercises.iter().map(|exercise| exercise.durations.median_s).fold(0.0, f64::max);
        let bound = (LEAST_DELAY_S.max(DELAY_SHARE * median_s) * rate_hz).ceil() as usize;
        let slowest = exercises.iter().map(|exercise| exercise.gate.duration[1]).fold(1.0, f64::max);
        // A repetition that does not fit is too slow to count.
        let capacity = (slowest * longest_s * rate_hz).ceil() as usize + 2 * bound + 8;
        let watched: Vec<Watched> = exercises
            .into_iter()
            .map(|exercise| {
                let width = exercise.channels.len();
                let place = |channel: &String| all.iter().position(|other| other == channel).unwrap_or(0);
                Watched {
                    ratio: LogRatio::new(&exercise.movement),
                    channels: exercise.channels.iter().map(place).collect(),
                    values: vec![f64::NAN; width],
                    differentiator: Differentiator::new(rate_hz, width),
                    observations: vec![f64::NAN; 2 * width * capacity],
                    count: 0,
                    pending: None,
                    counted_until: None,
                    follower: Follower::new(rate_hz, width),
                    exercise,
                }
            })
            .collect();
        Self {
            rate_hz,
            viterbi: ShortTimeViterbi::new(network.topology(), Some(bound)),
            log_density: vec![0.0; network.states()],
            network,
            watched,
            origin: None,
            states: vec![0; capacity],
            certain: 0,
            open: None,
            emitted: Vec::with_capacity(2 * bound + 8),
            path: Vec::with_capacity(capacity),
            hint: None,
        }
    }

    /// Number of frames in the rings.
    fn capacity(&self) -> u64 {
        self.states.len() as u64
    }

    /// Time at the beginning of one of the decoder's frames, s.
    fn t_s(&self, frame: u64) -> f64 {
        (self.origin.unwrap_or(0) + frame) as f64 / self.rate_hz
    }

    fn push(&mut self, frame: Frame<'_>, t_s: f64, each: &mut impl FnMut(Event)) {
        if frame.after_gap {
            // What was going on is over, as far as anybody can tell.
            self.finish(each);
            self.origin = None;
            for watched in &mut self.watched {
                watched.differentiator.reset();
                watched.counted_until = None;
            }
        }
        let now = self.viterbi.frames();
        let origin = *self.origin.get_or_insert(frame.index.wrapping_sub(now));
        debug_assert_eq!(origin.wrapping_add(now), frame.index, "the grid has no holes but after a gap");
        let slot = (now % self.capacity()) as usize;
        for (index, watched) in self.watched.iter_mut().enumerate() {
            for (value, channel) in watched.values.iter_mut().zip(&watched.channels) {
                *value = frame.values[*channel];
            }
            let observation = watched.differentiator.push(&watched.values);
            let width = observation.len();
            watched.observations[slot * width..(slot + 1) * width].copy_from_slice(observation);
            watched.ratio.write(observation, &mut self.log_density[self.network.range(index)]);
        }
        let emitted = &mut self.emitted;
        self.viterbi.push(&self.log_density, &mut |frame, state| emitted.push((frame, state as u16)));
        self.walk(t_s, each);
        self.look_ahead(t_s, each);
        self.hint = self.follow(slot);
    }

    /// What deviates in the repetition that the best path is in.
    fn follow(&mut self, slot: usize) -> Option<Hint> {
        let best = self.viterbi.best()?;
        let place = self.network.place(best);
        let mut hint = None;
        for (index, watched) in self.watched.iter_mut().enumerate() {
            match place {
                Place::Within { exercise, state } if exercise == index => {
                    let width = 2 * watched.channels.len();
                    let observation = &watched.observations[slot * width..(slot + 1) * width];
                    let log_ratio = self.log_density[best];
                    let Watched { follower, exercise, .. } = watched;
                    hint = Some(follower.follow(exercise, index, state, observation, log_ratio));
                }
                _ => watched.follower.leave(),
            }
        }
        hint
    }

    fn finish(&mut self, each: &mut impl FnMut(Event)) {
        self.hint = None;
        let t_s = self.t_s(self.viterbi.frames());
        let emitted = &mut self.emitted;
        self.viterbi.finish(&mut |frame, state| emitted.push((frame, state as u16)));
        self.walk(t_s, each);
        if let Some(start) = self.open.take() {
            let before = self.state_at(self.certain.saturating_sub(1));
            let Place::Within { exercise, state } = self.network.place(before) else { return };
            // Nothing follows, so the last states are as good as an end.
            if state + 2 >= self.watched[exercise].ratio.states() {
                self.conclude(exercise, start, self.certain, t_s, each);
            }
        }
        for exercise in 0..self.watched.len() {
            self.withdraw(exercise, u64::MAX, t_s, each);
        }
    }

    fn state_at(&self, frame: u64) -> usize {
        usize::from(self.states[(frame % self.capacity()) as usize])
    }

    /// Follows the path that has become certain.
    fn walk(&mut self, t_s: f64, each: &mut impl FnMut(Event)) {
        for item in 0..self.emitted.len() {
            let (frame, state) = self.emitted[item];
            let before = if frame > 0 { self.state_at(frame - 1) } else { 0 };
            let slot = (frame % self.capacity()) as usize;
            self.states[slot] = state;
            let state = usize::from(state);
            self.certain = frame + 1;
            if self.network.is_boundary(before, state)
                && let (Some(start), Place::Within { exercise, .. }) =
                    (self.open.take(), self.network.place(before))
            {
                self.conclude(exercise, start, frame, t_s, each);
            }
            if let (None, Place::Within { exercise, .. }) = (self.open, self.network.place(state)) {
                self.open = Some(frame);
                let t_start_s = self.t_s(frame);
                each(self.event(exercise, EventKind::Started, [t_start_s; 2], t_s));
            }
        }
        self.emitted.clear();
    }

    /// Measures of the repetition on `path`, which begins at frame `start`, and its first and last frame.
    fn measures(&self, exercise: usize, start: u64) -> Option<(Measures, [u64; 2])> {
        let capacity = self.capacity();
        if self.path.len() as u64 > capacity {
            return None; // its beginning is forgotten
        }
        let first = self.network.range(exercise).start;
        let watched = &self.watched[exercise];
        let states = self.path.iter().map(|state| usize::from(*state) - first);
        let moving = trim(states.clone(), watched.ratio.states());
        let width = 2 * watched.channels.len();
        let rows = states.enumerate().skip(moving.start).take(moving.len()).map(|(index, state)| {
            let slot = ((start + index as u64) % capacity) as usize;
            (&watched.observations[slot * width..(slot + 1) * width], state)
        });
        let measures = measure(&watched.exercise.movement, &watched.ratio, self.rate_hz, rows);
        Some((measures, [start + moving.start as u64, start + moving.end as u64 - 1]))
    }

    /// Judges the certain repetition of the frames `start..end`.
    fn conclude(&mut self, exercise: usize, start: u64, end: u64, t_s: f64, each: &mut impl FnMut(Event)) {
        self.path.clear();
        if end - start <= self.capacity() {
            for frame in start..end {
                self.path.push(self.states[(frame % self.capacity()) as usize]);
            }
        }
        let judged = if self.path.is_empty() { None } else { self.measures(exercise, start) };
        let (span, verdict) = match judged {
            Some((measures, span)) => (span, self.verdict(exercise, &measures, span)),
            None => ([start, end - 1], Err(Reason::TooSlow)),
        };
        // A provisional one that is not this one is none.
        self.withdraw(exercise, span[0], t_s, each);
        self.watched[exercise].pending = None;
        let kind = if verdict.is_ok() { EventKind::Counted } else { EventKind::Rejected };
        if verdict.is_ok() {
            self.watched[exercise].count += 1;
            self.watched[exercise].counted_until = Some(span[1]);
        }
        let times = [self.t_s(span[0]), self.t_s(span[1] + 1)];
        let mut event = self.event(exercise, kind, times, t_s);
        event.reason = verdict.err();
        event.measures = judged.map(|(measures, _)| measures);
        if let Some((measures, span)) = judged {
            event.feedback = self.feedback(exercise, start, span, &measures);
            let taught = &self.watched[exercise].exercise;
            event.remark = event.feedback.and_then(|feedback| feedback.remark(taught));
        }
        each(event);
    }

    fn verdict(&self, exercise: usize, measures: &Measures, span: [u64; 2]) -> Result<(), Reason> {
        let Watched { exercise, counted_until, .. } = &self.watched[exercise];
        judge(measures, &exercise.gate, &exercise.durations)?;
        let refractory = REFRACTORY * exercise.durations.shortest_s * self.rate_hz;
        match counted_until {
            Some(last) if span[1] < *last || ((span[1] - last) as f64) < refractory => Err(Reason::TooSoon),
            _ => Ok(()),
        }
    }

    fn feedback(&self, exercise: usize, start: u64, span: [u64; 2], measures: &Measures) -> Option<Feedback> {
        let watched = &self.watched[exercise];
        let (first, width) = (self.network.range(exercise).start, 2 * watched.channels.len());
        let rows = (span[0]..=span[1]).map(|frame| {
            let slot = (frame % self.capacity()) as usize;
            let state = usize::from(self.path[(frame - start) as usize]) - first;
            (&watched.observations[slot * width..(slot + 1) * width], state)
        });
        describe(&watched.exercise, measures, rows)
    }

    /// Looks at the path that is best now: a repetition at its end is provisional.
    fn look_ahead(&mut self, t_s: f64, each: &mut impl FnMut(Event)) {
        let before_all = self.certain;
        let now = self.viterbi.frames();
        for exercise in 0..self.watched.len() {
            // The path has passed it and found none.
            let until = if self.open.is_some() { 0 } else { before_all };
            self.withdraw(exercise, until, t_s, each);
        }
        let Some(best) = self.viterbi.best() else { return };
        // Only where a repetition has just ended: in the background, or early in the next one.
        let early = match self.network.place(best) {
            Place::Background => true,
            Place::Within { exercise, state } => 4 * state < self.watched[exercise].ratio.states(),
        };
        if !early || now == before_all {
            return;
        }
        let (first, path) = self.viterbi.provisional();
        debug_assert_eq!(first, before_all, "what is certain was taken");
        // The last boundary on the path.
        let mut end = None;
        let mut before = best;
        for (index, state) in path.iter().enumerate().rev() {
            let state = usize::from(*state);
            if self.network.is_boundary(state, before) && index + 1 < path.len() {
                end = Some(index);
                break;
            }
            before = state;
        }
        let Some(end) = end else { return };
        let last = usize::from(path[end]);
        let Place::Within { exercise, .. } = self.network.place(last) else { return };
        self.path.clear();
        // Back to its beginning: on the path that is not certain, then on the certain one.
        let mut begin = end;
        while begin > 0 && usize::from(path[begin - 1]) != 0 && path[begin - 1] <= path[begin] {
            begin -= 1;
        }
        let reaches_back = begin == 0 && self.open.is_some() && {
            let state = self.states
                [((before_all + self.states.len() as u64 - 1) % self.states.len() as u64) as usize];
            state != 0 && state <= path[0]
        };
        let start = if reaches_back { self.open.unwrap_or(first) } else { first + begin as u64 };
        if first + end as u64 + 1 - start > self.states.len() as u64 {
            return;
        }
        for frame in start..first {
            self.path.push(self.states[(frame % self.states.len() as u64) as usize]);
        }
        self.path.extend_from_slice(&path[begin..=end]);
        let Some((measures, span)) = self.measures(exercise, start) else { return };
        if self.verdict(exercise, &measures, span).is_err() {
            return;
        }
        let watched = &mut self.watched[exercise];
        let near = (REFRACTORY * watched.exercise.durations.shortest_s * self.rate_hz) as u64;
        if watched.pending.is_some_and(|pending| pending[1].abs_diff(span[1]) <= near) {
            return;
        }
        if watched.pending.is_some() {
            self.withdraw(exercise, u64::MAX, t_s, each);
        }
        self.watched[exercise].pending = Some(span);
        let times = [self.t_s(span[0]), self.t_s(span[1] + 1)];
        let mut event = self.event(exercise, EventKind::Provisional, times, t_s);
        event.measures = Some(measures);
        each(event);
    }

    /// Takes a provisional repetition back that ended before frame `until`.
    fn withdraw(&mut self, exercise: usize, until: u64, t_s: f64, each: &mut impl FnMut(Event)) {
        if let Some(span) = self.watched[exercise].pending
            && span[1] < until
        {
            self.watched[exercise].pending = None;
            let times = [self.t_s(span[0]), self.t_s(span[1] + 1)];
            each(self.event(exercise, EventKind::Withdrawn, times, t_s));
        }
    }

    fn event(&self, exercise: usize, kind: EventKind, [t_start_s, t_s]: [f64; 2], t_decided_s: f64) -> Event {
        let count = self.watched[exercise].count;
        let (reason, measures, feedback, remark) = (None, None, None, None);
        Event { t_s, t_start_s, t_decided_s, exercise, kind, count, reason, measures, feedback, remark }
    }
}
