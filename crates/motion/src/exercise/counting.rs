//! Counting on the grid of frames: observations in, events out.
//!
//! What comes in: frames of channels. What goes out: events. Observation -> log ratio per state -> short-time Viterbi ->
//! path -> passage -> gate -> event; what is certain is counted or rejected, what looks complete on the path that is best
//! now is provisional.

use posed_state::Plain;

use super::align::trim;
use super::cost::Spans;
use super::event::{Event, EventKind};
use super::exercise::{Exercise, Manner};
use super::exercise_topology::{ExerciseTopology, PathState};
use super::feedback::{Feedback, Way, beside, describe};
use super::frames::{Differentiator, Frame};
use super::frozen::Frozen;
use super::hint::{Follower, Hint};
use super::hmm::{LogRatio, Movement};
use super::joint::Spoken;
use super::judge::{Measures, Reason, goes_the_way, judge, measure};
use super::passage::{Mark, Passage};
use super::posture::Posture;
use super::remark::DeviationKind;
use super::still::{Role, Still, Together, role, ways};
use super::viterbi::ShortTimeViterbi;

/// A set still goes on for so many of the longest taught repetitions after the one that was counted last.
const IN_SET: f64 = 2.0;

/// One exercise with what it sees.
#[derive(Clone, Debug, Plain)]
struct Watched {
    exercise: Exercise,
    /// Which of its channels may be spoken of.
    spoken: Vec<Option<Spoken>>,
    /// The manners in which it is looked for.
    chains: Vec<Chain>,
    /// Where its channels are among all.
    channels: Vec<usize>,
    values: Vec<f64>,
    differentiator: Differentiator,
    frozen: Frozen,
    posture: Posture,
    /// Ring of observations, a frame per slot.
    observations: Vec<f64>,
    /// Where the joints that keep still are among all, where they are there, and the ring of their values.
    still_channels: Vec<Option<usize>>,
    still_values: Vec<f64>,
    /// Which of them are of the legs that only carry the exercise.
    stands: Vec<bool>,
    /// Those of the others that belong to one joint.
    together: Vec<Together>,
    /// How far the movement is in each state.
    ways: Vec<f64>,
    count: u64,
    /// A repetition that was said to be provisional: its first and last frame.
    pending: Option<[u64; 2]>,
    /// Last frame of the repetition that was counted last.
    counted_until: Option<u64>,
    follower: Follower,
}

impl Watched {
    /// What it saw in a frame that a ring of so many still holds.
    fn observation(&self, frame: u64, capacity: u64) -> &[f64] {
        let (slot, width) = ((frame % capacity) as usize, 2 * self.channels.len());
        &self.observations[slot * width..(slot + 1) * width]
    }

    /// The same of a joint that keeps still.
    fn still_value(&self, still: usize, frame: u64, capacity: u64) -> f64 {
        self.still_values[(frame % capacity) as usize * self.still_channels.len() + still]
    }

    /// Whether what begins at frame `start` belongs to the set of the repetition that counted last.
    fn set_goes_on(&self, start: u64, rate_hz: f64) -> bool {
        let longest_frames = self.exercise.durations.longest_s * rate_hz;
        self.counted_until.is_some_and(|last| start.saturating_sub(last) as f64 <= IN_SET * longest_frames)
    }
}

/// An exercise in one manner.
#[derive(Clone, Debug, Plain)]
struct Chain {
    size: f64,
    movement: Movement,
    ratio: LogRatio,
}

impl Chain {
    fn new(exercise: &Exercise, Manner { size, tempo }: Manner) -> Self {
        let movement = exercise.movement.sized(size).at_tempo(tempo);
        Self { size, ratio: LogRatio::new(&movement, &exercise.channels), movement }
    }
}

/// See the module.
#[derive(Clone, Debug, Plain)]
pub(super) struct Counting {
    rate_hz: f64,
    watched: Vec<Watched>,
    exercise_topology: ExerciseTopology,
    viterbi: ShortTimeViterbi,
    log_density: Vec<f64>,
    /// Number on the grid of the decoder's first frame.
    origin: Option<u64>,
    /// Ring of states that are certain, a frame per slot, and number of frames in it ever.
    states: Vec<u16>,
    certain: u64,
    /// Where the certain path is.
    passage: Passage,
    /// What a state made certain.
    marks: Vec<Mark>,
    /// Frames and states that a push made certain.
    emitted: Vec<(u64, u16)>,
    /// Path of the repetition that is judged.
    path: Vec<u16>,
    #[state(skip)]
    ways: Vec<Option<Way>>,
    hint: Option<Hint>,
}

impl Counting {
    pub(super) fn new(exercises: Vec<Exercise>, all: &[String], rate_hz: f64) -> Self {
        let exercise_topology =
            ExerciseTopology::new(exercises.iter().map(|exercise| (exercise.states(), exercise.chains())));
        let Spans { bound_frames: bound, capacity_frames: capacity } = Spans::of(&exercises);
        let watched: Vec<Watched> = exercises
            .into_iter()
            .map(|mut exercise| {
                exercise.take_turns_of_means();
                let width = exercise.channels.len();
                let stands: Vec<bool> = exercise
                    .still
                    .iter()
                    .map(|still| role(&still.channel, &exercise.channels) == Some(Role::Stands))
                    .collect();
                let place = |channel: &String| all.iter().position(|other| other == channel).unwrap_or(0);
                Watched {
                    chains: exercise.manners().map(|manner| Chain::new(&exercise, manner)).collect(),
                    channels: exercise.channels.iter().map(place).collect(),
                    values: vec![f64::NAN; width],
                    differentiator: Differentiator::new(rate_hz, width),
                    frozen: Frozen::new(&exercise.channels, rate_hz),
                    posture: Posture::new(&exercise.channels, &exercise.rest, rate_hz),
                    together: Together::of(&exercise.still, |still| !stands[still]),
                    stands,
                    observations: vec![f64::NAN; 2 * width * capacity],
                    still_channels: exercise
                        .still
                        .iter()
                        .map(|still| all.iter().position(|other| *other == still.channel))
                        .collect(),
                    ways: ways(&exercise.movement, &exercise.channels),
                    still_values: vec![f64::NAN; exercise.still.len() * capacity],
                    count: 0,
                    pending: None,
                    counted_until: None,
                    follower: Follower::new(rate_hz, width),
                    spoken: Spoken::of(&exercise.channels),
                    exercise,
                }
            })
            .collect();
        Self {
            rate_hz,
            viterbi: ShortTimeViterbi::new(exercise_topology.topology(), Some(bound)),
            log_density: vec![0.0; exercise_topology.states()],
            exercise_topology,
            watched,
            origin: None,
            states: vec![0; capacity],
            certain: 0,
            passage: Passage::default(),
            marks: Vec::with_capacity(4),
            emitted: Vec::with_capacity(2 * bound + 8),
            path: Vec::with_capacity(capacity),
            ways: Vec::new(),
            hint: None,
        }
    }

    /// The exercises, in the order of their index.
    pub(super) fn exercises(&self) -> impl Iterator<Item = &Exercise> {
        self.watched.iter().map(|watched| &watched.exercise)
    }

    /// Repetitions of an exercise counted so far.
    pub(super) fn count(&self, exercise: usize) -> u64 {
        self.watched.get(exercise).map_or(0, |watched| watched.count)
    }

    /// Begins to count from 0.
    pub(super) fn reset(&mut self) {
        for watched in &mut self.watched {
            watched.count = 0;
        }
    }

    /// What deviates just now.
    pub(super) fn hint(&self) -> Option<Hint> {
        self.hint
    }

    /// End of a frame of the grid, s.
    pub(super) fn end_s(&self, index: u64) -> f64 {
        (index + 1) as f64 / self.rate_hz
    }

    /// Number of frames in the rings.
    fn capacity(&self) -> u64 {
        self.states.len() as u64
    }

    /// Time at the beginning of one of the decoder's frames, s.
    fn t_s(&self, frame: u64) -> f64 {
        (self.origin.unwrap_or(0) + frame) as f64 / self.rate_hz
    }

    pub(super) fn push(&mut self, frame: Frame<'_>, t_s: f64, each: &mut dyn FnMut(Event)) {
        if frame.after_gap {
            // What was going on is over, as far as anybody can tell.
            self.finish(each);
            self.origin = None;
            for watched in &mut self.watched {
                watched.differentiator.reset();
                watched.frozen.reset();
                watched.posture.reset();
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
            for (still, channel) in watched.still_channels.iter().enumerate() {
                let value = channel.map_or(f64::NAN, |channel| frame.values[channel]);
                watched.still_values[slot * watched.still_channels.len() + still] = value;
            }
            let from = watched.differentiator.push(&watched.values);
            let width = from.len();
            let observation = &mut watched.observations[slot * width..(slot + 1) * width];
            observation.copy_from_slice(from);
            watched.frozen.leave_out(observation);
            watched.posture.push(&watched.values);
            watched.posture.take_off(observation);
            for (number, chain) in watched.chains.iter().enumerate() {
                chain
                    .ratio
                    .write(observation, &mut self.log_density[self.exercise_topology.range(index, number)]);
            }
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
        let (place, now) = (self.exercise_topology.place(best), self.viterbi.frames());
        let mut hint = None;
        for (index, watched) in self.watched.iter_mut().enumerate() {
            match place {
                PathState::Within { exercise, state, .. } if exercise == index => {
                    let width = 2 * watched.channels.len();
                    let observation = &watched.observations[slot * width..(slot + 1) * width];
                    let log_ratio = self.log_density[best];
                    // Before one has counted, whatever somebody does may be on its way to look like it.
                    let is_meant = watched.set_goes_on(now, self.rate_hz);
                    let Watched { follower, exercise, spoken, .. } = watched;
                    let followed = follower.follow((index, exercise), spoken, state, observation, log_ratio);
                    hint = Some(followed).filter(|_| is_meant);
                }
                _ => watched.follower.leave(),
            }
        }
        hint
    }

    pub(super) fn finish(&mut self, each: &mut dyn FnMut(Event)) {
        self.hint = None;
        let t_s = self.t_s(self.viterbi.frames());
        let emitted = &mut self.emitted;
        self.viterbi.finish(&mut |frame, state| emitted.push((frame, state as u16)));
        self.walk(t_s, each);
        if let Some(start) = self.passage.open() {
            let last = self.states[(self.certain.saturating_sub(1) % self.capacity()) as usize];
            if let PathState::Within { exercise, state, .. } = self.exercise_topology.place(usize::from(last))
                // Nothing follows, so the last states are as good as an end.
                && state + 2 >= self.watched[exercise].exercise.states()
            {
                self.conclude(exercise, start, self.certain, t_s, each);
            }
        }
        self.passage = Passage::default();
        for exercise in 0..self.watched.len() {
            self.withdraw(exercise, u64::MAX, t_s, each);
        }
    }

    /// Follows the path that has become certain.
    fn walk(&mut self, t_s: f64, each: &mut dyn FnMut(Event)) {
        for item in 0..self.emitted.len() {
            let (frame, state) = self.emitted[item];
            let slot = (frame % self.capacity()) as usize;
            self.states[slot] = state;
            self.certain = frame + 1;
            let mut passage = self.passage;
            passage
                .step(&self.exercise_topology, frame, usize::from(state), &mut |mark| self.marks.push(mark));
            self.passage = passage;
            for index in 0..self.marks.len() {
                match self.marks[index] {
                    Mark::Begun { exercise, start } => {
                        let t_start_s = self.t_s(start);
                        each(self.event(exercise, EventKind::Started, [t_start_s; 2], t_s));
                    }
                    Mark::Complete { exercise, start, end } => {
                        self.conclude(exercise, start, end, t_s, each);
                    }
                }
            }
            self.marks.clear();
        }
        self.emitted.clear();
    }

    /// Copies the certain states of `start..end` to `path`; false where they are forgotten.
    fn recall(&mut self, start: u64, end: u64) -> bool {
        self.path.clear();
        let known = self.viterbi.frames().saturating_sub(start) <= self.capacity();
        for frame in if known { start..end } else { 0..0 } {
            self.path.push(self.states[(frame % self.capacity()) as usize]);
        }
        known
    }

    /// The manner of the repetition on `path`; a repetition stays in one.
    fn chain(&self) -> Option<usize> {
        match self.exercise_topology.place(usize::from(*self.path.first()?)) {
            PathState::Within { chain, .. } => Some(chain),
            PathState::Background => None,
        }
    }

    /// Measures of the repetition on `path`, which begins at frame `start`, and its first and last frame.
    fn measures(&self, exercise: usize, start: u64) -> Option<(Measures, [u64; 2])> {
        let capacity = self.capacity();
        let number = self.chain()?;
        let first = self.exercise_topology.range(exercise, number).start;
        let watched = &self.watched[exercise];
        let Chain { size, movement, ratio } = watched.chains.get(number)?;
        let states = self.path.iter().map(|state| usize::from(*state) - first);
        let moving = trim(states.clone(), ratio.states());
        let rows = states
            .enumerate()
            .skip(moving.start)
            .take(moving.len())
            .map(|(index, state)| (watched.observation(start + index as u64, capacity), state));
        let mut measures = measure(movement, ratio, &watched.exercise.channels, self.rate_hz, rows);
        measures.gain *= size;
        let span = [start + moving.start as u64, start + moving.end as u64 - 1];
        for (number, still) in watched.exercise.still.iter().enumerate() {
            let values = self.still_course(watched, number, start, span, first).map(|(_, value)| value);
            let elsewhere = if watched.stands[number] {
                f64::from(u8::from(still.sways(values)))
            } else {
                still.elsewhere(values)
            };
            measures.elsewhere = measures.elsewhere.max(elsewhere);
        }
        let moved = |number: usize| {
            let still = &watched.exercise.still[number];
            still.moved_deg(self.still_course(watched, number, start, span, first))
        };
        if watched.together.iter().any(|together| together.is_another(moved)) {
            measures.elsewhere = 1.0;
        }
        Some((measures, span))
    }

    /// The values of a joint that keeps still in the repetition on `path`, whose states begin with `first`, each with how far the movement
    /// is there.
    fn still_course<'a>(
        &'a self,
        watched: &'a Watched,
        number: usize,
        start: u64,
        [from, to]: [u64; 2],
        first: usize,
    ) -> impl Iterator<Item = (f64, f64)> + Clone + 'a {
        let capacity = self.capacity();
        (from..=to).map(move |frame| {
            let state = usize::from(self.path[(frame - start) as usize]) - first;
            (watched.ways[state], watched.still_value(number, frame, capacity))
        })
    }

    /// Judges the certain repetition of the frames `start..end`.
    fn conclude(&mut self, exercise: usize, start: u64, end: u64, t_s: f64, each: &mut dyn FnMut(Event)) {
        let judged = if self.recall(start, end) { self.measures(exercise, start) } else { None };
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
        event.is_attempt = verdict.is_ok() || self.is_attempt(exercise, start, event.measures.as_ref());
        if let Some((measures, span)) = judged {
            let mut ways = std::mem::take(&mut self.ways);
            event.feedback = self.feedback(exercise, start, span, &measures, &mut ways);
            self.ways = ways;
            // What does not count has a reason; which joint of another movement went wrong nobody can say, but for one that was to
            // keep still.
            let is_compensated =
                |feedback: &Feedback| event.is_attempt && feedback.kind == DeviationKind::Moved;
            let is_said = |feedback: &Feedback| {
                kind == EventKind::Counted || verdict == Err(Reason::Different) && is_compensated(feedback)
            };
            event.remark = event.feedback.filter(is_said).and_then(|feedback| feedback.remark());
        }
        each(event);
    }

    /// Whether what was rejected was meant: it goes the way of the exercise, or comes so soon after a repetition that counted that
    /// the set still goes on. People reach for a glass between sets, and nobody wants to hear of that.
    fn is_attempt(&self, exercise: usize, start: u64, measures: Option<&Measures>) -> bool {
        let watched = &self.watched[exercise];
        watched.set_goes_on(start, self.rate_hz)
            || measures.is_some_and(|measures| goes_the_way(measures, &watched.exercise.gate))
    }

    fn verdict(&self, exercise: usize, measures: &Measures, span: [u64; 2]) -> Result<(), Reason> {
        let Watched { exercise, counted_until, .. } = &self.watched[exercise];
        judge(measures, &exercise.gate, &exercise.durations)?;
        let refractory = exercise.refractory_s() * self.rate_hz;
        match counted_until {
            Some(last) if span[1] < *last || ((span[1] - last) as f64) < refractory => Err(Reason::TooSoon),
            _ => Ok(()),
        }
    }

    fn feedback(
        &self,
        exercise: usize,
        start: u64,
        span: [u64; 2],
        measures: &Measures,
        ways: &mut Vec<Option<Way>>,
    ) -> Option<Feedback> {
        let watched = &self.watched[exercise];
        let (number, capacity) = (self.chain()?, self.capacity());
        let first = self.exercise_topology.range(exercise, number).start;
        let rows = (span[0]..=span[1]).map(|frame| {
            let state = usize::from(self.path[(frame - start) as usize]) - first;
            (watched.observation(frame, capacity), state)
        });
        let size = watched.chains.get(number).map_or(1.0, |chain| chain.size);
        let pad = beside((span[1] + 1 - span[0]) as usize) as u64;
        let now = self.viterbi.frames();
        let oldest = now.saturating_sub(capacity);
        let around = (span[0].saturating_sub(pad).max(oldest)..now.min(span[1] + 1 + pad))
            .map(|frame| (watched.observation(frame, capacity), (span[0]..=span[1]).contains(&frame)));
        let compensation = self.compensation(exercise, start, span);
        describe((&watched.exercise, &watched.spoken), measures, size, rows, around, compensation, ways)
    }

    /// Of the joints that keep still, the one that moved most with the movement: its number, by how much, and what that is worth.
    fn compensation(&self, exercise: usize, start: u64, span: [u64; 2]) -> Option<(usize, f64, f64)> {
        let watched = &self.watched[exercise];
        let first = self.exercise_topology.range(exercise, self.chain()?).start;
        let moved = |(number, still): (usize, &Still)| {
            let moved = still.moved(self.still_course(watched, number, start, span, first))?;
            Some((number, moved, still.worth(moved)))
        };
        let most = |a: (usize, f64, f64), b: (usize, f64, f64)| if b.2 > a.2 { b } else { a };
        // Of channels there is more to say than this, and of legs that stand there is nothing.
        let is_silent = |number: usize, still: &Still| {
            !watched.stands[number] && !watched.exercise.channels.contains(&still.channel)
        };
        let stills = watched.exercise.still.iter().enumerate();
        let stills = stills.filter(|(number, still)| is_silent(*number, still));
        stills.filter_map(moved).reduce(most)
    }

    /// Looks at the path that is best now: a repetition at its end is provisional.
    fn look_ahead(&mut self, t_s: f64, each: &mut dyn FnMut(Event)) {
        let certain = self.certain;
        for exercise in 0..self.watched.len() {
            // The path has passed it and found none.
            let until = if self.passage.open().is_some() { 0 } else { certain };
            self.withdraw(exercise, until, t_s, each);
        }
        let Some(best) = self.viterbi.best() else { return };
        let ended = match self.exercise_topology.place(best) {
            PathState::Background => true,
            PathState::Within { exercise, state, .. } => {
                let states = self.watched[exercise].exercise.states();
                4 * state < states || state + 1 == states
            }
        };
        if !ended || self.viterbi.frames() == certain {
            return;
        }
        let (first, path) = self.viterbi.provisional();
        debug_assert_eq!(first, certain, "what is certain was taken");
        let (mut passage, mut complete) = (self.passage, None);
        for (frame, state) in (first..).zip(path) {
            passage.step(&self.exercise_topology, frame, usize::from(*state), &mut |mark| {
                if let Mark::Complete { exercise, start, end } = mark {
                    complete = Some((exercise, start, end));
                }
            });
        }
        let Some((exercise, start, end)) = complete else { return };
        if !self.recall(start, end.min(certain)) {
            return;
        }
        let (first, path) = self.viterbi.provisional();
        let from = start.max(first) - first;
        self.path.extend_from_slice(path.get(from as usize..(end - first) as usize).unwrap_or(&[]));
        let Some((measures, span)) = self.measures(exercise, start) else { return };
        if self.verdict(exercise, &measures, span).is_err() {
            return;
        }
        let watched = &mut self.watched[exercise];
        let near = (watched.exercise.refractory_s() * self.rate_hz) as u64;
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
    fn withdraw(&mut self, exercise: usize, until: u64, t_s: f64, each: &mut dyn FnMut(Event)) {
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
        let (reason, measures, is_attempt, feedback, remark) = (None, None, true, None, None);
        Event {
            t_s,
            t_start_s,
            t_decided_s,
            exercise,
            kind,
            count,
            reason,
            measures,
            is_attempt,
            feedback,
            remark,
        }
    }
}
