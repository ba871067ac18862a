//! Messages of an x-IMU3 as bytes: lines, byte stuffing, multiplexer channels.
//!
//! Every message ends with LF, which occurs nowhere else. Its first byte tells whether it is a command
//! (`{`), data as text (`A` to `Z`), data in binary (the letter with bit 7 set), or a message of one unit of a
//! chain (`^`, channel byte, message).

use posed_state::Plain;

/// End of every message.
pub const LF: u8 = 0x0A;
/// Longest message that is waited for, bytes without LF; a longer one is skipped.
pub const MAX_LINE: usize = 4096;
/// First byte of a message of a chain; as a channel it means all units.
pub const MUX: u8 = b'^';
/// How the notification of a pressed button begins.
pub const BUTTON_PRESSED: &[u8] = b"Button pressed";
/// Bit 7 of the first byte of binary data.
const BINARY: u8 = 0x80;
const ESCAPE: u8 = 0xDB;
const ESCAPED_LF: u8 = 0xDC;
const ESCAPED_ESCAPE: u8 = 0xDD;

/// Cuts a stream of bytes into lines. What comes out does not depend on how the bytes were cut.
#[derive(Clone, Debug, Default, Plain)]
pub struct Lines {
    buffer: Vec<u8>,
    start: usize,
    searched: usize,
    /// Place in the stream of `buffer[0]`.
    origin: u64,
    /// Inside a line too long to be a message, of which the front has been dropped.
    overlong: bool,
    bytes_skipped: u64,
}

/// Where a line lies in [`Lines`]; good until the next [`Lines::push`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Line {
    /// Place in the stream of the line's first byte: bytes pushed before it.
    pub offset: u64,
    start: usize,
    end: usize,
}

impl Lines {
    /// Takes more bytes, in the order of the stream. Earlier [`Line`]s are void from here on.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.drain(..self.start);
        self.origin += self.start as u64;
        self.searched -= self.start;
        self.start = 0;
        self.buffer.extend_from_slice(bytes);
    }

    /// The next line, empty ones included, or `None` until more bytes come.
    pub fn find(&mut self) -> Option<Line> {
        loop {
            match self.buffer[self.searched..].iter().position(|&byte| byte == LF) {
                Some(at) => {
                    let line = Line {
                        offset: self.origin + self.start as u64,
                        start: self.start,
                        end: self.searched + at,
                    };
                    self.start = line.end + 1;
                    self.searched = self.start;
                    if std::mem::take(&mut self.overlong) || line.end - line.start >= MAX_LINE {
                        self.bytes_skipped += (self.start - line.start) as u64;
                        continue;
                    }
                    return Some(line);
                }
                None => {
                    if self.buffer.len() - self.start > MAX_LINE {
                        self.bytes_skipped += (self.buffer.len() - self.start) as u64;
                        self.start = self.buffer.len();
                        self.overlong = true;
                    }
                    self.searched = self.buffer.len();
                    return None;
                }
            }
        }
    }

    /// The line without its LF, as it came.
    ///
    /// # Panics
    /// May panic, or give other bytes, where `line` is from before the last [`Lines::push`], or from other lines.
    pub fn line(&self, line: Line) -> &[u8] {
        &self.buffer[line.start..line.end]
    }

    /// Bytes are missing here: what is pending is no message, nor is what follows up to the next LF.
    pub fn lose(&mut self) {
        self.interrupt();
        self.overlong = true;
    }

    /// The stream has ended; what is pending is no message. The next one begins anew.
    pub fn interrupt(&mut self) {
        self.bytes_skipped += (self.buffer.len() - self.start) as u64;
        self.start = self.buffer.len();
        self.searched = self.start;
        self.overlong = false;
    }

    /// Bytes dropped by the cutting; lines that are no message are not among them.
    pub fn bytes_skipped(&self) -> u64 {
        self.bytes_skipped
    }
}

/// A message, still in its bytes. Its form has been checked, and nothing else: there is no checksum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message<'a> {
    /// Unit of a chain: its channel, or for a hub behind a hub `256 * outer + inner`; 0 without a multiplexer, and for channel 0.
    pub address: u16,
    /// What it is.
    pub body: Body<'a>,
}

/// What a message is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Body<'a> {
    /// A command or its answer: a JSON object with one key.
    Command(&'a [u8]),
    /// Data as text: the whole line.
    Text(&'a [u8]),
    /// Data in binary: the letter without its mark, and what follows (time stamp, arguments), unstuffed.
    Binary(u8, &'a [u8]),
}

/// Reads a line without its LF; `scratch` takes the bytes that had to be unstuffed.
///
/// `None` where it is no message: an unknown first byte, a broken escape, channels nested more than twice.
pub fn parse<'a>(line: &'a [u8], scratch: &'a mut Vec<u8>) -> Option<Message<'a>> {
    let mut address = 0;
    let mut rest = line;
    for depth in 0.. {
        let [MUX, channel, inner @ ..] = rest else { break };
        if depth == 2 || *channel == MUX || inner.is_empty() {
            return None;
        }
        address = address << 8 | u16::from(*channel);
        rest = inner;
    }
    let body = match rest.first()? {
        b'{' => Body::Command(rest),
        b'A'..=b'Z' => Body::Text(rest),
        &first if (BINARY | b'A'..=BINARY | b'Z').contains(&first) => {
            unstuff(rest, scratch)?;
            let (&letter, data) = scratch.split_first()?;
            Body::Binary(letter & !BINARY, data)
        }
        _ => return None,
    };
    Some(Message { address, body })
}

fn unstuff(bytes: &[u8], out: &mut Vec<u8>) -> Option<()> {
    out.clear();
    let mut bytes = bytes.iter();
    while let Some(&byte) = bytes.next() {
        out.push(match byte {
            ESCAPE => match *bytes.next()? {
                ESCAPED_LF => LF,
                ESCAPED_ESCAPE => ESCAPE,
                _ => return None,
            },
            byte => byte,
        });
    }
    Some(())
}

/// Appends the channel bytes that lead to a unit.
fn address_into(address: u16, out: &mut Vec<u8>) {
    let [outer, inner] = address.to_be_bytes();
    for channel in [outer, inner].into_iter().filter(|&channel| channel != 0) {
        out.extend([MUX, channel]);
    }
}

/// Whether a unit may have this address: 0 (no multiplexer), or channels of which none is LF or [`MUX`] and the inner one is not
/// 0.
pub fn is_address(address: u16) -> bool {
    let [outer, inner] = address.to_be_bytes();
    let usable = |channel| channel != LF && channel != MUX;
    address == 0 || inner != 0 && usable(outer) && usable(inner)
}

/// A command as it travels, LF included: channels of `address`, then a JSON object with this one key. Value null asks.
pub fn command(address: u16, key: &str, value: &serde_json::Value) -> Vec<u8> {
    let mut out = Vec::new();
    address_into(address, &mut out);
    out.extend(serde_json::json!({ key: value }).to_string().bytes());
    out.push(LF);
    out
}

/// Appends a binary data message as it travels, LF included: channels of `address`, letter with its mark, then `data` (time
/// stamp and arguments, see [`super::data::encode`]), stuffed.
pub fn binary(address: u16, letter: u8, data: &[u8], out: &mut Vec<u8>) {
    address_into(address, out);
    out.push(letter | BINARY);
    for &byte in data {
        match byte {
            LF => out.extend([ESCAPE, ESCAPED_LF]),
            ESCAPE => out.extend([ESCAPE, ESCAPED_ESCAPE]),
            byte => out.push(byte),
        }
    }
    out.push(LF);
}

/// The key of an answer in its plain form (see [`plain_key`]), and its value; `None` where the bytes are no JSON object with
/// exactly one key.
pub fn answer(json: &[u8]) -> Option<(String, serde_json::Value)> {
    let object: serde_json::Map<String, serde_json::Value> = serde_json::from_slice(json).ok()?;
    let mut entries = object.into_iter();
    let (key, value) = entries.next()?;
    entries.next().is_none().then(|| (plain_key(&key), value))
}

/// A key as devices compare it: ASCII letters and digits only, in lower case.
pub fn plain_key(key: &str) -> String {
    key.chars().filter(char::is_ascii_alphanumeric).map(|letter| letter.to_ascii_lowercase()).collect()
}
