//! A plan at work: one step after the other, with the rests between them.

use posed_protocol::PlanProgress;
use posed_sessions::Plan;
use posed_stage::input::{self, Model, Request};
use posed_stage::output::ExerciseState;

use super::super::fusion::Command;

/// A stage that has not taken up an exercise by then does not, s.
const TAKEN_UP_S: f64 = 5.0;

/// How far it is.
#[derive(Debug)]
pub(super) struct PlanRun {
    plan: Plan,
    /// The exercise of each step, where it is not loaded yet.
    models: Vec<Option<Model>>,
    step: usize,
    phase: Phase,
}

/// What is waited for.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// The stage takes the exercise up; since when, s.
    Selecting(f64),
    /// The sets are done.
    Training,
    /// The rest ends, s.
    Resting(f64),
    /// All steps are done.
    Done,
}

impl PlanRun {
    /// `models` are as many as the plan has steps.
    pub(super) fn new(plan: Plan, models: Vec<Option<Model>>, now_s: f64) -> Self {
        Self { plan, models, step: 0, phase: Phase::Selecting(now_s) }
    }

    pub(super) fn name(&self) -> &str {
        &self.plan.name
    }

    pub(super) fn is_done(&self) -> bool {
        self.phase == Phase::Done
    }

    /// Selects the exercise of the step that is at hand.
    pub(super) fn select(&self, subject: &str) -> Command {
        let step = &self.plan.steps[self.step];
        let request = Request::ExerciseSelect {
            subject: subject.to_owned(),
            exercises: vec![step.exercise.clone()],
            plan: input::Plan {
                repetitions: Some(step.repetitions),
                sets: Some(step.sets),
                rest_s: step.rest_s,
            },
            sensors: Default::default(),
            // A subject that is called as a body is that one.
            body: None,
        };
        let models = self.models[self.step].clone().into_iter().collect();
        Command::Request { request, models, reply: None }
    }

    /// Takes what the stage says of the subject; whether anything has changed.
    pub(super) fn progress(&mut self, state: &ExerciseState, now_s: f64) -> bool {
        let step = &self.plan.steps[self.step];
        let of_step = state.exercises.iter().find(|progress| progress.exercise == step.exercise);
        match (self.phase, of_step) {
            (Phase::Selecting(_), Some(progress)) if !progress.done => self.phase = Phase::Training,
            (Phase::Training, Some(progress)) if progress.done && self.step + 1 == self.plan.steps.len() => {
                self.phase = Phase::Done;
            }
            (Phase::Training, Some(progress)) if progress.done => {
                self.phase = Phase::Resting(now_s + step.rest_s);
                self.step += 1;
            }
            _ => return false,
        }
        true
    }

    /// What is to be selected now that it is so late.
    pub(super) fn tick(&mut self, subject: &str, now_s: f64) -> Option<Command> {
        match self.phase {
            Phase::Resting(until_s) if until_s <= now_s => {
                self.phase = Phase::Selecting(now_s);
                Some(self.select(subject))
            }
            _ => None,
        }
    }

    /// What stands against it.
    pub(super) fn problem(&self, now_s: f64) -> Option<String> {
        match self.phase {
            Phase::Selecting(since_s) if now_s > since_s + TAKEN_UP_S => {
                let exercise = &self.plan.steps[self.step].exercise;
                Some(format!("the stage does not take up {exercise:?}: exercise.select states why"))
            }
            _ => None,
        }
    }

    /// For the topic.
    pub(super) fn shown(&self) -> PlanProgress {
        PlanProgress {
            name: self.plan.name.clone(),
            step: self.step as u32 + 1,
            steps: self.plan.steps.len() as u32,
            exercise: self.plan.steps[self.step].exercise.clone(),
            rest_until_s: match self.phase {
                Phase::Resting(until_s) => Some(until_s),
                _ => None,
            },
        }
    }
}
