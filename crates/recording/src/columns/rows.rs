//! A table of whole numbers, as it comes and as it is packed.

use posed_protocol::{Stamp, round};

/// What is not known.
const UNKNOWN: i32 = i32::MIN;

/// Rows of equal width.
#[derive(Clone, Debug, Default)]
pub(super) struct Rows {
    rows: usize,
    values: Vec<i32>,
}

impl Rows {
    /// Begins a row with its time and time code.
    pub(super) fn begin(&mut self, stamp: &Stamp) {
        self.values.extend(time(stamp.t_us));
        let code = stamp.timecode.map(|label| {
            let frame = label.frame;
            let second =
                i32::from(frame.hours) * 3600 + i32::from(frame.minutes) * 60 + i32::from(frame.seconds);
            [second, i32::from(frame.frames) * 100 + i32::from(label.hundredths), i32::from(label.drop)]
        });
        self.values.extend(code.unwrap_or([UNKNOWN; 3]));
    }

    /// Ends it.
    pub(super) fn end(&mut self) {
        self.rows += 1;
    }

    pub(super) fn push(&mut self, number: Option<i32>) {
        self.values.push(number.unwrap_or(UNKNOWN));
    }

    /// Numbers in steps of `1 / per_unit`, or as many that are not known.
    pub(super) fn each<const N: usize>(&mut self, per_unit: f64, values: Option<[f64; N]>) {
        match values {
            Some(values) => self.values.extend(values.map(|value| steps(per_unit, value))),
            None => self.values.extend([UNKNOWN; N]),
        }
    }

    /// Rows, and numbers in each; `None` while it is empty.
    pub(super) fn size(&self) -> Option<(usize, usize)> {
        self.values.len().checked_div(self.rows).map(|width| (self.rows, width))
    }

    pub(super) fn numbers(&self) -> usize {
        self.values.len()
    }

    /// Column by column the difference of each number to the one before it, the first to 0, modulo 2^32; of all of these the lowest bytes first, then the second
    /// ones and so on. What moves smoothly has high bytes that are all the same, and packs to little more than its noise.
    pub(super) fn packed(&self) -> Vec<u8> {
        let Some((rows, width)) = self.size() else { return Vec::new() };
        let mut bytes = vec![0; 4 * self.values.len()];
        let plane = self.values.len();
        for column in 0..width {
            let mut before = 0_i32;
            let numbers = self.values.iter().skip(column).step_by(width);
            for (place, number) in (column * rows..).zip(numbers) {
                let difference = number.wrapping_sub(before).to_le_bytes();
                before = *number;
                for (at, byte) in difference.into_iter().enumerate() {
                    bytes[at * plane + place] = byte;
                }
            }
        }
        bytes
    }
}

/// Whole seconds and microseconds.
pub(super) fn time(t_us: i64) -> [i32; 2] {
    // A stage that runs for 68 years stays at its last second.
    let seconds = t_us.div_euclid(1_000_000).clamp(i64::from(-i32::MAX), i64::from(i32::MAX));
    [seconds as i32, t_us.rem_euclid(1_000_000) as i32]
}

/// The nearest step, as messages round it; what is no number is not known.
pub(super) fn steps(per_unit: f64, value: f64) -> i32 {
    let steps = (round::to(per_unit, value) * per_unit).round();
    if steps.is_nan() { UNKNOWN } else { (steps as i32).max(-i32::MAX) }
}
