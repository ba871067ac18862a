//! How the reading of a recording ends: at its end, where it breaks off, or at what cannot be read.

use std::io;

use super::machine::MachineError;

/// How a recording ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// With its index, as it should.
    Complete,
    /// In the middle: the program or the computer was stopped.
    Torn,
}

/// Why a recording cannot be read, or not further.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The system said no.
    #[error("cannot read the recording: {0}")]
    Io(#[from] io::Error),
    /// It is something else, or was cut before its front part was complete.
    #[error("this is no recording of posed: {0}")]
    NotARecording(String),
    /// Bytes have changed since they were written.
    #[error(
        "the recording is damaged before byte {before_byte}: {reason}; `posed info --repair` saves what comes before"
    )]
    Corrupt {
        /// The damage lies before this offset in the file.
        before_byte: u64,
        /// What does not fit.
        reason: String,
    },
    /// What was written is sound, and this version cannot read it: to cut it there would lose data.
    #[error(
        "the recording holds what this version of posed does not know: {0}; open it with a newer version"
    )]
    Newer(String),
    /// Who asked for it wants it no more.
    #[error("it was cancelled")]
    Cancelled,
    /// Its messages cannot be made anew from its log.
    #[error(transparent)]
    Machine(#[from] MachineError),
    /// Entries of the input log are missing; a replay would not say the same.
    #[error("the recording has a hole: entry {expected} is followed by entry {found}")]
    Hole {
        /// Number of the first entry missed.
        expected: u32,
        /// Number found in its place.
        found: u32,
    },
}
