//! Messages of VRPN 7.x on a TCP connection, both ways.
//!
//! What comes in: values, or bytes in pieces of any size. What goes out: the other of the two. All integers and doubles are
//! big-endian. The length in a header does not count the padding that brings the next message to a multiple of eight bytes.

/// What each side says first.
pub const GREETING: [u8; 24] = *b"vrpn: ver. 07.38  0\0\0\0\0\0";
/// So much of it must agree: other minor versions are understood.
const AGREE: usize = 14;
/// Where the log mode stands in it.
const LOG_MODE: usize = 18;
/// Bytes of a header, its padding included.
pub const HEADER: usize = 24;
/// Longest message that is taken from a client.
const MAX_LENGTH: usize = 64_000;
/// Longest name that clients take.
pub const MAX_NAME: usize = 95;
/// Numbers of types and senders end here.
const MAX_NUMBER: i32 = 2000;
/// Bytes of a text's payload.
const TEXT: usize = 1032;

/// Types of system messages.
pub mod system {
    #![expect(missing_docs, reason = "the protocol's names")]
    pub const SENDER: i32 = -1;
    pub const TYPE: i32 = -2;
    pub const LOG: i32 = -4;
}

/// Why a client is not served.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    /// The greeting is not that of a VRPN 7 client.
    #[error("not a VRPN 7 client")]
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
    if bytes[..AGREE] != GREETING[..AGREE] {
        return Err(Refused::Greeting);
    }
    if bytes[LOG_MODE] == b'0' { Ok(()) } else { Err(Refused::Log) }
}

/// One message of a client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message<'a> {
    /// When it was true: UTC, ns since 1970.
    pub utc_ns: i64,
    /// Number of the sender, by the client's own count.
    pub sender: i32,
    /// Number of the type, by the client's own count; negative for [`system`] messages.
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

/// Cuts what a client sends into messages.
#[derive(Clone, Debug, Default)]
pub struct Messages {
    buffer: Vec<u8>,
    start: usize,
}

impl Messages {
    /// Takes more bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.drain(..self.start);
        self.start = 0;
        self.buffer.extend_from_slice(bytes);
    }

    /// The next whole message, if there is one.
    ///
    /// # Errors
    /// A length that no message has; nothing behind it can be understood.
    pub fn find(&mut self) -> Result<Option<Message<'_>>, Refused> {
        let pending = &self.buffer[self.start..];
        let Some(header) = pending.first_chunk::<HEADER>() else { return Ok(None) };
        let word =
            |at: usize| i32::from_be_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
        let length = usize::try_from(word(0)).map_err(|_| Refused::Malformed)?;
        if !(HEADER..=MAX_LENGTH).contains(&length) {
            return Err(Refused::Malformed);
        }
        let whole = HEADER + (length - HEADER).next_multiple_of(8);
        if pending.len() < whole {
            return Ok(None);
        }
        let utc_ns = i64::from(word(4) as u32) * 1_000_000_000 + i64::from(word(8)) * 1000;
        let message = Message { utc_ns, sender: word(12), kind: word(16), payload: &pending[HEADER..length] };
        self.start += whole;
        Ok(Some(message))
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

/// Appends a pose: position in the room, m, and orientation, sensor to room, unit quaternion with its scalar first.
pub fn pose(from: From, position_m: [f64; 3], orientation_wxyz: [f64; 4], out: &mut Vec<u8>) {
    let mut payload = Doubles::<64>::new();
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
        pose(From { sender: 1, kind: 4, utc_ns: AT }, [0.1, 0.2, -0.3], [half, 0.0, 0.0, half], &mut out);
        let mut sheet = hex(
            "00 00 00 58 65 53 f1 00 00 03 d0 90 00 00 00 01 00 00 00 04 00 00 00 10 00 00 00 00 00 00 00 00
             3f b9 99 99 99 99 99 9a 3f c9 99 99 99 99 99 9a bf d3 33 33 33 33 33 33 00 00 00 00 00 00 00 00
             00 00 00 00 00 00 00 00 3f e6 a0 9e 66 7f 3b cd 3f e6 a0 9e 66 7f 3b cd",
        );
        sheet[20..24].fill(0);
        assert_eq!(out, sheet);
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
