//! Plans: which exercises, how many sets and repetitions, with how much rest.

use serde::{Deserialize, Serialize};

/// Steps of a plan at most.
const STEPS: usize = 64;
/// Longest name, bytes.
const NAME_BYTES: usize = 64;

/// A plan: its steps in order, each with all its sets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// Its name, 1 to 64 bytes.
    pub name: String,
    /// 1 to 64 of them.
    pub steps: Vec<PlanStep>,
}

/// One exercise of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlanStep {
    /// Name of the exercise.
    pub exercise: String,
    /// Sets, 1 to 100.
    pub sets: u32,
    /// Repetitions of each set, 1 to 1000.
    pub repetitions: u32,
    /// Rest after each set, s, 0 to 3600.
    #[serde(default)]
    pub rest_s: f64,
}

/// What is wrong with a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlanError {
    /// It has no name that serves.
    #[error("name: give {NAME}")]
    Name,
    /// It has no steps, or too many.
    #[error("steps: give 1 to {STEPS}")]
    Steps,
    /// A step has a value that does not serve.
    #[error("steps[{step}].{key}: give {expected}")]
    Step {
        /// Which step, from 0.
        step: usize,
        /// Which of its keys.
        key: &'static str,
        /// What serves.
        expected: &'static str,
    },
}

impl Plan {
    /// Whether it can be kept.
    ///
    /// # Errors
    /// What is wrong, with the place.
    pub fn check(&self) -> Result<(), PlanError> {
        if !is_name(&self.name) {
            return Err(PlanError::Name);
        }
        if !(1..=STEPS).contains(&self.steps.len()) {
            return Err(PlanError::Steps);
        }
        self.steps.iter().enumerate().try_for_each(|(step, of)| {
            let PlanStep { exercise, sets, repetitions, rest_s } = of;
            let wrong = |key, expected| Err(PlanError::Step { step, key, expected });
            match () {
                () if !is_name(exercise) => wrong("exercise", "the name of an exercise"),
                () if !(1..=100).contains(sets) => wrong("sets", "1 to 100"),
                () if !(1..=1000).contains(repetitions) => wrong("repetitions", "1 to 1000"),
                () if !(0.0..=3600.0).contains(rest_s) => wrong("rest_s", "0 to 3600 seconds"),
                () => Ok(()),
            }
        })
    }
}

/// What [`is_name`] wants, in words.
pub(crate) const NAME: &str = "1 to 64 bytes without control characters and spaces at the ends";

/// Whether a person, a plan or an exercise can have this name.
pub(crate) fn is_name(name: &str) -> bool {
    name.trim() == name && (1..=NAME_BYTES).contains(&name.len()) && !name.chars().any(char::is_control)
}
