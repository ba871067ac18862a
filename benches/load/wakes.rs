//! How late threads and runtimes come to run: what a pause at a client is to be held against.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Distance of two looks at a runtime.
const BEAT: Duration = Duration::from_millis(2);

/// Wake-ups with their time, UTC in s, and by how much each was too late; clones share them.
#[derive(Clone, Default)]
pub(crate) struct Wakes(Arc<Mutex<Vec<(f64, Duration)>>>);

impl Wakes {
    pub(crate) fn push(&self, late: Duration) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push((utc_s(), late));
    }

    /// The latest within so many seconds, ms.
    pub(crate) fn late_ms(&self, begins_utc_s: f64, seconds: f64) -> f64 {
        let wakes = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let within = wakes.iter().filter(|(utc_s, _)| (0.0..seconds).contains(&(utc_s - begins_utc_s)));
        within.map(|(_, late)| *late).max().unwrap_or_default().as_secs_f64() * 1e3
    }

    /// Watches the runtime that this runs on, for ever.
    #[expect(clippy::disallowed_methods, reason = "this program owns its clock")]
    pub(crate) async fn watch(self) {
        loop {
            let due = Instant::now() + BEAT;
            tokio::time::sleep_until(due.into()).await;
            self.push(due.elapsed());
        }
    }
}

/// Now.
pub(crate) fn utc_s() -> f64 {
    jiff::Timestamp::now().as_nanosecond() as f64 * 1e-9
}
