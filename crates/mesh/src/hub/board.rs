//! What the hub reports about its stages: written by who follows each, read once a second and when something changes.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

use posed_daemon::StageClock;
use posed_protocol::{StageEntry, StagePresence, Stages};

/// Shared by all who follow a stage.
#[derive(Clone, Debug)]
pub(super) struct Board {
    entries: Arc<Mutex<BTreeMap<String, StageEntry>>>,
    changed: Arc<Notify>,
    clock: StageClock,
}

impl Board {
    pub(super) fn new(clock: StageClock) -> Self {
        Self { entries: Arc::default(), changed: Arc::default(), clock }
    }

    /// A stage is followed from now on.
    pub(super) fn enter(&self, id: &str) {
        self.entries().insert(id.to_owned(), StageEntry { id: id.to_owned(), ..StageEntry::default() });
    }

    /// Changes what is said of a stage that is followed; it goes out with the next look.
    pub(super) fn write(&self, id: &str, change: impl FnOnce(&mut StageEntry)) {
        if let Some(entry) = self.entries().get_mut(id) {
            change(entry);
        }
    }

    /// Of the stages that are not there, the one that has been gone longest, else the one that has said nothing yet for longest; it
    /// is forgotten.
    pub(super) fn forget_one(&self) -> Option<String> {
        let mut entries = self.entries();
        let absent = entries.values().filter(|entry| entry.state != StagePresence::Present);
        let rank = |entry: &StageEntry| (entry.state != StagePresence::Gone, entry.since_s);
        let id = absent.min_by(|a, b| rank(a).partial_cmp(&rank(b)).unwrap_or(Ordering::Equal))?.id.clone();
        entries.remove(&id);
        Some(id)
    }

    /// A stage has come, vanished or returned: that goes out at once. How long it had been as it was, s.
    pub(super) fn presence(&self, id: &str, state: StagePresence) -> f64 {
        let now_s = self.now_s();
        let mut lasted_s = 0.0;
        self.write(id, |entry| {
            lasted_s = now_s - entry.since_s;
            entry.vanished += u32::from(state == StagePresence::Gone && entry.state != state);
            entry.state = state;
            entry.since_s = now_s;
            if state == StagePresence::Gone {
                entry.frames_hz = 0.0;
            }
        });
        self.changed.notify_one();
        lasted_s
    }

    pub(super) async fn changed(&self) {
        self.changed.notified().await;
    }

    /// All of it, now.
    pub(super) fn stages(&self) -> Stages {
        Stages { t_s: self.now_s(), stages: self.entries().values().cloned().collect() }
    }

    /// Hub time, s, to the microsecond.
    fn now_s(&self) -> f64 {
        (self.clock.now().as_nanos() / 1000) as f64 * 1e-6
    }

    fn entries(&self) -> MutexGuard<'_, BTreeMap<String, StageEntry>> {
        // Every change is complete before anything in it could panic.
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_is_gone_or_has_said_nothing_gives_way_and_who_is_there_does_not() {
        let board = Board::new(StageClock::start());
        for (id, state, since_s) in [
            ("there", StagePresence::Present, 0.0),
            ("silent", StagePresence::Joining, 1.0),
            ("silent for longer", StagePresence::Joining, 0.5),
            ("gone", StagePresence::Gone, 3.0),
            ("gone for longer", StagePresence::Gone, 2.0),
            ("there too", StagePresence::Present, 9.0),
        ] {
            board.enter(id);
            board.write(id, |entry| (entry.state, entry.since_s) = (state, since_s));
        }
        let forgotten: Vec<String> = std::iter::from_fn(|| board.forget_one()).collect();
        assert_eq!(forgotten, ["gone for longer", "gone", "silent for longer", "silent"]);
        let left = board.stages().stages.into_iter().map(|entry| entry.id);
        assert!(left.eq(["there", "there too"]));
    }
}
