//! The carrier of lines: `$`, fields between commas, `*`, and two digits of a checksum.

use super::{Battery, Count, Hello, Message, Motion, Refused, Time, Unit, is_id, name};

/// Longest line without its LF, bytes.
pub const MAX_LINE: usize = 256;
/// Asks a device on a line who it is.
pub const WHO: &[u8] = b"$?\n";

/// A command for a device on a line: so many samples a second, Hz.
pub fn rate(rate_hz: u32) -> Vec<u8> {
    format!("$R,{rate_hz}\n").into_bytes()
}

/// A line around these fields, with checksum and LF.
pub fn line(fields: &str) -> Vec<u8> {
    format!("${fields}*{:02X}\n", checksum(fields.as_bytes())).into_bytes()
}

/// XOR of all bytes.
fn checksum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum, byte| sum ^ byte)
}

/// Reads a line without its LF, which begins with `$`: the device's identifier, and what it says. `Ok(None)` is a line of a kind that
/// this version does not know.
///
/// # Errors
/// Its checksum is wrong, or missing where it is not `unchecked`, or its fields are none of its kind.
pub fn parse(line: &[u8], unchecked: bool) -> Result<Option<(&str, Message)>, Refused> {
    let line = line.strip_suffix(b"\r").unwrap_or(line);
    let body = line.strip_prefix(b"$").filter(|_| line.len() <= MAX_LINE).ok_or(Refused)?;
    let fields = match body {
        [fields @ .., b'*', high, low] => {
            let digit = |byte: u8| char::from(byte).to_digit(16);
            let sum = digit(*high).zip(digit(*low)).map(|(high, low)| 16 * high + low);
            Some(fields).filter(|fields| sum == Some(checksum(fields).into()))
        }
        _ => Some(body).filter(|_| unchecked),
    };
    let text = fields.and_then(|fields| std::str::from_utf8(fields).ok()).ok_or(Refused)?;
    let (kind, rest) = text.split_once(',').ok_or(Refused)?;
    let (id, rest) = rest.split_once(',').unwrap_or((rest, ""));
    if !is_id(id) {
        return Err(Refused);
    }
    let mut fields = Fields(rest.split(','));
    let message = match kind {
        "I" => fields.motion(false)?,
        "A" => fields.motion(true)?,
        "Q" => fields.orientation()?,
        "B" => fields.battery()?,
        "K" => Message::Buttons(fields.next()?.parse().map_err(|_| Refused)?),
        "H" => Message::Hello(fields.hello()?),
        _ => return Ok(None),
    };
    fields.end()?;
    Ok(Some((id, message)))
}

/// A message in a line that may have swallowed the end of another: the first that makes sense, and where it begins. `None` where nothing
/// does.
pub fn find(line: &[u8], unchecked: bool) -> Option<(usize, Option<(&str, Message)>)> {
    let starts = line.iter().enumerate().filter(|(_, byte)| **byte == b'$');
    starts.map(|(at, _)| at).find_map(|at| Some((at, parse(&line[at..], unchecked).ok()?)))
}

struct Fields<'a>(std::str::Split<'a, char>);

impl<'a> Fields<'a> {
    fn next(&mut self) -> Result<&'a str, Refused> {
        self.0.next().ok_or(Refused)
    }

    /// A line with more fields than its kind has is two that have run into one another.
    fn end(mut self) -> Result<(), Refused> {
        if self.0.next().is_none() { Ok(()) } else { Err(Refused) }
    }

    /// A number with a decimal point, or nothing.
    fn float(&mut self) -> Result<f32, Refused> {
        match self.next()? {
            "" => Ok(f32::NAN),
            text => number(text).map(|value| value as f32),
        }
    }

    fn floats<const N: usize>(&mut self) -> Result<[f32; N], Refused> {
        let mut values = [f32::NAN; N];
        for value in &mut values {
            *value = self.float()?;
        }
        Ok(values)
    }

    fn head(&mut self) -> Result<(u8, Option<u32>, Option<Time>), Refused> {
        let sensor = self.next()?.parse().map_err(|_| Refused)?;
        let count = match self.next()? {
            "" => None,
            text => Some(text.parse().map_err(|_| Refused)?),
        };
        let time = match self.next()? {
            "" => None,
            text => Some(time(text)?),
        };
        Ok((sensor, count, time))
    }

    fn motion(&mut self, with_orientation: bool) -> Result<Message, Refused> {
        let (sensor, number, time) = self.head()?;
        let (gyro, acc) = (self.floats()?, self.floats()?);
        let orientation = if with_orientation { Some(self.floats()?) } else { None };
        let has_mag = !with_orientation && self.0.clone().next().is_some();
        let mag = if has_mag { Some(self.floats()?) } else { None };
        // A temperature, which nothing uses.
        self.optional(self::number)?;
        let motion = Motion::checked(number, time, [Some(gyro), Some(acc), mag], orientation);
        Ok(Message::Motion { sensor, count: Count::Motion, motion })
    }

    fn orientation(&mut self) -> Result<Message, Refused> {
        let (sensor, number, time) = self.head()?;
        let motion = Motion::checked(number, time, [None; 3], Some(self.floats()?));
        Ok(Message::Motion { sensor, count: Count::Orientation, motion })
    }

    fn optional<T>(&mut self, read: impl Fn(&str) -> Result<T, Refused>) -> Result<Option<T>, Refused> {
        match self.0.next() {
            None | Some("") => Ok(None),
            Some(text) => read(text).map(Some),
        }
    }

    fn battery(&mut self) -> Result<Message, Refused> {
        let percent = self.optional(number)?;
        let volts = self.optional(number)?;
        let charging = self.optional(|text| match text {
            "0" => Ok(false),
            "1" => Ok(true),
            _ => Err(Refused),
        })?;
        Ok(Message::Battery(Battery::checked(percent.map(|percent| 0.01 * percent), volts, charging)))
    }

    fn hello(&mut self) -> Result<Hello, Refused> {
        Ok(Hello {
            version: self.next()?.parse().map_err(|_| Refused)?,
            name: self.0.next().and_then(name),
            software: self.0.next().and_then(name),
            rate_hz: self.optional(number)?,
            unit: self.optional(|text| Unit::parse(text).ok_or(Refused))?,
            bits: self.optional(|text| text.parse().ok().and_then(super::bits).ok_or(Refused))?,
            ..Hello::default()
        })
    }
}

/// A decimal number: no spaces, no words such as `inf`.
fn number(text: &str) -> Result<f64, Refused> {
    let allowed = |byte: u8| byte.is_ascii_digit() || b"+-.eE".contains(&byte);
    if text.bytes().all(allowed) { text.parse().map_err(|_| Refused) } else { Err(Refused) }
}

fn time(text: &str) -> Result<Time, Refused> {
    if let Ok(ticks) = text.parse() {
        return Ok(Time::Ticks(ticks));
    }
    match text.parse::<u64>() {
        Ok(ticks) => Ok(Time::Ticks(ticks as i64)),
        Err(_) => number(text).map(Time::Units),
    }
}
