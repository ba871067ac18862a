//! Records and commands of a Fastrak, both ways.
//!
//! What comes in: bytes in pieces of any size. What goes out: records, in metres. The output list is always
//! position, quaternion, the stylus button if wanted, and CR LF: the longest terminator there is.

use posed_state::Plain;

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

/// Lines of text in a row that agree on other columns before those are believed.
const AGREEING: u32 = 4;

/// Where a unit's lines of text have their numbers. Its fields have a fixed width, so that the decimal points of all lines stand
/// in the same columns: where they do not, a byte was lost or added, which a number alone does not show.
#[derive(Clone, Copy, Debug, Default, Plain)]
struct Columns {
    believed: Option<[u64; 3]>,
    /// Other columns, and how many lines in a row had them.
    others: Option<[u64; 3]>,
    agreeing: u32,
}

impl Columns {
    /// Whether a line has the columns of those before it.
    fn take(&mut self, line: &[u8]) -> bool {
        let mut columns = [0, 0, line.len() as u64];
        for (at, _) in line.iter().take(128).enumerate().filter(|(_, byte)| **byte == b'.') {
            columns[at / 64] |= 1 << (at % 64);
        }
        if *self.believed.get_or_insert(columns) == columns {
            self.agreeing = 0;
            return true;
        }
        self.agreeing = if self.others.replace(columns) == Some(columns) { self.agreeing + 1 } else { 1 };
        let changed = self.agreeing >= AGREEING;
        if changed {
            self.believed = Some(columns);
        }
        changed
    }
}

/// Cuts a stream of bytes into records. What comes out does not depend on how the bytes were cut.
///
/// A record that does not fit gives up only its first byte, since the next one may begin inside it.
#[derive(Clone, Debug, Plain)]
pub struct Splitter {
    shape: Shape,
    buffer: Vec<u8>,
    start: usize,
    origin: u64,
    in_sync: bool,
    columns: Columns,
    rejected: u64,
    bytes_skipped: u64,
}

impl Splitter {
    /// A splitter before the first byte, for records of this shape only.
    pub fn new(shape: Shape) -> Self {
        Self {
            shape,
            buffer: Vec::new(),
            start: 0,
            origin: 0,
            in_sync: true,
            columns: Columns::default(),
            rejected: 0,
            bytes_skipped: 0,
        }
    }

    /// Takes more bytes, in the order of the stream.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.drain(..self.start);
        self.origin += self.start as u64;
        self.start = 0;
        self.buffer.extend_from_slice(bytes);
    }

    /// The next piece, or `None` until more bytes come. Bytes of no piece are skipped and counted.
    pub fn find(&mut self) -> Option<Piece> {
        loop {
            let pending = &self.buffer[self.start..];
            let offset = self.origin + self.start as u64;
            let (len, piece) = match pending.first()? {
                b'2' => match status_len(pending) {
                    Ok(len) => (len, Some(Piece::Status)),
                    Err(Cut::Wait) => return None,
                    Err(Cut::No) => (1, None),
                },
                b'\r' | b'\n' if self.in_sync => {
                    // The unit's line ends around answers.
                    self.start += 1;
                    continue;
                }
                &DATA if self.shape.text => match line_len(pending) {
                    Ok(len) => {
                        let line = &pending[..len];
                        let record = Record::parse_text(line, self.shape);
                        let record = record.filter(|_| self.columns.take(line));
                        (len, record.map(|record| Piece::Record { offset, len, record }))
                    }
                    Err(Cut::Wait) => return None,
                    Err(Cut::No) => (1, None),
                },
                &DATA => {
                    let len = self.shape.binary_len();
                    if !begins_a_record(pending) {
                        (1, None)
                    } else if pending.len() < len {
                        return None;
                    } else {
                        let record = Record::parse_binary(&pending[..len], self.shape);
                        (len, record.map(|record| Piece::Record { offset, len, record }))
                    }
                }
                _ => (1, None),
            };
            match piece {
                Some(piece) => {
                    self.start += len;
                    self.in_sync = true;
                    return Some(piece);
                }
                None => {
                    // One loss of sync is one record refused.
                    self.rejected += u64::from(self.in_sync);
                    self.in_sync = false;
                    self.start += 1;
                    self.bytes_skipped += 1;
                }
            }
        }
    }

    /// Bytes are missing here, or the stream has ended: what is pending is no record and counts as skipped.
    pub fn interrupt(&mut self) {
        self.bytes_skipped += (self.buffer.len() - self.start) as u64;
        self.start = self.buffer.len();
        self.in_sync = true;
    }

    /// Times that sync was lost: at least so many records were refused.
    pub fn rejected(&self) -> u64 {
        self.rejected
    }

    /// Bytes of no record and no answer; line ends between answers are not counted.
    pub fn bytes_skipped(&self) -> u64 {
        self.bytes_skipped
    }
}

enum Cut {
    /// More bytes may make it one.
    Wait,
    No,
}

/// Whether the first bytes can be a record's header, as far as they are there.
fn begins_a_record(bytes: &[u8]) -> bool {
    let station = bytes.get(1).is_none_or(|station| (b'1'..=b'0' + STATIONS).contains(station));
    let status = bytes.get(2).is_none_or(|&status| status == b' ' || status.is_ascii_alphabetic());
    station && status
}

/// Length of a line of text at the front.
fn line_len(bytes: &[u8]) -> Result<usize, Cut> {
    match bytes.iter().take(MAX_LINE).position(|&byte| byte == b'\n') {
        Some(at) => Ok(at + 1),
        None if bytes.len() < MAX_LINE => Err(Cut::Wait),
        None => Err(Cut::No),
    }
}

/// Length of a status answer: `2`, station, `S`, 50 or 51 more bytes, CR LF.
fn status_len(bytes: &[u8]) -> Result<usize, Cut> {
    let len = line_len(bytes);
    // What follows the line is no part of it, whether it has come yet or not.
    let line = len.as_ref().map_or(bytes, |&len| &bytes[..len]);
    if line.get(2).is_some_and(|&kind| kind != b'S') || !line.iter().all(|&byte| is_printable(byte)) {
        return Err(Cut::No);
    }
    len.and_then(|len| if (50..=60).contains(&len) { Ok(len) } else { Err(Cut::No) })
}

fn is_printable(byte: u8) -> bool {
    (b' '..=b'~').contains(&byte) || byte == b'\r' || byte == b'\n'
}
