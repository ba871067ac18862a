//! What a device claims about its own pace.
//!
//! Rates end up as divisors, pauses and ticks, and most protocols carry them without a checksum. So each claim passes
//! [`Rate::claimed`] with the range that its kind of device can have; what is refused is warned of, and the session goes on with
//! what it knew before.

use std::ops::RangeInclusive;
use std::time::Duration;

use posed_state::Plain;
use thiserror::Error;

/// A rate that can be true: finite, above zero, and possible for its kind of device.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd, Plain)]
pub struct Rate(f64);

/// A rate that no device of its kind can have: the answer was damaged, or meant something else.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("a rate of {claimed_hz} Hz cannot be: {} to {} Hz are possible", .possible_hz.start(), .possible_hz.end())]
pub struct ImpossibleRate {
    /// What was claimed, Hz; may be infinite or NaN.
    pub claimed_hz: f64,
    /// What its kind of device can have, Hz.
    pub possible_hz: RangeInclusive<f64>,
}

impl Rate {
    /// The rate that a device claims, Hz, if it is one of those that its kind can have.
    ///
    /// # Errors
    /// It is outside of `possible_hz`, or no number.
    ///
    /// # Panics
    /// A range that begins at 0 or below, or has no end, checks nothing.
    pub fn claimed(claimed_hz: f64, possible_hz: &RangeInclusive<f64>) -> Result<Self, ImpossibleRate> {
        assert!(*possible_hz.start() > 0.0 && possible_hz.end().is_finite(), "{possible_hz:?}");
        if possible_hz.contains(&claimed_hz) {
            Ok(Self(claimed_hz))
        } else {
            Err(ImpossibleRate { claimed_hz, possible_hz: possible_hz.clone() })
        }
    }

    /// Per second, Hz.
    pub const fn hz(self) -> f64 {
        self.0
    }

    /// From one to the next, s.
    pub const fn period_s(self) -> f64 {
        1.0 / self.0
    }

    /// The time that `periods` take.
    pub fn periods(self, periods: f64) -> Duration {
        Duration::from_secs_f64(periods * self.period_s())
    }
}

/// Rate below which no pose is good, Hz: a pose is kept for half a second, and a record must follow before.
const LEAST_HZ: f64 = 2.0;

/// What to report of a device that is set to `rate_hz` records a second from each sensor, if they are too seldom to track by.
pub(crate) fn too_seldom(rate_hz: f64) -> Option<String> {
    (rate_hz <= LEAST_HZ).then(|| {
        format!("at {rate_hz:.1} Hz no pose is good: more than {LEAST_HZ} a second are needed; lower report_every_cycles")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_possible_rates_are_believed() {
        let possible = 10.0..=200.0;
        assert_eq!(Rate::claimed(10.0, &possible).map(Rate::hz), Ok(10.0));
        assert_eq!(
            Rate::claimed(50.0, &possible).map(|rate| rate.periods(2.0)),
            Ok(Duration::from_millis(40))
        );
        for claimed in [0.0, -50.0, 1e-300, 115_200.0, f64::INFINITY, f64::NAN] {
            let refused = Rate::claimed(claimed, &possible).unwrap_err().to_string();
            assert!(refused.ends_with("cannot be: 10 to 200 Hz are possible"), "{refused}");
        }
    }
}
