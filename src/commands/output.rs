//! Files that a command writes: whole or not at all, with the command's own words for what goes wrong.

use std::io::{self, Write};
use std::path::Path;

use posed_recording::AtomicFile;

use super::Error;

/// Writes a file so that nobody ever sees half of it, and replaces an old one.
pub(crate) fn replace(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), Error> {
    written(path, write).and_then(AtomicFile::commit).map_err(|error| Error::file("write", path, &error))
}

/// As [`replace`], but refuses to touch a file that is there already.
pub(crate) fn create(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<(), Error> {
    written(path, write).and_then(AtomicFile::commit_new).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => exists(path),
        _ => Error::file("write", path, &error),
    })
}

/// The refusal to overwrite a file.
pub(crate) fn exists(path: &Path) -> Error {
    Error::Failed(format!("{} is there already; remove it or choose another name", path.display()))
}

fn written(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<AtomicFile> {
    let mut file = AtomicFile::create(path)?;
    write(&mut file)?;
    Ok(file)
}
