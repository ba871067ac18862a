//! Data messages of an x-IMU3: letter, time stamp, arguments.
//!
//! Some letters have changed their arguments between firmware versions, so the length decides. Values are in
//! the units of the wire; [`Data::measurement`] gives them in SI, and only if they can have been measured.

use super::wire::Body;
use crate::sample::Measurement;
use posed_geometry::GRAVITY_M_S2;

/// A data message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stamped<'a> {
    /// Microseconds since the unit was switched on, or of the clock that its network shares; at most a hundred years. The time
    /// of the last sample of those that a message is the average of.
    pub time_us: u64,
    /// What it says, in the units of the wire.
    pub data: Data<'a>,
}

/// What a data message reports, in the units of the wire. Numbers are finite; whether they can have been measured is for
/// [`Data::measurement`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Data<'a> {
    /// `I`: angular rate, degrees/s; acceleration, g.
    Inertial {
        /// Angular rate in sensor axes, degrees per second.
        gyroscope: [f64; 3],
        /// Specific force in sensor axes, g; +1 upwards at rest.
        accelerometer: [f64; 3],
    },
    /// `M`: magnetic field in sensor axes; 1 is the field at the place of calibration.
    Magnetometer([f64; 3]),
    /// `H`: specific force of the accelerometer for shocks, sensor axes, g.
    HighG([f64; 3]),
    /// `Q`: w, x, y, z; sensor to Earth, in the unit's axes convention (set-up selects east, north, up). Not normalised.
    Quaternion([f64; 4]),
    /// `R`: rotation matrix, row by row, sensor to Earth.
    Matrix([f64; 9]),
    /// `A`: roll, pitch, yaw in degrees.
    Euler([f64; 3]),
    /// `L`: orientation (older firmware only) and acceleration without gravity in sensor axes, g.
    Linear(Option<[f64; 4]>, [f64; 3]),
    /// `E`: orientation (older firmware only) and acceleration without gravity in Earth axes, g.
    Earth(Option<[f64; 4]>, [f64; 3]),
    /// `U`, older firmware: initialising, angular rate recovery, acceleration recovery, magnetic recovery.
    AhrsFlags([bool; 4]),
    /// `U`, newer firmware: text, as sent.
    AhrsText(&'a [u8]),
    /// `T`: degrees Celsius.
    Temperature(f64),
    /// `B`: percentage, V, charging (0 no, 1 yes, 2 complete, 3 on hold).
    Battery([f64; 3]),
    /// `W`: strength of the radio signal: percentage, dBm.
    Rssi([f64; 2]),
    /// `N`: text for the user, as sent; need not be UTF-8.
    Notification(&'a [u8]),
    /// `F`: text for the user, as sent; need not be UTF-8.
    Error(&'a [u8]),
    /// `S` accessories, `Y` edges, `O` buttons, `C` time code: letter and bytes.
    Other(u8, &'a [u8]),
}

/// Most values of one message.
const MAX_VALUES: usize = 9;
/// Longest time stamp that is believed: a hundred years.
const MAX_TIME_US: u64 = 100 * 366 * 86_400 * 1_000_000;

/// Decodes data, binary (little-endian, single precision) or text. `None` where letter, length or form do not fit, a number is
/// not finite, the time stamp is above a hundred years, and for commands.
///
/// There is no checksum: what fits may still be damaged.
pub fn decode<'a>(body: &Body<'a>) -> Option<Stamped<'a>> {
    let stamped = match *body {
        Body::Command(_) => return None,
        Body::Binary(letter, bytes) => {
            let (time, arguments) = bytes.split_first_chunk()?;
            Stamped { time_us: u64::from_le_bytes(*time), data: from_binary(letter, arguments)? }
        }
        Body::Text(line) => from_text(line)?,
    };
    (stamped.time_us <= MAX_TIME_US).then_some(stamped)
}

fn from_binary(letter: u8, bytes: &[u8]) -> Option<Data<'_>> {
    let mut values = [0.0; MAX_VALUES];
    let (chunks, rest) = bytes.as_chunks::<4>();
    for (value, chunk) in values.iter_mut().zip(chunks) {
        *value = f64::from(f32::from_le_bytes(*chunk));
    }
    let count = if rest.is_empty() && chunks.len() <= MAX_VALUES { Some(chunks.len()) } else { None };
    from_values(letter, count.map(|count| &values[..count]), bytes)
}

fn from_text(line: &[u8]) -> Option<Stamped<'_>> {
    let (&letter, rest) = line.split_first()?;
    let rest = rest.strip_prefix(b",")?;
    let (time, arguments) = match rest.iter().position(|&byte| byte == b',') {
        Some(comma) => (&rest[..comma], &rest[comma + 1..]),
        None => (rest, &rest[rest.len()..]),
    };
    let is_digits = !time.is_empty() && time.iter().all(u8::is_ascii_digit);
    let time_us = std::str::from_utf8(time).ok().filter(|_| is_digits)?.parse().ok()?;
    let mut values = [0.0; MAX_VALUES];
    let mut count = Some(0);
    for field in arguments.split(|&byte| byte == b',') {
        count = count.and_then(|count| {
            *values.get_mut(count)? = std::str::from_utf8(field).ok()?.parse().ok()?;
            Some(count + 1)
        });
    }
    Some(Stamped { time_us, data: from_values(letter, count.map(|count| &values[..count]), arguments)? })
}

fn from_values<'a>(letter: u8, values: Option<&[f64]>, bytes: &'a [u8]) -> Option<Data<'a>> {
    let numbers = || values.filter(|values| values.iter().all(|value| value.is_finite()));
    Some(match letter {
        b'I' => match *numbers()? {
            [gx, gy, gz, ax, ay, az] => {
                Data::Inertial { gyroscope: [gx, gy, gz], accelerometer: [ax, ay, az] }
            }
            _ => return None,
        },
        b'M' => Data::Magnetometer(numbers()?.try_into().ok()?),
        b'H' => Data::HighG(numbers()?.try_into().ok()?),
        b'Q' => Data::Quaternion(numbers()?.try_into().ok()?),
        b'R' => Data::Matrix(numbers()?.try_into().ok()?),
        b'A' => Data::Euler(numbers()?.try_into().ok()?),
        b'L' | b'E' => {
            let (orientation, acceleration) = match *numbers()? {
                [x, y, z] => (None, [x, y, z]),
                [w, i, j, k, x, y, z] => (Some([w, i, j, k]), [x, y, z]),
                _ => return None,
            };
            match letter {
                b'L' => Data::Linear(orientation, acceleration),
                _ => Data::Earth(orientation, acceleration),
            }
        }
        b'U' => match numbers() {
            Some(&[a, b, c, d]) if [a, b, c, d].iter().all(|&flag| flag == 0.0 || flag == 1.0) => {
                Data::AhrsFlags([a, b, c, d].map(|flag| flag == 1.0))
            }
            _ => Data::AhrsText(bytes),
        },
        b'T' => match *numbers()? {
            [value] => Data::Temperature(value),
            _ => return None,
        },
        b'B' => Data::Battery(numbers()?.try_into().ok()?),
        b'W' => Data::Rssi(numbers()?.try_into().ok()?),
        b'N' => Data::Notification(bytes),
        b'F' => Data::Error(bytes),
        b'S' | b'Y' | b'O' | b'C' => Data::Other(letter, bytes),
        _ => return None,
    })
}

/// Most that a unit measures, with room for its calibration: degrees/s, g, g (high), field.
const MOST_DEG_S: f64 = 2500.0;
const MOST_G: f64 = 30.0;
const MOST_HIGH_G: f64 = 300.0;
const MOST_FIELD: f64 = 50.0;
/// Most of a battery's percentage and volts, and of a radio signal's percentage and dBm.
const MOST_BATTERY: f64 = 110.0;
const MOST_SIGNAL: f64 = 200.0;

impl Data<'_> {
    /// Letter on the wire, without the mark of binary data.
    pub fn letter(&self) -> u8 {
        match self {
            Data::Inertial { .. } => b'I',
            Data::Magnetometer(_) => b'M',
            Data::HighG(_) => b'H',
            Data::Quaternion(_) => b'Q',
            Data::Matrix(_) => b'R',
            Data::Euler(_) => b'A',
            Data::Linear(..) => b'L',
            Data::Earth(..) => b'E',
            Data::AhrsFlags(_) | Data::AhrsText(_) => b'U',
            Data::Temperature(_) => b'T',
            Data::Battery(_) => b'B',
            Data::Rssi(_) => b'W',
            Data::Notification(_) => b'N',
            Data::Error(_) => b'F',
            Data::Other(letter, _) => *letter,
        }
    }

    /// The measurement in SI, sensor axes, for the messages that can be one: `I`, `M`, `Q` and `L`. `Ok(None)` for others.
    ///
    /// # Errors
    /// The values cannot have been measured, so the message was damaged: above 2500 degrees/s, 30 g, 300 g (`H`), or 50 times
    /// the field; a quaternion whose norm is further than 0.001 from 1. Damage within these bounds is not found.
    pub fn measurement(&self) -> Result<Option<Measurement>, Impossible> {
        let within = |values: &[f64], most: f64| {
            if values.iter().all(|value| value.abs() <= most) { Ok(()) } else { Err(Impossible) }
        };
        let mut imu = Imu::default();
        match *self {
            Data::Inertial { gyroscope, accelerometer } => {
                within(&gyroscope, MOST_DEG_S)?;
                within(&accelerometer, MOST_G)?;
                imu.angular_velocity = Some(gyroscope.map(f64::to_radians));
                imu.specific_force = Some(accelerometer.map(|value| value * GRAVITY_M_S2));
            }
            Data::Magnetometer(field) => {
                within(&field, MOST_FIELD)?;
                imu.magnetic_field = Some(field);
            }
            Data::Quaternion(q) => imu.orientation = Some(unit(q).ok_or(Impossible)?),
            Data::Linear(q, acceleration) => {
                within(&acceleration, MOST_G)?;
                imu.linear_acceleration = Some(acceleration.map(|value| value * GRAVITY_M_S2));
                imu.orientation = q.map(|q| unit(q).ok_or(Impossible)).transpose()?;
            }
            Data::HighG(values) => {
                within(&values, MOST_HIGH_G)?;
                return Ok(None);
            }
            Data::Battery(values) => {
                within(&values, MOST_BATTERY)?;
                return Ok(None);
            }
            Data::Rssi(values) => {
                within(&values, MOST_SIGNAL)?;
                return Ok(None);
            }
            _ => return Ok(None),
        }
        Ok(Some(Measurement::Imu {
            angular_velocity_rad_s: imu.angular_velocity,
            specific_force_m_s2: imu.specific_force,
            linear_acceleration_m_s2: imu.linear_acceleration,
            magnetic_field: imu.magnetic_field,
            orientation_wxyz: imu.orientation,
        }))
    }
}

/// Values that cannot have been measured; see [`Data::measurement`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Impossible;

#[derive(Default)]
struct Imu {
    angular_velocity: Option<[f64; 3]>,
    specific_force: Option<[f64; 3]>,
    linear_acceleration: Option<[f64; 3]>,
    magnetic_field: Option<[f64; 3]>,
    orientation: Option<[f64; 4]>,
}

/// A unit quaternion; `None` when `q` is more than the text form's four decimals away from one.
fn unit(q: [f64; 4]) -> Option<[f64; 4]> {
    let norm = q.iter().map(|value| value * value).sum::<f64>().sqrt();
    (0.999..=1.001).contains(&norm).then(|| q.map(|value| value / norm))
}

/// Bytes of a binary message behind its letter: time stamp (8 bytes) and single precision values, little-endian, not stuffed;
/// see [`super::wire::binary`].
pub fn encode(time_us: u64, values: &[f64]) -> Vec<u8> {
    let values = values.iter().flat_map(|&value| (value as f32).to_le_bytes());
    time_us.to_le_bytes().into_iter().chain(values).collect()
}

/// A text message, LF included: letter, microseconds, values with four decimals, held at ±999999.9999, no minus zero.
pub fn encode_text(letter: u8, time_us: u64, values: &[f64]) -> Vec<u8> {
    let mut out = format!("{},{time_us}", char::from(letter));
    for value in values {
        let rounded = (value.clamp(-999_999.999_9, 999_999.999_9) * 1e4).round() / 1e4 + 0.0;
        out += &format!(",{rounded:.4}");
    }
    out.push('\n');
    out.into_bytes()
}
