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
}

impl StageClock {
    /// Starts the clock: now is the stage's epoch.
    #[expect(clippy::disallowed_methods, reason = "this is the daemon's clock")]
    pub fn start() -> Self {
        Self { origin: Instant::now(), epoch_utc_ns: utc_nanos() }
    }

    /// Time since the epoch.
    pub fn now(&self) -> Timestamp {
        Timestamp::from_nanos(self.origin.elapsed().as_nanos() as i64)
    }

    /// The monotonic instant of a time since the epoch; times before the epoch are the epoch.
    pub fn instant(&self, t: Timestamp) -> Instant {
        self.origin + Duration::from_nanos(t.as_nanos().max(0) as u64)
    }

    /// UTC of the epoch, in nanoseconds since 1970.
    pub fn epoch_utc_ns(&self) -> i64 {
        self.epoch_utc_ns
    }

    /// By how many seconds the wall clock has moved against this clock since the epoch, if that is more
    /// than half a second: somebody set the computer's clock.
    pub fn wall_clock_jump_s(&self) -> Option<f64> {
        let off_ns = utc_nanos() - self.epoch_utc_ns - self.now().as_nanos();
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
