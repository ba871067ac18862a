//! What tracking reported last, as the server has passed it on: evidence that both live.
//!
//! In: every status, once it has gone to the clients. Out: the newest one, for whoever runs the daemon, and whether there has
//! been one lately, for `/health` and for a watchdog. A part that hangs reports nothing, and no other part can speak for it.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use posed_protocol::Status;
use tokio::sync::watch;

/// A status comes once a second: after so long without one something hangs.
const SILENCE: Duration = Duration::from_secs(3);

/// Why nobody can say that tracking goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum Silent {
    /// There has been no status yet, for so long.
    #[error("tracking is starting: no report for {} s", .0.as_secs())]
    Starting(Duration),
    /// There has been none for so long.
    #[error("tracking has reported nothing for {} s", .0.as_secs())]
    For(Duration),
}

/// The newest status, and when it came.
#[derive(Debug)]
pub(super) struct Reports {
    newest: watch::Sender<Status>,
    started: Instant,
    at: Mutex<Option<Instant>>,
}

impl Reports {
    /// Before the first.
    pub(super) fn new() -> Self {
        Self { newest: watch::channel(Status::default()).0, started: now(), at: Mutex::new(None) }
    }

    /// Clients have been sent a status.
    pub(super) fn passed_on(&self, status: &Status) {
        *self.at.lock().unwrap_or_else(PoisonError::into_inner) = Some(now());
        self.newest.send_replace(status.clone());
    }

    /// The newest that clients have been sent; empty before the first.
    pub(super) fn newest(&self) -> watch::Receiver<Status> {
        self.newest.subscribe()
    }

    /// Whether one has come lately; at first there need not be one.
    pub(super) fn check(&self) -> Result<(), Silent> {
        let at = *self.at.lock().unwrap_or_else(PoisonError::into_inner);
        let silence = now().saturating_duration_since(at.unwrap_or(self.started));
        match at {
            _ if silence <= SILENCE => Ok(()),
            None => Err(Silent::Starting(silence)),
            Some(_) => Err(Silent::For(silence)),
        }
    }
}

#[expect(clippy::disallowed_methods, reason = "what hangs is measured in the time of those who wait")]
fn now() -> Instant {
    Instant::now()
}
