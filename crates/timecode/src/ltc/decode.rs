//! LTC from sound.
//!
//! The middle between the signal's own highest and lowest level is the line that it must cross; a crossing counts once the signal has
//! left it by a share of its height, so that noise makes none. Times between crossings are whole or half bits of a length that is
//! followed. Where they do not add up, bits are gathered anew: a frame is only what 80 bits in a row say.

use super::word::{BITS, Word};
use crate::Reading;

/// How fast the levels are forgotten, s: slower than any bit, sooner than a frame.
const LEVELS_S: f64 = 0.02;
/// Height of a signal below which it is silence, of 2 for full scale: -60 dB.
const LEAST_HEIGHT: f64 = 0.002;
/// Share of the height by which the line must be left.
const HYSTERESIS: f64 = 0.15;
/// Longest and shortest bit, s: a fifth and six times the usual speed.
const LONGEST_BIT_S: f64 = 5.0 / (24.0 * BITS as f64);
const SHORTEST_BIT_S: f64 = 1.0 / (6.0 * 30.0 * BITS as f64);
/// Share of a wrong length by which the bit's is put right.
const GAIN: f64 = 0.1;
/// Times between crossings among which a bit is looked for while there is none: a sync word and the bits around it.
const LOOKED_AT: usize = 48;
/// Bits without a frame after which their length is looked for anew: two frames and a half.
const LOST_BITS: u32 = 200;

/// Reads LTC from samples, in any pieces.
#[derive(Clone, Debug)]
pub struct Decoder {
    sample_rate_hz: f64,
    stream: u32,
    /// Samples so far.
    count: u64,
    /// Share of a level that a sample keeps.
    keep: f64,
    high: f64,
    low: f64,
    /// Above the line, or below it.
    is_high: bool,
    last_sample: f64,
    /// Where the line was crossed last, since the signal left it; samples.
    crossing: Option<f64>,
    /// The crossing that counted last.
    edge: Option<f64>,
    /// Length of a bit, samples; `None` while it is looked for.
    bit: Option<f64>,
    /// Latest times between crossings, while the bit is looked for.
    steps: Vec<f64>,
    /// Beginning of a bit whose first half was short.
    half: Option<f64>,
    /// Bits in a row, the first lowest, how many they are, and where each began, samples, the oldest first.
    bits: u128,
    gathered: usize,
    begins: [f64; BITS],
    /// Bits since the last frame.
    since_frame: u32,
}

impl Decoder {
    /// A decoder of that many samples per second.
    pub fn new(sample_rate_hz: f64) -> Self {
        Self {
            sample_rate_hz,
            stream: 0,
            count: 0,
            keep: 1.0 - (1.0 / (LEVELS_S * sample_rate_hz)).min(0.5),
            high: 0.0,
            low: 0.0,
            is_high: false,
            last_sample: 0.0,
            crossing: None,
            edge: None,
            bit: None,
            steps: Vec::with_capacity(LOOKED_AT),
            half: None,
            bits: 0,
            gathered: 0,
            begins: [0.0; BITS],
            since_frame: 0,
        }
    }

    /// Samples so far.
    pub fn samples(&self) -> u64 {
        self.count
    }

    /// Takes the samples of one read, -1 to 1, of the stream of that number; another number begins anew. Gives the frames that end
    /// in them.
    pub fn push(&mut self, samples: &[f32], stream: u32, mut frame: impl FnMut(Reading)) {
        if stream != self.stream {
            *self = Self { stream, ..Self::new(self.sample_rate_hz) };
        }
        let end = (self.count + samples.len() as u64) as f64;
        for sample in samples {
            if let Some(edge) = self.sample(f64::from(*sample))
                && let Some((word, reversed, begin)) = self.edge(edge)
            {
                frame(Reading {
                    frame: word.frame,
                    drop: word.drop,
                    frames_per_s: None,
                    user_bits: word.user_bits,
                    stream,
                    position_s: Some(begin / self.sample_rate_hz),
                    behind_s: (end - begin) / self.sample_rate_hz,
                    reversed,
                });
            }
        }
    }

    /// Takes a sample, and gives the place of a change of level once it is sure.
    fn sample(&mut self, sample: f64) -> Option<f64> {
        // What is no number is silence.
        let sample = if sample.is_finite() { sample.clamp(-4.0, 4.0) } else { 0.0 };
        let at = self.count as f64;
        self.count += 1;
        let middle = 0.5 * (self.high + self.low);
        self.high = sample.max(middle + (self.high - middle) * self.keep);
        self.low = sample.min(middle + (self.low - middle) * self.keep);
        let (middle, height) = (0.5 * (self.high + self.low), self.high - self.low);
        let (before, now) = (self.last_sample - middle, sample - middle);
        self.last_sample = sample;
        if before != now && (before < 0.0) != (now < 0.0) && (now < 0.0) == self.is_high {
            self.crossing = Some(at - now / (now - before));
        }
        if height < LEAST_HEIGHT {
            return None;
        }
        let left = HYSTERESIS * height;
        let changed = if self.is_high { now < -left } else { now > left };
        if !changed {
            return None;
        }
        self.is_high = !self.is_high;
        Some(self.crossing.take().unwrap_or(at))
    }

    /// Takes a change of level, and gives the frame that ends with it and where it began.
    fn edge(&mut self, at: f64) -> Option<(Word, bool, f64)> {
        let step = at - self.edge.replace(at)?;
        let Some(bit) = self.bit else {
            self.look_for_bit(step);
            return None;
        };
        let share = step / bit;
        if (0.75..1.5).contains(&share) && self.half.is_none() {
            self.bit = Some(bit + GAIN * (step - bit));
            self.bit(false, at - step)
        } else if (0.25..0.75).contains(&share) {
            let begin = self.half.take();
            let Some(begin) = begin else {
                self.half = Some(at - step);
                return None;
            };
            self.bit = Some(bit + GAIN * (at - begin - bit));
            self.bit(true, begin)
        } else {
            self.lose();
            // A whole bit behind half of one: it was in the middle that the bits were thought to begin.
            if (0.75..1.5).contains(&share) { self.bit(false, at - step) } else { None }
        }
    }

    /// Finds the length of a bit among the latest steps: the longest usual one is a zero.
    fn look_for_bit(&mut self, step: f64) {
        let range = SHORTEST_BIT_S * 0.5 * self.sample_rate_hz..=LONGEST_BIT_S * self.sample_rate_hz;
        if !range.contains(&step) {
            self.steps.clear();
            return;
        }
        self.steps.push(step);
        if self.steps.len() < LOOKED_AT {
            return;
        }
        self.steps.sort_by(f64::total_cmp);
        // Above nine in ten: a damaged one or two do not count, and a sync word has more zeros than that.
        self.bit = Some(self.steps[LOOKED_AT * 9 / 10]);
        self.steps.clear();
        self.since_frame = 0;
    }

    fn lose(&mut self) {
        self.half = None;
        self.gathered = 0;
        self.lost_bit();
    }

    fn lost_bit(&mut self) {
        self.since_frame += 1;
        if self.since_frame > LOST_BITS {
            self.bit = None;
        }
    }

    fn bit(&mut self, one: bool, begin: f64) -> Option<(Word, bool, f64)> {
        self.bits = self.bits >> 1 | u128::from(one) << (BITS - 1);
        self.begins.rotate_left(1);
        self.begins[BITS - 1] = begin;
        self.gathered = (self.gathered + 1).min(BITS);
        let read = if self.gathered == BITS { Word::read(self.bits) } else { None };
        let Some((word, reversed)) = read else {
            self.lost_bit();
            return None;
        };
        self.since_frame = 0;
        // The next frame shares no bit with this one.
        self.gathered = 0;
        Some((word, reversed, self.begin()))
    }

    /// Where the frame begins, by all of its bits: the line through their beginnings.
    fn begin(&self) -> f64 {
        const MIDDLE: f64 = (BITS - 1) as f64 / 2.0;
        const SQUARES: f64 = BITS as f64 * (BITS * BITS - 1) as f64 / 12.0;
        let first = self.begins[0];
        let each = || self.begins.iter().enumerate().map(|(n, begin)| (n as f64 - MIDDLE, begin - first));
        let mean = each().map(|(_, at)| at).sum::<f64>() / BITS as f64;
        let slope = each().map(|(n, at)| n * at).sum::<f64>() / SQUARES;
        first + mean - MIDDLE * slope
    }
}
