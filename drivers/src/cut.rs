//! Cuts a stream of bytes into messages that have no mark which the rest cannot hold.
//!
//! What comes in: bytes in pieces of any size, and a [`Grammar`] that says what begins at a place. What goes out: messages in
//! their order, and counts of what was none. What comes out does not depend on how the bytes were cut. A start that turns out to be
//! none gives up one byte, since the next message may begin inside it.

use posed_state::Plain;

/// What begins at a place of the stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Front<M> {
    /// More bytes may make it a message. Whoever says so must not wait for more than a message has.
    Wait,
    /// No message.
    No,
    /// So many bytes, at least one, that belong to nothing and are in order, such as line ends around answers.
    Pass(usize),
    /// A message of so many bytes, at least one.
    Message(usize, M),
}

/// The messages of one protocol.
pub trait Grammar {
    /// What a message says.
    type Message;

    /// What begins with the first of `bytes`, of which there is one at least; `offset` is its place in the stream. Out of sync (`in_sync` is
    /// false) the bytes before were none, and a grammar whose messages are easily imitated may ask for more proof.
    fn front(&mut self, offset: u64, bytes: &[u8], in_sync: bool) -> Front<Self::Message>;
}

/// See the module.
#[derive(Clone, Debug, Plain)]
pub struct Cutter<G> {
    grammar: G,
    buffer: Vec<u8>,
    start: usize,
    /// Place in the stream of `buffer[0]`.
    origin: u64,
    in_sync: bool,
    rejected: u64,
    bytes_skipped: u64,
}

impl<G: Grammar> Cutter<G> {
    /// A cutter before the first byte.
    pub fn of(grammar: G) -> Self {
        Self {
            grammar,
            buffer: Vec::new(),
            start: 0,
            origin: 0,
            in_sync: true,
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

    /// The next message, or `None` until more bytes come. Bytes of no message are skipped and counted.
    pub fn find(&mut self) -> Option<G::Message> {
        loop {
            let pending = &self.buffer[self.start..];
            if pending.is_empty() {
                return None;
            }
            match self.grammar.front(self.origin + self.start as u64, pending, self.in_sync) {
                Front::Wait => return None,
                Front::Pass(len) => self.start += len,
                Front::Message(len, message) => {
                    self.start += len;
                    self.in_sync = true;
                    return Some(message);
                }
                Front::No => {
                    // One loss of sync is one message refused.
                    self.rejected += u64::from(self.in_sync);
                    self.in_sync = false;
                    self.start += 1;
                    self.bytes_skipped += 1;
                }
            }
        }
    }

    /// Bytes are missing here, or the stream has ended: what is pending is no message and counts as skipped.
    pub fn interrupt(&mut self) {
        self.bytes_skipped += (self.buffer.len() - self.start) as u64;
        self.start = self.buffer.len();
        self.in_sync = true;
    }

    /// Times that sync was lost: at least so many messages were refused.
    pub fn rejected(&self) -> u64 {
        self.rejected
    }

    /// Bytes of no message; those passed over in order are not counted.
    pub fn bytes_skipped(&self) -> u64 {
        self.bytes_skipped
    }
}

/// Length of the line of text at the front, its LF included.
///
/// # Errors
/// None has come: wait for it, unless it would be longer than `most`.
pub(crate) fn line_len<M>(bytes: &[u8], most: usize) -> Result<usize, Front<M>> {
    match bytes.iter().take(most).position(|&byte| byte == b'\n') {
        Some(at) => Ok(at + 1),
        None if bytes.len() < most => Err(Front::Wait),
        None => Err(Front::No),
    }
}

/// Lines of text in a row that agree on other columns before those are believed.
const AGREEING: u32 = 4;

/// Where a unit's lines of text have their numbers. Fields have a fixed width, so that the decimal points of all lines stand in the same
/// columns: where they do not, a byte was lost or added, which a number alone does not show.
#[derive(Clone, Copy, Debug, Default, Plain)]
pub(crate) struct Columns {
    believed: Option<[u64; 3]>,
    /// Other columns, and how many lines in a row had them.
    others: Option<[u64; 3]>,
    agreeing: u32,
}

impl Columns {
    /// Whether a line has the columns of those before it.
    pub(crate) fn take(&mut self, line: &[u8]) -> bool {
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
