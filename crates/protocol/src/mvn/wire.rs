//! Datagrams of MXTP: a header of 24 bytes, then items; big-endian.

use posed_fusion::body::WHOLE;

/// Header and payload size, bytes.
const HEADER: usize = 24;
/// Where the payload's size stands.
const SIZE: usize = 22;
/// Bit 7: the last datagram of its type and sample; the rest counts from 0.
const ONLY_ONE: u8 = 0x80;

/// What all datagrams of a sample share.
pub(super) struct Head {
    pub(super) sample: u32,
    /// Since the stream began, ms.
    pub(super) time_ms: u32,
    pub(super) character: u8,
}

/// One datagram that is being written.
pub(super) struct Datagram(Vec<u8>);

impl Datagram {
    /// Of a type, 0 to 99, with so many items.
    pub(super) fn new(kind: u8, head: &Head, items: u8) -> Self {
        let mut bytes = format!("MXTP{kind:02}").into_bytes();
        bytes.extend(head.sample.to_be_bytes());
        bytes.extend([ONLY_ONE, items]);
        bytes.extend(head.time_ms.to_be_bytes());
        // No props, no fingers; two bytes without a meaning, and the size of what follows.
        bytes.extend([head.character, WHOLE as u8, 0, 0, 0, 0, 0, 0]);
        Self(bytes)
    }

    /// An id or a count, 32 bits.
    pub(super) fn count(&mut self, count: u32) {
        self.0.extend(count.to_be_bytes());
    }

    /// Numbers of 32 bits.
    pub(super) fn numbers<'a>(&mut self, numbers: impl Iterator<Item = &'a f64>) {
        numbers.for_each(|number| self.0.extend((*number as f32).to_be_bytes()));
    }

    /// A text with its length in bytes.
    pub(super) fn text(&mut self, text: &str) {
        self.count(text.len() as u32);
        self.0.extend(text.as_bytes());
    }

    /// The bytes, with the size of the payload. Names of stages are short: a datagram holds them.
    pub(super) fn finish(mut self) -> Vec<u8> {
        let size = (self.0.len() - HEADER) as u16;
        self.0[SIZE..HEADER].copy_from_slice(&size.to_be_bytes());
        self.0
    }
}
