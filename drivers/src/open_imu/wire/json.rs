//! The carrier JSON: one object per text message of a websocket.

use std::fmt;

use serde::de::{Deserialize, Deserializer, Error, IgnoredAny, SeqAccess, Visitor};
use serde::{Deserialize as Derive, Serialize};

use super::{Battery, Count, Hello, Message, Motion, Refused, Time, Unit, is_id, name};

/// Longest message, bytes.
pub const MAX_MESSAGE: usize = 16 * 1024;
/// Most rows of a block.
pub const MAX_ROWS: usize = 64;

/// All keys of all messages; keys that this version does not know are passed over.
#[derive(Derive)]
struct Keys {
    imu: Option<u32>,
    id: Option<String>,
    name: Option<String>,
    sw: Option<String>,
    rate: Option<f64>,
    unit: Option<String>,
    bits: Option<u32>,
    #[serde(default)]
    sensors: Vec<Place>,
    #[serde(default)]
    north: bool,
    n: Option<u32>,
    t: Option<Time>,
    g: Option<[f32; 3]>,
    a: Option<[f32; 3]>,
    m: Option<[f32; 3]>,
    q: Option<[f32; 4]>,
    #[serde(default)]
    s: u8,
    b: Option<Rows>,
    bat: Option<f64>,
    volt: Option<f64>,
    chg: Option<bool>,
    btn: Option<u32>,
    ping: Option<i64>,
    bye: Option<String>,
}

#[derive(Derive)]
struct Place {
    s: u8,
    place: Option<String>,
}

impl<'de> Deserialize<'de> for Time {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Number;

        impl Visitor<'_> for Number {
            type Value = Time;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a time")
            }

            fn visit_i64<E: Error>(self, ticks: i64) -> Result<Time, E> {
                Ok(Time::Ticks(ticks))
            }

            fn visit_u64<E: Error>(self, ticks: u64) -> Result<Time, E> {
                Ok(Time::Ticks(ticks as i64))
            }

            fn visit_f64<E: Error>(self, units: f64) -> Result<Time, E> {
                Ok(Time::Units(units))
            }
        }

        from.deserialize_any(Number)
    }
}

/// A row of a block: number, time and values.
#[derive(Clone, Copy)]
struct Row {
    number: u32,
    time: Time,
    values: [f32; MAX_VALUES],
    count: usize,
}

/// Values of the longest row: gyro, acceleration, and magnetic field and orientation behind them.
const MAX_VALUES: usize = 13;

impl<'de> Deserialize<'de> for Row {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Columns;

        impl<'de> Visitor<'de> for Columns {
            type Value = Row;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a row of number, time and 6, 9, 10 or 13 values")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut row: A) -> Result<Row, A::Error> {
                let missing = || A::Error::custom("the row is too short");
                let number = row.next_element()?.ok_or_else(missing)?;
                let time = row.next_element()?.ok_or_else(missing)?;
                let (mut values, mut count) = ([0.0; MAX_VALUES], 0);
                while count < MAX_VALUES
                    && let Some(value) = row.next_element()?
                {
                    values[count] = value;
                    count += 1;
                }
                let is_longer = row.next_element::<IgnoredAny>()?.is_some();
                if is_longer || !matches!(count, 6 | 9 | 10 | 13) {
                    return Err(A::Error::custom("a row has 8, 11, 12 or 15 columns"));
                }
                Ok(Row { number, time, values, count })
            }
        }

        from.deserialize_seq(Columns)
    }
}

impl Row {
    fn motion(&self) -> Result<Motion, Refused> {
        let three = |at: usize| Some([self.values[at], self.values[at + 1], self.values[at + 2]]);
        let mag = if matches!(self.count, 9 | 13) { three(6) } else { None };
        let orientation = self.values[..self.count].get(if mag.is_some() { 9 } else { 6 }..);
        let orientation = orientation.and_then(|rest| rest.try_into().ok());
        Motion::checked(Some(self.number), Some(self.time), [three(0), three(3), mag], orientation)
    }
}

/// The rows of a block.
struct Rows {
    rows: [Option<Row>; MAX_ROWS],
}

impl<'de> Deserialize<'de> for Rows {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct List;

        impl<'de> Visitor<'de> for List {
            type Value = Rows;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("1 to 64 rows")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Rows, A::Error> {
                let mut rows = [None; MAX_ROWS];
                let mut count = 0;
                while let Some(row) = list.next_element()? {
                    let place = rows.get_mut(count).ok_or_else(|| A::Error::custom("more than 64 rows"))?;
                    *place = Some(row);
                    count += 1;
                }
                if count == 0 { Err(A::Error::custom("a block without rows")) } else { Ok(Rows { rows }) }
            }
        }

        from.deserialize_seq(List)
    }
}

/// One object, or one part of it.
#[derive(Clone, Debug, PartialEq)]
pub enum Item {
    /// Who the device on this connection is.
    Hello {
        /// Its identifier.
        id: String,
        /// The rest.
        hello: Hello,
    },
    /// What every carrier says.
    Message(Message),
    /// The device asks for the time; the number comes back.
    Ping(i64),
    /// It goes, and says why.
    Bye(String),
}

/// Hands on what an object says, in order.
///
/// # Errors
/// It is no object, its keys have other types than the format's, it has none that the format knows, or it names a device that
/// cannot be.
pub fn items(text: &[u8], each: &mut impl FnMut(Item)) -> Result<(), Refused> {
    let keys: Keys = serde_json::from_slice(text).map_err(|_| Refused)?;
    if let Some(version) = keys.imu {
        let id = keys.id.filter(|id| is_id(id)).ok_or(Refused)?;
        let unit = keys.unit.map(|text| Unit::parse(&text).ok_or(Refused)).transpose()?;
        let bits = keys.bits.map(|bits| super::bits(bits).ok_or(Refused)).transpose()?;
        let places = keys.sensors.into_iter();
        let hello = Hello {
            version,
            name: keys.name.as_deref().and_then(name),
            software: keys.sw.as_deref().and_then(name),
            rate_hz: keys.rate,
            unit,
            bits,
            north: keys.north,
            places: places.filter_map(|at| Some((at.s, at.place.as_deref().and_then(name)?))).collect(),
        };
        each(Item::Hello { id, hello });
        return Ok(());
    }
    let mut known = false;
    let mut say = |item| {
        known = true;
        each(item);
    };
    let motion = |motion| Item::Message(Message::Motion { sensor: keys.s, count: Count::Motion, motion });
    if keys.g.is_some() || keys.a.is_some() || keys.q.is_some() {
        say(motion(Motion::checked(keys.n, keys.t, [keys.g, keys.a, keys.m], keys.q)));
    }
    if let Some(rows) = &keys.b {
        rows.rows.iter().flatten().for_each(|row| say(motion(row.motion())));
    }
    if keys.bat.is_some() || keys.volt.is_some() || keys.chg.is_some() {
        say(Item::Message(Message::Battery(Battery::checked(keys.bat, keys.volt, keys.chg))));
    }
    if let Some(buttons) = keys.btn {
        say(Item::Message(Message::Buttons(buttons)));
    }
    if let Some(id) = keys.ping {
        say(Item::Ping(id));
    }
    if let Some(why) = keys.bye {
        say(Item::Bye(name(&why).unwrap_or_default()));
    }
    if known { Ok(()) } else { Err(Refused) }
}

/// What the server says to a device, each one text message.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Reply<'a> {
    /// The device's hello was taken.
    Ok {
        /// 1.
        ok: u32,
        /// Its identifier.
        id: &'a str,
        /// How often its clock has begun anew, from 1.
        epoch: u32,
    },
    /// The answer to a ping.
    Pong {
        /// The number of the question.
        pong: i64,
        /// The server's time, µs.
        t: i64,
    },
    /// So many samples a second would do, Hz.
    Rate {
        /// Hz.
        rate: f64,
    },
    /// A message was refused.
    Err {
        /// Which kind of mistake.
        err: Problem,
        /// In words.
        why: &'a str,
    },
}

impl Reply<'_> {
    /// The text to send.
    pub fn text(&self) -> Vec<u8> {
        serde_json::to_vec(self).unwrap_or_default()
    }
}

/// Kinds of mistakes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Problem {
    /// A message came before the hello.
    NoHello,
    /// The text is no object of this format.
    BadJson,
    /// The message is no text.
    BadType,
    /// There are too many devices, sensors or samples.
    TooMany,
    /// The message is too long.
    TooBig,
    /// Another connection came for this device.
    DupId,
}
