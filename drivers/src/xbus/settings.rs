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
}

impl Default for Settings {
    fn default() -> Self {
        Self { rate_hz: 100.0, orientation: true }
    }
}

impl Settings {
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
