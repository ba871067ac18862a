//! Whether the links are there that the stage file asks for, and why not.
//!
//! In: how many other ends zenoh has, every two seconds. Out: what is in the way, for the status of a stage and the log of a hub. Never: anything
//! about an end that connects to this one; that one says it itself.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError};
use zenoh::{Session, Wait};

use super::obstacle::obstacle;
use super::session::{LinkError, thread};
use posed_protocol::Problem;
use posed_stage::Zenoh;

/// Distance of two looks. A link that has just broken is repaired within one, and is nothing to speak of.
const LOOK: Duration = Duration::from_secs(2);

/// What is in the way; clones share it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Links {
    missing: Arc<Mutex<Vec<Problem>>>,
}

impl Links {
    /// Looks until `stopped`, on a thread of its own that nobody need wait for: a look at an end that does not answer takes seconds.
    pub(crate) fn watch(
        &self,
        session: Session,
        settings: Zenoh,
        stopped: Receiver<()>,
    ) -> Result<(), LinkError> {
        if settings.connect.is_empty() {
            return Ok(());
        }
        let this = self.clone();
        thread("zenoh-links", move || this.run(&session, &settings, &stopped)).map(drop)
    }

    /// What is in the way of the first of the links that are not there.
    pub(crate) fn problem(&self) -> Option<Problem> {
        self.missing.lock().unwrap_or_else(PoisonError::into_inner).first().cloned()
    }

    fn run(&self, session: &Session, settings: &Zenoh, stopped: &Receiver<()>) {
        let mut lacked = false;
        while let Err(RecvTimeoutError::Timeout) = stopped.recv_timeout(LOOK) {
            let info = session.info();
            let linked = info.peers_zid().wait().count() + info.routers_zid().wait().count();
            let lacks = linked < settings.connect.len();
            let mut missing = Vec::new();
            if lacks && lacked {
                missing.extend(settings.connect.iter().map(|end| obstacle(end, settings)));
                if linked > 0 {
                    // Which of those that answer is linked already, nobody knows.
                    missing.retain(|problem| {
                        !matches!(problem.code.as_str(), "zenoh_password" | "zenoh_refused")
                    });
                }
            }
            lacked = lacks;
            let mut known = self.missing.lock().unwrap_or_else(PoisonError::into_inner);
            for problem in missing.iter().filter(|problem| !known.contains(problem)) {
                tracing::warn!("[zenoh]: {}", problem.message);
            }
            *known = missing;
        }
    }
}
