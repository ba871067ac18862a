//! Messages of the format: what all three carriers say.
//!
//! Values travel in single precision at most ([`osc`] has no more), so that a sample is the same whatever carried it.

pub mod csv;
pub mod json;
pub mod osc;

use std::fmt;

use posed_state::Plain;

/// Version of the format.
pub const VERSION: u32 = 1;
/// Longest identifier of a device, and longest name, in bytes.
pub const MAX_ID: usize = 32;
/// See [`MAX_ID`].
pub const MAX_NAME: usize = 64;

/// Largest values that a sensor can mean, in the units of [`Motion`].
const MOST_GYRO_RAD_S: f64 = 70.0;
const MOST_ACC_M_S2: f64 = 400.0;
const MOST_MAG_UT: f64 = 10_000.0;
/// Norms of what is still a rotation.
const NORMS: std::ops::RangeInclusive<f64> = 0.9..=1.1;

/// A message that cannot be so: of another form, or with values that no sensor has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refused;

/// A time on the device's own clock, as it was written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Time {
    /// A whole number of the device's units; unsigned 64-bit ones wrap into it.
    Ticks(i64),
    /// A number of the device's units with a fraction.
    Units(f64),
    /// Seconds, whatever the unit of the device (OSC).
    Seconds(f64),
}

/// The unit in which a device gives its times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Plain)]
pub enum Unit {
    /// Microseconds.
    #[default]
    Microseconds,
    /// Milliseconds.
    Milliseconds,
    /// Seconds, with a fraction.
    Seconds,
}

impl Unit {
    /// The unit by its word; `None` for a word that is none.
    pub fn parse(text: &str) -> Option<Self> {
        match text {
            "us" => Some(Self::Microseconds),
            "ms" => Some(Self::Milliseconds),
            "s" => Some(Self::Seconds),
            _ => None,
        }
    }

    /// Its word.
    pub fn word(self) -> &'static str {
        match self {
            Self::Microseconds => "us",
            Self::Milliseconds => "ms",
            Self::Seconds => "s",
        }
    }

    /// Microseconds of one unit.
    pub fn microseconds(self) -> i64 {
        match self {
            Self::Microseconds => 1,
            Self::Milliseconds => 1000,
            Self::Seconds => 1_000_000,
        }
    }
}

/// What a sensor measured at one time, in its own axes. At least one of angular velocity, acceleration and orientation is there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Number of the sample; `None`: the device does not count.
    pub number: Option<u32>,
    /// Time of the sample; `None`: the device has no clock.
    pub time: Option<Time>,
    /// Angular velocity, rad/s.
    pub gyro_rad_s: Option<[f64; 3]>,
    /// Specific force, m/s²: the axis that points up reads +9.81 at rest.
    pub acc_m_s2: Option<[f64; 3]>,
    /// Magnetic field, µT.
    pub mag_ut: Option<[f64; 3]>,
    /// Unit quaternion (w, x, y, z) that turns sensor vectors into a world with z up.
    pub orientation_wxyz: Option<[f64; 4]>,
}

impl Motion {
    /// A motion of values as they were read, each of which may be missing; not a number is missing, too, where it fills a whole vector.
    ///
    /// # Errors
    /// A value is out of the range of its kind or not finite, or nothing is there. An orientation that is no rotation is only left out.
    pub fn checked(
        number: Option<u32>,
        time: Option<Time>,
        [gyro, acc, mag]: [Option<[f32; 3]>; 3],
        orientation_wxyz: Option<[f32; 4]>,
    ) -> Result<Self, Refused> {
        let vector = |values: Option<[f32; 3]>, most: f64| match values.map(|values| values.map(f64::from)) {
            Some(values) if values.iter().all(|value| value.is_nan()) => Ok(None),
            Some(values) if values.iter().any(|value| value.is_nan() || value.abs() > most) => Err(Refused),
            values => Ok(values),
        };
        if let Some(Time::Units(t) | Time::Seconds(t)) = time
            && !t.is_finite()
        {
            return Err(Refused);
        }
        let motion = Self {
            number,
            time,
            gyro_rad_s: vector(gyro, MOST_GYRO_RAD_S)?,
            acc_m_s2: vector(acc, MOST_ACC_M_S2)?,
            mag_ut: vector(mag, MOST_MAG_UT)?,
            orientation_wxyz: orientation_wxyz.and_then(rotation),
        };
        let is_empty =
            motion.gyro_rad_s.is_none() && motion.acc_m_s2.is_none() && motion.orientation_wxyz.is_none();
        if is_empty { Err(Refused) } else { Ok(motion) }
    }
}

fn rotation(values: [f32; 4]) -> Option<[f64; 4]> {
    let values = values.map(f64::from);
    let norm = values.iter().map(|value| value * value).sum::<f64>().sqrt();
    NORMS.contains(&norm).then(|| values.map(|value| value / norm))
}

/// Which of a sensor's two counts numbers a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Plain)]
pub enum Count {
    /// That of rates and accelerations.
    Motion,
    /// That of orientations which travel by themselves.
    Orientation,
}

/// What a device says of itself; what is `None` it did not say.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hello {
    /// Version of the format that it speaks; OSC has it in the address.
    pub version: u32,
    /// Name for people, without control characters.
    pub name: Option<String>,
    /// Its software.
    pub software: Option<String>,
    /// Samples a second of each sensor, Hz; not checked.
    pub rate_hz: Option<f64>,
    /// Unit of its times.
    pub unit: Option<Unit>,
    /// Width of its clock in bits: 32, 64, or 0 for a clock that never wraps.
    pub bits: Option<u8>,
    /// Whether its orientations know north: x east, y north.
    pub north: bool,
    /// Where its sensors sit, by number, in the device's own words.
    pub places: Vec<(u8, String)>,
}

/// What is left of a battery.
#[derive(Clone, Copy, Debug, Default, PartialEq, Plain)]
pub struct Battery {
    /// Share, 0 to 1.
    pub level: Option<f64>,
    /// V.
    pub volts: Option<f64>,
    /// Whether it is being charged.
    pub charging: Option<bool>,
}

impl Battery {
    /// A battery of values as they were read; what is out of range is left out.
    pub fn checked(level: Option<f64>, volts: Option<f64>, charging: Option<bool>) -> Self {
        Self {
            level: level.filter(|level| (-0.01..=1.01).contains(level)).map(|level| level.clamp(0.0, 1.0)),
            volts: volts.filter(|volts| (0.0..=100.0).contains(volts)),
            charging,
        }
    }
}

/// One message of a device.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// Who it is.
    Hello(Hello),
    /// A sample of sensor `sensor`.
    Motion {
        /// Number of the sensor on its device.
        sensor: u8,
        /// What numbers it.
        count: Count,
        /// What it measured; refused where its values cannot be.
        motion: Result<Motion, Refused>,
    },
    /// Its battery.
    Battery(Battery),
    /// Which buttons are down, one bit each.
    Buttons(u32),
}

/// Whether a text can be the identifier of a device: 1 to 32 of letters, digits, `_` and `-`.
pub fn is_id(text: &str) -> bool {
    let allowed = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-';
    (1..=MAX_ID).contains(&text.len()) && text.bytes().all(allowed)
}

/// A text for people, without control characters and not longer than a name may be; `None` if nothing is left.
pub fn name(text: &str) -> Option<String> {
    let mut name: String = text.chars().filter(|c| !c.is_control()).collect();
    while name.len() > MAX_NAME {
        name.pop();
    }
    (!name.trim().is_empty()).then(|| name.trim().to_owned())
}

/// A clock's width that the format knows.
pub(super) fn bits(bits: u32) -> Option<u8> {
    matches!(bits, 0 | 32 | 64).then_some(bits as u8)
}

/// Which carrier a datagram or a text message belongs to, by its first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// An object: [`json`].
    Json,
    /// A message or a bundle: [`osc`].
    Osc,
    /// Lines: [`csv`].
    Lines,
    /// Somebody looks for a server.
    Discovery,
    /// Nothing of this format.
    Unknown,
}

/// What a device that looks for its server sends, once a second, to whoever listens.
pub const DISCOVERY: &[u8] = b"IMU?1";

impl Kind {
    /// The kind of a datagram.
    pub fn of(data: &[u8]) -> Self {
        match data.trim_ascii_start() {
            [b'{', ..] => Self::Json,
            [b'/', ..] => Self::Osc,
            [b'$', ..] => Self::Lines,
            _ if data.starts_with(osc::BUNDLE) => Self::Osc,
            other if other.trim_ascii_end() == DISCOVERY => Self::Discovery,
            _ => Self::Unknown,
        }
    }
}

/// The answer to [`DISCOVERY`]: who serves, and at which ports; 0 where there is none, or it is not known here.
pub fn discovered(server: impl fmt::Display, websocket: u16, osc: u16, csv: u16) -> Vec<u8> {
    format!("IMU!1 {server} {websocket} {osc} {csv}").into_bytes()
}
