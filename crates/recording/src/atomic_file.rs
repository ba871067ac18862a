//! Files that exist whole or not at all.
//!
//! What comes in: a path and bytes. What goes out: the finished file under its name, by one rename. What it
//! never does: leave a half-written file behind, or touch the old one before the new one is on the disk.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

/// A file being written beside its final place.
///
/// Dropped without [`AtomicFile::commit`], it disappears. A path that is there and no ordinary file (`/dev/stdout`, a
/// pipe) is written to as it is: to put a file in its place would destroy it.
#[derive(Debug)]
pub struct AtomicFile {
    file: BufWriter<Target>,
    path: PathBuf,
}

#[derive(Debug)]
enum Target {
    Beside(NamedTempFile),
    Through(File),
}

impl AtomicFile {
    /// Begins to write what will become `path`.
    ///
    /// # Errors
    /// The folder does not exist or may not be written to, or `path` names no file.
    pub fn create(path: &Path) -> io::Result<Self> {
        // Through a link, so that the link stays and its target is replaced.
        let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        let special = path.metadata().is_ok_and(|there| !there.is_file() && !there.is_dir());
        let target = if special {
            Target::Through(File::options().write(true).open(&path)?)
        } else {
            let (Some(_), Some(folder)) = (path.file_name(), path.parent()) else {
                let reason = format!("{} names no file", path.display());
                return Err(io::Error::new(io::ErrorKind::InvalidInput, reason));
            };
            let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
            let mut builder = tempfile::Builder::new();
            builder.prefix(".posed-").suffix(".tmp");
            #[cfg(unix)]
            {
                // What the file has that is replaced, which may hold secrets, else what other files get; the user's mask still applies.
                use std::os::unix::fs::PermissionsExt;
                let mode = path.metadata().map_or(0o666, |there| there.permissions().mode() & 0o777);
                builder.permissions(std::fs::Permissions::from_mode(mode));
            }
            Target::Beside(builder.tempfile_in(folder)?)
        };
        Ok(Self { file: BufWriter::new(target), path })
    }

    /// Writes a whole file, in the place of one that is there.
    ///
    /// # Errors
    /// Those of [`Self::create`] and [`Self::commit`].
    pub fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
        let mut file = Self::create(path)?;
        file.write_all(bytes)?;
        file.commit()
    }

    /// Gives the file its name, in the place of one that is there; its content is on the disk before that, and its name after.
    ///
    /// # Errors
    /// The disk is full or the rename was refused; the old file is as it was.
    pub fn commit(self) -> io::Result<()> {
        self.finish(|file, path| file.persist(path))
    }

    /// As [`Self::commit`], but refuses to take the place of a file that is there.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`], and those of [`Self::commit`].
    pub fn commit_new(self) -> io::Result<()> {
        self.finish(|file, path| file.persist_noclobber(path))
    }

    fn finish(
        self,
        persist: impl FnOnce(NamedTempFile, &Path) -> Result<File, tempfile::PersistError>,
    ) -> io::Result<()> {
        match self.file.into_inner().map_err(io::IntoInnerError::into_error)? {
            Target::Through(mut file) => file.flush(),
            Target::Beside(file) => {
                file.as_file().sync_all()?;
                persist(file, &self.path).map_err(|refused| refused.error)?;
                sync_folder_of(&self.path)
            }
        }
    }
}

/// Waits until the disk knows of the files in the folder of `path` by their names: the content of a file that was synced is of no
/// use after a power cut where its name is lost.
///
/// # Errors
/// The folder cannot be read, or its disk fails. A file system that cannot do it is no error.
pub fn sync_folder_of(path: &Path) -> io::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match File::open(folder)?.sync_all() {
        Err(error) if matches!(error.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported) => {
            Ok(())
        }
        done => done,
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Write for Target {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Beside(file) => file.write(bytes),
            Self::Through(file) => file.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Beside(file) => file.flush(),
            Self::Through(file) => file.flush(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::ffi::OsString;

    use super::*;

    #[cfg(unix)]
    #[test]
    fn a_file_that_is_replaced_keeps_its_mode() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("stage.toml");
        std::fs::write(&path, "secret").unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
        let mut file = AtomicFile::create(&path).unwrap();
        file.write_all(b"another").unwrap();
        file.commit().unwrap();
        assert_eq!(path.metadata().unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "another");
    }

    fn names(folder: &Path) -> Vec<OsString> {
        let mut names: Vec<_> = std::fs::read_dir(folder).unwrap().map(|f| f.unwrap().file_name()).collect();
        names.sort();
        names
    }

    #[test]
    fn given_a_commit_the_old_file_is_replaced_and_nothing_else_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        std::fs::write(&path, "old").unwrap();
        let mut file = AtomicFile::create(&path).unwrap();
        file.write_all(b"new").unwrap();
        file.flush().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"old", "until the end the old one stands");
        file.commit().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert_eq!(names(folder.path()), ["a.csv"]);
    }

    #[test]
    fn given_no_commit_nothing_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let mut file = AtomicFile::create(&folder.path().join("a.csv")).unwrap();
        file.write_all(b"half").unwrap();
        drop(file);
        assert!(names(folder.path()).is_empty());
    }

    #[test]
    fn given_two_writers_of_one_name_both_work() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        let (mut one, mut two) = (AtomicFile::create(&path).unwrap(), AtomicFile::create(&path).unwrap());
        one.write_all(b"1").unwrap();
        two.write_all(b"2").unwrap();
        one.commit().unwrap();
        two.commit().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"2");
    }

    #[test]
    fn given_a_file_that_is_there_a_new_one_does_not_replace_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("stage.toml");
        for (text, done) in [("first", true), ("second", false)] {
            let mut file = AtomicFile::create(&path).unwrap();
            file.write_all(text.as_bytes()).unwrap();
            assert_eq!(file.commit_new().is_ok(), done);
        }
        assert_eq!(std::fs::read(&path).unwrap(), b"first");
        assert_eq!(names(folder.path()), ["stage.toml"]);
    }

    #[test]
    fn given_a_device_it_is_written_to_and_stays_one() {
        let mut file = AtomicFile::create(Path::new("/dev/null")).unwrap();
        file.write_all(b"gone").unwrap();
        file.commit().unwrap();
        assert!(!Path::new("/dev/null").metadata().unwrap().is_file());
    }

    #[test]
    fn given_no_folder_or_no_name_it_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        assert!(AtomicFile::create(&folder.path().join("gone/a.csv")).is_err());
        assert!(AtomicFile::create(Path::new("/")).is_err());
    }
}
