//! Why a request or a model is not taken.

use posed_motion::exercise::CounterError;
use posed_stage::WhichBody;

impl From<WhichBody> for InputError {
    fn from(which: WhichBody) -> Self {
        match which {
            WhichBody::Unknown(name) => Self::NoBody(name),
            WhichBody::Several => Self::WhichBody,
        }
    }
}

/// What stands against a request or a model; each is a sentence for whoever sent it.
#[derive(Debug, thiserror::Error)]
pub enum InputError {
    /// A value out of its range.
    #[error("{key}: give {expected}")]
    OutOfRange {
        /// The value's key; several, where it may be any of them.
        key: &'static str,
        /// What it may be.
        expected: String,
    },
    /// The numbers make no model.
    #[error("{0}")]
    NoModel(String),
    /// As many are there as can be.
    #[error("{key}: there are {limit} {key}s already")]
    Full {
        /// The key of what is full.
        key: &'static str,
        /// How many.
        limit: usize,
    },
    /// As many exercises are loaded as can be.
    #[error("there are {0} exercises already: load it under the name of one of them")]
    Loaded(usize),
    /// More exercises than one subject can be counted in.
    #[error("exercises: at most {0} at once")]
    Selected(usize),
    /// An exercise stands there twice.
    #[error("exercises: {0:?} stands there twice")]
    Twice(String),
    /// An exercise is not loaded.
    #[error("exercises: no exercise {0:?} is loaded")]
    NotLoaded(String),
    /// The stage lacks a sensor.
    #[error("sensors: this stage has no sensor {0:?}")]
    NoSensor(String),
    /// The stage lacks a body.
    #[error("body: this stage has no body {0:?}")]
    NoBody(String),
    /// Several could be meant.
    #[error("body: several people are on this stage: say whom it is about")]
    WhichBody,
    /// No exercise was taught with the sensors that others are to stand for.
    #[error("sensors: these exercises were taught with none of them")]
    TaughtWithOthers,
    /// The exercises cannot be counted in what the stage tracks, or not at once.
    #[error(transparent)]
    Counter(#[from] CounterError),
    /// All subjects together cost too much.
    #[error(
        "exercises: counting them beside those of all other subjects takes more memory or time than a stage has; \
         select fewer"
    )]
    TooCostly,
    /// Nobody of this name is counted.
    #[error("subject: nothing is counted for {0:?}")]
    NoSubject(String),
    /// Nobody wears an IMU whose heading a person could tell.
    #[error("{0}")]
    NoHeading(&'static str),
    /// The exercises have no such request.
    #[error("this is no request about exercises")]
    NotAboutExercises,
}
