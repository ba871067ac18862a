//! Which recordings must stay where they are: somebody writes into them, plays or reads them.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// What is done with a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Use {
    /// It is being recorded.
    Recorded,
    /// It is open, for somebody or for who may come back.
    Played,
    /// A job reads it.
    Read,
}

/// All that is in use; clones are the same list.
#[derive(Clone, Debug, Default)]
pub(crate) struct InUse {
    list: Arc<List>,
}

#[derive(Debug, Default)]
struct List {
    files: Mutex<Vec<(PathBuf, Use)>>,
    freed: Condvar,
}

/// A recording that is in use until this is dropped.
#[derive(Debug)]
pub(crate) struct Held {
    list: Arc<List>,
    path: PathBuf,
    how: Use,
}

impl List {
    fn lock(&self) -> MutexGuard<'_, Vec<(PathBuf, Use)>> {
        // Every change is complete before anything in it could panic.
        self.files.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl InUse {
    /// A recording is in use from now on.
    pub(crate) fn hold(&self, path: &Path, how: Use) -> Held {
        self.list.lock().push((path.to_owned(), how));
        Held { list: Arc::clone(&self.list), path: path.to_owned(), how }
    }

    /// How a recording is in use: of several uses the first.
    pub(super) fn of(&self, path: &Path) -> Option<Use> {
        self.list.lock().iter().find(|(known, _)| known == path).map(|(_, how)| *how)
    }

    pub(super) fn is_recorded(&self, path: &Path) -> bool {
        self.list.lock().iter().any(|(known, how)| known == path && *how == Use::Recorded)
    }

    /// Name of the file in `folder` that is being recorded.
    pub(super) fn recording(&self, folder: &Path) -> Option<String> {
        let list = self.list.lock();
        // The newest: one before it may still write its index.
        let found =
            list.iter().rev().find(|(known, how)| *how == Use::Recorded && known.parent() == Some(folder));
        Some(found?.0.file_name()?.to_string_lossy().into_owned())
    }

    /// Waits until a recording is free, so long at most; whether it is.
    pub(super) fn wait_until_free(&self, path: &Path, patience: Duration) -> bool {
        let is_in_use = |list: &mut Vec<(PathBuf, Use)>| list.iter().any(|(known, _)| known == path);
        let waited = self.list.freed.wait_timeout_while(self.list.lock(), patience, is_in_use);
        !waited.unwrap_or_else(PoisonError::into_inner).1.timed_out()
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        let mut files = self.list.lock();
        if let Some(at) = files.iter().position(|(known, how)| *known == self.path && *how == self.how) {
            files.remove(at);
        }
        drop(files);
        self.list.freed.notify_all();
    }
}
