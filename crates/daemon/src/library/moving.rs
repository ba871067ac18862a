//! Recordings get another name, go into the bin and come back; what belongs to them goes along.

use std::fs::{File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::{BIN, EXPORTS, Librarian, Outcome, Use};
use crate::recordings;
use crate::server::Refusal;
use posed_protocol::{Answer, RefusalReason, Removed, Renamed};
use posed_recording::table::LabelFiles;
use posed_recording::{digest_file, sync_folder_of};

/// How long a take that nobody watches any more has to be closed.
const CLOSING: Duration = Duration::from_secs(2);
/// Takes of one name that the bin keeps apart.
const SAME_NAME: u32 = 1000;

impl Librarian {
    pub(super) fn rename(&mut self, name: &str, to: &str) -> Outcome {
        let to = recordings::new_name(to)?;
        let from = self.movable(name)?;
        if to != name {
            move_all(&from, &self.folder.join(&to)).map_err(|error| refusal(&error, &to))?;
            self.renamed(name, &to);
        }
        Ok(Some(Answer::Renamed(Renamed { name: to })))
    }

    pub(super) fn remove(&mut self, name: &str) -> Outcome {
        let from = self.movable(name)?;
        let bin = self.folder.join(BIN);
        std::fs::create_dir_all(&bin).map_err(Refusal::failed)?;
        for number in 1..SAME_NAME {
            let to = numbered(name, number);
            match move_all(&from, &bin.join(&to)) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(refusal(&error, &to)),
                Ok(()) => {
                    if to != name {
                        self.renamed(name, &to);
                    }
                    return Ok(Some(Answer::Renamed(Renamed { name: to })));
                }
            }
        }
        Err(Refusal::new("exists", format!("name: the bin has too many takes called {name:?}; empty it")))
    }

    pub(super) fn restore(&mut self, name: &str) -> Outcome {
        let from = recordings::find(&self.folder.join(BIN), name)?;
        move_all(&from, &self.folder.join(name)).map_err(|error| refusal(&error, name))?;
        Ok(Some(Answer::Renamed(Renamed { name: name.to_owned() })))
    }

    pub(super) fn empty_bin(&mut self) -> Outcome {
        let bin = self.folder.join(BIN);
        let mut removed = 0;
        for name in recordings::list(&bin)? {
            let path = bin.join(name);
            std::fs::remove_file(&path).map_err(Refusal::failed)?;
            removed += 1;
            for beside in beside(&path) {
                remove_if_there(&beside).map_err(Refusal::failed)?;
            }
        }
        Ok(Some(Answer::Removed(Removed { removed })))
    }

    /// A recording that may be moved.
    fn movable(&self, name: &str) -> Result<PathBuf, Refusal> {
        let path = recordings::find(&self.folder, name)?;
        let busy =
            |reason: RefusalReason, sentence: &str| Err(Refusal::new("busy", sentence).because(reason));
        match self.in_use.of(&path) {
            // Another program may be recording into it: a recorder locks its file.
            None if is_locked(&path) => {
                busy(RefusalReason::IsWritten, "another program writes it; stop that first")
            }
            None => Ok(path),
            Some(Use::Recorded) => busy(RefusalReason::IsRecorded, "it is being recorded; stop that first"),
            Some(Use::Read) => busy(RefusalReason::IsRead, "a job reads it; wait for that, or cancel it"),
            Some(Use::Played) => {
                // It is kept open for who comes back; who moves it does not.
                let closes = self.shared.let_go.get().is_some_and(|let_go| let_go(name));
                if closes && self.in_use.wait_until_free(&path, CLOSING) {
                    return Ok(path);
                }
                busy(RefusalReason::IsWatched, "somebody watches it; close it first")
            }
        }
    }

    fn renamed(&self, from: &str, to: &str) {
        if let Some(on_rename) = self.shared.on_rename.get() {
            on_rename(from, to);
        }
    }
}

fn is_locked(path: &Path) -> bool {
    let locked = File::open(path).map(|file| file.try_lock_shared());
    matches!(locked, Ok(Err(TryLockError::WouldBlock)))
}

fn refusal(error: &io::Error, name: &str) -> Refusal {
    match error.kind() {
        io::ErrorKind::AlreadyExists => {
            Refusal::new("exists", format!("there is a recording {name:?} already; choose another name"))
                .because(RefusalReason::TakeExists)
                .with("name", name)
        }
        _ => Refusal::failed(error),
    }
}

/// The name, or that with a number before its end.
fn numbered(name: &str, number: u32) -> String {
    match Path::new(name).extension().and_then(|end| end.to_str()) {
        Some(end) if number > 1 => format!("{}-{number}.{end}", &name[..name.len() - end.len() - 1]),
        _ => name.to_owned(),
    }
}

/// What may stand beside a recording and belongs to it: its digest and its labels.
fn beside(path: &Path) -> [PathBuf; 3] {
    let LabelFiles { rows, elan } = LabelFiles::beside(path);
    [digest_file(path), rows, elan]
}

/// Moves a recording with what belongs to it, never over another.
fn move_all(from: &Path, to: &Path) -> io::Result<()> {
    let pairs: Vec<_> = beside(from).into_iter().zip(beside(to)).filter(|(from, _)| from.exists()).collect();
    if let Some((_, taken)) = pairs.iter().find(|(_, to)| to.exists()) {
        let reason = format!("{} is there already", taken.display());
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, reason));
    }
    move_one(from, to)?;
    for (from, to) in pairs {
        // The recording is where it was asked to be, and can do without.
        if let Err(error) = move_one(&from, &to) {
            tracing::warn!("{} stays behind: {error}", from.display());
        }
    }
    // So that a power cut does not undo one half.
    sync_folder_of(to)?;
    sync_folder_of(from)
}

#[cfg(target_os = "linux")]
fn move_one(from: &Path, to: &Path) -> io::Result<()> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    use rustix::io::Errno;
    match renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
        // Not every file system knows this flag.
        Err(Errno::INVAL | Errno::NOSYS) => move_if_free(from, to),
        moved => Ok(moved?),
    }
}

#[cfg(not(target_os = "linux"))]
fn move_one(from: &Path, to: &Path) -> io::Result<()> {
    move_if_free(from, to)
}

fn move_if_free(from: &Path, to: &Path) -> io::Result<()> {
    if to.symlink_metadata().is_ok() {
        return Err(io::ErrorKind::AlreadyExists.into());
    }
    std::fs::rename(from, to)
}

/// Removes a recording of that name for good, with what belongs to it and what was exported from it, in the folder and in its bin.
///
/// # Errors
/// Something could not be removed.
pub fn forget(folder: &Path, name: &str) -> io::Result<()> {
    for path in [folder.join(name), folder.join(BIN).join(name)] {
        remove_if_there(&path)?;
        beside(&path).iter().try_for_each(|path| remove_if_there(path))?;
    }
    let stem = format!("{}.", Path::new(name).file_stem().unwrap_or_default().to_string_lossy());
    let exports = match std::fs::read_dir(folder.join(EXPORTS)) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        exports => exports?,
    };
    for export in exports {
        let export = export?;
        if export.file_name().to_string_lossy().starts_with(&stem) {
            remove_if_there(&export.path())?;
        }
    }
    Ok(())
}

fn remove_if_there(path: &Path) -> io::Result<()> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        removed => removed,
    }
}
