//! What the stage file may say about a Flock of Birds.

use posed_state::Plain;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::family::Family;
use super::wire::{Addressing, Format, Hemisphere, QuaternionSense, Range, ReportRate, Shape};

/// Settings of one Flock; every key has a default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Plain)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Which units: a Flock, or `3d-guidance` for trakSTAR and driveBAY at their RS-232 port (inferred, never tried on a real unit).
    pub family: Family,
    /// What each bird's records hold.
    pub format: Format,
    /// Full scale of positions in inches, 36, 72 or 144; absent: 144 with an extended range controller, else 36.
    pub range_in: Option<Range>,
    /// The half-space around the transmitter in which the sensors start.
    pub hemisphere: Hemisphere,
    /// Records are sent every 1, 2, 8 or 32 measurement cycles.
    pub report_every_cycles: ReportRate,
    /// Measurement rate to set, Hz, 14 to 144, of a 3D Guidance unit 20 to 255; absent: as the unit has it.
    #[schemars(range(min = 14.0, max = 255.0))]
    pub measurement_rate_hz: Option<f64>,
    /// Whether the unit streams, is asked for each record, or is only listened to.
    pub mode: Mode,
    /// Which rotation the quaternion on the wire describes.
    pub quaternion_sense: QuaternionSense,
    /// Whether records carry a button byte.
    pub button: bool,
    /// Filters to set; absent: as the unit has them.
    pub filters: Option<Filters>,
    /// Unit whose transmitter is used; absent: the first one found.
    #[schemars(range(min = 1, max = 15))]
    pub transmitter_address: Option<u8>,
    /// Number of that transmitter at its unit, 0 to 3.
    #[schemars(range(max = 3))]
    pub transmitter_number: u8,
    /// Units on the bus, controllers included; absent: as many as answer.
    #[schemars(range(min = 1, max = 126))]
    pub units: Option<u8>,
    /// How units are numbered; absent: as the unit is set.
    pub addressing: Option<Addressing>,
    /// Whether RTS resets the unit when the port opens, where the line exists; never a 3D Guidance unit.
    pub reset_on_open: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            family: Family::Flock,
            format: Format::PositionQuaternion,
            range_in: None,
            hemisphere: Hemisphere::Forward,
            report_every_cycles: ReportRate::Every,
            measurement_rate_hz: None,
            mode: Mode::Stream,
            quaternion_sense: QuaternionSense::Vendor,
            button: false,
            filters: None,
            transmitter_address: None,
            transmitter_number: 0,
            units: None,
            addressing: None,
            reset_on_open: true,
        }
    }
}

impl Settings {
    /// Checks values that the types cannot.
    ///
    /// # Errors
    /// The first value out of its range, by key.
    pub fn validate(&self) -> Result<(), SettingsError> {
        let check = |key, ok: bool, expected| if ok { Ok(()) } else { Err(SettingsError { key, expected }) };
        let rate = self.measurement_rate_hz;
        if self.family == Family::Guidance {
            const NONE: &str = "left out: a 3D Guidance unit is not known to have it";
            check(
                "measurement_rate_hz",
                rate.is_none_or(|hz| self.family.rates_hz().contains(&hz)),
                "20 to 255",
            )?;
            check(
                "format",
                self.family.has_format(self.format),
                "position-angles, position-matrix or position-quaternion of a 3D Guidance unit",
            )?;
            check(
                "hemisphere",
                self.family.has_hemisphere(self.hemisphere),
                "forward or aft of a 3D Guidance unit",
            )?;
            check("range_in", self.range_in != Some(Range::In144), "36 or 72 of a 3D Guidance unit")?;
            check("report_every_cycles", self.report_every_cycles == ReportRate::Every, NONE)?;
            check("button", !self.button, NONE)?;
            check("filters", self.filters.is_none(), NONE)?;
            check("transmitter_address", self.transmitter_address.is_none(), NONE)?;
            check("units", self.units.is_none(), NONE)?;
            return check("addressing", self.addressing.is_none(), NONE);
        }
        check("measurement_rate_hz", rate.is_none_or(|hz| (14.0..=144.0).contains(&hz)), "14 to 144")?;
        check("units", self.units.is_none_or(|n| (1..=126).contains(&n)), "1 to 126")?;
        check("transmitter_number", self.transmitter_number <= 3, "0 to 3")?;
        check(
            "transmitter_address",
            self.transmitter_address.is_none_or(|n| (1..=15).contains(&n)),
            "1 to 15",
        )
    }

    /// Shape of every record.
    pub(super) fn shape(&self, group: bool) -> Shape {
        Shape { format: self.format, button: self.button, group }
    }
}

/// A setting out of its range, of this driver or another: the first one that was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("{key} must be {expected}")]
pub struct SettingsError {
    /// The key as the stage file names it.
    pub key: &'static str,
    /// What it may be, in words.
    pub expected: &'static str,
}

/// How records are got.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Plain)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// The unit sends each cycle by itself.
    #[default]
    Stream,
    /// The driver asks for each cycle once the one before has come. An answer holds what the unit measured last, so that its
    /// capture time may be late by up to a cycle, which no stated uncertainty shows.
    Point,
    /// The driver sends nothing and takes what comes: another program has set the unit up as the stage file specifies.
    Listen,
}

/// The unit's own filters; `true` = on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Plain)]
#[serde(deny_unknown_fields)]
pub struct Filters {
    /// Adaptive low-pass filter.
    pub dc: bool,
    /// Wide mains notch filter.
    pub ac_wide_notch: bool,
    /// Narrow mains notch filter.
    pub ac_narrow_notch: bool,
}

impl Filters {
    /// Value of parameter 4, where 1 means off.
    pub(super) fn word(self) -> u16 {
        u16::from(!self.dc) | u16::from(!self.ac_wide_notch) << 1 | u16::from(!self.ac_narrow_notch) << 2
    }
}
