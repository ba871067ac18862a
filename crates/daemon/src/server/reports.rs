//! What tracking reported last, as the server has passed it on: evidence that both live.
//!
//! In: every status, once it has gone to the clients. Out: the newest one, for whoever runs the daemon, and for how long there has
//! been none, for `/health` and for a watchdog. A part that hangs reports nothing, and no other part can speak for it.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use posed_protocol::Status;
use tokio::sync::watch;

/// A status comes once a second: after so long without one something hangs.
const SILENCE: Duration = Duration::from_secs(3);

/// The newest status, and when it came.
#[derive(Debug)]
pub(super) struct Reports {
    newest: watch::Sender<Status>,
    at: Mutex<Instant>,
}

impl Reports {
    /// Before the first.
    pub(super) fn new() -> Self {
        Self { newest: watch::channel(Status::default()).0, at: Mutex::new(now()) }
    }

    /// Clients have been sent a status.
    pub(super) fn passed_on(&self, status: &Status) {
        *self.at.lock().unwrap_or_else(PoisonError::into_inner) = now();
        self.newest.send_replace(status.clone());
    }

    /// The newest that clients have been sent; empty before the first.
    pub(super) fn newest(&self) -> watch::Receiver<Status> {
        self.newest.subscribe()
    }

    /// For how long there has been none, where that is too long.
    pub(super) fn silent_for(&self) -> Option<Duration> {
        let at = *self.at.lock().unwrap_or_else(PoisonError::into_inner);
        Some(now().saturating_duration_since(at)).filter(|silence| *silence > SILENCE)
    }
}

#[expect(clippy::disallowed_methods, reason = "what hangs is measured in the time of those who wait")]
fn now() -> Instant {
    Instant::now()
}
