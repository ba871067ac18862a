//! All sessions there are, as one closed type: so that a pipeline is plain data.

use posed_drivers::Session;
use posed_drivers::flock::FlockSession;
use serde::{Deserialize, Serialize};

use super::PipelineError;
use crate::input::SensorIndex;
use crate::stage::{Device, Driver};

/// The session of one device.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) enum DeviceSession {
    Flock(Box<FlockSession>),
}

impl DeviceSession {
    /// A session for a device of the stage file and the addresses of its sensors.
    pub(super) fn new(device: &Device, sensors: &[(u16, SensorIndex)]) -> Result<Self, PipelineError> {
        match &device.driver {
            Driver::FlockOfBirds(settings) => {
                let wanted: Vec<u16> = sensors.iter().map(|&(address, _)| address).collect();
                FlockSession::new(settings.clone(), device.baud, &wanted)
                    .map(|session| Self::Flock(Box::new(session)))
                    .map_err(|source| PipelineError::Settings { device: device.name.clone(), source })
            }
        }
    }

    pub(super) fn get(&self) -> &dyn Session {
        match self {
            Self::Flock(session) => session.as_ref(),
        }
    }

    pub(super) fn get_mut(&mut self) -> &mut dyn Session {
        match self {
            Self::Flock(session) => session.as_mut(),
        }
    }
}
