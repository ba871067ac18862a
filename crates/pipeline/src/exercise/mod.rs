//! The exercise stage: counts taught exercises in what the stage tracks.
//!
//! What comes in: estimates, exercises, and what clients ask. What goes out: outcomes of the subjects' repetitions. What
//! it never does: cost anything while nobody counts. An exercise that is loaded is counted for the subject
//! [`DEFAULT_SUBJECT`] until that subject selects its own.

mod subject;

use std::collections::BTreeMap;

use posed_state::State;

use self::subject::Subject;
use super::input_error::InputError;
use posed_motion::exercise::{Counter, CountingCost, Exercise};
use posed_stage::Stage;
use posed_stage::input::{Plan, Request};
use posed_stage::name::Name;
use posed_stage::output::{Body, Estimate, Outcome};
use posed_stage::signals::{self, BodyColumns, InertialColumns};

/// Name of the subject that moves unless a client specifies otherwise: loaded exercises are counted for it until it selects its
/// own.
pub const DEFAULT_SUBJECT: &str = "default";
/// Subjects at a time.
const SUBJECTS: usize = 64;
/// Exercises that one subject can be counted in at once, and longest set.
const SELECTED: usize = 32;
/// Exercises that can be loaded at a time, by name.
const LOADED: usize = 256;
/// Most that counting may cost over all subjects.
const STAGE_COST: CountingCost = CountingCost { states: 65_536, bytes: 256 << 20, evaluations_per_s: 2e8 };
const LONGEST_SET: u32 = 10_000;
/// Longest name of a subject, bytes.
const NAME_BYTES: usize = 64;

fn out_of_range(key: &'static str, expected: String) -> InputError {
    InputError::OutOfRange { key, expected }
}

/// All exercises and who does them.
#[derive(Clone, Debug, State)]
pub(super) struct ExerciseStage {
    #[state(keep)]
    columns: Vec<String>,
    #[state(keep)]
    inertial: InertialColumns,
    #[state(keep)]
    body: BodyColumns,
    row: Vec<Option<f64>>,
    /// The newest of each name.
    #[state(keep)]
    library: Vec<Exercise>,
    subjects: Vec<Subject>,
}

impl ExerciseStage {
    /// For a stage with its sensors and its body.
    pub(super) fn new(stage: &Stage) -> Self {
        let columns = signals::columns_of(stage);
        let row = Vec::with_capacity(columns.len());
        let (inertial, body) = (InertialColumns::of(stage), BodyColumns::of(stage));
        Self { columns, inertial, body, row, library: Vec::new(), subjects: Vec::new() }
    }

    /// Whether an exercise can be loaded.
    ///
    /// # Errors
    /// The stage lacks one of its channels, it costs too much, or there are too many.
    pub(super) fn check_load(&self, exercise: &Exercise) -> Result<(), InputError> {
        let known = self.library.iter().any(|known| known.name == exercise.name);
        if !known && self.library.len() >= LOADED {
            return Err(InputError::Loaded(LOADED));
        }
        let one = std::slice::from_ref(exercise);
        Ok(Counter::check(one, &self.columns).map(drop)?)
    }

    /// Takes an exercise that [`Self::check_load`] accepts; false where it does not.
    pub(super) fn load(&mut self, exercise: &Exercise) -> bool {
        if self.check_load(exercise).is_err() {
            return false;
        }
        match self.library.iter_mut().find(|known| known.name == exercise.name) {
            Some(known) => known.clone_from(exercise),
            None => self.library.push(exercise.clone()),
        }
        true
    }

    /// Counts what is loaded for the default subject, if that one has not selected anything.
    pub(super) fn loaded(&mut self, estimate: &Estimate, emit: &mut impl FnMut(&Outcome)) {
        if self.subjects.iter().any(|subject| subject.name() == DEFAULT_SUBJECT && subject.has_selected()) {
            return;
        }
        // Exercises of other frame rates have to be selected alone.
        let rate_hz = self.library.first().map(|exercise| exercise.rate_hz);
        let fitting = self.library.iter().filter(|exercise| Some(exercise.rate_hz) == rate_hz);
        let mut names: Vec<String> = fitting.take(SELECTED).map(|exercise| exercise.name.clone()).collect();
        // As many as can be counted at once: what was loaded last gives way.
        let counter = loop {
            match self.affordable(DEFAULT_SUBJECT, &names, &BTreeMap::new()) {
                Ok(exercises) => break Counter::new(exercises, &self.columns).ok(),
                Err(_) if names.pop().is_some() => {}
                Err(_) => break None,
            }
        };
        self.select(DEFAULT_SUBJECT, counter, Plan::default(), false, estimate, emit);
    }

    /// Whether a request can be carried out.
    ///
    /// # Errors
    /// What stands against it.
    pub(super) fn check(&self, request: &Request) -> Result<(), InputError> {
        match request {
            Request::ExerciseSelect { subject, exercises, plan, sensors } => {
                let known = self.subjects.iter().any(|known| known.name() == subject);
                if subject.is_empty() || subject.len() > NAME_BYTES {
                    return Err(out_of_range("subject", format!("a name of 1 to {NAME_BYTES} bytes")));
                }
                if !known && self.subjects.len() >= SUBJECTS {
                    return Err(InputError::Full { key: "subject", limit: SUBJECTS });
                }
                if exercises.len() > SELECTED {
                    return Err(InputError::Selected(SELECTED));
                }
                let in_range = |count: Option<u32>| count.is_none_or(|n| (1..=LONGEST_SET).contains(&n));
                if !in_range(plan.repetitions) || !in_range(plan.sets) {
                    return Err(out_of_range("repetitions, sets", format!("1 to {LONGEST_SET}")));
                }
                if !(0.0..=3600.0).contains(&plan.rest_s) {
                    return Err(out_of_range("rest_s", "0 to 3600 seconds".into()));
                }
                if exercises.is_empty() {
                    Ok(())
                } else {
                    self.affordable(subject, exercises, sensors).map(drop)
                }
            }
            Request::ExerciseReset { subject } => {
                let known = self.subjects.iter().any(|known| known.name() == subject);
                if known { Ok(()) } else { Err(InputError::NoSubject(subject.clone())) }
            }
            Request::FieldStart { .. } | Request::FieldFinish {} | Request::HeadingReset { .. } => {
                Err(InputError::NotAboutExercises)
            }
        }
    }

    /// Carries out a request; one that cannot be is not.
    pub(super) fn request(
        &mut self,
        request: &Request,
        estimate: &Estimate,
        emit: &mut impl FnMut(&Outcome),
    ) -> bool {
        if self.check(request).is_err() {
            return false;
        }
        match request {
            Request::ExerciseSelect { subject, exercises, plan, sensors } => {
                let exercises = self.affordable(subject, exercises, sensors).ok();
                let counter = exercises.and_then(|exercises| Counter::new(exercises, &self.columns).ok());
                self.select(subject, counter, *plan, true, estimate, emit);
            }
            Request::ExerciseReset { subject } => {
                if let Some(known) = self.subjects.iter_mut().find(|known| known.name() == subject) {
                    known.reset(estimate.t_valid, emit);
                }
            }
            Request::FieldStart { .. } | Request::FieldFinish {} | Request::HeadingReset { .. } => {}
        }
        true
    }

    /// Follows a frame.
    pub(super) fn frame(
        &mut self,
        estimate: &Estimate,
        body: Option<&Body>,
        emit: &mut impl FnMut(&Outcome),
    ) {
        if self.subjects.is_empty() {
            return;
        }
        signals::write(estimate, &mut self.row);
        self.inertial.append(estimate, &mut self.row);
        self.body.append(body, estimate, &mut self.row);
        for subject in &mut self.subjects {
            subject.frame(estimate.t_valid, &self.row, emit);
        }
    }

    /// What a subject is to be counted in, if it can be had beside what is counted for all others.
    fn affordable(
        &self,
        subject: &str,
        names: &[String],
        sensors: &BTreeMap<String, String>,
    ) -> Result<Vec<Exercise>, InputError> {
        let exercises = self.exercises(names, sensors)?;
        let cost = Counter::check(&exercises, &self.columns)?;
        let others = self.subjects.iter().filter(|other| other.name() != subject).filter_map(Subject::cost);
        if others.fold(cost, CountingCost::plus).within(&STAGE_COST) {
            Ok(exercises)
        } else {
            Err(InputError::TooCostly)
        }
    }

    /// These exercises, with the sensors that stand for those they were taught with.
    fn exercises(
        &self,
        names: &[String],
        sensors: &BTreeMap<String, String>,
    ) -> Result<Vec<Exercise>, InputError> {
        let mut exercises = Vec::with_capacity(names.len());
        for name in names {
            if exercises.iter().any(|known: &Exercise| known.name == *name) {
                return Err(InputError::Twice(name.clone()));
            }
            let known = self.library.iter().find(|exercise| exercise.name == *name);
            exercises.push(known.cloned().ok_or_else(|| InputError::NotLoaded(name.clone()))?);
        }
        let on_stage = |sensor: &str| self.columns.iter().any(|column| behind(column, sensor).is_some());
        if let Some(sensor) = sensors.values().find(|sensor| !on_stage(sensor)) {
            return Err(InputError::NoSensor(sensor.clone()));
        }
        let mut channels = exercises.iter().flat_map(|exercise| &exercise.channels);
        let taught = |channel: &String| sensors.keys().any(|sensor| behind(channel, sensor).is_some());
        if !sensors.is_empty() && !channels.any(taught) {
            return Err(InputError::TaughtWithOthers);
        }
        let named = exercises.iter_mut().flat_map(|Exercise { channels, still, .. }| {
            channels.iter_mut().chain(still.iter_mut().map(|still| &mut still.channel))
        });
        for channel in named {
            let renamed =
                sensors.iter().find_map(|(from, to)| Some(format!("{to}{}", behind(channel, from)?)));
            if let Some(renamed) = renamed {
                *channel = renamed;
            }
        }
        Ok(exercises)
    }

    fn select(
        &mut self,
        subject: &str,
        counter: Option<Counter>,
        plan: Plan,
        explicit: bool,
        estimate: &Estimate,
        emit: &mut impl FnMut(&Outcome),
    ) {
        let new = Subject::new(Name::from(subject), counter, plan, explicit);
        new.say_state(estimate.t_valid, emit);
        match self.subjects.iter_mut().find(|known| known.name() == subject) {
            Some(known) => *known = new,
            None => self.subjects.push(new),
        }
    }
}

/// What stands behind the name of a sensor in the name of its channel, `_qw` for example.
fn behind<'a>(channel: &'a str, sensor: &str) -> Option<&'a str> {
    let part = channel.strip_prefix(sensor)?;
    let known = ["_up_x", "_up_y", "_up_z"];
    (known.contains(&part) || signals::is_part(part)).then_some(part)
}
