//! The stage's clock: the one place where host time becomes [`Timestamp`]s.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use posed_drivers::Timestamp;

/// How far the wall clock may move against the monotonic one before it counts as a jump.
const JUMP: Duration = Duration::from_millis(500);

/// A monotonic clock that starts at the stage's epoch, and the UTC of that epoch, asked once.
#[derive(Clone, Copy, Debug)]
pub struct StageClock {
    origin: Instant,
    epoch_utc_ns: i64,
    /// Asks for UTC, in nanoseconds since 1970.
    utc: fn() -> i64,
}

impl StageClock {
    /// Starts the clock: now is the stage's epoch.
    pub fn start() -> Self {
        Self::with_utc(utc_nanos)
    }

    /// As [`Self::start`], with another source of UTC.
    #[expect(clippy::disallowed_methods, reason = "this is the daemon's clock")]
    pub(super) fn with_utc(utc: fn() -> i64) -> Self {
        Self { origin: Instant::now(), epoch_utc_ns: utc(), utc }
    }

    /// Time since the epoch, in whole microseconds; it never goes backwards, whatever is done to the computer's clock. Digits
    /// beyond are noise, and would be a tenth of a recording.
    pub fn now(&self) -> Timestamp {
        Timestamp::from_nanos(self.origin.elapsed().as_micros() as i64 * 1000)
    }

    /// The monotonic instant of a time since the epoch; times before the epoch are the epoch.
    pub fn instant(&self, t: Timestamp) -> Instant {
        self.origin + Duration::from_nanos(t.as_nanos().max(0) as u64)
    }

    /// UTC of the epoch, in nanoseconds since 1970.
    pub fn epoch_utc_ns(&self) -> i64 {
        self.epoch_utc_ns
    }

    /// By how many seconds the wall clock has moved against this clock since the epoch, forwards positive, if that is more than
    /// half a second: somebody set the computer's clock. `None`: it has not.
    pub fn wall_clock_jump_s(&self) -> Option<f64> {
        let off_ns = (self.utc)() - self.epoch_utc_ns - self.now().as_nanos();
        (off_ns.unsigned_abs() as u128 > JUMP.as_nanos()).then_some(off_ns as f64 * 1e-9)
    }
}

#[expect(clippy::disallowed_methods, reason = "the one question for UTC")]
fn utc_nanos() -> i64 {
    match SystemTime::now().duration_since(UNIX_EPOCH) {
        Ok(since) => since.as_nanos() as i64,
        Err(before) => -(before.duration().as_nanos() as i64),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicI64, Ordering};

    use super::*;

    /// By how much somebody has set the computer's clock, ns.
    static SET_BY_NS: AtomicI64 = AtomicI64::new(0);

    #[test]
    fn given_a_jump_of_the_wall_clock_it_is_reported_and_stage_time_goes_on() {
        let clock = StageClock::with_utc(|| utc_nanos() + SET_BY_NS.load(Ordering::Relaxed));
        let (epoch, before) = (clock.epoch_utc_ns(), clock.now());
        assert_eq!(clock.wall_clock_jump_s(), None);
        for jump_s in [3600, -86_400] {
            SET_BY_NS.store(jump_s * 1_000_000_000, Ordering::Relaxed);
            let told_s = clock.wall_clock_jump_s().unwrap();
            assert!((told_s - jump_s as f64).abs() < 10.0, "{told_s} for {jump_s}");
            assert_eq!(clock.epoch_utc_ns(), epoch);
            assert!(clock.now() >= before && clock.now().as_secs_f64() < 1000.0);
        }
    }
}
