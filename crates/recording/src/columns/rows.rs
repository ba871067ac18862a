//! A table of whole numbers, as it comes and as it is packed.

use serde::{Serialize, Serializer};

use posed_protocol::{Stamp, round};

/// What is not known.
const UNKNOWN: i32 = i32::MIN;

/// A table, packed.
#[derive(Serialize)]
pub(super) struct Table<'a, S> {
    states: &'a [S],
    pub(super) rows: usize,
    pub(super) width: usize,
    #[serde(serialize_with = "bytes")]
    pub(super) values: Vec<u8>,
}

fn bytes<S: Serializer>(bytes: &[u8], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_bytes(bytes)
}

/// Rows of equal width.
#[derive(Clone, Debug, Default)]
pub(super) struct Rows {
    rows: usize,
    values: Vec<i32>,
}

impl Rows {
    /// Begins a row with its time and time code.
    pub(super) fn begin(&mut self, stamp: &Stamp) {
        self.time(stamp.t_us);
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

    pub(super) fn push(&mut self, number: i32) {
        self.values.push(number);
    }

    /// Whole seconds and microseconds.
    pub(super) fn time(&mut self, t_us: i64) {
        // A stage that runs for 68 years stays at its last second.
        let seconds = t_us.div_euclid(1_000_000).clamp(i64::from(-i32::MAX), i64::from(i32::MAX));
        self.values.extend([seconds as i32, t_us.rem_euclid(1_000_000) as i32]);
    }

    /// The numbers of others behind these.
    pub(super) fn append(&mut self, others: &Self) {
        self.values.extend_from_slice(&others.values);
    }

    /// Numbers in steps of `1 / per_unit`, or as many that are not known.
    pub(super) fn each<const N: usize>(&mut self, per_unit: f64, values: Option<[f64; N]>) {
        match values {
            Some(values) => self.values.extend(values.map(|value| steps(per_unit, value))),
            None => self.values.extend([UNKNOWN; N]),
        }
    }

    /// Rows, and numbers in each; `None` while it is empty.
    fn size(&self) -> Option<(usize, usize)> {
        self.values.len().checked_div(self.rows).map(|width| (self.rows, width))
    }

    pub(super) fn numbers(&self) -> usize {
        self.values.len()
    }

    /// As a reader gets it, with the names of the states in it; `None` while it is empty.
    pub(super) fn table<'a, S>(&self, states: &'a [S]) -> Option<Table<'a, S>> {
        let (rows, width) = self.size()?;
        Some(Table { states, rows, width, values: self.packed(rows, width) })
    }

    /// Column by column the difference of each number to the one before it, the first to 0, modulo 2^32, in zigzag coding; of all of these the lowest
    /// bytes first, then the second ones and so on. What moves smoothly has high bytes that are all 0, and packs to little more than its noise.
    fn packed(&self, rows: usize, width: usize) -> Vec<u8> {
        let mut bytes = vec![0; 4 * self.values.len()];
        let plane = self.values.len();
        for column in 0..width {
            let mut before = 0_i32;
            let numbers = self.values.iter().skip(column).step_by(width);
            for (place, number) in (column * rows..).zip(numbers) {
                let difference = number.wrapping_sub(before);
                before = *number;
                for (at, byte) in zigzag(difference).to_le_bytes().into_iter().enumerate() {
                    bytes[at * plane + place] = byte;
                }
            }
        }
        bytes
    }
}

/// 0, -1, 1, -2 as 0, 1, 2, 3: small numbers of either sign have high bytes that are 0.
fn zigzag(number: i32) -> i32 {
    (number << 1) ^ (number >> 31)
}

/// The nearest step, as messages round it; what is no number is not known.
fn steps(per_unit: f64, value: f64) -> i32 {
    let steps = round::steps(per_unit, value);
    if steps.is_nan() { UNKNOWN } else { (steps as i32).max(-i32::MAX) }
}
