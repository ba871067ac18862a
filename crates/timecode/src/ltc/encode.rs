//! LTC as sound: for tests, and for who has no generator.

use super::word::{BITS, Word};
use crate::{Counting, Frame};

/// Share of full scale.
const LEVEL: f64 = 0.5;
/// How long the level takes from one end to the other, s: what SMPTE 12M asks of a generator.
const RISE_S: f64 = 40e-6;

/// A generator of LTC, sample by sample.
#[derive(Clone, Debug)]
pub struct Encoder {
    counting: Counting,
    number: u32,
    user_bits: u32,
    bits: u128,
    /// Samples per half bit.
    half_bit: f64,
    /// Which half of which bit is now, and samples since it began.
    half: usize,
    since: f64,
    /// Level in this half and in the one before.
    level: f64,
    before: f64,
    /// Samples that a change takes.
    rise: f64,
}

impl Encoder {
    /// Begins with that frame, at that many frames per second of `sample_rate_hz` samples each. A frame without a name is midnight.
    pub fn new(sample_rate_hz: f64, frame_rate_hz: f64, counting: Counting, first: Frame) -> Self {
        let half_bit = sample_rate_hz / frame_rate_hz / (2 * BITS) as f64;
        let mut encoder = Self {
            counting,
            number: counting.number(first).unwrap_or(0),
            user_bits: 0,
            bits: 0,
            half_bit,
            half: 0,
            since: 0.0,
            level: LEVEL,
            before: -LEVEL,
            rise: RISE_S * sample_rate_hz,
        };
        encoder.begin();
        encoder
    }

    /// The same with these user bits in every frame.
    #[must_use]
    pub fn with_user_bits(mut self, user_bits: u32) -> Self {
        self.user_bits = user_bits;
        self.begin();
        self
    }

    /// The next frame that begins is that many frames further on than it would be.
    pub fn skip(&mut self, frames: u32) {
        self.number = (self.number + frames) % self.counting.day();
    }

    /// The frame that is under way.
    pub fn frame(&self) -> Frame {
        self.counting.frame(self.number)
    }

    /// The next sample, -1 to 1.
    pub fn sample(&mut self) -> f32 {
        // The change lies about the beginning of its half bit; what is left of it comes first.
        let into = (self.since / self.rise + 0.5).min(1.0);
        let left = ((self.half_bit - self.since) / self.rise).min(0.5);
        let level = self.before + (self.level - self.before) * into;
        let next = self.next_level();
        let level = if left < 0.5 { level + (next - self.level) * (0.5 - left) } else { level };
        self.since += 1.0;
        while self.since >= self.half_bit {
            self.since -= self.half_bit;
            self.before = self.level;
            self.level = next;
            self.half += 1;
            if self.half == 2 * BITS {
                self.half = 0;
                self.number = (self.number + 1) % self.counting.day();
                self.begin();
            }
        }
        level as f32
    }

    /// Level of the half bit that comes next.
    fn next_level(&self) -> f64 {
        let ends_a_bit = self.half % 2 == 1;
        let is_one = self.bits >> (self.half / 2) & 1 == 1;
        if ends_a_bit || is_one { -self.level } else { self.level }
    }

    fn begin(&mut self) {
        let word = Word { frame: self.frame(), drop: self.counting.drop, user_bits: self.user_bits };
        self.bits = word.bits(self.counting);
    }
}
