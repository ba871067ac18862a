//! Cuts what a server sends: its greeting, then messages; finds its way again behind bytes that are missing or damaged.
//!
//! What comes in: bytes in pieces of any size. What goes out: greetings and messages, with their places in the stream. A message
//! has neither checksum nor mark. It counts in its turn when its header can be one, and behind damage when it is a pose.

use posed_state::Plain;

use super::wire::{
    ANY_VERSION, GREETING, HEADER, Header, MAX_NUMBER, Message, Messages, POSE, is_version_7, system, types,
};

/// Least number of a system message, and end of what it may have in the sender's place: one has a UDP port there.
const LEAST_TYPE: i32 = -16;
const MAX_SYSTEM_SENDER: i32 = 65_536;
/// Types whose payloads have one length, and that length, bytes. Poses are the first.
const LENGTHS: [(&str, usize); 7] = [
    (types::POSE, POSE),
    (types::VELOCITY, 72),
    (types::ACCELERATION, 72),
    (types::BUTTON, 8),
    (types::TEXT, 1032),
    (types::PING, 0),
    (types::PONG, 0),
];
/// 64-bit words of the set of types.
const WORDS: usize = MAX_NUMBER as usize / 64 + 1;

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Piece<'a> {
    /// What the server begins with, of whatever version.
    Greeting([u8; 24]),
    /// The payload of a pose, not looked at yet.
    Pose(Message<'a>),
    /// Any other message.
    Other(Message<'a>),
}

/// The reader of one connection.
#[derive(Clone, Debug, Default, Plain)]
pub struct Reader {
    messages: Messages,
    greeted: bool,
    /// What is passed over is the same damage until a pose is found.
    damaged: bool,
    /// Numbers of the types of [`LENGTHS`], once they are described.
    known: [Option<i32>; LENGTHS.len()],
    /// A bit for each type that is described.
    described: Vec<u64>,
    rejected: u64,
    bytes_skipped: u64,
}

impl Reader {
    /// A connection begins: what is left of the one before is dropped.
    pub fn begin(&mut self) {
        self.skip(usize::MAX);
        self.greeted = false;
        self.damaged = false;
        self.known = Default::default();
        self.described.clear();
    }

    /// Bytes are missing here.
    pub fn interrupt(&mut self) {
        self.skip(usize::MAX);
        self.damaged = true;
    }

    /// Takes more bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.messages.push(bytes);
    }

    /// The next piece, until `None`.
    pub fn find(&mut self) -> Option<Piece<'_>> {
        if !self.greeted {
            return self.greeting().map(Piece::Greeting);
        }
        let header = loop {
            match self.messages.ready(|header| self.believes(header)) {
                Ok(Some(header)) => break header,
                Ok(None) => return None,
                Err(_) => {
                    self.rejected += u64::from(!std::mem::replace(&mut self.damaged, true));
                    self.skip(1);
                }
            }
        };
        self.damaged = false;
        let message = self.messages.take(header);
        if header.kind == system::TYPE {
            match message.description() {
                Ok((number, name)) => {
                    self.described.resize(WORDS, 0);
                    self.described[number as usize / 64] |= 1 << (number % 64);
                    for (known, (of, _)) in self.known.iter_mut().zip(LENGTHS) {
                        // A number that changes its name is not what it was.
                        *known = known.filter(|known| *known != number);
                        if name == of {
                            *known = Some(number);
                        }
                    }
                }
                Err(_) => self.rejected += 1,
            }
        }
        let is_pose = self.known[0] == Some(header.kind);
        Some(if is_pose { Piece::Pose(message) } else { Piece::Other(message) })
    }

    /// Places of damage, and descriptions that are none.
    pub fn rejected(&self) -> u64 {
        self.rejected
    }

    /// Bytes that belong to no message.
    pub fn bytes_skipped(&self) -> u64 {
        self.bytes_skipped
    }

    fn greeting(&mut self) -> Option<[u8; 24]> {
        loop {
            let pending = self.messages.pending();
            let shown = pending.len().min(ANY_VERSION.len());
            if pending[..shown] != ANY_VERSION[..shown] {
                self.skip(1);
                continue;
            }
            let greeting: [u8; GREETING.len()] = *pending.first_chunk()?;
            self.messages.skip(GREETING.len());
            self.greeted = is_version_7(&greeting);
            return Some(greeting);
        }
    }

    /// Whether a header can be one of a message: types are described before they are used.
    fn believes(&self, header: &Header) -> bool {
        let payload = header.length - HEADER;
        let is_pose = self.known[0] == Some(header.kind);
        if header.micros >= 1_000_000 || (self.damaged && !is_pose) {
            return false;
        }
        if header.kind < 0 {
            return header.kind >= LEAST_TYPE && (0..MAX_SYSTEM_SENDER).contains(&header.sender);
        }
        let of_type = self.known.iter().zip(LENGTHS).find(|(known, _)| **known == Some(header.kind));
        self.is_described(header.kind)
            && (0..MAX_NUMBER).contains(&header.sender)
            && of_type.is_none_or(|(_, (_, length))| payload == length)
    }

    fn is_described(&self, kind: i32) -> bool {
        usize::try_from(kind)
            .ok()
            .and_then(|kind| self.described.get(kind / 64).map(|word| word >> (kind % 64) & 1 == 1))
            .unwrap_or(false)
    }

    fn skip(&mut self, bytes: usize) {
        let before = self.messages.pending().len();
        self.messages.skip(bytes);
        self.bytes_skipped += (before - self.messages.pending().len()) as u64;
    }
}
