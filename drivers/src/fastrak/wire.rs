//! Records and commands of a Fastrak, both ways.
//!
//! What comes in: bytes in pieces of any size. What goes out: records, in metres. The output list is always
//! position, quaternion, the stylus button if wanted, and CR LF: the longest terminator there is.

use posed_state::Plain;

use crate::cut::{Columns, Cutter, Front, Grammar, line_len};

/// Most stations of a unit; they are numbered from 1.
pub const STATIONS: u8 = 4;
/// First byte of every data record.
const DATA: u8 = b'0';
/// Metres per centimetre, the unit that set-up selects.
const CM: f64 = 0.01;
/// Greatest distance that a unit measures, with room, m.
const FARTHEST_M: f64 = 10.0;
/// How far from 1 the norm of a quaternion may be: text has few decimals.
const BINARY_NORM: f64 = 0.005;
const TEXT_NORM: f64 = 0.02;
/// Longest line of text that is waited for.
const MAX_LINE: usize = 200;

/// What the records look like: both sides of the line must agree, for a record does not tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Plain)]
pub struct Shape {
    /// Lines of decimals instead of binary numbers (single precision, least significant byte first).
    pub text: bool,
    /// Whether the stylus button follows the pose: a space and `0` or `1`.
    pub button: bool,
}

impl Shape {
    /// Bytes of a binary record: header 3, seven numbers of 4, button 2 where there is one, terminator 2.
    pub const fn binary_len(self) -> usize {
        3 + 28 + if self.button { 2 } else { 0 } + 2
    }

    /// Items of the output list as the command takes them: 2 position, 11 quaternion, 16 stylus button where wanted, 1 CR LF.
    pub const fn items(self) -> &'static str {
        if self.button { "2,11,16,1" } else { "2,11,1" }
    }
}

/// One record. It is plausible, not proven: the protocol has no checksum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// Station, 1 to 4.
    pub station: u8,
    /// A space when all is well, else the unit's letter for what is not.
    pub status: u8,
    /// Position of the sensor in the transmitter frame, m; each coordinate within 10 m. Centimetres on the wire.
    pub position_m: [f64; 3],
    /// Unit quaternion (w, x, y, z), sensor to transmitter, normalised when read.
    pub orientation_wxyz: [f64; 4],
    /// Whether the stylus button is down; `None` where the shape has no button.
    pub button: Option<bool>,
}

impl Record {
    /// Reads a binary record that fills `bytes`, terminator included.
    ///
    /// `None` unless all of it fits: length, header, button, terminator, coordinates within 10 m, norm of the quaternion within
    /// 0.005 of 1.
    pub fn parse_binary(bytes: &[u8], shape: Shape) -> Option<Self> {
        if bytes.len() != shape.binary_len() {
            return None;
        }
        let (header, rest) = bytes.split_first_chunk::<3>()?;
        let (numbers, rest) = rest.split_first_chunk::<28>()?;
        let (numbers, _) = numbers.as_chunks::<4>();
        let values: [f64; 7] = std::array::from_fn(|k| f64::from(f32::from_le_bytes(numbers[k])));
        let button = match (shape.button, rest) {
            (false, b"\r\n") => None,
            (true, b" 0\r\n") => Some(false),
            (true, b" 1\r\n") => Some(true),
            _ => return None,
        };
        Self::new(*header, values, button, BINARY_NORM)
    }

    /// Reads a line of text, with CR LF or without.
    ///
    /// `None` unless all of it fits: header, seven numbers and the button, coordinates within 10 m, norm of the quaternion
    /// within 0.02 of 1 (text has few decimals). Numbers may touch where a minus sign parts them.
    pub fn parse_text(line: &[u8], shape: Shape) -> Option<Self> {
        let line = line.trim_ascii_end();
        let (header, rest) = line.split_first_chunk::<3>()?;
        let mut fields = Fields(std::str::from_utf8(rest).ok()?);
        let mut values = [0.0; 7];
        for value in &mut values {
            *value = fields.next()?.parse().ok()?;
        }
        let button = match (shape.button, fields.next()) {
            (false, None) => None,
            (true, Some("0")) => Some(false),
            (true, Some("1")) => Some(true),
            _ => return None,
        };
        if fields.next().is_some() {
            return None;
        }
        Self::new(*header, values, button, TEXT_NORM)
    }

    fn new(
        [kind, station, status]: [u8; 3],
        values: [f64; 7],
        button: Option<bool>,
        norm_error: f64,
    ) -> Option<Self> {
        let [x, y, z, q @ ..] = values;
        let norm = q.iter().map(|value| value * value).sum::<f64>().sqrt();
        let position_m = [x, y, z].map(|value| value * CM);
        let fits = kind == DATA
            && (b'1'..=b'0' + STATIONS).contains(&station)
            && (status == b' ' || status.is_ascii_alphabetic())
            && position_m.iter().all(|value| value.abs() <= FARTHEST_M)
            && (1.0 - norm_error..=1.0 + norm_error).contains(&norm);
        fits.then(|| Self {
            station: station - b'0',
            status,
            position_m,
            orientation_wxyz: q.map(|value| value / norm),
            button,
        })
    }

    /// Appends the record as it travels, terminator included: centimetres, single precision in binary, four decimals in text.
    /// The station must be 1 to 4. Where the shape has a button and the record none, the button is up.
    pub fn encode(&self, shape: Shape, out: &mut Vec<u8>) {
        out.extend([DATA, b'0' + self.station, self.status]);
        let values = self.position_m.map(|value| value / CM).into_iter().chain(self.orientation_wxyz);
        for value in values {
            if shape.text {
                out.extend(format!(" {value:8.4}").bytes());
            } else {
                out.extend((value as f32).to_le_bytes());
            }
        }
        if shape.button {
            out.extend([b' ', b'0' + u8::from(self.button == Some(true))]);
        }
        out.extend(b"\r\n");
    }
}

/// Fields of a line: parted by spaces, or by a minus sign where a wide number has left no space.
struct Fields<'a>(&'a str);

impl<'a> Iterator for Fields<'a> {
    type Item = &'a str;
    fn next(&mut self) -> Option<&'a str> {
        let rest = self.0.trim_start_matches(' ');
        let end = rest
            .char_indices()
            .skip(1)
            .find(|&(at, letter)| letter == ' ' || letter == '-' && !rest[..at].ends_with(['e', 'E']))
            .map_or(rest.len(), |(at, _)| at);
        let (field, rest) = rest.split_at(end);
        self.0 = rest;
        (!field.is_empty()).then_some(field)
    }
}

/// What the stream of a unit holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Piece {
    /// A record that has the form.
    Record {
        /// Place in the stream of its first byte: bytes pushed before it.
        offset: u64,
        /// Bytes on the line, terminator included.
        len: usize,
        /// What it says.
        record: Record,
    },
    /// An answer to the status question: recognised by its form alone, its contents are not read.
    Status,
}

/// Cuts a stream of bytes into records. What comes out does not depend on how the bytes were cut.
pub type Splitter = Cutter<Records>;

/// Records of one shape, and answers.
#[derive(Clone, Debug, Plain)]
pub struct Records {
    shape: Shape,
    columns: Columns,
}

impl Records {
    /// Records of this shape only, and answers.
    pub fn new(shape: Shape) -> Self {
        Self { shape, columns: Columns::default() }
    }
}

impl Splitter {
    /// A splitter before the first byte, for records of this shape only.
    pub fn new(shape: Shape) -> Self {
        Self::of(Records::new(shape))
    }
}

impl Grammar for Records {
    type Message = Piece;

    fn front(&mut self, offset: u64, bytes: &[u8], in_sync: bool) -> Front<Piece> {
        let (len, record) = match bytes[0] {
            b'2' => return status(bytes),
            // The unit's line ends around answers.
            b'\r' | b'\n' if in_sync => return Front::Pass(1),
            DATA if self.shape.text => match line_len(bytes, MAX_LINE) {
                Ok(len) => {
                    let line = &bytes[..len];
                    let record = Record::parse_text(line, self.shape);
                    (len, record.filter(|_| self.columns.take(line)))
                }
                Err(front) => return front,
            },
            DATA if begins_a_record(bytes) => match bytes.get(..self.shape.binary_len()) {
                Some(bytes) => (bytes.len(), Record::parse_binary(bytes, self.shape)),
                None => return Front::Wait,
            },
            _ => return Front::No,
        };
        record.map_or(Front::No, |record| Front::Message(len, Piece::Record { offset, len, record }))
    }
}

/// Whether the first bytes can be a record's header, as far as they are there.
fn begins_a_record(bytes: &[u8]) -> bool {
    let station = bytes.get(1).is_none_or(|station| (b'1'..=b'0' + STATIONS).contains(station));
    let status = bytes.get(2).is_none_or(|&status| status == b' ' || status.is_ascii_alphabetic());
    station && status
}

/// A status answer at the front: `2`, station, `S`, 50 or 51 more bytes, CR LF.
fn status(bytes: &[u8]) -> Front<Piece> {
    let len = line_len(bytes, MAX_LINE);
    // What follows the line is no part of it, whether it has come yet or not.
    let line = len.as_ref().map_or(bytes, |&len| &bytes[..len]);
    if line.get(2).is_some_and(|&kind| kind != b'S') || !line.iter().all(|&byte| is_printable(byte)) {
        return Front::No;
    }
    match len {
        Ok(len) if (50..=60).contains(&len) => Front::Message(len, Piece::Status),
        Ok(_) => Front::No,
        Err(front) => front,
    }
}

fn is_printable(byte: u8) -> bool {
    (b' '..=b'~').contains(&byte) || byte == b'\r' || byte == b'\n'
}
