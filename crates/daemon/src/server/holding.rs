//! Events that still hold: faults that have not ended, the newest model of each kind, counts. Who comes later gets them.

use posed_field::{Cause, Warning};
use posed_fusion::faults;
use posed_motion::exercise::EventKind;
use posed_stage::BodyIndex;
use posed_stage::input::{Model, SensorIndex};
use posed_stage::name::Name;
use posed_stage::output::{ExerciseOutcome, ExerciseWhat, FieldNews, Outcome, OutcomeKind};

/// What holds, in the order in which it was said; `T` is what is kept of each event.
#[derive(Debug)]
pub struct Holding<T> {
    holds: Vec<(Key, T)>,
}

impl<T> Default for Holding<T> {
    fn default() -> Self {
        Self { holds: Vec::new() }
    }
}

/// What an event speaks of.
#[derive(Debug, PartialEq)]
enum Key {
    Fault(SensorIndex, faults::Cause),
    Transmitter,
    /// How the sensors of a body sit, by its name where there are several.
    Mounting(Option<String>),
    /// How the IMU of a magnetic sensor sits, by the sensor's name.
    AttachedImu(String),
    /// By unit.
    Imu(String),
    TrackerNoise(String),
    FieldMap,
    FieldProgress,
    Disturbed(Cause, [usize; 2]),
    Drifted,
    Exercise(String),
    FaultMap,
    /// What a subject does.
    Subject(Name),
    /// The newest count since then.
    Count(Name, Name),
    /// Of a body.
    MotionSegment(Option<BodyIndex>),
}

impl<T> Holding<T> {
    /// Takes an event in: it replaces an older one on the same matter, or ends it. `value` is what is kept of it, asked for only
    /// where it holds.
    pub fn take(&mut self, outcome: &Outcome, value: impl FnOnce() -> T) {
        // What holds until something else is said is reported to who subscribes later.
        let state = match &outcome.what {
            OutcomeKind::Fault { sensor, cause, active } => Some((Key::Fault(*sensor, *cause), *active)),
            // The newest word on what is being done.
            OutcomeKind::MotionSegment(segment) => Some((Key::MotionSegment(segment.body), true)),
            OutcomeKind::ModelSwapped(Model::Transmitter { .. }) => Some((Key::Transmitter, true)),
            OutcomeKind::ModelSwapped(Model::Mounting { body, .. } | Model::Chain { body, .. }) => {
                Some((Key::Mounting(body.clone()), true))
            }
            OutcomeKind::ModelSwapped(Model::AttachedImu { sensor, .. }) => {
                Some((Key::AttachedImu(sensor.clone()), true))
            }
            OutcomeKind::ModelSwapped(Model::Imu { unit, .. }) => Some((Key::Imu(unit.clone()), true)),
            OutcomeKind::ModelSwapped(Model::TrackerNoise { device, .. }) => {
                Some((Key::TrackerNoise(device.clone()), true))
            }
            OutcomeKind::ModelSwapped(Model::Field { .. }) => Some((Key::FieldMap, true)),
            OutcomeKind::Field(FieldNews::Progress(progress)) => {
                Some((Key::FieldProgress, progress.collecting))
            }
            OutcomeKind::Field(FieldNews::Warning(Warning::Disturbed { cause, sensors, active, .. })) => {
                Some((Key::Disturbed(*cause, *sensors), *active))
            }
            OutcomeKind::Field(FieldNews::Warning(Warning::Drifted { .. })) => Some((Key::Drifted, true)),
            OutcomeKind::ModelSwapped(Model::Exercise { exercise }) => {
                Some((Key::Exercise(exercise.name.clone()), true))
            }
            OutcomeKind::ModelSwapped(Model::Faults { .. }) => Some((Key::FaultMap, true)),
            OutcomeKind::Exercise(ExerciseOutcome { subject, what }) => match what {
                ExerciseWhat::State(_) => {
                    // It holds all counts so far.
                    self.holds.retain(|(key, _)| !matches!(key, Key::Count(of, _) if of == subject));
                    Some((Key::Subject(subject.clone()), true))
                }
                ExerciseWhat::Repetition(repetition) if repetition.kind == EventKind::Counted => {
                    Some((Key::Count(subject.clone(), repetition.exercise.clone()), true))
                }
                ExerciseWhat::Repetition(_) | ExerciseWhat::Hint(_) => None,
            },
            OutcomeKind::KeyPose(_) | OutcomeKind::Mark { .. } => None,
        };
        if matches!(state, Some((Key::FieldMap, _))) {
            // What watches over the field begins anew with each map.
            self.holds.retain(|(key, _)| !matches!(key, Key::Disturbed(..) | Key::Drifted));
        }
        if let Some((key, holds)) = state {
            self.holds.retain(|(other, _)| *other != key);
            if holds {
                self.holds.push((key, value()));
            }
        }
    }

    /// All that holds, in the order in which it was said.
    pub fn iter(&self) -> impl Iterator<Item = &T> {
        self.holds.iter().map(|(_, value)| value)
    }

    /// Nothing holds any more.
    pub fn clear(&mut self) {
        self.holds.clear();
    }
}
