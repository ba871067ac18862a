//! Completing a torn or damaged recording.
//!
//! Everything before the break is copied into a new file beside the old one, which takes its name only once it is
//! on the disk: at every moment there is either the old file or the new one.

use std::fs::{File, TryLockError};
use std::io::{self, BufReader, Write};
use std::path::Path;

use mcap::records::MessageHeader;

use super::ending::{Ending, ReadError};
use super::header::METADATA_END;
use super::mcap_file::McapFile;
use super::reader::Reader;
use super::records::{Record, Records};
use super::writer::WriteError;
use crate::atomic_file::AtomicFile;

/// What a repair has done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Repaired {
    /// It was complete; nothing was touched.
    WasComplete,
    /// It is complete now.
    Completed {
        /// Messages of all topics that were saved.
        messages: u64,
    },
}

/// Why a recording could not be repaired; it is as it was.
#[derive(Debug, thiserror::Error)]
pub enum RepairError {
    /// There is nothing to save.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Somebody is writing it: its file is locked.
    #[error("the recording is still being written; stop it first")]
    InUse,
    /// The new file could not be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

impl From<io::Error> for RepairError {
    fn from(error: io::Error) -> Self {
        Self::Write(error.into())
    }
}

/// Completes the recording at `path`, in place: keeps what comes before the first damage, hole or break and gives it an index.
/// `progress` receives the bytes looked at so far.
///
/// # Errors
/// It is no recording, it cannot be read to its end, a newer version wrote it, it is being written, or the folder cannot be
/// written to; it is as it was.
pub fn repair(path: &Path, mut progress: impl FnMut(u64)) -> Result<Repaired, RepairError> {
    let original = File::open(path).map_err(ReadError::Io)?;
    // The recorder holds the lock. A file system without locks does not stop the repair.
    if matches!(original.try_lock(), Err(TryLockError::WouldBlock)) {
        return Err(RepairError::InUse);
    }
    let Some(messages) = broken_after(Reader::open(path)?, &mut progress)? else {
        return Ok(Repaired::WasComplete);
    };
    let bytes = original.metadata().map_err(ReadError::Io)?.len();
    let source = BufReader::new(original);
    let mut file = AtomicFile::create(path)?;
    copy(Records::new(source, bytes), messages, &mut file)?;
    file.commit()?;
    Ok(Repaired::Completed { messages })
}

/// How many messages come before the break; `None` of a complete recording. Only what the bytes themselves show to be wrong is a
/// break: a disk that fails may be read tomorrow, and what a newer version wrote is not known to be wrong.
fn broken_after<R: io::Read>(
    mut reader: Reader<R>,
    progress: &mut impl FnMut(u64),
) -> Result<Option<u64>, ReadError> {
    while let Some(item) = reader.next() {
        progress(reader.bytes_read());
        match item {
            Ok(_) => {}
            Err(ReadError::Corrupt { .. } | ReadError::Hole { .. }) => {
                return Ok(Some(reader.sound_messages()));
            }
            Err(error) => return Err(error),
        }
    }
    Ok((reader.ending() != Some(Ending::Complete)).then(|| reader.sound_messages()))
}

/// Copies records until `messages` messages are over.
fn copy<R: io::Read>(mut records: Records<R>, messages: u64, sink: impl Write) -> Result<(), RepairError> {
    let mut mcap = McapFile::new(sink).map_err(WriteError::from)?;
    let mut copied_messages = 0;
    loop {
        let copied = match records.next() {
            Ok(Some(Record::Message(_))) if copied_messages == messages => break,
            Ok(Some(Record::Message(message))) => {
                copied_messages += 1;
                let header = MessageHeader {
                    channel_id: message.channel.id,
                    sequence: message.sequence,
                    log_time: message.log_time,
                    publish_time: message.publish_time,
                };
                mcap.declare(&message.channel).and_then(|()| mcap.write(&header, &message.data))
            }
            Ok(Some(Record::Attachment(attachment))) => mcap.attach(&attachment),
            // The old end comes back below, behind whatever follows it.
            Ok(Some(Record::Metadata(metadata))) if metadata.name == METADATA_END => Ok(()),
            Ok(Some(Record::Metadata(metadata))) => mcap.write_metadata(&metadata),
            Ok(None) | Err(ReadError::Corrupt { .. }) if copied_messages == messages => break,
            Ok(None) => return Err(ReadError::Io(io::ErrorKind::UnexpectedEof.into()).into()),
            // Fewer than a moment ago: the disk, not the file.
            Err(error) => return Err(error.into()),
        };
        copied.map_err(WriteError::from)?;
    }
    // They say what bundles hold, and have no messages that would bring them along.
    for channel in records.channels().filter(|channel| channel.schema.is_none()) {
        mcap.declare(channel).map_err(WriteError::from)?;
    }
    let reason = "broke off; completed by `posed info --repair`".to_owned();
    let metadata = [("reason".to_owned(), reason)].into();
    mcap.write_metadata(&mcap::records::Metadata { name: METADATA_END.to_owned(), metadata })
        .map_err(WriteError::from)?;
    mcap.finish().map_err(WriteError::from)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;
    use crate::testing::{items, record};

    /// A disk that fails at `at`.
    struct Failing<'a> {
        bytes: &'a [u8],
        at: usize,
    }

    impl Read for Failing<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            if self.at == 0 {
                return Err(io::Error::other("the cable"));
            }
            let end = self.at.min(buffer.len());
            let read = self.bytes.read(&mut buffer[..end])?;
            self.at -= read;
            Ok(read)
        }
    }

    #[test]
    fn a_disk_that_fails_for_a_moment_is_no_damage() {
        let bytes = record(&items(), 6);
        for at in (bytes.len() / 3..bytes.len()).step_by(97) {
            let Ok(reader) = Reader::new(Failing { bytes: &bytes, at }, bytes.len() as u64) else { continue };
            let examined = broken_after(reader, &mut |_| ());
            assert!(matches!(examined, Err(ReadError::Io(_))), "failing at {at}: {examined:?}");
        }
        // The second look sees less than the first.
        for at in (bytes.len() / 3..bytes.len()).step_by(97) {
            let records = Records::new(Failing { bytes: &bytes, at }, bytes.len() as u64);
            assert!(copy(records, 1000, io::sink()).is_err(), "failing at {at}");
        }
        assert!(copy(Records::new(&bytes[..bytes.len() / 2], 0), 1000, io::sink()).is_err());
    }
}
