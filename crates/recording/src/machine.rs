//! The machine that a recording's log is fed into: the pipeline and its publisher, as they stood when it began.

use posed_drivers::Timestamp;

use super::header::Header;
use super::replay::Replayable;
use posed_pipeline::{PipelineError, SupervisedPipeline};
use posed_protocol::{Fields, Payload, Publisher, unpack};
use posed_stage::input::Entry;
use posed_stage::{Problems, Stage};

/// Why a recording cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum MachineError {
    /// The stage file in the recording is not one of this version.
    #[error("the recording's stage file does not fit this version of posed; give one with --stage: {0}")]
    Stage(#[from] Problems),
    /// No pipeline can be made.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// The publisher's state cannot be read.
    #[error("the recording's snapshot cannot be read: {0}")]
    Snapshot(#[from] rmp_serde::decode::Error),
}

/// Pipeline and publisher of a replay.
pub struct Machine {
    /// Entries to outputs.
    pub pipeline: SupervisedPipeline,
    /// Outputs to messages.
    pub publisher: Publisher,
}

impl Machine {
    /// As it was recorded: says the same messages again, byte for byte. Returns the recorded stage too.
    ///
    /// # Errors
    /// The recording's stage file or snapshot is of another version, or no pipeline can be made.
    pub fn as_recorded(header: &Header) -> Result<(Stage, Self), MachineError> {
        let stage = Stage::parse(&header.stage_toml)?;
        let mut publisher = Publisher::new(&stage, Fields::all());
        let pipeline = match &header.snapshot {
            None => SupervisedPipeline::new(&stage)?,
            Some(snapshot) => {
                publisher.restore(unpack(&snapshot.publisher)?);
                SupervisedPipeline::restore(&stage, &header.models, &snapshot.pipeline)?
            }
        };
        Ok((stage, Self { pipeline, publisher }))
    }

    /// On another stage file: from the beginning of its own state, with the models that were swapped in before.
    ///
    /// A recording begun mid-run holds no set-up of its devices; on another stage file their sessions then follow
    /// what they see, as after a restart of the daemon beside running devices.
    ///
    /// # Errors
    /// No pipeline can be made of `stage`.
    pub fn on_stage(header: &Header, stage: &Stage) -> Result<Self, MachineError> {
        let mut pipeline = SupervisedPipeline::new(stage)?;
        for input in header.models.entries() {
            pipeline.push(&Entry { t: header.begun, input }, &mut |_| {});
        }
        Ok(Self { pipeline, publisher: Publisher::new(stage, Fields::all()) })
    }
}

impl Replayable for Machine {
    fn push(&mut self, entry: &Entry, publish: &mut dyn FnMut(&str, Timestamp, &[u8])) {
        let Self { pipeline, publisher } = self;
        pipeline.push(entry, &mut |output| {
            if let Some(payload) = Payload::of(&output) {
                let (stamp, message) = publisher.publish(&payload);
                publish(stamp.topic.name(), stamp.t(), message);
            }
        });
    }
}
