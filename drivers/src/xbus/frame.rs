//! Messages in a byte stream: preamble, bus identifier, message identifier, length, data, checksum.
//!
//! What comes in: bytes in pieces of any size. What goes out: whole messages with a right checksum, and
//! counts of what was not one. Which messages come out does not depend on how the bytes were cut.
//!
//! The preamble also occurs inside data, and the sum is one byte, so a false start may look right.
//! Therefore a rejected candidate gives up only its first byte; after a loss of sync a message must also
//! have a known name and a length that fits it; and while a candidate waits for its end, a message of
//! that stricter kind inside it goes first, so that a false preamble with a great length stalls nothing. Where the candidate follows on a message
//! like it, only one of the same sender does (it has restarted): of records that are all alike one in a million holds the picture of another's message, and is no
//! less a record.

use posed_state::Plain;

use super::{message, mtdata2};

/// First byte of every message. It is not escaped in data.
pub const PREAMBLE: u8 = 0xFA;
/// Most data bytes of a message.
pub const MAX_DATA: usize = 2048;
/// Bytes around the data of a message of up to 254 data bytes; a longer one has two more.
pub const OVERHEAD: usize = 5;
/// Length byte that announces a two-byte length.
const EXTENDED: u8 = 0xFF;

/// One message. From a [`Framer`] its checksum was right: a sum of one byte, which 1 in 256 random messages has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Bus identifier: 0xFF the master or a stand-alone device, 1 and up the trackers of a bus.
    pub bid: u8,
    /// Message identifier, see [`message`]; a name that is not known is possible.
    pub mid: u8,
    /// Data, at most [`MAX_DATA`] bytes.
    pub data: &'a [u8],
}

impl Frame<'_> {
    /// Appends the message as it travels: preamble, identifiers, length, data, checksum.
    ///
    /// # Panics
    /// With more than [`MAX_DATA`] bytes of data.
    pub fn encode_into(&self, out: &mut Vec<u8>) {
        assert!(self.data.len() <= MAX_DATA, "{} bytes of data do not fit a message", self.data.len());
        let start = out.len() + 1;
        out.extend([PREAMBLE, self.bid, self.mid]);
        match u8::try_from(self.data.len()) {
            Ok(len) if len != EXTENDED => out.push(len),
            _ => {
                out.push(EXTENDED);
                out.extend((self.data.len() as u16).to_be_bytes());
            }
        }
        out.extend(self.data);
        let sum = sum(&out[start..]);
        out.push(sum.wrapping_neg());
    }

    /// The message as it travels; see [`Frame::encode_into`].
    ///
    /// # Panics
    /// With more than [`MAX_DATA`] bytes of data.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(self.data.len() + OVERHEAD + 2);
        self.encode_into(&mut out);
        out
    }
}

fn sum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum: u8, &byte| sum.wrapping_add(byte))
}

/// What the bytes at a preamble announce.
#[derive(Clone, Copy)]
struct Header {
    bid: u8,
    mid: u8,
    /// Bytes before the data, and of the data.
    before: usize,
    len: usize,
}

enum Parsed {
    /// Too few bytes to tell.
    Short,
    Impossible,
    Header(Header),
}

impl Header {
    fn parse(bytes: &[u8]) -> Parsed {
        let &[_, bid, mid, len, ref rest @ ..] = bytes else { return Parsed::Short };
        if len != EXTENDED {
            return Parsed::Header(Self { bid, mid, before: 4, len: len.into() });
        }
        let Some(&extended) = rest.first_chunk() else { return Parsed::Short };
        let len = usize::from(u16::from_be_bytes(extended));
        if !(usize::from(EXTENDED)..=MAX_DATA).contains(&len) {
            return Parsed::Impossible;
        }
        Parsed::Header(Self { bid, mid, before: 6, len })
    }

    const fn total(self) -> usize {
        self.before + self.len + 1
    }

    /// Whether a message of this name and length exists.
    fn is_known(self) -> bool {
        self.has_address() && message::fits(self.mid, self.len)
    }

    /// Whether some device may have this bus identifier, the broadcast of a host included.
    const fn has_address(self) -> bool {
        self.bid <= 0x14 || self.bid == 0xFF
    }
}

/// Whether data can be what a message of this name holds.
fn has_form(mid: u8, data: &[u8]) -> bool {
    mid != message::MTDATA2 || mtdata2::fills(data)
}

/// Where a message lies in a [`Framer`]; good until the next call of [`Framer::push`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Found {
    /// Place in the stream of the preamble: bytes pushed before it.
    pub offset: u64,
    /// Bytes on the line, preamble and checksum included.
    pub len: usize,
    bid: u8,
    mid: u8,
    data: (usize, usize),
}

/// Finds messages in a stream of bytes; see the module. A false match is possible: random bytes behind a preamble have a right
/// checksum once in 256 times, fewer after a loss of sync, where name and length must fit, too.
#[derive(Clone, Debug, Default, Plain)]
pub struct Framer {
    buffer: Vec<u8>,
    /// Bytes of the buffer that are done with.
    start: usize,
    /// Place in the stream of `buffer[0]`.
    origin: u64,
    in_sync: bool,
    /// Bus identifier, name and length of the last message.
    last: Option<(u8, u8, usize)>,
    /// Place up to which a rejected candidate reached: candidates inside it are not counted again.
    rejected_to: u64,
    bytes_skipped: u64,
    bad_checksums: u64,
}

impl Framer {
    /// Bytes so far that belong to no message; those still pending are not counted.
    pub fn bytes_skipped(&self) -> u64 {
        self.bytes_skipped
    }

    /// Candidates so far with a wrong checksum or impossible contents; overlapping ones count once.
    pub fn bad_checksums(&self) -> u64 {
        self.bad_checksums
    }

    /// Takes more bytes, in the order of the stream. Earlier [`Found`]s are void from here on.
    pub fn push(&mut self, bytes: &[u8]) {
        if self.start > 0 {
            self.buffer.drain(..self.start);
            self.origin += self.start as u64;
            self.start = 0;
        }
        self.buffer.extend_from_slice(bytes);
    }

    /// The next message with a right checksum, in the order of the stream, or `None` until more bytes come.
    pub fn find(&mut self) -> Option<Found> {
        loop {
            let pending = &self.buffer[self.start..];
            if pending.first() != Some(&PREAMBLE) {
                let junk = pending.iter().position(|&byte| byte == PREAMBLE).unwrap_or(pending.len());
                if junk > 0 {
                    self.skip(junk);
                }
                if self.start == self.buffer.len() {
                    return None;
                }
                continue;
            }
            let header = match Header::parse(pending) {
                Parsed::Short => return None,
                Parsed::Header(header) if header.has_address() && (self.in_sync || header.is_known()) => {
                    header
                }
                Parsed::Header(_) | Parsed::Impossible => {
                    self.skip(1);
                    continue;
                }
            };
            let kind = (header.bid, header.mid, header.len);
            let sender = (self.in_sync && self.last == Some(kind)).then_some(header.bid);
            if let Some(inner) = first_inside(pending, header.total(), sender) {
                self.note_rejected(inner);
                self.skip(inner);
                continue;
            }
            if pending.len() < header.total() {
                return None;
            }
            let (message, data) = (&pending[..header.total()], header.before..header.before + header.len);
            // A master never calls itself 0, and nobody asks 0 for its identity: this is binary noise.
            let is_noise = header.bid == 0 && header.mid == 0;
            if sum(&message[1..]) != 0 || is_noise || !has_form(header.mid, &message[data.clone()]) {
                self.note_rejected(header.total());
                self.skip(1);
                continue;
            }
            let found = Found {
                offset: self.origin + self.start as u64,
                len: header.total(),
                bid: header.bid,
                mid: header.mid,
                data: (self.start + data.start, self.start + data.end),
            };
            self.start += header.total();
            self.in_sync = true;
            self.last = Some(kind);
            return Some(found);
        }
    }

    /// The message found.
    ///
    /// # Panics
    /// May panic, or give other bytes, where `found` is from before the last [`Framer::push`], or from another framer.
    pub fn frame(&self, found: Found) -> Frame<'_> {
        Frame { bid: found.bid, mid: found.mid, data: &self.buffer[found.data.0..found.data.1] }
    }

    /// The byte behind a message, where it has come.
    ///
    /// # Panics
    /// As [`Framer::frame`].
    pub(super) fn behind(&self, found: Found) -> Option<u8> {
        self.buffer.get(found.data.1 + 1).copied()
    }

    /// Gives up what is pending, which counts as skipped: bytes are missing here, or the stream has ended.
    pub fn interrupt(&mut self) {
        self.skip(self.buffer.len() - self.start);
    }

    fn skip(&mut self, bytes: usize) {
        self.start += bytes;
        self.bytes_skipped += bytes as u64;
        self.in_sync = self.in_sync && bytes == 0;
    }

    fn note_rejected(&mut self, len: usize) {
        let offset = self.origin + self.start as u64;
        if offset >= self.rejected_to {
            self.bad_checksums += 1;
            self.rejected_to = offset + len as u64;
        }
    }
}

/// Where the message of a known name begins that ends first inside the candidate of `len` bytes at the
/// front of `bytes`, if there is one; where a sender is given, of that one alone.
fn first_inside(bytes: &[u8], len: usize, sender: Option<u8>) -> Option<usize> {
    let inside = &bytes[..bytes.len().min(len.saturating_sub(1))];
    let mut first: Option<(usize, usize)> = None;
    for at in (1..inside.len()).filter(|&at| inside[at] == PREAMBLE) {
        let Parsed::Header(header) = Header::parse(&inside[at..]) else { continue };
        let end = at + header.total();
        if sender.is_some_and(|bid| bid != header.bid) {
            continue;
        }
        if end > inside.len() || !header.is_known() || (header.bid, header.mid) == (0, 0) {
            continue;
        }
        if first.is_none_or(|(_, earliest)| end < earliest)
            && sum(&inside[at + 1..end]) == 0
            && has_form(header.mid, &inside[at + header.before..end - 1])
        {
            first = Some((at, end));
        }
    }
    first.map(|(at, _)| at)
}
