//! The 80 bits of a frame.

use crate::{Counting, Frame};

/// Bits of a frame.
pub(super) const BITS: usize = 80;
/// The last sixteen bits, the first one lowest: `0011 1111 1111 1101` in the order of time.
const SYNC: u128 = 0b1011_1111_1111_1100;
/// The same as it begins a frame that runs backwards.
const SYNC_REVERSED: u128 = 0b0011_1111_1111_1101;
const SYNC_AT: usize = 64;
/// Where the digits stand: lowest bit, and how many there are.
const DIGITS: [(usize, usize); 8] = [(0, 4), (8, 2), (16, 4), (24, 3), (32, 4), (40, 3), (48, 4), (56, 2)];
const DROP_AT: usize = 10;

/// What the bits of a frame say; the first bit in time is the lowest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Word {
    pub(super) frame: Frame,
    pub(super) drop: bool,
    pub(super) user_bits: u32,
}

impl Word {
    /// The bits, with the one that makes every frame begin with the same level: bit 59 where 25 frames are counted, else 27.
    pub(super) fn bits(self, counting: Counting) -> u128 {
        let Frame { hours, minutes, seconds, frames } = self.frame;
        let numbers = [frames, seconds, minutes, hours];
        let digits = numbers.iter().flat_map(|number| [number % 10, number / 10]);
        let mut bits = SYNC << SYNC_AT | u128::from(self.drop) << DROP_AT;
        for ((at, _), digit) in DIGITS.into_iter().zip(digits) {
            bits |= u128::from(digit) << at;
        }
        for digit in 0..8 {
            bits |= u128::from(self.user_bits >> (4 * digit) & 0xf) << (8 * digit + 4);
        }
        let polarity = if counting.frames_per_s == 25 { 59 } else { 27 };
        // A zero changes the level once, a one twice: an even number of zeros.
        if bits.count_ones() % 2 == 1 { bits | 1 << polarity } else { bits }
    }

    /// Reads the bits of a frame; whether they came backwards is said beside. `None` where they are none, or their digits say no time.
    pub(super) fn read(bits: u128) -> Option<(Self, bool)> {
        let (bits, reversed) = if bits >> SYNC_AT & 0xffff == SYNC {
            (bits, false)
        } else if bits & 0xffff == SYNC_REVERSED {
            (bits.reverse_bits() >> (128 - BITS), true)
        } else {
            return None;
        };
        let digit = |(at, length): (usize, usize)| (bits >> at) as u8 & ((1 << length) - 1);
        let number = |at: usize| {
            let (units, tens) = (digit(DIGITS[at]), digit(DIGITS[at + 1]));
            (units < 10).then_some(10 * tens + units)
        };
        let frame = Frame::new(number(6)?, number(4)?, number(2)?, number(0)?);
        let drop = bits >> DROP_AT & 1 == 1;
        Counting { frames_per_s: 30, drop }.number(frame)?;
        let user = |digit: usize| (bits >> (8 * digit + 4)) as u32 & 0xf;
        let user_bits = (0..8).map(|at| user(at) << (4 * at)).sum();
        Some((Self { frame, drop, user_bits }, reversed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_forwards_and_backwards() {
        for (drop, frame) in [(false, Frame::new(23, 59, 59, 29)), (true, Frame::new(1, 2, 3, 4))] {
            for frames_per_s in [24, 25, 30] {
                let word = Word { frame, drop, user_bits: 0x8765_4321 };
                let bits = word.bits(Counting { frames_per_s, drop });
                assert_eq!(bits.count_ones() % 2, 0, "the level begins anew");
                assert_eq!(Word::read(bits), Some((word, false)));
                assert_eq!(Word::read(bits.reverse_bits() >> (128 - BITS)), Some((word, true)));
            }
        }
    }

    #[test]
    fn bits_that_say_no_time_are_no_frame() {
        let counting = Counting { frames_per_s: 30, drop: true };
        let bits = |frame, drop| Word { frame, drop, user_bits: 0 }.bits(counting);
        assert_eq!(Word::read(0), None);
        assert_eq!(Word::read(bits(Frame::new(0, 1, 0, 0), true)), None, "a name that is left out");
        assert_eq!(Word::read(bits(Frame::new(29, 0, 0, 0), false)), None);
        assert_eq!(Word::read(bits(Frame::new(0, 0, 0, 0), false) | 0xf), None, "a digit above nine");
    }
}
