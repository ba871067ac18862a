//! Plans: which exercises, how many sets and repetitions, with how much rest.

use serde::{Deserialize, Serialize};

/// Steps of a plan at most.
const STEPS: usize = 64;
/// Longest name, bytes.
pub(crate) const NAME_BYTES: usize = 64;

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

impl Plan {
    /// Whether it can be kept.
    ///
    /// # Errors
    /// What is wrong, with the place.
    pub fn check(&self) -> Result<(), String> {
        check_name(&self.name).map_err(|reason| format!("name: {reason}"))?;
        if !(1..=STEPS).contains(&self.steps.len()) {
            return Err(format!("steps: give 1 to {STEPS}"));
        }
        self.steps.iter().enumerate().try_for_each(|(at, step)| {
            let PlanStep { exercise, sets, repetitions, rest_s } = step;
            let wrong = |what: &str| Err(format!("steps[{at}].{what}"));
            match () {
                () if check_name(exercise).is_err() => wrong("exercise: give the name of an exercise"),
                () if !(1..=100).contains(sets) => wrong("sets: give 1 to 100"),
                () if !(1..=1000).contains(repetitions) => wrong("repetitions: give 1 to 1000"),
                () if !(0.0..=3600.0).contains(rest_s) => wrong("rest_s: give 0 to 3600 seconds"),
                () => Ok(()),
            }
        })
    }
}

/// Whether a person, a plan or an exercise can have this name.
pub(crate) fn check_name(name: &str) -> Result<(), String> {
    if name.trim() != name || name.is_empty() || name.len() > NAME_BYTES || name.chars().any(char::is_control)
    {
        return Err(format!(
            "give 1 to {NAME_BYTES} bytes without control characters and spaces at the ends"
        ));
    }
    Ok(())
}
