//! Counters on the wire, and what their steps tell: time, loss, restart.

use posed_state::Plain;

/// Number of values of the packet and sample counters.
pub const PACKETS: u64 = 1 << 16;
/// `sample_time_fine` of the MTi 10 and 100 series starts again after so many ticks: a day of 10 kHz.
pub const DAY: u64 = 864_000_000;
/// `sample_time_fine` of the MTi 1 and 600 series starts again after so many ticks: 32 bits.
pub const FULL: u64 = 1 << 32;
/// Seconds per tick of `sample_time_fine`.
pub const SAMPLE_TIME_TICK_S: f64 = 1e-4;

/// What a counter's step meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// The first value.
    First,
    /// As many steps forward; 0 is a repetition. A restart that lands a little ahead looks the same.
    Forward(u64),
    /// The device has started its counter again.
    Restarted,
}

/// Unwraps a 16-bit packet counter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Plain)]
pub struct PacketCounter {
    last: Option<u16>,
    unwrapped: u64,
}

impl PacketCounter {
    /// Takes the next value. A step over half the range is a restart: so many lost packets in a row would have been a silence of
    /// minutes. A loss is known modulo 65536 only.
    pub fn step(&mut self, value: u16) -> Step {
        let step = match self.last {
            None => Step::First,
            Some(last) => match value.wrapping_sub(last) {
                step if step < 0x8000 => Step::Forward(step.into()),
                _ => Step::Restarted,
            },
        };
        self.last = Some(value);
        match step {
            Step::Forward(step) => self.unwrapped += step,
            Step::First | Step::Restarted => self.unwrapped = value.into(),
        }
        step
    }

    /// The count without its wraps, from the first value on; 0 before it. A restart sets it back to the value that came.
    pub fn unwrapped(&self) -> u64 {
        self.unwrapped
    }
}

/// Unwraps `sample_time_fine`, whichever of its two lengths it has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Plain)]
pub struct SampleTime {
    last: Option<u32>,
    unwrapped: u64,
}

impl SampleTime {
    /// A step this great across a wrap, a minute, is a restart instead.
    const MOST: u64 = 600_000;

    /// Takes the next value, in ticks of 0.1 ms. One that goes back is a wrap if it lies less than a minute ahead across the end
    /// of a day, or of 32 bits; else a restart.
    pub fn step(&mut self, value: u32) -> Step {
        let step = match self.last.replace(value) {
            None => Step::First,
            Some(last) if value >= last => Step::Forward((value - last).into()),
            Some(last) => [DAY, FULL]
                .into_iter()
                .filter(|length| u64::from(last) < *length)
                .map(|length| length - u64::from(last) + u64::from(value))
                .find(|step| *step < Self::MOST)
                .map_or(Step::Restarted, Step::Forward),
        };
        match step {
            Step::Forward(step) => self.unwrapped += step,
            Step::First | Step::Restarted => self.unwrapped = value.into(),
        }
        step
    }

    /// The time in ticks of 0.1 ms, without its wraps, from the first value on; 0 before it. A restart sets it back.
    pub fn unwrapped(&self) -> u64 {
        self.unwrapped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packet_counters_wrap_and_restart() {
        let mut counter = PacketCounter::default();
        let steps = [65533, 65535, 0, 0, 5, 40000].map(|value| (counter.step(value), counter.unwrapped()));
        assert_eq!(
            steps,
            [
                (Step::First, 65533),
                (Step::Forward(2), 65535),
                (Step::Forward(1), 65536),
                (Step::Forward(0), 65536),
                (Step::Forward(5), 65541),
                (Step::Restarted, 40000),
            ]
        );
    }

    #[test]
    fn sample_time_wraps_after_a_day_or_after_32_bits() {
        for length in [DAY, FULL] {
            let mut time = SampleTime::default();
            assert_eq!(time.step((length - 50) as u32), Step::First);
            assert_eq!(time.step(50), Step::Forward(100));
            assert_eq!(time.unwrapped(), length + 50);
            assert_eq!(time.step(10), Step::Restarted);
            assert_eq!(time.unwrapped(), 10);
        }
    }
}
