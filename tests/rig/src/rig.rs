//! A pipeline with its virtual stage.

use posed_drivers::Timestamp;
use posed_pipeline::{Pipeline, SupervisedPipeline};
use posed_simulator::scenario::Scenario;
use posed_stage::Stage;
use posed_stage::input::{Entry, Input};
use posed_stage::output::{Estimate, Output};

use crate::{Host, Said, simulate};

/// A pipeline with its virtual stage.
pub struct Rig {
    /// The devices, and who reads them.
    pub host: Host,
    /// What is tested.
    pub pipeline: SupervisedPipeline,
    /// All that the pipeline was given.
    pub log: Vec<Entry>,
    /// What it said of the tracking.
    pub emitted: Vec<Said>,
    /// When each of it was said.
    pub said_at: Vec<Timestamp>,
}

impl Rig {
    /// A stage at time zero, whose lines have just opened.
    pub fn new(stage: &Stage, scenario: &Scenario) -> Self {
        let mut rig = Self {
            host: Host::new(simulate(stage, scenario), vec![false; stage.devices.len()]),
            pipeline: SupervisedPipeline::new(stage).unwrap(),
            log: Vec::new(),
            emitted: Vec::new(),
            said_at: Vec::new(),
        };
        for input in rig.host.opened() {
            rig.push(input);
        }
        rig
    }

    /// Lets time pass.
    pub fn run_until(&mut self, seconds: f64) {
        let end = Timestamp::from_secs_f64(seconds);
        while let Some(input) = self.host.next(self.pipeline.poll_timeout(), end) {
            self.push(input);
        }
    }

    /// Forgets what has been read and said up to now.
    pub fn forget(&mut self) {
        self.host.truth = Vec::new();
        self.host.losses = Vec::new();
        self.log = Vec::new();
        self.emitted = Vec::new();
        self.said_at = Vec::new();
    }

    /// Gives the pipeline something now.
    pub fn push(&mut self, input: Input) {
        let entry = Entry { t: self.host.now, input };
        let Self { pipeline, host, emitted, said_at, .. } = self;
        pipeline.push(&entry, &mut |output| {
            if let Output::Transmit { device, bytes } = &output {
                host.devices.write(usize::from(*device), host.now, bytes);
            }
            emitted.extend(Said::of_tracking(&output));
            said_at.resize(emitted.len(), host.now);
        });
        self.log.push(entry);
    }

    /// Of what was said, the frames.
    pub fn estimates(&self) -> impl Iterator<Item = &Estimate> {
        self.emitted.iter().filter_map(|emitted| match emitted {
            Said::Estimate(estimate) => Some(estimate),
            _ => None,
        })
    }
}

/// What a pipeline says of the tracking when it is given these entries.
pub fn replay(pipeline: &mut Pipeline, log: &[Entry]) -> Vec<Said> {
    let mut emitted = Vec::new();
    for entry in log {
        pipeline.push(entry, &mut |output| emitted.extend(Said::of_tracking(&output)));
    }
    emitted
}
