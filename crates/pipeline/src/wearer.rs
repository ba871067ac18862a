//! Who wears sensors of the stage: a human body or a chain of hinges, one of each `[[body]]`.
//!
//! What comes in: closed frames and their estimates; how sensors sit, as a model. What goes out: a body, if there is news of it. What it never does: look at
//! sensors that somebody else wears.

use nalgebra::Vector3;
use posed_state::State;

use super::PipelineError;
use super::body::BodyStage;
use super::chain::ChainStage;
use super::status::BodyStatus;
use crate::frame::Frame;
use posed_stage::input::SensorIndex;
use posed_stage::output::{Body, Estimate};
use posed_stage::{BodyIndex, Stage};

/// One of a stage's bodies. It has one skeleton, or none where it wears no sensor.
#[derive(Clone, Debug, State)]
pub(super) struct Wearer {
    #[state(keep)]
    pub(super) name: String,
    /// Boxed, as is the chain: both are large, and a body is one of them at most.
    #[state(each)]
    pub(super) human: Option<Box<BodyStage>>,
    #[state(each)]
    pub(super) chain: Option<Box<ChainStage>>,
}

impl Wearer {
    pub(super) fn new(stage: &Stage, index: BodyIndex) -> Result<Self, PipelineError> {
        Ok(Self {
            name: stage.bodies[usize::from(index)].name.clone(),
            human: BodyStage::new(stage, index)?.map(Box::new),
            chain: ChainStage::new(stage, index).map(Box::new),
        })
    }

    /// Takes a closed frame; the body, if there is news of it.
    pub(super) fn frame(&mut self, frame: &Frame, estimate: &Estimate) -> Option<&Body> {
        match (&mut self.human, &mut self.chain) {
            (Some(human), _) => human.frame(frame, estimate),
            (None, Some(chain)) => chain.frame(frame),
            (None, None) => None,
        }
    }

    /// The latest body; none before the first.
    pub(super) fn latest(&self) -> Option<&Body> {
        let human = self.human.as_ref().and_then(|human| human.latest());
        human.or_else(|| self.chain.as_ref().and_then(|chain| chain.latest()))
    }

    /// A sensor's samples are corrected otherwise from now on.
    pub(super) fn restart(&mut self, sensor: SensorIndex) {
        self.human.iter_mut().for_each(|human| human.restart(sensor));
        self.chain.iter_mut().for_each(|chain| chain.restart(sensor));
    }

    /// See [`BodyStage::brought_by_feet`].
    pub(super) fn brought_by_feet(&self) -> impl Iterator<Item = (SensorIndex, Vector3<f64>)> {
        self.human.iter().flat_map(|human| human.brought_by_feet())
    }

    /// The IMU whose taps say that headings begin anew, if it was tapped since somebody asked.
    pub(super) fn take_tapped(&mut self) -> Option<SensorIndex> {
        self.human.as_mut()?.take_tapped()
    }

    /// The headings of this IMU, or of all, that no field identifies begin anew: see [`BodyStage::reset_heading`]. False where there is none.
    pub(super) fn reset_heading(&mut self, sensor: Option<SensorIndex>, heading_rad: f64) -> bool {
        self.human.as_mut().is_some_and(|human| human.reset_heading(sensor, heading_rad))
    }

    /// `None` where it wears no sensor.
    pub(super) fn status(&self) -> Option<BodyStatus> {
        if let Some(human) = &self.human {
            return Some(BodyStatus { mounted: human.is_mounted(), faults: human.faults().collect() });
        }
        let chain = self.chain.as_ref()?;
        Some(BodyStatus { mounted: chain.is_mounted(), faults: Vec::new() })
    }
}
