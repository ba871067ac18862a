//! The exercise stage: counts taught exercises in what the stage tracks.
//!
//! What comes in: estimates, exercises, and what clients ask. What goes out: outcomes of the subjects' repetitions. What
//! it never does: cost anything while nobody counts. An exercise that is loaded is counted for the subject
//! [`DEFAULT_SUBJECT`], or where there are several bodies for a subject of the name of each, until that subject selects its own.
//!
//! An exercise knows nothing of who does it: its channels are joints of any body. Whose they are is said where it is selected.

mod subject;

use std::collections::BTreeMap;

use posed_state::State;

use self::subject::Subject;
use super::input_error::InputError;
use posed_motion::exercise::{Counter, CountingCost, Exercise};
use posed_stage::input::{Plan, Request};
use posed_stage::name::Name;
use posed_stage::output::{Body, Estimate, Outcome};
use posed_stage::signals::{self, BodyColumns, InertialColumns};
use posed_stage::{BodyIndex, Stage, body_counted};

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
    angles: BodyColumns,
    /// The bodies of the stage, in their order.
    #[state(keep)]
    bodies: Vec<Counted>,
    row: Vec<Option<f64>>,
    /// The newest of each name.
    #[state(keep)]
    library: Vec<Exercise>,
    subjects: Vec<Subject>,
}

/// A body whose joints can be counted.
#[derive(Clone, Debug)]
struct Counted {
    name: String,
    /// What stands in front of the names of its angles.
    prefix: String,
}

impl Counted {
    /// Who is counted in the joints of a body; `explicit` where a client asked for it.
    fn subject(
        body: Option<&Self>,
        name: &str,
        counter: Option<Counter>,
        plan: Plan,
        explicit: bool,
    ) -> Subject {
        let (body, prefix) = body.map_or((None, ""), |body| (Some(&*body.name), &*body.prefix));
        Subject::new(Name::from(name), body, prefix, counter, plan, explicit)
    }

    fn all(stage: &Stage) -> Vec<Self> {
        let of = |(index, name): (BodyIndex, &str)| Self {
            name: name.to_owned(),
            prefix: signals::prefix_of(stage, index),
        };
        (0..).zip(stage.body_names()).map(of).collect()
    }
}

impl ExerciseStage {
    /// For a stage with its sensors and its bodies.
    pub(super) fn new(stage: &Stage) -> Self {
        let columns = signals::columns_of(stage);
        let row = Vec::with_capacity(columns.len());
        let (inertial, angles) = (InertialColumns::of(stage), BodyColumns::of(stage));
        let bodies = Counted::all(stage);
        Self { columns, inertial, angles, bodies, row, library: Vec::new(), subjects: Vec::new() }
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
        // Whoever has its channels can be counted in it; of nobody who has, the first one's lack is said.
        let mut whose: Vec<Option<&Counted>> = self.bodies.iter().map(Some).collect();
        if whose.is_empty() {
            whose.push(None);
        }
        let checked = whose.into_iter().map(|body| self.check_channels(exercise, body));
        let mut lack = None;
        for result in checked {
            match result {
                Ok(()) => return Ok(()),
                Err(error) => lack = lack.or(Some(error)),
            }
        }
        lack.map_or(Ok(()), Err)
    }

    /// Whether an exercise can be counted in the joints of this body.
    fn check_channels(&self, exercise: &Exercise, body: Option<&Counted>) -> Result<(), InputError> {
        let mut one = exercise.clone();
        self.assign(&mut one, body);
        Ok(Counter::check(&[one], &self.columns).map(drop)?)
    }

    /// Lets the joints of an exercise be those of this body.
    fn assign(&self, exercise: &mut Exercise, body: Option<&Counted>) {
        let Some(body) = body else { return };
        for channel in channels_of(exercise) {
            *channel = signals::column_of(channel, &body.prefix, &self.columns);
        }
    }

    /// The body that is counted for a subject: that of this name, else the one that is called as the subject, else the first.
    fn counted(&self, subject: &str, body: Option<&str>) -> Result<Option<&Counted>, InputError> {
        let names = self.bodies.iter().map(|body| &*body.name);
        Ok(self.bodies.get(usize::from(body_counted(names, body, Some(subject))?)))
    }

    /// Who is counted for whom nobody has selected anything.
    fn default_subjects(&self) -> Vec<String> {
        match &*self.bodies {
            [] | [_] => vec![DEFAULT_SUBJECT.to_owned()],
            several => several.iter().map(|body| body.name.clone()).collect(),
        }
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

    /// Counts what is loaded for the default subjects, those that have not selected anything.
    pub(super) fn loaded(&mut self, estimate: &Estimate, emit: &mut dyn FnMut(&Outcome)) {
        for subject in self.default_subjects() {
            if !self.subjects.iter().any(|known| known.name() == subject && known.has_selected()) {
                self.loaded_for(&subject, estimate, emit);
            }
        }
    }

    fn loaded_for(&mut self, subject: &str, estimate: &Estimate, emit: &mut dyn FnMut(&Outcome)) {
        let Ok(body) = self.counted(subject, None).map(|body| body.cloned()) else { return };
        let has_channels = |exercise: &&Exercise| self.check_channels(exercise, body.as_ref()).is_ok();
        // Exercises of other frame rates have to be selected alone.
        let mut own = self.library.iter().filter(has_channels).peekable();
        let rate_hz = own.peek().map(|exercise| exercise.rate_hz);
        let fitting = own.filter(|exercise| Some(exercise.rate_hz) == rate_hz);
        let mut names: Vec<String> = fitting.take(SELECTED).map(|exercise| exercise.name.clone()).collect();
        // As many as can be counted at once: what was loaded last gives way.
        let counter = loop {
            match self.affordable(subject, &names, &BTreeMap::new(), body.as_ref()) {
                Ok(exercises) => break Counter::new(exercises, &self.columns).ok(),
                Err(_) if names.pop().is_some() => {}
                Err(_) => break None,
            }
        };
        let new = Counted::subject(body.as_ref(), subject, counter, Plan::default(), false);
        self.select(new, estimate, emit);
    }

    /// Whether a request can be carried out.
    ///
    /// # Errors
    /// What stands against it.
    pub(super) fn check(&self, request: &Request) -> Result<(), InputError> {
        match request {
            Request::ExerciseSelect { subject, exercises, plan, sensors, body } => {
                let body = self.counted(subject, body.as_deref())?;
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
                    self.affordable(subject, exercises, sensors, body).map(drop)
                }
            }
            Request::ExerciseReset { subject } => {
                let known = self.subjects.iter().any(|known| known.name() == subject);
                if known { Ok(()) } else { Err(InputError::NoSubject(subject.clone())) }
            }
            Request::FieldStart { .. }
            | Request::FieldFinish {}
            | Request::HeadingReset { .. }
            | Request::Mark { .. } => Err(InputError::NotAboutExercises),
        }
    }

    /// Carries out a request; one that cannot be is not.
    pub(super) fn request(
        &mut self,
        request: &Request,
        estimate: &Estimate,
        emit: &mut dyn FnMut(&Outcome),
    ) -> bool {
        if self.check(request).is_err() {
            return false;
        }
        match request {
            Request::ExerciseSelect { subject, exercises, plan, sensors, body } => {
                let Ok(body) = self.counted(subject, body.as_deref()).map(|body| body.cloned()) else {
                    return false;
                };
                let exercises = self.affordable(subject, exercises, sensors, body.as_ref()).ok();
                let counter = exercises.and_then(|exercises| Counter::new(exercises, &self.columns).ok());
                let new = Counted::subject(body.as_ref(), subject, counter, *plan, true);
                self.select(new, estimate, emit);
            }
            Request::ExerciseReset { subject } => {
                if let Some(known) = self.subjects.iter_mut().find(|known| known.name() == subject) {
                    known.reset(estimate.t_valid, emit);
                }
            }
            Request::FieldStart { .. }
            | Request::FieldFinish {}
            | Request::HeadingReset { .. }
            | Request::Mark { .. } => {}
        }
        true
    }

    /// Follows a frame; `latest` gives the newest of a body.
    pub(super) fn frame<'a>(
        &mut self,
        estimate: &Estimate,
        latest: impl Fn(BodyIndex) -> Option<&'a Body>,
        emit: &mut dyn FnMut(&Outcome),
    ) {
        if self.subjects.is_empty() {
            return;
        }
        signals::write(estimate, &mut self.row);
        self.inertial.append(estimate, &mut self.row);
        self.angles.append(latest, estimate, &mut self.row);
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
        body: Option<&Counted>,
    ) -> Result<Vec<Exercise>, InputError> {
        let mut exercises = self.exercises(names, sensors)?;
        exercises.iter_mut().for_each(|exercise| self.assign(exercise, body));
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
        for channel in exercises.iter_mut().flat_map(channels_of) {
            let renamed =
                sensors.iter().find_map(|(from, to)| Some(format!("{to}{}", behind(channel, from)?)));
            if let Some(renamed) = renamed {
                *channel = renamed;
            }
        }
        Ok(exercises)
    }

    fn select(&mut self, new: Subject, estimate: &Estimate, emit: &mut dyn FnMut(&Outcome)) {
        new.say_state(estimate.t_valid, emit);
        match self.subjects.iter_mut().find(|known| known.name() == new.name()) {
            Some(known) => *known = new,
            None => self.subjects.push(new),
        }
    }
}

/// Names of all that an exercise looks at.
fn channels_of(Exercise { channels, still, .. }: &mut Exercise) -> impl Iterator<Item = &mut String> {
    channels.iter_mut().chain(still.iter_mut().map(|still| &mut still.channel))
}

/// What stands behind the name of a sensor in the name of its channel, `_qw` for example.
fn behind<'a>(channel: &'a str, sensor: &str) -> Option<&'a str> {
    let part = channel.strip_prefix(sensor)?;
    let known = ["_up_x", "_up_y", "_up_z"];
    (known.contains(&part) || signals::is_part(part)).then_some(part)
}
