//! What a service manager (systemd) receives: that the daemon is ready, that it lives, that it ends.
//!
//! In: the daemon's status, which the fusion thread makes once a second. Out: words on the manager's socket, if there is one. A daemon whose
//! fusion thread hangs says nothing any more, and is started again.

use std::time::{Duration, Instant};

use sd_notify::NotifyState;

/// The manager is reported in words so seldom.
const WORDS_INTERVAL: Duration = Duration::from_secs(5);

/// A service manager, or nobody.
pub(crate) struct Manager {
    watched: bool,
    reported: Option<Instant>,
}

impl Manager {
    /// Reports that the daemon serves.
    pub(crate) fn ready() -> Self {
        emit(&[NotifyState::Ready]);
        Self { watched: sd_notify::watchdog_enabled().is_some(), reported: None }
    }

    /// Reports that the daemon lives: once for each status that its thread has made.
    pub(crate) fn alive(&mut self, words: impl FnOnce() -> String) {
        if self.watched {
            emit(&[NotifyState::Watchdog]);
        }
        #[expect(clippy::disallowed_methods, reason = "how often a person may look is wall time")]
        let now = Instant::now();
        if self.reported.is_none_or(|reported| now >= reported + WORDS_INTERVAL) {
            self.reported = Some(now);
            emit(&[NotifyState::Status(&words())]);
        }
    }

    /// Reports that it ends.
    pub(crate) fn stopping(self) {
        emit(&[NotifyState::Stopping]);
    }
}

/// Reports what the start waits for.
pub(crate) fn waits(reason: &str) {
    emit(&[NotifyState::Status(reason)]);
}

fn emit(what: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(what) {
        tracing::debug!(%error, "the service manager does not listen");
    }
}
