//! Time stamps of a stage.

use std::ops::{Add, Sub};
use std::time::Duration;

use posed_state::Plain;
use serde::{Deserialize, Serialize};

/// A point in time: nanoseconds since the stage's epoch, on the host's monotonic clock; 292 years to either side.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, Plain,
)]
#[serde(transparent)]
pub struct Timestamp(i64);

impl Timestamp {
    /// The stage's epoch.
    pub const ZERO: Self = Self(0);

    /// Time `nanos` nanoseconds after the stage's epoch; negative before it.
    #[inline]
    pub const fn from_nanos(nanos: i64) -> Self {
        Self(nanos)
    }

    /// Time `seconds` after the stage's epoch, rounded to the nanosecond; the ends of the range beyond it, the epoch for NaN.
    #[inline]
    pub fn from_secs_f64(seconds: f64) -> Self {
        Self((seconds * 1e9).round() as i64)
    }

    /// Nanoseconds since the stage's epoch.
    #[inline]
    pub const fn as_nanos(self) -> i64 {
        self.0
    }

    /// Seconds since the stage's epoch; an `f64` resolves the nanosecond for the first three months.
    #[inline]
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// Seconds from `earlier` to `self`; negative when `self` is the earlier one, and never more than 292 years: a damaged file's
    /// times may lie further apart.
    #[inline]
    pub fn seconds_since(self, earlier: Self) -> f64 {
        self.0.saturating_sub(earlier.0) as f64 * 1e-9
    }
}

impl Add<Duration> for Timestamp {
    type Output = Self;
    fn add(self, duration: Duration) -> Self {
        Self(self.0 + duration.as_nanos() as i64)
    }
}

impl Sub<Duration> for Timestamp {
    type Output = Self;
    fn sub(self, duration: Duration) -> Self {
        Self(self.0 - duration.as_nanos() as i64)
    }
}

#[cfg(test)]
mod tests {
    use super::Timestamp;

    #[test]
    fn times_at_both_ends_of_the_range_are_far_apart_in_the_right_order() {
        let [first, last] = [i64::MIN, i64::MAX].map(Timestamp::from_nanos);
        assert!(last.seconds_since(first) > 9e9 && first.seconds_since(last) < -9e9);
        assert_eq!(last.seconds_since(last), 0.0);
    }
}
