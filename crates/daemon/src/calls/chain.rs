//! `body.calibrate` on a stage with a chain of hinges: guides somebody through a posture and a movement, and finds the axes.
//!
//! In: samples from the fusion thread, while the job runs on a thread of its own. Out: what to do next, as the job's message; in
//! the end a model for the pipeline, through its log, or one sentence about what to repeat. Axes that are not known well enough
//! are not used.

use serde_json::{Map, json};

use super::super::fusion::{Command, FusionInbox};
use super::super::jobs::{Failure, Job};
use super::super::observers::ChainSource;
use super::super::server::Reply;
use super::Calls;
use super::guided::{self, Guided};
use posed_fusion::chain::{ChainSegment, Epoch, GOOD_DEG, Guide, calibrate};
use posed_stage::input::{Model, SensorIndex};
use posed_stage::layout::ChainLayout;

impl Calls {
    /// Begins a calibration of the chain.
    pub(super) fn calibrate_chain(&self, body: Option<String>, layout: ChainLayout, reply: Reply) {
        let ChainLayout { segments, imus } = layout;
        let session = Session { body, segments, imus, inbox: self.inbox.clone() };
        self.jobs.run("body.calibrate", reply, move |job| session.run(job));
    }
}

/// A calibration at work.
struct Session {
    /// Its name, where there are several.
    body: Option<String>,
    segments: Vec<ChainSegment>,
    imus: Vec<SensorIndex>,
    inbox: FusionInbox,
}

impl Session {
    fn run(self, job: &Job) -> Result<String, Failure> {
        let mut guide = Guide::default();
        let source = ChainSource { imus: self.imus };
        guided::run(&mut guide, job, &self.inbox, source)?;
        let calibration = calibrate(&self.segments, guide.recorded())
            .map_err(|error| format!("{error}; begin again, and move that joint more"))?;
        let hinges = self.segments.iter().zip(&calibration.segments).filter_map(|(segment, found)| {
            Some((segment.hinge.as_ref()?.1.clone(), found.hinge?.quality_deg))
        });
        let hinges: Vec<(String, f64)> = hinges.collect();
        let quality: Map<String, serde_json::Value> =
            hinges.iter().map(|(joint, quality_deg)| (joint.clone(), json!(quality_deg))).collect();
        job.result(json!({ "quality_deg": quality }));
        let worst = hinges.iter().max_by(|(_, a), (_, b)| a.total_cmp(b));
        if let Some((joint, quality_deg)) = worst.filter(|(_, quality_deg)| *quality_deg > GOOD_DEG) {
            return Err(format!(
                "the axis of {joint} is known to {quality_deg:.1} degrees only; begin again, bend that joint more, and turn the whole \
                 chain so that its axis does not stay level"
            ).into());
        }
        let calibration = Box::new(calibration);
        self.inbox.command(Command::load(Model::Chain { body: self.body, calibration }));
        let worst = worst.map_or_else(String::new, |(joint, quality_deg)| {
            format!("; the worst is {joint} with {quality_deg:.1} degrees")
        });
        Ok(format!("the axes of the chain are known{worst}"))
    }
}

impl Guided for Guide {
    type Source = ChainSource;
    const NAME: &'static str = "calibration";
    const UNCHANGED: &'static str = "the sensors count as they did before";
    const LONGEST_S: f64 = Guide::LONGEST_S;

    fn prompt(&self) -> Option<String> {
        self.prompt().map(str::to_owned)
    }

    fn report(&mut self, job: &Job, prompt: &str) {
        job.progress(Some(self.progress()), Some(prompt.to_owned()));
    }

    fn time_s(epoch: &Epoch) -> f64 {
        epoch.t_s
    }

    fn push(&mut self, epoch: Epoch) {
        self.push(epoch);
    }

    fn silence(&self) -> String {
        "no sensor sends anything; see to the devices".to_owned()
    }
}
