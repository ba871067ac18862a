//! What the disk of the recordings still takes.
//!
//! What comes in: a folder. What goes out: free bytes, some seconds old. What it never does: keep anybody waiting for the disk.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tokio::sync::watch;

use super::ports::ended;

/// How often the disk is asked: it fills by some MB a second at most.
const INTERVAL: Duration = Duration::from_secs(5);
/// Where nobody knows.
const UNKNOWN: u64 = u64::MAX;

/// Free bytes of the disk of a folder; clones share the answer.
#[derive(Clone, Debug)]
pub(super) struct FreeSpace {
    bytes: Arc<AtomicU64>,
}

impl FreeSpace {
    pub(super) fn new() -> Self {
        Self { bytes: Arc::new(AtomicU64::new(UNKNOWN)) }
    }

    /// So many; `None` before the disk has answered, and where it cannot be asked.
    pub(super) fn bytes(&self) -> Option<u64> {
        Some(self.bytes.load(Ordering::Relaxed)).filter(|&bytes| bytes != UNKNOWN)
    }

    /// Asks again and again, until shutdown.
    pub(super) async fn watch(self, folder: PathBuf, mut down: watch::Receiver<bool>) {
        let mut ticks = tokio::time::interval(INTERVAL);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                () = ended(&mut down) => return,
                _ = ticks.tick() => {}
            }
            let folder = folder.clone();
            // A disk that hangs keeps only this waiting.
            let asked = tokio::task::spawn_blocking(move || free_bytes(&folder));
            tokio::select! {
                () = ended(&mut down) => return,
                answer = asked => self.bytes.store(answer.ok().flatten().unwrap_or(UNKNOWN), Ordering::Relaxed),
            }
        }
    }
}

/// What whoever runs the daemon may still write; of a folder that is not there yet, where it would be made.
fn free_bytes(folder: &Path) -> Option<u64> {
    let from_here = |folder: &Path| {
        if folder.as_os_str().is_empty() { Path::new(".").to_owned() } else { folder.to_owned() }
    };
    let there = folder.ancestors().map(from_here).find(|folder| folder.exists())?;
    let disk = rustix::fs::statvfs(&there).ok()?;
    Some(disk.f_bavail.saturating_mul(disk.f_frsize))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_is_not_there_yet_has_the_space_of_the_one_above() {
        let folder = tempfile::tempdir().unwrap();
        let free = free_bytes(&folder.path().join("not/yet")).unwrap();
        assert!(free > 0 && free != UNKNOWN);
        assert!(free_bytes(Path::new("not-yet")).is_some());
    }
}
