//! Which of the maker's units it is, and where they differ.
//!
//! What is known of a 3D Guidance unit comes from two published drivers of its USB port. That its RS-232 port speaks the same
//! commands, and streams records with addresses like a Flock, is inferred; no real unit was met. Only what both show is used: three
//! formats, two hemispheres, EXAMINE and CHANGE of the parameters in [`Family::knows`].

use std::ops::RangeInclusive;
use std::time::Duration;

use posed_state::Plain;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::wire::value::{self, Parameter, parameter};
use super::wire::{Addressing, Format, Hemisphere};

/// A family of units that share commands, words and error codes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Plain)]
#[serde(rename_all = "kebab-case")]
pub enum Family {
    /// A Flock of Birds: a unit for each sensor, on a common bus.
    #[default]
    Flock,
    /// 3D Guidance, that is trakSTAR or driveBAY: one unit with four inputs for sensors, which have the addresses 1 to 4.
    #[serde(rename = "3d-guidance")]
    Guidance,
}

/// Inputs for sensors of a 3D Guidance unit, by their addresses.
pub const INPUTS: RangeInclusive<u8> = 1..=4;
/// What a Flock and the units like it write as their model (parameter 15), without padding.
const FLOCK_MODELS: [&str; 7] = ["6DFOB", "6DERC", "6DBOF", "PCBIRD", "SPACEPAD", "MOTIONSTAR", "WIRELESS"];

impl Family {
    /// Whether a unit of this model can be a 3D Guidance unit: what such a unit writes is not known, what a Flock writes is.
    pub fn may_be_guidance(model: &str) -> bool {
        !model.is_empty() && !FLOCK_MODELS.contains(&model)
    }

    /// Measurement rates that a unit can have, Hz.
    pub const fn rates_hz(self) -> RangeInclusive<f64> {
        match self {
            Self::Flock => value::RATES_HZ,
            Self::Guidance => 20.0..=255.0,
        }
    }

    /// Measurement rate after power-up, Hz: taken where a unit does not report its own.
    pub const fn power_up_rate_hz(self) -> f64 {
        match self {
            Self::Flock => 103.3,
            Self::Guidance => 80.0,
        }
    }

    /// How long after its port was opened a unit may be starting.
    pub(super) const fn power_up(self) -> Duration {
        match self {
            Self::Flock => Duration::from_secs(3),
            Self::Guidance => Duration::from_secs(10),
        }
    }

    /// Whether a unit has a record format.
    pub const fn has_format(self, format: Format) -> bool {
        matches!(self, Self::Flock) || format.has_position() && format.has_orientation()
    }

    /// Whether a unit has a hemisphere.
    pub const fn has_hemisphere(self, hemisphere: Hemisphere) -> bool {
        matches!(self, Self::Flock) || matches!(hemisphere, Hemisphere::Forward | Hemisphere::Aft)
    }

    /// Whether a unit has a parameter; of a Flock old firmware lacks some.
    pub const fn knows(self, number: u8) -> bool {
        matches!(self, Self::Flock)
            || matches!(
                number,
                0x00 | 0x01 | 0x03 | 0x04 | 0x07 | 0x0A | 0x0E..=0x10 | 0x14 | 0x19..=0x1B | 0x23 | 0x32
            )
    }

    /// Bytes of data that CHANGE VALUE takes; `None` where the parameter is read-only.
    pub fn write_len(self, of: &Parameter, addressing: Addressing) -> Option<usize> {
        match (self, of.number) {
            (Self::Guidance, parameter::POSITION_SCALING) => Some(1),
            _ => of.write_len(addressing),
        }
    }
}
