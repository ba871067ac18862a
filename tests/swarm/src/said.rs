//! What a pipeline reports, as one's own, to hold two pipelines against each other.

use posed_stage::output::{Body, Estimate, Outcome, Output};

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Said {
    Estimate(Estimate),
    Body(Box<Body>),
    Outcome(Box<Outcome>),
    Transmit(u16, Vec<u8>),
    /// Anything else, in words.
    Other(String),
}

impl Said {
    pub(crate) fn of(output: &Output<'_>) -> Self {
        match output {
            Output::Estimate(estimate) => Self::Estimate((*estimate).clone()),
            Output::Body(body) => Self::Body(Box::new((*body).clone())),
            Output::Outcome(outcome) => Self::Outcome(Box::new((*outcome).clone())),
            Output::Transmit { device, bytes } => Self::Transmit(*device, bytes.to_vec()),
            other => Self::Other(format!("{other:?}")),
        }
    }
}
