//! The one folder with a stage's recordings: which there are, and where.
//!
//! In: the folder, names that clients give. Out: names in order, paths. Never: a path that leads out of the folder.

use std::io;
use std::path::{Path, PathBuf};

use super::server::Refusal;
use posed_protocol::RefusalReason;
use posed_recording::is_recording;

/// Why a recording is not found.
#[derive(Debug, thiserror::Error)]
pub enum FindError {
    /// The folder cannot be read.
    #[error("cannot read the folder {}: {error}", folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// There is no recording of that name.
    #[error("name: there is no recording {0:?}; replay.list names them")]
    Unknown(String),
}

impl From<FindError> for Refusal {
    fn from(error: FindError) -> Self {
        match error {
            FindError::Folder { .. } => Self::failed(error),
            FindError::Unknown(ref name) => {
                Self::new("not_found", &error).because(RefusalReason::NoTake).with("name", name)
            }
        }
    }
}

/// Path of the recording of that name in a folder; `name` is the file's name as [`list`] gives it, and never leads elsewhere.
///
/// # Errors
/// There is none of that name, or the folder cannot be read.
pub fn find(folder: &Path, name: &str) -> Result<PathBuf, FindError> {
    if list(folder)?.iter().any(|known| known == name) {
        Ok(folder.join(name))
    } else {
        Err(FindError::Unknown(name.to_owned()))
    }
}

/// Longest name of a recording, bytes.
const NAME_BYTES: usize = 128;

/// The file name of a recording that a client calls so: of letters, digits, `-`, `_`, `.` and spaces, ending in `.mcap`, never a path.
///
/// # Errors
/// It has something else in it, is empty or too long, or begins with a dot.
pub fn new_name(name: &str) -> Result<String, BadName> {
    let plain = |c: char| c.is_alphanumeric() || matches!(c, '-' | '_' | '.' | ' ');
    if name.is_empty() || name.len() > NAME_BYTES || name.starts_with('.') || !name.chars().all(plain) {
        return Err(BadName);
    }
    Ok(if name.ends_with(".mcap") { name.to_owned() } else { format!("{name}.mcap") })
}

/// Why a recording cannot be called so.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("name: give a file name of letters, digits, '-', '_', '.', without a path")]
pub struct BadName;

impl From<BadName> for Refusal {
    fn from(error: BadName) -> Self {
        Self::bad_request(error).because(RefusalReason::BadName)
    }
}

/// Names of the files in a folder that end in `.mcap`, in letters of either case, in order; none where there is no folder yet. Nothing is opened.
///
/// # Errors
/// The folder cannot be read.
pub fn list(folder: &Path) -> Result<Vec<String>, FindError> {
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(FindError::Folder { folder: folder.to_owned(), error }),
    };
    let mut names: Vec<String> = entries
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|name| is_recording(Path::new(name)))
        .collect();
    names.sort();
    Ok(names)
}
