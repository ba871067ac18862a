//! What there is to say of each recording of a folder, read once as long as its file stays as it is.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use crate::recordings::{self, FindError};
use posed_protocol::LibraryTake;
use posed_recording::{Brief, digest_file};

/// What was read, by folder and name.
#[derive(Default)]
pub(super) struct Lists {
    folders: BTreeMap<PathBuf, BTreeMap<String, (State, LibraryTake)>>,
}

/// How a file stood when it was read, and the one with its digest beside it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct State {
    bytes: u64,
    modified: Option<SystemTime>,
    digest_modified: Option<SystemTime>,
}

impl State {
    /// `None` of what is no file, or is gone.
    fn of(path: &Path) -> Option<Self> {
        let known = path.metadata().ok().filter(std::fs::Metadata::is_file)?;
        let digest = digest_file(path).metadata().ok();
        Some(Self {
            bytes: known.len(),
            modified: known.modified().ok(),
            digest_modified: digest.and_then(|digest| digest.modified().ok()),
        })
    }
}

impl Lists {
    /// The recordings of a folder: the newest first, those that cannot be read last.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub(super) fn of(&mut self, folder: &Path) -> Result<Vec<LibraryTake>, FindError> {
        let names = recordings::list(folder)?;
        let mut known = self.folders.remove(folder).unwrap_or_default();
        let mut read = BTreeMap::new();
        for name in names {
            let path = folder.join(&name);
            let Some(state) = State::of(&path) else { continue };
            let take = match known.remove(&name) {
                Some((before, take)) if before == state => take,
                _ => take(&path, &name, state.bytes),
            };
            read.insert(name, (state, take));
        }
        let mut takes: Vec<LibraryTake> = read.values().map(|(_, take)| take.clone()).collect();
        // By UTC in one form: the order of the texts is that of the times.
        takes.sort_by(|one, other| other.utc.cmp(&one.utc).then_with(|| one.name.cmp(&other.name)));
        self.folders.insert(folder.to_owned(), read);
        Ok(takes)
    }
}

fn take(path: &Path, name: &str, bytes: u64) -> LibraryTake {
    let take = LibraryTake { name: name.to_owned(), bytes, ..LibraryTake::default() };
    match Brief::read(path) {
        Ok(brief) => LibraryTake {
            utc: Some(brief.utc()),
            complete: brief.is_complete(),
            length_s: brief.length_s,
            stage: brief.stage,
            counts: brief.counts,
            picture: brief.picture,
            ..take
        },
        Err(error) => LibraryTake { unreadable: Some(error.to_string()), ..take },
    }
}
