//! One subject: what is counted for it, and how far it is with sets and rests.

use posed_drivers::Timestamp;
use posed_state::Plain;

use posed_motion::exercise::{Counter, CountingCost, Event, EventKind, Hint};
use posed_stage::input::Plan;
use posed_stage::name::Name;
use posed_stage::output::{
    ExerciseOutcome, ExerciseProgress, ExerciseState, ExerciseWhat, LiveHint, Outcome, OutcomeKind,
    Repetition,
};

/// Least distance of two hints, s: people cannot read faster.
const HINT_INTERVAL_S: f64 = 0.25;

/// Who moves, and what is counted.
#[derive(Clone, Debug, Plain)]
pub(super) struct Subject {
    name: Name,
    /// The body that is counted; `None` on a stage without bodies.
    body: Option<Name>,
    /// None while nothing is selected.
    counter: Option<Counter>,
    plan: Plan,
    exercises: Vec<Progress>,
    /// Whether a client has selected, rather than the stage by default.
    selected: bool,
    hinted: Hinted,
}

/// How far it is with an exercise.
#[derive(Clone, Debug, PartialEq, Plain)]
struct Progress {
    name: Name,
    channels: Vec<Name>,
    count: u64,
    /// Sets completed.
    sets: u32,
    set_count: u32,
    rest_until_s: Option<f64>,
}

/// Exercise, channel and whether it was too much; and whether it was an anomaly.
type HintKey = (usize, Option<(usize, bool)>, bool);

/// What was last said while moving.
#[derive(Clone, Debug, PartialEq, Plain)]
struct Hinted {
    /// None: nothing, or that what was said is over.
    what: Option<HintKey>,
    t_s: f64,
}

impl Subject {
    /// `prefix` is what stands in front of the names of this body's angles on the stage, and in no message.
    pub(super) fn new(
        name: Name,
        body: Option<&str>,
        prefix: &str,
        counter: Option<Counter>,
        plan: Plan,
        selected: bool,
    ) -> Self {
        let exercises = counter.iter().flat_map(Counter::exercises).map(|exercise| Progress {
            name: Name::from(exercise.name.as_str()),
            channels: (0..exercise.channels.len() + exercise.still.len())
                .filter_map(|number| exercise.channel(number))
                .map(|channel| Name::from(channel.strip_prefix(prefix).unwrap_or(channel)))
                .collect(),
            count: 0,
            sets: 0,
            set_count: 0,
            rest_until_s: None,
        });
        let exercises = exercises.collect();
        let hinted = Hinted { what: None, t_s: f64::NEG_INFINITY };
        let body = body.map(Name::from);
        Self { name, body, counter, plan, exercises, selected, hinted }
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// What counting costs for it; `None` where nothing is selected.
    pub(super) fn cost(&self) -> Option<CountingCost> {
        self.counter.as_ref().map(Counter::cost)
    }

    pub(super) fn has_selected(&self) -> bool {
        self.selected
    }

    /// Counts from 0 again; what is under way goes on.
    pub(super) fn reset(&mut self, t: Timestamp, emit: &mut dyn FnMut(&Outcome)) {
        for progress in &mut self.exercises {
            (progress.count, progress.sets, progress.set_count) = (0, 0, 0);
            progress.rest_until_s = None;
        }
        self.say_state(t, emit);
    }

    /// Reports what is counted and how far it is.
    pub(super) fn say_state(&self, t: Timestamp, emit: &mut dyn FnMut(&Outcome)) {
        let Plan { repetitions, sets, rest_s } = self.plan;
        let exercises = self.exercises.iter().map(|progress| progress.state(&self.plan)).collect();
        let body = self.body.as_ref().map(ToString::to_string);
        let state = ExerciseState { body, exercises, repetitions, sets, rest_s };
        self.emit(t, t, ExerciseWhat::State(state), emit);
    }

    /// Follows a frame with the row of signals.
    pub(super) fn frame(&mut self, t: Timestamp, row: &[Option<f64>], emit: &mut dyn FnMut(&Outcome)) {
        let Some(mut counter) = self.counter.take() else { return };
        let t_s = t.as_secs_f64();
        counter.push(t_s, row, &mut |event| self.event(t, event, emit));
        self.hint(t, counter.hint(), &counter, emit);
        self.counter = Some(counter);
        let rested = |progress: &mut Progress| progress.rest_until_s.take_if(|end_s| *end_s <= t_s).is_some();
        // All of them: `any` would stop at the first.
        if self.exercises.iter_mut().filter_map(|progress| rested(progress).then_some(())).count() > 0 {
            self.say_state(t, emit);
        }
    }

    fn event(&mut self, t: Timestamp, event: Event, emit: &mut dyn FnMut(&Outcome)) {
        let plan = self.plan;
        let progress = &mut self.exercises[event.exercise];
        let mut completed = false;
        if event.kind == EventKind::Counted {
            progress.count += 1;
            if progress.is_complete(&plan) && !progress.is_done(&plan) {
                progress.set_count = 0;
            }
            progress.set_count += 1;
            progress.rest_until_s = None;
            if progress.is_complete(&plan) {
                completed = plan.sets.is_none_or(|sets| progress.sets < sets);
                progress.sets += u32::from(completed);
            }
            if completed && plan.rest_s > 0.0 && !progress.is_done(&plan) {
                progress.rest_until_s = Some(t.as_secs_f64() + plan.rest_s);
            }
        }
        let feedback = event.feedback;
        let channel = |index: usize| progress.channels.get(index).cloned();
        let repetition = Repetition {
            exercise: progress.name.clone(),
            kind: event.kind,
            count: progress.count,
            set_count: progress.set_count,
            t_start_s: event.t_start_s,
            reason: event.reason,
            is_attempt: event.is_attempt,
            feedback: feedback.and_then(|feedback| Some((channel(feedback.channel)?, feedback))),
            remark: event.remark,
        };
        self.emit(Timestamp::from_secs_f64(event.t_s), t, ExerciseWhat::Repetition(repetition), emit);
        if completed {
            self.say_state(t, emit);
        }
    }

    /// Reports what deviates now, when that changes.
    fn hint(&mut self, t: Timestamp, hint: Option<Hint>, counter: &Counter, emit: &mut dyn FnMut(&Outcome)) {
        let remark = hint.and_then(|hint| hint.remark(counter.exercises().nth(hint.exercise)?));
        let what = hint.and_then(|hint| {
            let deviates = remark.map(|_| (hint.channel, hint.deviation > 0.0));
            (deviates.is_some() || hint.anomaly).then_some((hint.exercise, deviates, hint.anomaly))
        });
        let t_s = t.as_secs_f64();
        if what == self.hinted.what || t_s < self.hinted.t_s + HINT_INTERVAL_S {
            return;
        }
        self.hinted = Hinted { what, t_s };
        let emitted = hint.filter(|_| what.is_some()).and_then(|hint| {
            let progress = self.exercises.get(hint.exercise)?;
            let channel = progress.channels.get(hint.channel).cloned();
            Some(LiveHint {
                exercise: progress.name.clone(),
                phase: hint.phase,
                anomaly: hint.anomaly,
                remark: channel.zip(remark),
            })
        });
        self.emit(t, t, ExerciseWhat::Hint(emitted), emit);
    }

    fn emit(
        &self,
        t_valid: Timestamp,
        t_decided: Timestamp,
        what: ExerciseWhat,
        emit: &mut dyn FnMut(&Outcome),
    ) {
        let what = OutcomeKind::Exercise(ExerciseOutcome { subject: self.name.clone(), what });
        emit(&Outcome { t_valid, t_decided, what });
    }
}

impl Progress {
    /// Whether the set is complete.
    fn is_complete(&self, plan: &Plan) -> bool {
        plan.repetitions.is_some_and(|repetitions| self.set_count >= repetitions)
    }

    /// Whether all sets are.
    fn is_done(&self, plan: &Plan) -> bool {
        plan.sets.is_some_and(|sets| self.sets >= sets)
    }

    fn state(&self, plan: &Plan) -> ExerciseProgress {
        let done = self.is_done(plan);
        let current = if self.is_complete(plan) { self.sets } else { self.sets + 1 };
        ExerciseProgress {
            exercise: self.name.to_string(),
            count: self.count,
            set: current.max(1),
            set_count: self.set_count,
            rest_until_s: self.rest_until_s,
            done,
        }
    }
}
