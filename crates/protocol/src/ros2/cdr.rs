//! CDR as DDS has it, version 1, little-endian: numbers stand at multiples of their size, counted from behind the four bytes that say so.

/// Says: CDR, little-endian, no options.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// A message that is being written.
#[derive(Clone, Debug)]
pub(super) struct Cdr(Vec<u8>);

impl Cdr {
    pub(super) fn new() -> Self {
        Self(HEADER.to_vec())
    }

    fn align(&mut self, to: usize) {
        let written = self.0.len() - HEADER.len();
        self.0.resize(HEADER.len() + written.next_multiple_of(to), 0);
    }

    pub(super) fn count(&mut self, count: usize) {
        self.align(4);
        // Nobody has as many sensors or joints as this could not hold.
        self.0.extend((count as u32).to_le_bytes());
    }

    /// A text, with its length and a NUL at its end.
    pub(super) fn text(&mut self, text: &str) {
        self.count(text.len() + 1);
        self.0.extend(text.as_bytes());
        self.0.push(0);
    }

    /// Numbers that nothing counts: those of vectors, quaternions and arrays of a fixed size.
    pub(super) fn numbers(&mut self, numbers: &[f64]) {
        if !numbers.is_empty() {
            self.align(8);
        }
        numbers.iter().for_each(|number| self.0.extend(number.to_le_bytes()));
    }

    /// `std_msgs/Header`: a time, ns since 1970, and a frame.
    pub(super) fn header(&mut self, utc_ns: i64, frame: &str) {
        self.align(4);
        // Of the years until 2038, as the message itself.
        self.0.extend((utc_ns.div_euclid(1_000_000_000) as i32).to_le_bytes());
        self.0.extend((utc_ns.rem_euclid(1_000_000_000) as u32).to_le_bytes());
        self.text(frame);
    }

    pub(super) fn finish(self) -> Vec<u8> {
        self.0
    }
}
