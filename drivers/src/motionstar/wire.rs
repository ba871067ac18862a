//! BirdNet packets, both ways: header, system status, bird status, data records.
//!
//! What comes in: bytes in pieces of any size, or values. What goes out: the other of the two. All words are
//! big-endian; formats and the meaning of their words are those of the Flock.

use posed_state::Plain;

use crate::flock::wire::{Format, QuaternionSense, rotation, value};
use crate::rate::{ImpossibleRate, Rate};

/// Bytes of a packet's header.
pub const HEADER: usize = 16;
/// Most bytes of a body: 126 records of the longest format (12 words), each with head and buttons.
pub const MAX_BODY: usize = 126 * (2 + 24 + 2);
/// Most bytes of a body without records: the status of a system with all units, and some to spare.
const MAX_PLAIN_BODY: usize = 256;
/// Measurement rates that a system can have, Hz. The maker states 20 to 144 Hz; its birds are those of a Flock, whose range
/// ([`crate::flock::wire::value::RATES_HZ`]) leaves room for servers of other versions.
pub const RATES_HZ: std::ops::RangeInclusive<f64> = crate::flock::wire::value::RATES_HZ;
/// Number of the protocol.
const PROTOCOL: u8 = 3;
/// Full scale of a word.
const FULL_SCALE: f64 = 32768.0;
/// How far an orientation may be from a rotation: quaternion norm, matrix elements.
const QUATERNION_NORM: f64 = 0.0015;
const MATRIX: f64 = 0.03;

/// Types of packets, by the vendor's names.
///
/// Client to server: 10, 11, 30, 101 to 106. Server to client: 20, 21, 31 and 201 to 206, the answers to these in turn; 40, the
/// question came at the wrong time; 50, it was not known; 210 and 212, data; 211, an acknowledgement.
pub mod kind {
    #![expect(missing_docs, reason = "the vendor's names")]
    pub const WAKE_UP: u8 = 10;
    pub const SHUT_DOWN: u8 = 11;
    pub const RSP_WAKE_UP: u8 = 20;
    pub const RSP_SHUT_DOWN: u8 = 21;
    pub const SYNC_SEQUENCE: u8 = 30;
    pub const RSP_SYNC_SEQUENCE: u8 = 31;
    pub const RSP_ILLEGAL: u8 = 40;
    pub const RSP_UNKNOWN: u8 = 50;
    pub const GET_STATUS: u8 = 101;
    pub const SEND_SETUP: u8 = 102;
    pub const SINGLE_SHOT: u8 = 103;
    pub const RUN_CONTINUOUS: u8 = 104;
    pub const STOP_DATA: u8 = 105;
    pub const SEND_DATA: u8 = 106;
    pub const RSP_GET_STATUS: u8 = 201;
    pub const RSP_SEND_SETUP: u8 = 202;
    pub const RSP_SINGLE_SHOT: u8 = 203;
    pub const RSP_RUN_CONTINUOUS: u8 = 204;
    pub const RSP_STOP_DATA: u8 = 205;
    pub const RSP_SEND_DATA: u8 = 206;
    pub const DATA_PACKET: u8 = 210;
    pub const DATA_ACK: u8 = 211;
    pub const DATA_SINGLE: u8 = 212;

    /// Whether a packet of this type exists, in either direction.
    pub const fn is_known(kind: u8) -> bool {
        matches!(kind, 10 | 11 | 20 | 21 | 30 | 31 | 40 | 50 | 101..=106 | 201..=206 | 210..=212)
    }
}

/// Header of a packet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// Number of the packet, with wrap; an answer repeats that of its question, data packets step by one.
    pub sequence: u16,
    /// Server's time: milliseconds of the second; this driver sends 0.
    pub millis: u16,
    /// Server's time: seconds since 1970, by the clock of the server; this driver sends 0.
    pub seconds: u32,
    /// Type, see [`kind`].
    pub kind: u8,
    /// 0 for the whole system, else a unit's address, 1 to 126.
    pub unit: u8,
    /// Error, 0 for none; see [`error_words`].
    pub error: u8,
    /// More about the error; its meaning is not documented.
    pub error_extension: u16,
}

impl Header {
    /// Appends a packet: this header (16 bytes, big-endian), with the length of the body, and the body.
    ///
    /// # Panics
    /// With more than [`MAX_BODY`] bytes of body.
    pub fn encode(&self, body: &[u8], out: &mut Vec<u8>) {
        assert!(body.len() <= MAX_BODY, "{} bytes do not fit a packet", body.len());
        out.extend(self.sequence.to_be_bytes());
        out.extend(self.millis.to_be_bytes());
        out.extend(self.seconds.to_be_bytes());
        out.extend([self.kind, self.unit, PROTOCOL, self.error]);
        out.extend(self.error_extension.to_be_bytes());
        out.extend((body.len() as u16).to_be_bytes());
        out.extend(body);
    }

    /// Whether the body is a row of records.
    fn has_records(&self) -> bool {
        matches!(self.kind, kind::DATA_PACKET | kind::DATA_SINGLE)
    }

    /// Reads a header and the length of the body; `None` when it cannot be one.
    fn parse(bytes: &[u8; HEADER]) -> Option<(Self, usize)> {
        let be16 = |at: usize| u16::from_be_bytes([bytes[at], bytes[at + 1]]);
        let header = Self {
            sequence: be16(0),
            millis: be16(2),
            seconds: u32::from_be_bytes([bytes[4], bytes[5], bytes[6], bytes[7]]),
            kind: bytes[8],
            unit: bytes[9],
            error: bytes[11],
            error_extension: be16(12),
        };
        let len = usize::from(be16(14));
        let most = if header.has_records() { MAX_BODY } else { MAX_PLAIN_BODY };
        let fits = bytes[10] == PROTOCOL && kind::is_known(header.kind) && header.unit <= 126 && len <= most;
        fits.then_some((header, len))
    }
}

/// Where a packet lies in [`Packets`]; good until the next [`Packets::push`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Found {
    /// Place in the stream of the header's first byte: bytes pushed before it.
    pub offset: u64,
    /// The header; its fields are possible, not proven.
    pub header: Header,
    body: (usize, usize),
}

/// Cuts a stream of bytes into packets.
///
/// Packets have neither mark nor checksum. A header must be possible and its records must fill the body, as far
/// as it has come; else it gives up one byte, and a wrong length holds up little. Where bytes of a body were lost, its
/// end is the begin of the next packet: if nothing can begin behind it, that one is looked for in it.
#[derive(Clone, Debug, Default, Plain)]
pub struct Packets {
    buffer: Vec<u8>,
    start: usize,
    /// The packet that ends at `start`, if one does: its number, and where its body begins.
    before: Option<(u16, usize)>,
    origin: u64,
    bytes_skipped: u64,
}

impl Packets {
    /// Takes more bytes, in the order of the stream. Earlier [`Found`]s are void from here on.
    pub fn push(&mut self, bytes: &[u8]) {
        let done = self.before.map_or(self.start, |(_, body)| body);
        self.buffer.drain(..done);
        self.origin += done as u64;
        self.start -= done;
        self.before = self.before.map(|(number, _)| (number, 0));
        self.buffer.extend_from_slice(bytes);
    }

    /// The next packet, or `None` until more bytes come. Bytes that can be no header are skipped one by one.
    ///
    /// A data packet is checked to hold records of known formats that fill it; the body of another packet is not checked.
    pub fn find(&mut self) -> Option<Found> {
        loop {
            let pending = &self.buffer[self.start..];
            let head = pending.first_chunk()?;
            let Some((header, len)) = possible(head, &pending[HEADER..]) else {
                if let Some(offset) = self.before.take().and_then(|before| self.begun_in(before)) {
                    self.start = offset;
                    continue;
                }
                self.start += 1;
                self.bytes_skipped += 1;
                continue;
            };
            if pending.len() < HEADER + len {
                return None;
            }
            let offset = self.origin + self.start as u64;
            let body = (self.start + HEADER, self.start + HEADER + len);
            self.start = body.1;
            self.before = Some((header.sequence, body.0));
            return Some(Found { offset, header, body });
        }
    }

    /// Where in the body of a packet the packet after it begins, if it does.
    fn begun_in(&self, (number, body): (u16, usize)) -> Option<usize> {
        (body..self.start).rev().find(|offset| {
            let head = self.buffer[*offset..].first_chunk().and_then(Header::parse);
            head.is_some_and(|(header, _)| header.has_records() && header.sequence == number.wrapping_add(1))
        })
    }

    /// The body of a packet, as it came.
    ///
    /// # Panics
    /// May panic, or give other bytes, where `found` is from before the last [`Packets::push`], or from other packets.
    pub fn body(&self, found: Found) -> &[u8] {
        &self.buffer[found.body.0..found.body.1]
    }

    /// Whether what has come behind a data packet can be the front of another one. Where it cannot, a byte of the packet was lost or
    /// added: its last record ends elsewhere. Until a whole header is there its number tells, for the next one steps by one.
    ///
    /// # Panics
    /// As [`Packets::body`].
    pub(super) fn is_followed(&self, found: Found) -> bool {
        let behind = &self.buffer[found.body.1..];
        match behind.first_chunk() {
            Some(head) => possible(head, &behind[HEADER..]).is_some(),
            None => {
                let next = found.header.sequence.wrapping_add(1).to_be_bytes();
                behind.iter().zip(&next).all(|(byte, expected)| byte == expected)
            }
        }
    }

    /// Bytes are missing here, or the stream has ended: what is pending is no packet and counts as skipped.
    pub fn interrupt(&mut self) {
        self.bytes_skipped += (self.buffer.len() - self.start) as u64;
        self.start = self.buffer.len();
        self.before = None;
    }

    /// Bytes of no packet so far.
    pub fn bytes_skipped(&self) -> u64 {
        self.bytes_skipped
    }
}

/// The header that a packet can begin with, and the length of its body; `rest` is what has come of that and behind it.
fn possible(head: &[u8; HEADER], rest: &[u8]) -> Option<(Header, usize)> {
    Header::parse(head)
        .filter(|&(header, len)| !header.has_records() || may_be_records(&rest[..rest.len().min(len)], len))
}

/// What the whole system reports about itself (answer 201 for unit 0); 16 bytes, then one per address.
#[derive(Clone, Debug, PartialEq, Eq, Plain)]
pub struct SystemStatus {
    /// The body as it came; it is sent back with another rate.
    body: Vec<u8>,
}

impl SystemStatus {
    /// Reads the body; `None` when it has less than 16 bytes. Its contents are not checked.
    pub fn parse(body: &[u8]) -> Option<Self> {
        (body.len() >= 16).then(|| Self { body: body.to_vec() })
    }

    /// Measurement rate as it is set (six digits of mHz on the wire).
    ///
    /// # Errors
    /// The digits are none (NaN is what they claim then), or not one of [`RATES_HZ`].
    pub fn rate(&self) -> Result<Rate, ImpossibleRate> {
        let digits = std::str::from_utf8(&self.body[5..11]).ok();
        let millihertz = digits.and_then(|digits| digits.trim().parse::<u32>().ok());
        let hz = millihertz.map_or(f64::NAN, |millihertz| f64::from(millihertz) / 1000.0);
        Rate::claimed(hz, &RATES_HZ)
    }

    /// Addresses of units that are accessible and have a sensor, rising. A controller that claims a sensor is among them.
    pub fn sensors(&self) -> impl Iterator<Item = u8> + '_ {
        (1..=126).zip(&self.body[16..]).filter(|(_, flags)| *flags & 0xA0 == 0xA0).map(|(address, _)| address)
    }

    /// The body that sets another measurement rate, Hz, held within 0 and 999.999: the first 16 bytes only, as long as some
    /// servers take.
    pub fn with_rate(&self, rate_hz: f64) -> Vec<u8> {
        let mut body = self.body[..16].to_vec();
        let digits = format!("{:06}", (rate_hz * 1000.0).round().clamp(0.0, 999_999.0) as u32);
        body[5..11].copy_from_slice(digits.as_bytes());
        body
    }
}

/// Bytes of a bird's status, asked for and sent back.
pub const BIRD_STATUS: usize = 70;

/// What one bird reports about itself (answer 201 for its address).
#[derive(Clone, Debug, PartialEq, Eq, Plain)]
pub struct BirdStatus {
    /// The body as it came; it is sent back with other settings.
    body: Vec<u8>,
}

impl BirdStatus {
    /// Reads the body; `None` when it has not [`BIRD_STATUS`] bytes. Its contents are not checked.
    pub fn parse(body: &[u8]) -> Option<Self> {
        (body.len() == BIRD_STATUS).then(|| Self { body: body.to_vec() })
    }

    /// Whether a sensor is plugged in.
    pub fn has_sensor(&self) -> bool {
        self.body[0] & 0x04 != 0
    }

    /// Full scale of positions, m (12 bits of inches on the wire); `None` for a unit of length other than inches, and for 0.
    pub fn range_m(&self) -> Option<f64> {
        let word = u16::from_be_bytes([self.body[8], self.body[9]]);
        (word >> 12 == 0 && word != 0).then(|| f64::from(word & 0x0FFF) * 0.0254)
    }

    /// The body that sets format, one record per `report_every` cycles, hemisphere code (0 forward, 1 aft, 2 upper, 3 lower, 4
    /// left, 5 right: not the Flock's bytes), and whether records carry button bytes. All else stays as the bird reported it.
    pub fn with(&self, format: Format, report_every: u8, hemisphere: u8, button: bool) -> Vec<u8> {
        let mut body = self.body.clone();
        body[5] = if button { body[5] | 0x08 } else { body[5] & !0x08 };
        body[6] = (format.words() as u8) << 4 | format.status_code();
        body[7] = report_every;
        body[10] = hemisphere;
        body
    }
}

/// One record of a data packet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record<'a> {
    /// Address of the unit, 0 to 127 as sent.
    pub address: u8,
    /// Code of the format, see [`Format::status_code`]; besides 0 no data, 14 feed-through, 15 bad data.
    pub code: u8,
    /// Words as sent: big-endian, signed, 32768 to full scale.
    pub words: &'a [[u8; 2]],
    /// Button bytes as sent; `None` where the record has none.
    pub buttons: Option<[u8; 2]>,
}

/// The records of a data packet, in order; `None` when they do not fill the body exactly. Their formats are not checked: that is
/// for [`Record::pose`].
pub fn records(body: &[u8]) -> Option<impl Iterator<Item = Record<'_>>> {
    let mut check = body;
    while let Some((_, rest)) = next_record(check) {
        check = rest;
    }
    let mut rest = body;
    check.is_empty().then(|| {
        std::iter::from_fn(move || {
            let (record, after) = next_record(rest)?;
            rest = after;
            Some(record)
        })
    })
}

/// Whether bytes can be the front of a body of `len` bytes that records fill.
fn may_be_records(front: &[u8], len: usize) -> bool {
    let mut at = 0;
    while let Some(&[unit, form]) = front.get(at..).and_then(|rest| rest.first_chunk()) {
        let (code, words) = (form >> 4, usize::from(form & 0x0F));
        let has_form = match code {
            0 => words == 0,
            14 | 15 => true,
            _ => Format::from_status_code(code).is_some_and(|format| format.words() == words),
        };
        at += 2 + 2 * words + if unit & 0x80 != 0 { 2 } else { 0 };
        if !has_form || !(1..=126).contains(&(unit & 0x7F)) || at > len {
            return false;
        }
    }
    // Nothing may be left over: a last byte alone is no record.
    front.len() < len || at == len
}

fn next_record(bytes: &[u8]) -> Option<(Record<'_>, &[u8])> {
    let (&[unit, form], rest) = bytes.split_first_chunk()?;
    let (words, rest) = rest.split_at_checked(2 * usize::from(form & 0x0F))?;
    let (buttons, rest) = if unit & 0x80 != 0 {
        let (&buttons, rest) = rest.split_first_chunk()?;
        (Some(buttons), rest)
    } else {
        (None, rest)
    };
    Some((Record { address: unit & 0x7F, code: form >> 4, words: words.as_chunks().0, buttons }, rest))
}

/// A pose, position in m, orientation as unit quaternion sensor to transmitter: the device's own estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Position of the sensor in the transmitter frame, m; `None` in formats without.
    pub position_m: Option<[f64; 3]>,
    /// Unit quaternion (w, x, y, z), sensor to transmitter; `None` in the position format.
    pub orientation_wxyz: Option<[f64; 4]>,
}

impl Pose {
    /// Whether a coordinate is at the end of the words' range, `range_m` (full scale, m).
    pub fn is_clipped(&self, range_m: f64) -> bool {
        value::is_clipped(self.position_m, range_m, FULL_SCALE)
    }
}

impl Record<'_> {
    /// The pose; `Ok(None)` for a record without one (code 0 no data, 14 feed-through, such as a wand's buttons).
    ///
    /// `range_m` is the full scale of positions in m ([`BirdStatus::range_m`]), `sense` what the quaternion on the wire means.
    ///
    /// # Errors
    /// The record must not be used: it says that its data are bad, its format is not known or has another number of words, a
    /// quaternion's norm is further than 0.0015 from 1, or a matrix further than 0.03 from orthonormal. Positions and angles can
    /// be anything, so damage in them alone is not found.
    pub fn pose(&self, range_m: f64, sense: QuaternionSense) -> Result<Option<Pose>, BadRecord> {
        if self.code == 0 || self.code == 14 {
            return Ok(None);
        }
        let format = Format::from_status_code(self.code).ok_or(BadRecord)?;
        if self.words.len() != format.words() {
            return Err(BadRecord);
        }
        let mut values = [0.0; 12];
        for (value, word) in values.iter_mut().zip(self.words) {
            *value = f64::from(i16::from_be_bytes(*word)) / FULL_SCALE;
        }
        let [x, y, z, ..] = values;
        let position_m = format.has_position().then(|| [x, y, z].map(|value| value * range_m));
        let orientation = &values[if format.has_position() { 3 } else { 0 }..];
        let orientation_wxyz = match format {
            Format::Position => None,
            Format::Angles | Format::PositionAngles => {
                Some(rotation::from_angles([0, 1, 2].map(|k| orientation[k] * std::f64::consts::PI)))
            }
            Format::Matrix | Format::PositionMatrix => {
                let matrix = std::array::from_fn(|k| orientation[k]);
                if rotation::orthonormality_error(matrix) > MATRIX {
                    return Err(BadRecord);
                }
                Some(rotation::from_matrix(matrix))
            }
            Format::Quaternion | Format::PositionQuaternion => {
                let q = std::array::from_fn(|k| orientation[k]);
                if (rotation::norm(q) - 1.0).abs() > QUATERNION_NORM {
                    return Err(BadRecord);
                }
                Some(sensed(rotation::normalised(q), sense))
            }
        };
        Ok(Some(Pose { position_m, orientation_wxyz }))
    }
}

/// A record that must not be used; see [`Record::pose`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BadRecord;

/// Appends a record to `out`: `pose` in m and as unit quaternion sensor to transmitter, scaled by `range_m` (full scale, m).
///
/// Values beyond full scale are held at it. What the format needs and the pose lacks is the origin, or the identity. `address`
/// must be below 128.
pub fn encode_record(
    address: u8,
    format: Format,
    pose: Pose,
    range_m: f64,
    sense: QuaternionSense,
    buttons: Option<[u8; 2]>,
    out: &mut Vec<u8>,
) {
    out.extend([
        address | if buttons.is_some() { 0x80 } else { 0 },
        format.status_code() << 4 | format.words() as u8,
    ]);
    let mut word = |value: f64| {
        out.extend(((value * FULL_SCALE).round().clamp(-32768.0, 32767.0) as i16).to_be_bytes());
    };
    if format.has_position() {
        pose.position_m.unwrap_or_default().iter().for_each(|value| word(value / range_m));
    }
    let q = pose.orientation_wxyz.unwrap_or([1.0, 0.0, 0.0, 0.0]);
    match format {
        Format::Position => {}
        Format::Angles | Format::PositionAngles => {
            rotation::to_angles(q).iter().for_each(|angle| word(angle / std::f64::consts::PI));
        }
        Format::Matrix | Format::PositionMatrix => {
            rotation::to_matrix(q).iter().for_each(|&value| word(value))
        }
        Format::Quaternion | Format::PositionQuaternion => {
            sensed(q, sense).iter().for_each(|&value| word(value))
        }
    }
    out.extend(buttons.into_iter().flatten());
}

fn sensed([w, x, y, z]: [f64; 4], sense: QuaternionSense) -> [f64; 4] {
    match sense {
        QuaternionSense::Vendor => [w, -x, -y, -z],
        QuaternionSense::Direct => [w, x, y, z],
    }
}

/// What an error code of a header means, in words; codes as in the vendor's guide. Older servers number some of them otherwise,
/// so show the code, too.
pub fn error_words(code: u8) -> &'static str {
    match code {
        1..=3 => "packets of ours did not arrive",
        4 => "a packet of ours came twice",
        6 => "a packet of ours was not expected",
        7 => "a packet of ours was not understood",
        8 => "the status of a unit was asked that is not there",
        9 => "the settings are not allowed",
        100 => "the system is not ready",
        _ => "an error that is not documented",
    }
}
