//! Messages of VRPN 7.x on a TCP connection, of clients and servers, both ways.
//!
//! What comes in: values, or bytes in pieces of any size. What goes out: the other of the two. All integers and doubles are
//! big-endian. The length in a header does not count the padding that brings the next message to a multiple of eight bytes.

use posed_state::Plain;

/// What each side says first.
pub const GREETING: [u8; 24] = *b"vrpn: ver. 07.38  0\0\0\0\0\0";
/// What the greeting of every version begins with.
pub const ANY_VERSION: &[u8] = b"vrpn: ver. ";
/// So much of it must agree: other minor versions are understood.
const AGREE: usize = 14;
/// Where the version stands in it, as text.
const VERSION: std::ops::Range<usize> = 11..16;
/// Where the log mode stands in it.
const LOG_MODE: usize = 18;
/// Bytes of a header, its padding included.
pub const HEADER: usize = 24;
/// Longest message that is taken: the original's buffer.
const MAX_LENGTH: usize = 64_000;
/// Longest name that clients take.
pub const MAX_NAME: usize = 95;
/// Numbers of types and senders end here.
pub const MAX_NUMBER: i32 = 2000;
/// Bytes of a pose's payload.
pub const POSE: usize = 64;
/// Bytes of a text's payload.
const TEXT: usize = 1032;

/// What the original's servers call themselves, beside their trackers.
pub const CONTROL: &str = "VRPN Control";
/// Names of types, as both sides describe them.
pub mod types {
    #![expect(missing_docs, reason = "the protocol's names")]
    pub const POSE: &str = "vrpn_Tracker Pos_Quat";
    pub const VELOCITY: &str = "vrpn_Tracker Velocity";
    pub const ACCELERATION: &str = "vrpn_Tracker Acceleration";
    pub const BUTTON: &str = "vrpn_Button Change";
    pub const TEXT: &str = "vrpn_Base text_message";
    pub const PING: &str = "vrpn_Base ping_message";
    pub const PONG: &str = "vrpn_Base pong_message";
}

/// Types of system messages.
pub mod system {
    #![expect(missing_docs, reason = "the protocol's names")]
    pub const SENDER: i32 = -1;
    pub const TYPE: i32 = -2;
    pub const LOG: i32 = -4;
}

/// Why the other end is not listened to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    /// The greeting is not one of VRPN 7.
    #[error("it does not speak VRPN 7")]
    Greeting,
    /// It asks the server to write a log file.
    #[error("it asks this computer to write a log file, which is never done")]
    Log,
    /// A length, a name or a number out of its range.
    #[error("a message that is none")]
    Malformed,
}

/// Whether a client's greeting will do.
///
/// # Errors
/// Another protocol, another major version, or a log is asked for.
pub fn check_greeting(bytes: &[u8; 24]) -> Result<(), Refused> {
    if !is_version_7(bytes) {
        return Err(Refused::Greeting);
    }
    if bytes[LOG_MODE] == b'0' { Ok(()) } else { Err(Refused::Log) }
}

/// Whether a greeting is one of version 7, whatever its minor number.
pub fn is_version_7(greeting: &[u8; 24]) -> bool {
    greeting[..AGREE] == GREETING[..AGREE]
}

/// The version of a greeting, such as `07.38`.
pub fn version(greeting: &[u8; 24]) -> String {
    String::from_utf8_lossy(&greeting[VERSION]).escape_debug().collect()
}

/// What a header says of its message, which need not be there yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Bytes of the header and the payload, without padding.
    pub length: usize,
    /// When it was true: seconds since 1970, and microseconds.
    pub seconds: u32,
    /// The latter.
    pub micros: u32,
    /// Number of the sender, or what a system message has there.
    pub sender: i32,
    /// Number of the type.
    pub kind: i32,
}

impl Header {
    /// Bytes of the message on the wire.
    pub fn whole(&self) -> usize {
        HEADER + (self.length - HEADER).next_multiple_of(8)
    }
}

/// One message, by the numbers of who sent it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message<'a> {
    /// Place in the stream of its first byte.
    pub offset: u64,
    /// When it was true: UTC, µs since 1970.
    pub utc_us: u64,
    /// Number of the sender.
    pub sender: i32,
    /// Number of the type; negative for [`system`] messages.
    pub kind: i32,
    /// What follows the header.
    pub payload: &'a [u8],
}

impl Message<'_> {
    /// The number (0 to 1999) and the name that a description ([`system::SENDER`], [`system::TYPE`]) gives.
    ///
    /// # Errors
    /// The number or the name is out of range.
    pub fn description(&self) -> Result<(i32, String), Refused> {
        let (length, name) = self.payload.split_first_chunk().ok_or(Refused::Malformed)?;
        let fits = usize::try_from(i32::from_be_bytes(*length)) == Ok(name.len())
            && (1..=MAX_NAME + 1).contains(&name.len())
            && (0..MAX_NUMBER).contains(&self.sender);
        match name.split_last() {
            Some((0, name)) if fits && !name.contains(&0) => {
                Ok((self.sender, String::from_utf8_lossy(name).into_owned()))
            }
            _ => Err(Refused::Malformed),
        }
    }
}

/// Cuts what the other end sends into messages. Its caller says what to believe, and where it is to give up one byte.
#[derive(Clone, Debug, Default, Plain)]
pub struct Messages {
    buffer: Vec<u8>,
    start: usize,
    /// Place in the stream of `buffer[0]`.
    origin: u64,
}

impl Messages {
    /// Takes more bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.drain(..self.start);
        self.origin += self.start as u64;
        self.start = 0;
        self.buffer.extend_from_slice(bytes);
    }

    /// The bytes that belong to no message yet.
    pub fn pending(&self) -> &[u8] {
        &self.buffer[self.start..]
    }

    /// Gives up so many of them, or all.
    pub fn skip(&mut self, bytes: usize) {
        self.start = self.start.saturating_add(bytes).min(self.buffer.len());
    }

    /// The next whole message, if there is one.
    ///
    /// # Errors
    /// A length that no message has; nothing behind it can be understood.
    pub fn find(&mut self) -> Result<Option<Message<'_>>, Refused> {
        Ok(self.ready(|_| true)?.map(|header| self.take(header)))
    }

    /// The header of the next message, if all of that is there.
    ///
    /// # Errors
    /// A length that no message has, or the header is not believed.
    pub fn ready(&self, is_believed: impl FnOnce(&Header) -> bool) -> Result<Option<Header>, Refused> {
        let Some(bytes) = self.pending().first_chunk::<HEADER>() else { return Ok(None) };
        let word = |at: usize| u32::from_be_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let header = Header {
            length: word(0) as usize,
            seconds: word(4),
            micros: word(8),
            sender: word(12) as i32,
            kind: word(16) as i32,
        };
        if !(HEADER..=MAX_LENGTH).contains(&header.length) || !is_believed(&header) {
            return Err(Refused::Malformed);
        }
        Ok((self.pending().len() >= header.whole()).then_some(header))
    }

    /// Takes the message whose header is [`Messages::ready`].
    ///
    /// # Panics
    /// It is not.
    pub fn take(&mut self, header: Header) -> Message<'_> {
        let start = self.start;
        self.start += header.whole();
        Message {
            offset: self.origin + start as u64,
            utc_us: u64::from(header.seconds) * 1_000_000 + u64::from(header.micros),
            sender: header.sender,
            kind: header.kind,
            payload: &self.buffer[start + HEADER..start + header.length],
        }
    }
}

/// What a tracker reports of one of its sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Number of the sensor, from 0.
    pub sensor: u32,
    /// m.
    pub position_m: [f64; 3],
    /// Sensor to the server's axes, unit quaternion with its scalar first.
    pub orientation_wxyz: [f64; 4],
}

/// Why a pose is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BadPose {
    /// The payload has another length, or a sensor number below 0.
    #[error("no pose")]
    Form,
    /// A number that is not finite, or a quaternion further than [`NORM_ERROR`] from a unit one.
    #[error("no rotation or not a number")]
    Number,
    /// Farther than [`REACH_M`].
    #[error("farther than 100 m along an axis: the server may count in mm, and must in m")]
    Far,
    /// Exactly at the origin, which no measurement is: it is what servers send of what they do not see.
    #[error("exactly at the origin: the server does not see it, or measures no position")]
    Origin,
}

/// How far the norm of a quaternion may be from 1: servers compute in single precision, and some do not normalise.
pub const NORM_ERROR: f64 = 1e-3;
/// Farthest along an axis, m.
pub const REACH_M: f64 = 100.0;

impl Pose {
    /// Reads the payload of a pose; the quaternion is normalised.
    ///
    /// # Errors
    /// It is none that a tracker can have measured.
    pub fn parse(payload: &[u8]) -> Result<Self, BadPose> {
        let payload: &[u8; POSE] = payload.try_into().map_err(|_| BadPose::Form)?;
        let sensor = i32::from_be_bytes([payload[0], payload[1], payload[2], payload[3]]);
        let sensor = u32::try_from(sensor).map_err(|_| BadPose::Form)?;
        let (numbers, _) = payload[8..].as_chunks();
        let number = |at: usize| f64::from_be_bytes(numbers[at]);
        let position_m = [number(0), number(1), number(2)];
        let q = [number(6), number(3), number(4), number(5)];
        let norm = q.iter().map(|value| value * value).sum::<f64>().sqrt();
        let is_unit = (1.0 - NORM_ERROR..=1.0 + NORM_ERROR).contains(&norm);
        if !is_unit || !position_m.iter().all(|value| value.is_finite()) {
            return Err(BadPose::Number);
        }
        if position_m.iter().any(|value| value.abs() > REACH_M) {
            return Err(BadPose::Far);
        }
        if position_m == [0.0; 3] {
            return Err(BadPose::Origin);
        }
        Ok(Self { sensor, position_m, orientation_wxyz: q.map(|value| value / norm) })
    }
}

/// Where a message comes from and when it was true.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct From {
    /// Number of the sender.
    pub sender: i32,
    /// Number of the type.
    pub kind: i32,
    /// UTC, ns since 1970.
    pub utc_ns: i64,
}

/// Appends a message: its header, `payload`, and zeros up to a multiple of eight bytes. The time is cut to the microsecond.
pub fn message(from: From, payload: &[u8], out: &mut Vec<u8>) {
    let seconds = from.utc_ns.div_euclid(1_000_000_000) as u32;
    let micros = (from.utc_ns.rem_euclid(1_000_000_000) / 1000) as u32;
    out.extend(((HEADER + payload.len()) as u32).to_be_bytes());
    out.extend(seconds.to_be_bytes());
    out.extend(micros.to_be_bytes());
    out.extend(from.sender.to_be_bytes());
    out.extend(from.kind.to_be_bytes());
    // A number that no receiver reads.
    out.extend(0_u32.to_be_bytes());
    out.extend(payload);
    out.resize(out.len() + payload.len().next_multiple_of(8) - payload.len(), 0);
}

/// Appends the description of a number: `system` is [`system::SENDER`] or [`system::TYPE`].
///
/// # Panics
/// With a name of more than [`MAX_NAME`] bytes.
pub fn description(system: i32, number: i32, name: &str, utc_ns: i64, out: &mut Vec<u8>) {
    assert!(name.len() <= MAX_NAME, "{name} is too long for clients");
    let mut payload = Vec::with_capacity(8 + name.len());
    payload.extend((name.len() as i32 + 1).to_be_bytes());
    payload.extend(name.as_bytes());
    payload.push(0);
    message(From { sender: number, kind: system, utc_ns }, &payload, out);
}

/// Appends a pose of the sensor of this number, from 0: position in the room, m, and orientation, sensor to room, unit
/// quaternion with its scalar first.
pub fn pose(from: From, sensor: u32, position_m: [f64; 3], orientation_wxyz: [f64; 4], out: &mut Vec<u8>) {
    let mut payload = Doubles::<POSE>::new();
    for word in payload.bytes[..8].as_chunks_mut().0 {
        *word = sensor.to_be_bytes();
    }
    payload.put(&position_m);
    payload.put_quaternion(orientation_wxyz);
    message(from, &payload.bytes, out);
}

/// Appends a velocity or an acceleration in room axes: linear, m/s or m/s², and what is turned in `dt_s` (s), or by how much that
/// changes in a second, a unit quaternion with its scalar first. `from.kind` states which of the two it is.
pub fn motion(from: From, linear: [f64; 3], rotation_wxyz: [f64; 4], dt_s: f64, out: &mut Vec<u8>) {
    let mut payload = Doubles::<72>::new();
    payload.put(&linear);
    payload.put_quaternion(rotation_wxyz);
    payload.put(&[dt_s]);
    message(from, &payload.bytes, out);
}

/// Appends a button, by its number from 0, that was pressed or released.
pub fn button(from: From, number: i32, pressed: bool, out: &mut Vec<u8>) {
    let mut payload = [0; 8];
    payload[..4].copy_from_slice(&number.to_be_bytes());
    payload[4..].copy_from_slice(&i32::from(pressed).to_be_bytes());
    message(from, &payload, out);
}

/// Appends a sentence for the operator, cut to 1023 bytes; as a warning or as plain words.
pub fn text(from: From, sentence: &str, warning: bool, out: &mut Vec<u8>) {
    let mut payload = [0; TEXT];
    payload[..4].copy_from_slice(&u32::from(warning).to_be_bytes());
    let bytes = &sentence.as_bytes()[..sentence.floor_char_boundary(TEXT - 9)];
    payload[8..8 + bytes.len()].copy_from_slice(bytes);
    message(from, &payload, out);
}

/// A payload of doubles behind the number of the sensor, which is 0, twice.
struct Doubles<const N: usize> {
    bytes: [u8; N],
    at: usize,
}

impl<const N: usize> Doubles<N> {
    fn new() -> Self {
        Self { bytes: [0; N], at: 8 }
    }

    fn put(&mut self, values: &[f64]) {
        for value in values {
            self.bytes[self.at..self.at + 8].copy_from_slice(&value.to_be_bytes());
            self.at += 8;
        }
    }

    fn put_quaternion(&mut self, [w, x, y, z]: [f64; 4]) {
        self.put(&[x, y, z, w]);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const AT: i64 = 1_700_000_000_250_000_000;

    fn hex(text: &str) -> Vec<u8> {
        text.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
    }

    /// Without the number that nobody reads.
    fn same(made: &[u8], sheet: &str) {
        let mut sheet = hex(sheet);
        sheet[20..24].fill(0);
        assert_eq!(made, sheet);
    }

    #[test]
    fn worked_examples() {
        assert_eq!(
            GREETING[..],
            hex("76 72 70 6e 3a 20 76 65 72 2e 20 30 37 2e 33 38 20 20 30 00 00 00 00 00")
        );
        let mut out = Vec::new();
        description(system::SENDER, 1, "Tracker0", AT, &mut out);
        same(
            &out,
            "00 00 00 25 65 53 f1 00 00 03 d0 90 00 00 00 01 ff ff ff ff 00 00 00 00 00 00 00 09 54 72 61 63
             6b 65 72 30 00 00 00 00",
        );
        out.clear();
        description(system::TYPE, 4, "vrpn_Tracker Pos_Quat", AT, &mut out);
        same(
            &out,
            "00 00 00 32 65 53 f1 00 00 03 d0 90 00 00 00 04 ff ff ff fe 00 00 00 09 00 00 00 16 76 72 70 6e
             5f 54 72 61 63 6b 65 72 20 50 6f 73 5f 51 75 61 74 00 00 00 00 00 00 00",
        );
        out.clear();
        let half = 0.5_f64.sqrt();
        pose(From { sender: 1, kind: 4, utc_ns: AT }, 2, [0.1, 0.2, -0.3], [half, 0.0, 0.0, half], &mut out);
        same(
            &out,
            "00 00 00 58 65 53 f1 00 00 03 d0 90 00 00 00 01 00 00 00 04 00 00 00 10 00 00 00 02 00 00 00 02
             3f b9 99 99 99 99 99 9a 3f c9 99 99 99 99 99 9a bf d3 33 33 33 33 33 33 00 00 00 00 00 00 00 00
             00 00 00 00 00 00 00 00 3f e6 a0 9e 66 7f 3b cd 3f e6 a0 9e 66 7f 3b cd",
        );
        let mut messages = Messages::default();
        messages.push(&out);
        let message = messages.find().unwrap().unwrap();
        assert_eq!((message.utc_us, message.sender, message.kind), (AT as u64 / 1000, 1, 4));
        let read = Pose::parse(message.payload).unwrap();
        assert_eq!((read.sensor, read.position_m), (2, [0.1, 0.2, -0.3]));
        assert!((read.orientation_wxyz[0] - half).abs() < 1e-15 && read.orientation_wxyz[1] == 0.0);
        out.clear();
        let from = From { sender: 1, kind: 5, utc_ns: AT };
        motion(from, [1.0, -2.0, 0.5], [1.0, 0.0, 0.0, 0.0], 0.01, &mut out);
        assert_eq!(out.len(), 96);
        assert_eq!(out[88..], hex("3f 84 7a e1 47 ae 14 7b"));
        out.clear();
        button(From { sender: 2, kind: 9, utc_ns: AT }, 3, true, &mut out);
        same(
            &out,
            "00 00 00 20 65 53 f1 00 00 03 d0 90 00 00 00 02 00 00 00 09 00 00 00 13 00 00 00 03 00 00 00 01",
        );
        out.clear();
        text(from, &"ä".repeat(600), true, &mut out);
        assert_eq!((out.len(), &out[..4]), (HEADER + TEXT, &[0, 0, 4, 0x20][..]));
    }

    #[test]
    fn a_pose_that_nobody_measured_is_refused() {
        let read = |position_m, orientation_wxyz| {
            let mut out = Vec::new();
            pose(From { sender: 0, kind: 0, utc_ns: 0 }, 0, position_m, orientation_wxyz, &mut out);
            Pose::parse(&out[HEADER..]).map(|pose| pose.orientation_wxyz)
        };
        let (at, upright) = ([0.1, 0.2, 1.7], [1.0, 0.0, 0.0, 0.0]);
        assert_eq!(read(at, [1.0005, 0.0, 0.0, 0.0]), Ok(upright));
        for q in [[0.0; 4], [1.01, 0.0, 0.0, 0.0], [f64::NAN, 0.0, 0.0, 1.0], [0.0, f64::INFINITY, 0.0, 0.0]]
        {
            assert_eq!(read(at, q), Err(BadPose::Number), "{q:?}");
        }
        assert_eq!(read([f64::NAN, 0.0, 0.0], upright), Err(BadPose::Number));
        assert_eq!(read([f64::NEG_INFINITY, 0.0, 0.0], upright), Err(BadPose::Number));
        assert_eq!(read([0.0, 0.0, 1700.0], upright), Err(BadPose::Far));
        assert_eq!(read([0.0, -0.0, 0.0], upright), Err(BadPose::Origin));
        assert_eq!(Pose::parse(&[0; 63]), Err(BadPose::Form));
        assert_eq!(Pose::parse(&[0xFF; 64]), Err(BadPose::Form));
    }

    #[test]
    fn greetings_of_others_are_refused() {
        let mut greeting = GREETING;
        assert_eq!(check_greeting(&greeting), Ok(()));
        greeting[15] = b'0';
        assert_eq!(check_greeting(&greeting), Ok(()), "another minor version");
        greeting[18] = b'1';
        assert_eq!(check_greeting(&greeting), Err(Refused::Log));
        greeting[12] = b'8';
        assert_eq!(check_greeting(&greeting), Err(Refused::Greeting));
    }

    proptest! {
        #[test]
        fn messages_come_back_however_they_are_cut(
            names in proptest::collection::vec("[a-zA-Z _-]{0,95}", 1..8),
            cut in 1_usize..40,
        ) {
            let mut bytes = Vec::new();
            for (number, name) in (0..).zip(&names) {
                description(system::TYPE, number, name, AT, &mut bytes);
            }
            prop_assert_eq!(bytes.len() % 8, 0);
            let mut messages = Messages::default();
            let mut back = Vec::new();
            for piece in bytes.chunks(cut) {
                messages.push(piece);
                while let Some(message) = messages.find().unwrap() {
                    prop_assert_eq!(message.kind, system::TYPE);
                    back.push(message.description().unwrap());
                }
            }
            prop_assert_eq!(back, (0..).zip(names).collect::<Vec<_>>());
        }

        #[test]
        fn any_bytes_are_messages_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let mut messages = Messages::default();
            messages.push(&bytes);
            while let Ok(Some(message)) = messages.find() {
                let _ = message.description();
            }
        }
    }
}
