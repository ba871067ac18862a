//! The bytes of a Flock of Birds, both ways: records, commands, parameters.
//!
//! What comes in: slices of bytes, or poses and commands. What goes out: the other of the two. What it
//! never does: keep state between calls, apart from [`CommandParser`], which holds one unfinished command.
//! Device units (inches, degrees, counts) end here; everything outside is SI.

pub mod command;
pub mod record;
pub mod rotation;
pub mod value;

use std::fmt;

use posed_state::Plain;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use command::{Addressed, Command, CommandParser, Refused};
pub use record::{Record, RecordError, Scale, Shape, Tolerance};
pub use value::{BirdStatus, UnitStatus};

/// What a bird's record holds.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, JsonSchema, Plain,
)]
#[serde(rename_all = "kebab-case")]
pub enum Format {
    /// x, y, z.
    Position,
    /// Azimuth, elevation, roll.
    Angles,
    /// Rotation matrix, nine words.
    Matrix,
    /// Quaternion, scalar first.
    Quaternion,
    /// Position, then angles: the power-up format.
    PositionAngles,
    /// Position, then matrix.
    PositionMatrix,
    /// Position, then quaternion.
    PositionQuaternion,
}

impl Format {
    /// All formats, in the order of their command bytes.
    pub const ALL: [Self; 7] = [
        Self::Position,
        Self::Angles,
        Self::Matrix,
        Self::PositionAngles,
        Self::PositionMatrix,
        Self::Quaternion,
        Self::PositionQuaternion,
    ];

    /// The byte that selects the format.
    pub const fn command(self) -> u8 {
        match self {
            Self::Position => 0x56,
            Self::Angles => 0x57,
            Self::Matrix => 0x58,
            Self::PositionAngles => 0x59,
            Self::PositionMatrix => 0x5A,
            Self::Quaternion => 0x5C,
            Self::PositionQuaternion => 0x5D,
        }
    }

    /// The format selected by a command byte; `None` for a byte that selects none.
    pub fn from_command(byte: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.command() == byte)
    }

    /// Code of the format in bits 4 to 1 of the bird status word; MotionStar uses the same codes.
    pub const fn status_code(self) -> u8 {
        match self {
            Self::Position => 1,
            Self::Angles => 2,
            Self::Matrix => 3,
            Self::PositionAngles => 4,
            Self::PositionMatrix => 5,
            Self::Quaternion => 7,
            Self::PositionQuaternion => 8,
        }
    }

    /// The format named by bits 4 to 1 of the bird status word, given as a number; `None` for a code of no format.
    pub fn from_status_code(code: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.status_code() == code)
    }

    /// Whether records hold x, y, z.
    pub const fn has_position(self) -> bool {
        matches!(
            self,
            Self::Position | Self::PositionAngles | Self::PositionMatrix | Self::PositionQuaternion
        )
    }

    /// Whether records hold an orientation in any form.
    pub const fn has_orientation(self) -> bool {
        !matches!(self, Self::Position)
    }

    /// Number of words of a record: 14 bits each from a Flock, 16 from a MotionStar.
    pub const fn words(self) -> usize {
        match self {
            Self::Position | Self::Angles => 3,
            Self::Quaternion => 4,
            Self::PositionAngles => 6,
            Self::PositionQuaternion => 7,
            Self::Matrix => 9,
            Self::PositionMatrix => 12,
        }
    }

    /// Name as in files: `position-quaternion` and so on.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Position => "position",
            Self::Angles => "angles",
            Self::Matrix => "matrix",
            Self::Quaternion => "quaternion",
            Self::PositionAngles => "position-angles",
            Self::PositionMatrix => "position-matrix",
            Self::PositionQuaternion => "position-quaternion",
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Full scale of the position words.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema, Plain)]
#[serde(try_from = "u16", into = "u16")]
#[schemars(with = "u16", extend("enum" = [36, 72, 144]))]
pub enum Range {
    /// Standard transmitter, parameter 3 = 0.
    #[default]
    In36,
    /// Standard transmitter, parameter 3 = 1.
    In72,
    /// Extended range transmitter, whatever parameter 3 says.
    In144,
}

impl Range {
    /// Full scale in inches.
    pub const fn inches(self) -> u16 {
        match self {
            Self::In36 => 36,
            Self::In72 => 72,
            Self::In144 => 144,
        }
    }

    /// Full scale in metres: the position of a word at its limit, to either side.
    pub fn metres(self) -> f64 {
        f64::from(self.inches()) * 0.0254
    }
}

impl From<Range> for u16 {
    fn from(range: Range) -> Self {
        range.inches()
    }
}

impl TryFrom<u16> for Range {
    type Error = String;
    fn try_from(inches: u16) -> Result<Self, String> {
        match inches {
            36 => Ok(Self::In36),
            72 => Ok(Self::In72),
            144 => Ok(Self::In144),
            other => Err(format!("a Flock's range is 36, 72 or 144 inches, not {other}")),
        }
    }
}

/// Which rotation the quaternion on the wire describes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Plain)]
#[serde(rename_all = "kebab-case")]
pub enum QuaternionSense {
    /// The vendor's matrix, transmitter to sensor: conjugated when decoded.
    #[default]
    Vendor,
    /// Sensor to transmitter, taken as it comes.
    Direct,
}

/// The half-space around the transmitter in which a sensor is taken to be. +z points down.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Plain)]
#[serde(rename_all = "kebab-case")]
pub enum Hemisphere {
    /// +x, the power-up choice.
    #[default]
    Forward,
    /// -x.
    Aft,
    /// +y.
    Right,
    /// -y.
    Left,
    /// +z.
    Lower,
    /// -z.
    Upper,
}

impl Hemisphere {
    /// All six.
    pub const ALL: [Self; 6] = [Self::Forward, Self::Aft, Self::Right, Self::Left, Self::Lower, Self::Upper];

    /// The two data bytes of the command and of parameter 22: axis, sign.
    pub const fn bytes(self) -> [u8; 2] {
        match self {
            Self::Forward => [0x00, 0x00],
            Self::Aft => [0x00, 0x01],
            Self::Right => [0x06, 0x00],
            Self::Left => [0x06, 0x01],
            Self::Lower => [0x0C, 0x00],
            Self::Upper => [0x0C, 0x01],
        }
    }

    /// The hemisphere named by two data bytes; `None` for others than the six pairs.
    pub fn from_bytes(bytes: [u8; 2]) -> Option<Self> {
        Self::ALL.into_iter().find(|hemisphere| hemisphere.bytes() == bytes)
    }

    /// Unit vector into the half-space, transmitter axes (x forward, y right, z down).
    pub const fn direction(self) -> [f64; 3] {
        match self {
            Self::Forward => [1.0, 0.0, 0.0],
            Self::Aft => [-1.0, 0.0, 0.0],
            Self::Right => [0.0, 1.0, 0.0],
            Self::Left => [0.0, -1.0, 0.0],
            Self::Lower => [0.0, 0.0, 1.0],
            Self::Upper => [0.0, 0.0, -1.0],
        }
    }
}

/// How units on the intra-bird bus are numbered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Plain)]
#[serde(rename_all = "kebab-case")]
pub enum Addressing {
    /// Addresses 1 to 14.
    #[default]
    Normal,
    /// Addresses 1 to 30.
    Expanded,
    /// Addresses 1 to 126.
    SuperExpanded,
}

impl Addressing {
    /// Highest address of a unit, and length of the flock system status.
    pub const fn max_address(self) -> u8 {
        match self {
            Self::Normal => 14,
            Self::Expanded => 30,
            Self::SuperExpanded => 126,
        }
    }

    /// Value of parameter 19.
    pub const fn code(self) -> u8 {
        match self {
            Self::Normal => 0,
            Self::Expanded => 1,
            Self::SuperExpanded => 3,
        }
    }

    /// The mode named by the value of parameter 19; `None` for 2 and what is above 3.
    pub const fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Self::Normal),
            1 => Some(Self::Expanded),
            3 => Some(Self::SuperExpanded),
            _ => None,
        }
    }

    /// Appends the prefix that hands the next command, and only that, to the unit `address`; one byte, or two for addresses
    /// above 31 and in super-expanded mode. Whether the mode has such an address is not checked.
    pub fn prefix(self, address: u8, out: &mut Vec<u8>) {
        match (self, address) {
            (Self::SuperExpanded, _) => out.extend([0xA0, address]),
            (_, 0..=15) => out.push(0xF0 + address),
            (_, 16..=31) => out.push(0xE0 + (address - 16)),
            (_, _) => out.extend([0xA0, address]),
        }
    }
}

/// How often a unit streams, in measurement cycles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Plain)]
#[serde(try_from = "u16", into = "u16")]
#[schemars(with = "u16", extend("enum" = [1, 2, 8, 32]))]
pub enum ReportRate {
    /// Every cycle.
    #[default]
    Every,
    /// Every second cycle.
    Every2,
    /// Every eighth cycle.
    Every8,
    /// Every 32nd cycle.
    Every32,
}

impl ReportRate {
    /// Measurement cycles from one report to the next.
    pub const fn cycles(self) -> u16 {
        match self {
            Self::Every => 1,
            Self::Every2 => 2,
            Self::Every8 => 8,
            Self::Every32 => 32,
        }
    }

    /// The byte that selects it: `Q`, `R`, `S`, `T`.
    pub const fn command(self) -> u8 {
        match self {
            Self::Every => b'Q',
            Self::Every2 => b'R',
            Self::Every8 => b'S',
            Self::Every32 => b'T',
        }
    }
}

impl From<ReportRate> for u16 {
    fn from(rate: ReportRate) -> Self {
        rate.cycles()
    }
}

impl TryFrom<u16> for ReportRate {
    type Error = String;
    fn try_from(cycles: u16) -> Result<Self, String> {
        match cycles {
            1 => Ok(Self::Every),
            2 => Ok(Self::Every2),
            8 => Ok(Self::Every8),
            32 => Ok(Self::Every32),
            other => Err(format!("a Flock reports every 1, 2, 8 or 32 cycles, not every {other}")),
        }
    }
}
