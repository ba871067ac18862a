//! What a pipeline says, as one's own: to hold two pipelines against each other.

use posed_drivers::State;
use posed_stage::output::{Body, Estimate, Outcome, Output};

/// An output of a pipeline.
#[derive(Clone, Debug, PartialEq)]
pub enum Said {
    /// [`Output::Estimate`].
    Estimate(Estimate),
    /// [`Output::Body`].
    Body(Box<Body>),
    /// [`Output::Outcome`].
    Outcome(Outcome),
    /// [`Output::Device`].
    State(u16, State),
    /// [`Output::Warning`].
    Warning(u16, String),
    /// [`Output::Transmit`].
    Transmit(u16, Vec<u8>),
    /// Anything else, in words.
    Other(String),
}

impl Said {
    /// An output, whatever it is.
    pub fn of(output: &Output<'_>) -> Self {
        match output {
            Output::Estimate(estimate) => Self::Estimate((*estimate).clone()),
            Output::Body(body) => Self::Body(Box::new((*body).clone())),
            Output::Outcome(outcome) => Self::Outcome((*outcome).clone()),
            Output::Device { device, state } => Self::State(*device, (*state).clone()),
            Output::Warning { device, text } => Self::Warning(*device, (*text).to_owned()),
            Output::Transmit { device, bytes } => Self::Transmit(*device, bytes.to_vec()),
            other => Self::Other(format!("{other:?}")),
        }
    }

    /// An output that says something of the tracking.
    pub fn of_tracking(output: &Output<'_>) -> Option<Self> {
        let is_of_tracking = matches!(
            output,
            Output::Estimate(_)
                | Output::Body(_)
                | Output::Outcome(_)
                | Output::Device { .. }
                | Output::Warning { .. }
        );
        is_of_tracking.then(|| Self::of(output))
    }
}
