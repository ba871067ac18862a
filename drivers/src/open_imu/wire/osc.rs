//! The carrier OSC: messages and bundles of big-endian numbers over UDP.
//!
//! Messages are read in place, argument by argument: `rosc`, which other parts of this project send with, makes a list of each, and a
//! driver allocates nothing per sample. Tests hold this reader against it.

use super::{Battery, Count, Hello, MAX_ID, Message, Motion, Refused, Time, Unit, is_id, name};

/// Longest datagram, bytes.
pub const MAX_DATAGRAM: usize = 1472;
/// How a bundle begins.
pub const BUNDLE: &[u8] = b"#bundle\0";
/// How deep bundles may lie in bundles.
const DEPTH: u32 = 4;

/// One argument.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Argument<'a> {
    Int(i32),
    Long(i64),
    Float(f32),
    Double(f64),
    Bool(bool),
    Text(&'a str),
}

impl<'a> Argument<'a> {
    fn float(self) -> Option<f32> {
        match self {
            Self::Float(value) => Some(value),
            Self::Double(value) => Some(value as f32),
            Self::Int(value) => Some(value as f32),
            _ => None,
        }
    }

    fn number(self) -> Option<f64> {
        match self {
            Self::Float(value) => Some(value.into()),
            Self::Double(value) => Some(value),
            Self::Int(value) => Some(value.into()),
            _ => None,
        }
    }

    fn int(self) -> Option<i64> {
        match self {
            Self::Int(value) => Some(value.into()),
            Self::Long(value) => Some(value),
            Self::Bool(value) => Some(value.into()),
            _ => None,
        }
    }

    fn time(self) -> Option<Time> {
        match self {
            Self::Int(value) => Some(Time::Ticks(value.into())),
            Self::Long(value) => Some(Time::Ticks(value)),
            Self::Float(value) => Some(Time::Seconds(value.into())),
            Self::Double(value) => Some(Time::Seconds(value)),
            _ => None,
        }
    }

    fn text(self) -> Option<&'a str> {
        if let Self::Text(text) = self { Some(text) } else { None }
    }
}

/// The arguments of a message, in order.
#[derive(Clone, Copy, Debug)]
struct Arguments<'a> {
    tags: &'a [u8],
    data: &'a [u8],
}

impl<'a> Iterator for Arguments<'a> {
    type Item = Result<Argument<'a>, Refused>;

    fn next(&mut self) -> Option<Self::Item> {
        let (&tag, tags) = self.tags.split_first()?;
        self.tags = tags;
        Some(self.argument(tag).ok_or(Refused))
    }
}

impl<'a> Arguments<'a> {
    fn word<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (word, data) = self.data.split_first_chunk()?;
        self.data = data;
        Some(*word)
    }

    fn argument(&mut self, tag: u8) -> Option<Argument<'a>> {
        Some(match tag {
            b'i' => Argument::Int(i32::from_be_bytes(self.word()?)),
            b'h' | b't' => Argument::Long(i64::from_be_bytes(self.word()?)),
            b'f' => Argument::Float(f32::from_be_bytes(self.word()?)),
            b'd' => Argument::Double(f64::from_be_bytes(self.word()?)),
            b'T' => Argument::Bool(true),
            b'F' => Argument::Bool(false),
            b's' => {
                let (text, data) = padded(self.data)?;
                self.data = data;
                Argument::Text(text)
            }
            _ => return None,
        })
    }
}

/// A text that ends with 1 to 4 zero bytes at a multiple of 4, and what follows.
fn padded(data: &[u8]) -> Option<(&str, &[u8])> {
    let len = data.iter().position(|&byte| byte == 0)?;
    let (text, rest) = data.split_at_checked((len + 4) & !3)?;
    Some((std::str::from_utf8(&text[..len]).ok()?, rest))
}

/// Hands on what a datagram says, each message with the identifier of its device; `Err` is a message that was refused.
/// Addresses that are not of this format's version are passed over.
pub fn messages(datagram: &[u8], each: &mut impl FnMut(Result<(&str, Message), Refused>)) {
    if datagram.len() > MAX_DATAGRAM {
        return each(Err(Refused));
    }
    element(datagram, DEPTH, each);
}

fn element(data: &[u8], depth: u32, each: &mut impl FnMut(Result<(&str, Message), Refused>)) {
    let Some(bundle) = data.strip_prefix(BUNDLE) else {
        return match message(data) {
            Ok(None) => {}
            Ok(Some(found)) => each(Ok(found)),
            Err(Refused) => each(Err(Refused)),
        };
    };
    // Behind the time tag, which means nothing here.
    let Some(mut rest) = bundle.get(8..).filter(|_| depth > 0) else { return each(Err(Refused)) };
    while !rest.is_empty() {
        let inner = rest
            .split_first_chunk()
            .and_then(|(len, rest)| rest.split_at_checked(usize::try_from(u32::from_be_bytes(*len)).ok()?));
        let Some((inner, after)) = inner.filter(|(inner, _)| !inner.is_empty()) else {
            return each(Err(Refused));
        };
        element(inner, depth - 1, each);
        rest = after;
    }
}

fn message(data: &[u8]) -> Result<Option<(&str, Message)>, Refused> {
    let (address, rest) = padded(data).ok_or(Refused)?;
    let (tags, data) = padded(rest).ok_or(Refused)?;
    let tags = tags.strip_prefix(',').ok_or(Refused)?.as_bytes();
    let Some(path) = address.strip_prefix("/imu/1/") else { return Ok(None) };
    let Some((id, path)) = path.split_once('/') else { return Ok(None) };
    if !is_id(id) {
        return Err(Refused);
    }
    let arguments = Arguments { tags, data };
    let message = match path.split_once('/') {
        None if let Ok(sensor) = path.parse() => motion(sensor, arguments)?,
        Some((sensor, "q")) if let Ok(sensor) = sensor.parse() => orientation(sensor, arguments)?,
        None if path == "bat" => battery(arguments)?,
        None if path == "btn" => Message::Buttons(first(arguments)?.int().ok_or(Refused)? as u32),
        None if path == "hello" => Message::Hello(hello(arguments)?),
        _ => return Ok(None),
    };
    Ok(Some((id, message)))
}

fn first(mut arguments: Arguments<'_>) -> Result<Argument<'_>, Refused> {
    arguments.next().ok_or(Refused)?
}

/// Number, time, values and how many of these there are.
type Numbered<const N: usize> = (Option<u32>, Option<Time>, [f32; N], usize);

/// Number and time, and so many values behind them at least; a value more than the second number is refused by its form.
fn numbered<const N: usize>(mut arguments: Arguments<'_>) -> Result<Numbered<N>, Refused> {
    let number = first(arguments)?.int().ok_or(Refused)? as u32;
    arguments.next();
    let time = arguments.next().ok_or(Refused)??.time().ok_or(Refused)?;
    let mut values = [f32::NAN; N];
    let mut count = 0;
    for argument in arguments {
        *values.get_mut(count).ok_or(Refused)? = argument?.float().ok_or(Refused)?;
        count += 1;
    }
    // A device without a clock has a time that is no number.
    let time = Some(time).filter(|time| !matches!(time, Time::Seconds(t) if t.is_nan()));
    Ok((Some(number), time, values, count))
}

fn motion(sensor: u8, arguments: Arguments<'_>) -> Result<Message, Refused> {
    let (number, time, values, count) = numbered::<9>(arguments)?;
    let three = |at: usize| (at + 3 <= count).then(|| [values[at], values[at + 1], values[at + 2]]);
    if count != 6 && count != 9 {
        return Err(Refused);
    }
    let motion = Motion::checked(number, time, [three(0), three(3), three(6)], None);
    Ok(Message::Motion { sensor, count: Count::Motion, motion })
}

fn orientation(sensor: u8, arguments: Arguments<'_>) -> Result<Message, Refused> {
    let (number, time, values, count) = numbered::<4>(arguments)?;
    if count != 4 {
        return Err(Refused);
    }
    let motion = Motion::checked(number, time, [None; 3], Some(values));
    Ok(Message::Motion { sensor, count: Count::Orientation, motion })
}

fn battery(mut arguments: Arguments<'_>) -> Result<Message, Refused> {
    let level = arguments.next().ok_or(Refused)??.number().ok_or(Refused)?;
    let volts = arguments.next().transpose()?.and_then(Argument::number);
    Ok(Message::Battery(Battery::checked(Some(level), volts, None)))
}

fn hello(mut arguments: Arguments<'_>) -> Result<Hello, Refused> {
    let mut next = || arguments.next().transpose();
    let text = |argument: Option<Argument<'_>>| argument.and_then(Argument::text).ok_or(Refused).map(name);
    let (label, software) = (text(next()?)?, text(next()?)?);
    let rate_hz = next()?.and_then(Argument::number);
    let unit = next()?.and_then(Argument::text).map(|text| Unit::parse(text).ok_or(Refused)).transpose()?;
    let bits =
        next()?.and_then(Argument::int).map(|bits| super::bits(bits as u32).ok_or(Refused)).transpose()?;
    Ok(Hello { version: super::VERSION, name: label, software, rate_hz, unit, bits, ..Hello::default() })
}

/// Writes messages as devices send them: for virtual ones, and for tests.
#[derive(Clone, Debug, Default)]
pub struct Writer {
    bytes: Vec<u8>,
}

/// An argument to write.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value<'a> {
    /// `i`.
    Int(i32),
    /// `h`.
    Long(i64),
    /// `f`.
    Float(f32),
    /// `s`.
    Text(&'a str),
}

impl Writer {
    /// A message of these arguments at `/imu/1/<id>/<path>`.
    pub fn message(id: &str, path: &str, arguments: &[Value<'_>]) -> Vec<u8> {
        debug_assert!(id.len() <= MAX_ID, "{id}");
        let mut writer = Self::default();
        writer.text(&format!("/imu/1/{id}/{path}"));
        let tag = |value: &Value<'_>| match value {
            Value::Int(_) => 'i',
            Value::Long(_) => 'h',
            Value::Float(_) => 'f',
            Value::Text(_) => 's',
        };
        writer.text(&std::iter::once(',').chain(arguments.iter().map(tag)).collect::<String>());
        for value in arguments {
            match *value {
                Value::Int(value) => writer.bytes.extend(value.to_be_bytes()),
                Value::Long(value) => writer.bytes.extend(value.to_be_bytes()),
                Value::Float(value) => writer.bytes.extend(value.to_be_bytes()),
                Value::Text(text) => writer.text(text),
            }
        }
        writer.bytes
    }

    /// A bundle of messages, to be used at once.
    pub fn bundle(messages: &[Vec<u8>]) -> Vec<u8> {
        let mut bytes = BUNDLE.to_vec();
        bytes.extend(1_u64.to_be_bytes());
        for message in messages {
            bytes.extend((message.len() as u32).to_be_bytes());
            bytes.extend(message);
        }
        bytes
    }

    fn text(&mut self, text: &str) {
        self.bytes.extend(text.bytes());
        self.bytes.extend(&[0; 4][..4 - text.len() % 4]);
    }
}
