//! The one writer.

/// Appends plain data to bytes, little-endian, for [`Reader`](crate::Reader) to take in the same order.
#[derive(Debug, Default)]
pub struct Writer {
    bytes: Vec<u8>,
}

impl Writer {
    /// Appends a byte.
    pub fn byte(&mut self, byte: u8) {
        self.bytes.push(byte);
    }

    /// Appends 64 bits, little-endian.
    pub fn word(&mut self, word: u64) {
        self.bytes.extend_from_slice(&word.to_le_bytes());
    }

    /// Appends a number of items, as 32 bits.
    ///
    /// # Panics
    /// There are more than fit in 32 bits: more than any memory of a stage.
    pub fn length(&mut self, length: usize) {
        let length = u32::try_from(length).expect("a state of less than 4 G items");
        self.bytes.extend_from_slice(&length.to_le_bytes());
    }

    /// Appends bytes without their number: the reader must know it.
    pub fn raw(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// Appends the bits of numbers, eight bytes each, without how many there are: the reader must know it.
    pub fn floats(&mut self, values: &[f64]) {
        self.bytes.reserve(8 * values.len());
        for value in values {
            self.bytes.extend_from_slice(&value.to_bits().to_le_bytes());
        }
    }

    /// Appends the sum of all bytes so far.
    pub(crate) fn seal(&mut self) {
        self.word(sum(&self.bytes));
    }

    /// All bytes appended so far.
    pub fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }
}

/// Another one for bytes that differ in one word, and as good as always for any others.
pub(crate) fn sum(bytes: &[u8]) -> u64 {
    let (words, rest) = bytes.as_chunks();
    let mut last = [0; 8];
    last[..rest.len()].copy_from_slice(rest);
    // Each step loses nothing of what was before, nor of the word.
    words.iter().chain([&last]).fold(bytes.len() as u64, |sum, word| {
        let mixed = (sum ^ u64::from_le_bytes(*word)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        mixed ^ mixed >> 32
    })
}
