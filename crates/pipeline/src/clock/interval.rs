//! How far apart a device's cycles lie on its own counter.

use posed_state::Plain;

/// Share of a new step in the average.
const GAIN: f64 = 0.02;
/// Steps that differ from the average by more than this are gaps, or another rate.
const NEAR: std::ops::Range<f64> = 0.7..1.4;
/// So many of the same kind in a row are another rate.
const AGREEING: u32 = 8;

/// The usual step between two cycles, in nominal periods.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub(super) struct Interval {
    x: f64,
    /// Latest step that does not fit, and how many like it came in a row.
    odd: f64,
    odd_in_a_row: u32,
}

impl Default for Interval {
    fn default() -> Self {
        Self { x: 1.0, odd: 0.0, odd_in_a_row: 0 }
    }
}

impl Interval {
    pub(super) fn x(&self) -> f64 {
        self.x
    }

    pub(super) fn push(&mut self, step: f64) {
        if NEAR.contains(&(step / self.x)) {
            self.x += GAIN * (step - self.x);
            self.odd_in_a_row = 0;
            return;
        }
        let agrees = self.odd_in_a_row > 0 && NEAR.contains(&(step / self.odd));
        self.odd_in_a_row = if agrees { self.odd_in_a_row + 1 } else { 1 };
        self.odd = step;
        if self.odd_in_a_row >= AGREEING {
            *self = Self { x: step, ..Self::default() };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_do_not_count_and_another_rate_does() {
        let mut interval = Interval::default();
        for k in 0..1000 {
            interval.push(if k % 10 == 0 { 2.0 } else { 1.003 });
        }
        assert!((interval.x() - 1.003).abs() < 1e-6, "{}", interval.x());
        for _ in 0..AGREEING {
            interval.push(4.0);
        }
        assert_eq!(interval.x(), 4.0);
    }
}
