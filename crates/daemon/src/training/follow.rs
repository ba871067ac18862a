//! The end on the fusion thread.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use crossbeam_channel::Sender;

use super::super::observers::{Observer, Times};
use super::Shared;
use posed_pipeline::Pipeline;
use posed_sessions::{Follower, Repetition};
use posed_stage::output::{ExerciseOutcome, ExerciseState, ExerciseWhat, Outcome, OutcomeKind, Output};
use posed_stage::{LoadedModels, Stage};

/// What the fusion thread reports.
#[derive(Debug)]
pub(super) enum Report {
    /// A repetition was counted or rejected.
    Repetition(Box<Repetition>),
    /// How far a subject is.
    Progress {
        /// Who.
        subject: String,
        /// How far.
        state: ExerciseState,
    },
    /// A recording runs from now on, or none does.
    Recording(Option<String>),
}

/// Follows the pipeline's outputs on the fusion thread.
#[derive(Debug)]
pub(crate) struct Follow {
    follower: Follower,
    to: Sender<Report>,
    shared: Arc<Shared>,
    /// Capture time of the newest frame, ns.
    newest_ns: i64,
    /// The recording that was reported last.
    recording: Option<String>,
}

impl Follow {
    /// Exercises come as outputs, as all that is swapped in.
    pub(super) fn new(stage: &Stage, to: Sender<Report>, shared: Arc<Shared>) -> Self {
        Self {
            follower: Follower::new(stage, &LoadedModels::default()),
            to,
            shared,
            newest_ns: 0,
            recording: None,
        }
    }

    /// The recording that runs now.
    pub(crate) fn recording(&mut self, name: Option<&str>) {
        if self.recording.as_deref() != name {
            self.recording = name.map(str::to_owned);
            self.report(Report::Recording(self.recording.clone()));
        }
    }

    fn report(&self, report: Report) {
        if self.to.try_send(report).is_err() {
            self.shared.lost.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Observer for Follow {
    fn on_output(&mut self, output: &Output<'_>, _times: &Times) {
        match output {
            Output::Estimate(estimate) => self.newest_ns = estimate.t_valid.as_nanos(),
            Output::Outcome(Outcome {
                what: OutcomeKind::Exercise(ExerciseOutcome { subject, what: ExerciseWhat::State(state) }),
                ..
            }) => self.report(Report::Progress { subject: subject.to_string(), state: state.clone() }),
            _ => {}
        }
        if let Some(repetition) = self.follower.output(output) {
            self.report(Report::Repetition(Box::new(repetition)));
        }
    }

    fn after_entry(&mut self, _pipeline: &Pipeline) {
        // All that was decided until then has been reported.
        self.shared.decided_ns.store(self.newest_ns, Ordering::Release);
    }
}
