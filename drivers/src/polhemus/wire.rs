//! Records, answers and commands of a Liberty or Patriot, both ways.
//!
//! What comes in: bytes in pieces of any size. What goes out: records, in metres, and the answers that set-up needs.

use posed_state::Plain;

use crate::cut::{Columns, Cutter, Front, Grammar, line_len};

/// Most stations of any unit; they are numbered from 1.
pub const STATIONS: u8 = 16;
/// Bytes of a binary header.
pub const HEADER: usize = 8;
/// Bytes of the answer that says which stations are active, header apart.
const ACTIVE: usize = 4;
/// What a record was asked with: a stream.
pub const STREAM: u8 = b'C';
/// What a record was asked with: one of each station.
pub const POINT: u8 = b'P';
/// The question which stations are active.
pub const ACTIVE_STATIONS: u8 = 0x15;
/// The question who the unit is.
pub const WHO_AM_I: u8 = 0x16;
/// Metres per centimetre, the unit that set-up selects.
const CM: f64 = 0.01;
/// Greatest distance that a unit measures, with room, m.
const FARTHEST_M: f64 = 10.0;
/// How far from 1 the norm of a quaternion may be: in single precision, and with five decimals.
const NORM: f64 = 1e-3;
/// Longest line of text that is waited for.
const MAX_LINE: usize = 200;

/// Which unit it is, by the two letters in front of each binary record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Plain)]
pub enum Model {
    /// Up to 16 stations.
    Liberty,
    /// Up to 2 stations.
    Patriot,
}

impl Model {
    /// Its letters.
    pub const fn tag(self) -> [u8; 2] {
        match self {
            Self::Liberty => *b"LY",
            Self::Patriot => *b"PA",
        }
    }

    /// Frames per second, nominal; each has a record of every active station.
    pub const fn rate_hz(self) -> f64 {
        match self {
            Self::Liberty => 240.0,
            Self::Patriot => 60.0,
        }
    }
}

/// What the records look like: both sides of the line must agree, for a record does not tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Plain)]
pub struct Shape {
    /// Lines of decimals instead of binary numbers (least significant byte first).
    pub text: bool,
    /// Whether the stylus button follows the pose.
    pub button: bool,
}

impl Shape {
    /// The output list: 8 time, 9 frame, 2 position, 7 quaternion, 10 stylus button where wanted, and a space (0) or CR LF (1).
    pub const fn items(self) -> &'static [u8] {
        match self {
            Self { text: false, button: false } => &[8, 9, 2, 7, 0],
            Self { text: false, button: true } => &[8, 9, 2, 7, 10, 0],
            Self { text: true, button: false } => &[8, 9, 2, 7, 1],
            Self { text: true, button: true } => &[8, 9, 2, 7, 10, 1],
        }
    }

    /// Bytes of a binary record, header included.
    pub fn binary_len(self) -> usize {
        HEADER + self.items().iter().map(|&item| item_len(item)).sum::<usize>()
    }
}

/// Bytes of an item of a binary record; 0 for one that is not known.
const fn item_len(item: u8) -> usize {
    match item {
        0 => 1,
        1 => 2,
        2..=5 => 12,
        6 => 36,
        7 => 16,
        8..=12 => 4,
        _ => 0,
    }
}

/// The front of everything that a unit sends in binary.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Which unit.
    pub model: Model,
    /// Station from 1; 0 in an answer of the whole unit.
    pub station: u8,
    /// First byte of the command that it answers.
    pub command: u8,
    /// 0 or a space: all is well; of records else a letter, of other answers a number.
    pub error: u8,
    /// Bytes that follow. Some take the header for a part of them.
    pub size: u16,
}

impl Header {
    /// Reads the header at the front; `None` where there is none.
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        let [l, r, station, command, error, _, low, high] = *bytes.first_chunk::<HEADER>()?;
        let model = [Model::Liberty, Model::Patriot].into_iter().find(|model| model.tag() == [l, r])?;
        Some(Self { model, station, command, error, size: u16::from_le_bytes([low, high]) })
    }

    /// Appends it as it travels.
    pub fn encode(self, out: &mut Vec<u8>) {
        out.extend(self.model.tag());
        out.extend([self.station, self.command, self.error, 0]);
        out.extend(self.size.to_le_bytes());
    }

    /// Whether so many bytes follow it, whichever way they are counted.
    fn announces(self, body: usize) -> bool {
        usize::from(self.size) == body || usize::from(self.size) == body + HEADER
    }

    /// Bytes behind it, if it is one of what is read here.
    fn body_len(self, shape: Shape) -> Option<usize> {
        let record = shape.binary_len() - HEADER;
        match self.command {
            STREAM | POINT if !shape.text && self.announces(record) => {
                ((1..=STATIONS).contains(&self.station) && is_status(self.error)).then_some(record)
            }
            ACTIVE_STATIONS if self.announces(ACTIVE) => Some(ACTIVE),
            STREAM | POINT => None,
            _ => (self.announces(0) && (1..=72).contains(&self.error) && self.error != b' ').then_some(0),
        }
    }
}

/// Whether a record can carry this in the place of its error.
fn is_status(error: u8) -> bool {
    matches!(error, 0 | b' ' | b'A'..=b'G' | b'a'..=b'g' | b'u' | b'I')
}

/// Numbers of a record, by its list; those of items that are not in it are 0, and absent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Numbers {
    /// Item 8: ms since the unit's start.
    pub time_ms: u32,
    /// Item 9: frames since then.
    pub frame: u32,
    /// Item 2 or 3, in the unit of length that was set.
    pub position: [f64; 3],
    /// Item 4 or 5: azimuth, elevation, roll, degrees.
    pub angles_deg: Option<[f64; 3]>,
    /// Item 7, (w, x, y, z).
    pub quaternion_wxyz: [f64; 4],
    /// Item 10.
    pub button: Option<bool>,
}

impl Numbers {
    /// Reads the body of a binary record of this list; `None` where it is not of its length, or a terminator or button is not one.
    pub fn parse(items: &[u8], mut body: &[u8]) -> Option<Self> {
        let mut numbers = Self::default();
        for &item in items {
            let (bytes, rest) = body.split_at_checked(item_len(item))?;
            body = rest;
            let (words, _) = bytes.as_chunks::<4>();
            let float = |k: usize| words.get(k).map_or(0.0, |word| f64::from(f32::from_le_bytes(*word)));
            let word = words.first().map_or(0, |word| u32::from_le_bytes(*word));
            match item {
                0 if bytes != b" " => return None,
                1 if bytes != b"\r\n" => return None,
                2 | 3 => numbers.position = std::array::from_fn(float),
                4 | 5 => numbers.angles_deg = Some(std::array::from_fn(float)),
                7 => numbers.quaternion_wxyz = std::array::from_fn(float),
                8 => numbers.time_ms = word,
                9 => numbers.frame = word,
                10 if word > 1 => return None,
                10 => numbers.button = Some(word == 1),
                _ => {}
            }
        }
        body.is_empty().then_some(numbers)
    }
}

/// One record. It is plausible, not proven: the protocol has no checksum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// Which unit; text does not say it.
    pub model: Option<Model>,
    /// Station, from 1.
    pub station: u8,
    /// A space when all is well, else the unit's letter for what is not.
    pub status: u8,
    /// Milliseconds since the unit's start; wraps after 49.7 days.
    pub time_ms: u32,
    /// Frames since the unit's start.
    pub frame: u32,
    /// Position of the sensor in the frame of the source, m; each coordinate within 10 m. Centimetres on the wire.
    pub position_m: [f64; 3],
    /// Unit quaternion (w, x, y, z), sensor to source, normalised when read.
    pub orientation_wxyz: [f64; 4],
    /// Whether the stylus button is down; `None` where the shape has no button.
    pub button: Option<bool>,
}

impl Record {
    fn new(model: Option<Model>, station: u8, status: u8, numbers: Numbers) -> Option<Self> {
        let q = numbers.quaternion_wxyz;
        let norm = q.iter().map(|value| value * value).sum::<f64>().sqrt();
        let position_m = numbers.position.map(|value| value * CM);
        let fits = (1..=STATIONS).contains(&station)
            && position_m.iter().all(|value| value.abs() <= FARTHEST_M)
            && (1.0 - NORM..=1.0 + NORM).contains(&norm);
        fits.then(|| Self {
            model,
            station,
            status: if status == 0 { b' ' } else { status },
            time_ms: numbers.time_ms,
            frame: numbers.frame,
            position_m,
            orientation_wxyz: q.map(|value| value / norm),
            button: numbers.button,
        })
    }

    /// Reads a line of text: station and error letter, then the items of the list, parted by blanks.
    fn parse_text(line: &[u8], shape: Shape) -> Option<(Self, usize)> {
        let text = std::str::from_utf8(line).ok()?.trim_end();
        let (station, rest) = text.split_at_checked(2)?;
        let (status, rest) = rest.split_at_checked(1)?;
        let status = *status.as_bytes().first().filter(|&&status| status != 0 && is_status(status))?;
        let mut fields = rest.split_ascii_whitespace();
        let mut next = || fields.next();
        let (time_ms, frame) = (next()?, next()?);
        // The pose has columns of its own; a number of more digits moves them.
        let pose_at = frame.as_ptr() as usize - text.as_ptr() as usize + frame.len();
        let mut values = [0.0; 7];
        for value in &mut values {
            *value = next()?.parse().ok()?;
        }
        let button = match (shape.button, next()) {
            (false, None) => None,
            (true, Some("0")) => Some(false),
            (true, Some("1")) => Some(true),
            _ => return None,
        };
        let [x, y, z, quaternion_wxyz @ ..] = values;
        let numbers = Numbers {
            time_ms: time_ms.parse().ok()?,
            frame: frame.parse().ok()?,
            position: [x, y, z],
            angles_deg: None,
            quaternion_wxyz,
            button,
        };
        next().is_none().then_some(())?;
        Some((Self::new(None, station.parse().ok()?, status, numbers)?, pose_at))
    }

    /// Appends the record of a stream as it travels: centimetres; single precision in binary, three and five decimals in text. Where the shape
    /// has a button and the record none, the button is up; a record without a model is a Liberty's.
    pub fn encode(&self, shape: Shape, out: &mut Vec<u8>) {
        let button = shape.button.then_some(u32::from(self.button == Some(true)));
        let position_cm = self.position_m.map(|value| value / CM);
        if shape.text {
            out.extend(format!("{:02}{}", self.station, char::from(self.status)).bytes());
            out.extend(format!(" {:10} {:10}", self.time_ms, self.frame).bytes());
            out.extend(position_cm.iter().flat_map(|value| format!(" {value:8.3}").into_bytes()));
            out.extend(self.orientation_wxyz.iter().flat_map(|value| format!(" {value:8.5}").into_bytes()));
            out.extend(button.iter().flat_map(|button| format!(" {button}").into_bytes()));
            return out.extend(b"\r\n");
        }
        let model = self.model.unwrap_or(Model::Liberty);
        let size = (shape.binary_len() - HEADER) as u16;
        Header { model, station: self.station, command: STREAM, error: self.status, size }.encode(out);
        out.extend(self.time_ms.to_le_bytes().into_iter().chain(self.frame.to_le_bytes()));
        for value in position_cm.into_iter().chain(self.orientation_wxyz) {
            out.extend((value as f32).to_le_bytes());
        }
        out.extend(button.iter().flat_map(|button| button.to_le_bytes()));
        out.push(b' ');
    }
}

/// What the stream of a unit holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Piece {
    /// A record that has the form.
    Record {
        /// Place in the stream of its first byte: bytes pushed before it.
        offset: u64,
        /// Bytes on the line.
        len: usize,
        /// What it says.
        record: Record,
    },
    /// Which stations have a sensor and are switched on.
    Active {
        /// Which unit.
        model: Model,
        /// Bit 0 is station 1.
        stations: u16,
    },
    /// A command was not understood, or an error without a record.
    Refusal {
        /// First byte of the command.
        command: u8,
        /// The manual's number of the error.
        code: u8,
    },
}

/// Cuts a stream of bytes into records and answers. What comes out does not depend on how the bytes were cut.
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
        match bytes[0] {
            b'\r' | b'\n' if in_sync => Front::Pass(1),
            b'L' | b'P' => self.binary(offset, bytes, in_sync),
            b'0'..=b'9' if self.shape.text => match line_len(bytes, MAX_LINE) {
                Ok(len) => {
                    let record = Record::parse_text(&bytes[..len], self.shape);
                    let record = record.filter(|&(_, pose_at)| self.columns.take(&bytes[pose_at..len]));
                    record.map_or(Front::No, |(record, _)| {
                        Front::Message(len, Piece::Record { offset, len, record })
                    })
                }
                Err(front) => front,
            },
            _ => Front::No,
        }
    }
}

impl Records {
    fn binary(&self, offset: u64, bytes: &[u8], in_sync: bool) -> Front<Piece> {
        let tags = [Model::Liberty, Model::Patriot].map(Model::tag);
        if bytes.get(1).is_some_and(|second| !tags.contains(&[bytes[0], *second])) {
            return Front::No;
        }
        if bytes.len() < HEADER {
            return Front::Wait;
        }
        let header = Header::parse(bytes);
        let Some((header, body_len)) = header.and_then(|header| Some((header, header.body_len(self.shape)?)))
        else {
            return Front::No;
        };
        let len = HEADER + body_len;
        let Some(body) = bytes.get(HEADER..len) else { return Front::Wait };
        let piece = match header.command {
            STREAM | POINT => Numbers::parse(self.shape.items(), body)
                .and_then(|numbers| Record::new(Some(header.model), header.station, header.error, numbers))
                .map(|record| Piece::Record { offset, len, record }),
            ACTIVE_STATIONS => {
                let [detected, active] = [0, 2].map(|at| u16::from_le_bytes([body[at], body[at + 1]]));
                Some(Piece::Active { model: header.model, stations: detected & active })
            }
            command => Some(Piece::Refusal { command, code: header.error }),
        };
        let Some(piece) = piece else { return Front::No };
        // The letters of a tag also occur in numbers: behind damage the next header is the proof.
        let behind = &bytes[len..];
        if !in_sync && behind.len() < HEADER {
            return Front::Wait;
        }
        let proven = in_sync || Header::parse(behind).is_some_and(|next| next.body_len(self.shape).is_some());
        if proven { Front::Message(len, piece) } else { Front::No }
    }
}
