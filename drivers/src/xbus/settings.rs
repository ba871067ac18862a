//! What the stage file reports about an Xbus device.

use posed_state::Plain;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::flock::SettingsError;

/// Settings of an Xbus device; every key has a default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Plain)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Measurement rate, Hz, 5 to 2000; a slower one is taken, with a warning, where line or device need it.
    #[schemars(range(min = 5.0, max = 2000.0))]
    pub rate_hz: f64,
    /// Whether the device also sends the orientation that it computes.
    pub orientation: bool,
    /// What a sample is of the time since the one before; the mean is true half a period before its end.
    pub sampling: Sampling,
}

/// What the rates and accelerations of a sample are of its period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Plain)]
#[serde(rename_all = "lowercase")]
pub enum Sampling {
    /// Their values at its end.
    #[default]
    Instantaneous,
    /// Their means: of units that integrate inside.
    Mean,
}

impl Default for Settings {
    fn default() -> Self {
        Self { rate_hz: 100.0, orientation: true, sampling: Sampling::default() }
    }
}

impl Settings {
    /// How long before the end of its period a sample is true, s.
    pub fn averaging_s(&self) -> f64 {
        match self.sampling {
            Sampling::Instantaneous => 0.0,
            Sampling::Mean => 0.5 / self.rate_hz,
        }
    }

    /// Checks values that the types cannot.
    ///
    /// # Errors
    /// The first value out of its range, by key.
    pub fn validate(&self) -> Result<(), SettingsError> {
        if (5.0..=2000.0).contains(&self.rate_hz) {
            Ok(())
        } else {
            Err(SettingsError { key: "rate_hz", expected: "5 to 2000" })
        }
    }
}
