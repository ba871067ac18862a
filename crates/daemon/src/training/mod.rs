//! Sessions of training: who trains now is kept, repetition by repetition.
//!
//! What comes in: what the fusion thread reports ([`Follow`], which never waits), requests of clients. What goes out: the database
//! `sessions.db` in the data folder, the topic `session`, answers, and for a plan the exercises that are selected one after the other.
//! What it never does: keep the fusion thread waiting. A thread of its own writes; what cannot be written (the disk is full) waits
//! and is tried again, and the topic says so.
//!
//! ```text
//! fusion thread: Follow ──> bounded queue ──> thread "sessions" ──> State ──> Store
//! requests, on the thread for files ─────────────────────────────────┘
//! ```

mod follow;
mod plan;
mod requests;
mod state;
#[cfg(test)]
mod tests;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, Select, Sender, TryRecvError, bounded};
use posed_drivers::Timestamp;

pub(super) use self::follow::Follow;
use self::follow::Report;
use self::state::State;
use super::clock::StageClock;
use super::fault_points;
use super::fusion::FusionInbox;
use super::models::Library;
use super::server::Hub;
use posed_sessions::file_in;
use posed_stage::Stage;

/// Reports that may wait for the thread: a repetition takes a second, the disk may take its time.
const REPORTS: usize = 1024;
/// Distance of two looks at the clock, for rests and for what could not be written.
const TICK: Duration = Duration::from_millis(200);

/// All sessions of a stage; clones share them.
#[derive(Clone, Debug)]
pub(super) struct Training {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    reports: Receiver<Report>,
    /// Capture time up to which everything is decided and reported, ns.
    decided_ns: AtomicI64,
    /// Reports that were lost because the queue was full.
    lost: AtomicU64,
    state: Mutex<State>,
}

/// What a stage's sessions work with.
#[derive(Debug)]
pub(super) struct Tools {
    pub(super) clock: StageClock,
    pub(super) hub: Hub,
    pub(super) inbox: FusionInbox,
    /// Where exercises are kept.
    pub(super) exercises: Library,
}

impl Training {
    /// For a stage that keeps what it learns in `data`. Nothing is opened yet.
    pub(super) fn new(stage: &Stage, data: &Path, tools: Tools) -> (Self, Follow) {
        let (to, reports): (Sender<Report>, _) = bounded(REPORTS);
        let shared = Arc::new(Shared {
            reports,
            decided_ns: AtomicI64::new(0),
            lost: AtomicU64::new(0),
            state: Mutex::new(State::new(stage.name.clone(), file_in(data), tools)),
        });
        let follow = Follow::new(stage, to, Arc::clone(&shared));
        (Self { shared }, follow)
    }

    /// Starts the thread, which ends with [`Follow`]: all sessions have ended then.
    pub(super) fn start(&self) -> std::io::Result<JoinHandle<()>> {
        let shared = Arc::clone(&self.shared);
        #[expect(clippy::disallowed_methods, reason = "the daemon owns the thread that writes sessions")]
        std::thread::Builder::new().name("sessions".into()).spawn(move || shared.run())
    }
}

impl Shared {
    fn run(&self) {
        self.lock().begin();
        let mut reported = Select::new();
        reported.recv(&self.reports);
        loop {
            // Reports stay in the queue until the state is locked: who ends a session takes them in before.
            let _ = reported.ready_timeout(TICK);
            match catch_unwind(AssertUnwindSafe(|| self.look())) {
                Ok(true) => {}
                Ok(false) => break,
                Err(_) => tracing::error!("sessions go on without what they panicked at; please report this"),
            }
        }
        self.lock().shut_down();
    }

    /// Does what is due; false once nothing more can be reported.
    fn look(&self) -> bool {
        let _ = fault_points::pass("sessions");
        let (mut state, decided) = self.up_to_date();
        state.tick(decided, self.lost());
        match self.reports.try_recv() {
            Ok(report) => state.take(report),
            Err(TryRecvError::Empty) => {}
            Err(TryRecvError::Disconnected) => return false,
        }
        true
    }

    /// The state with all that was reported until now, and the capture time up to which that is all there is.
    fn up_to_date(&self) -> (MutexGuard<'_, State>, Timestamp) {
        let mut state = self.lock();
        let decided = Timestamp::from_nanos(self.decided_ns.load(Ordering::Acquire));
        self.reports.try_iter().for_each(|report| state.take(report));
        (state, decided)
    }

    /// Reports that never came.
    fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // What a panic leaves is a session without its last repetition at worst.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
