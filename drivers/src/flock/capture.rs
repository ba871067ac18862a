//! Decodes sessions that were recorded elsewhere: for `posed decode flock-of-birds FILE`.
//!
//! What comes in: a whole file, either a two-way log (see [`log`]) or the unit's bytes alone. What goes out:
//! every record of it, and counts. It holds nothing of a live session, and asks nothing.
//!
//! In a two-way log the host's commands are followed: they say which bytes are answers, and what
//! format, button mode, group mode and range each unit had. Without the host's side the records must say it
//! themselves (see [`raw`]).

pub mod follow;
mod judge;
pub mod log;
pub mod raw;

use posed_state::Plain;
use thiserror::Error;

use super::wire::{Format, QuaternionSense, Range, Record};

/// Button bytes that a unit sends.
const BUTTONS: [u8; 4] = [0x00, 0x10, 0x30, 0x70];

/// What the caller knows better than the file. The default knows nothing, and takes quaternions in the vendor's sense.
#[derive(Clone, Copy, Debug, Default, PartialEq, Plain)]
pub struct Options {
    /// Record format of all units in a capture without the host's side; `None`: that which fits most records of each.
    pub format: Option<Format>,
    /// Full scale of positions; `None`: what the session says, else 36 inches.
    pub range: Option<Range>,
    /// Which rotation the quaternions describe; nothing in a file tells it.
    pub quaternion_sense: QuaternionSense,
}

/// One record of a capture, decoded with [`super::wire::Tolerance::CAPTURE`]: poses of a start-up are among them.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct CapturedRecord {
    /// Time of the line with the record's first byte, exactly as written, in the unit of the log; `None` without a log.
    pub t: Option<String>,
    /// Address of the bird; 0 without group mode.
    pub address: u8,
    /// Its format, by the session or guessed: see [`Decoded::warnings`].
    pub format: Format,
    /// Its values: position in the transmitter frame, m; orientation sensor to transmitter.
    pub record: Record,
}

/// What a capture held, counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Plain)]
pub struct Summary {
    /// Records decoded.
    pub records: u64,
    /// Pieces that begin like a record and are none.
    pub rejected: u64,
    /// Bytes of the unit that are neither record nor answer.
    pub bytes_skipped: u64,
    /// Answers to the host's questions; 0 without the host's side.
    pub answers: u64,
}

/// A decoded capture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Decoded {
    /// All records in the order of the file.
    pub records: Vec<CapturedRecord>,
    /// Full scale of the positions at the end of the file; a record has that which held when it came.
    pub range: Range,
    /// Counts.
    pub summary: Summary,
    /// Sentences for the user: what had to be guessed. Empty: nothing.
    pub warnings: Vec<String>,
}

/// Why a file is no capture, in words for the user.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum CaptureError {
    /// There is nothing in it.
    #[error("the file is empty")]
    Empty,
    /// A line of a log cannot be read.
    #[error("line {line}: {problem}")]
    Line {
        /// Number of the line, from 1.
        line: usize,
        /// What is wrong with it.
        problem: String,
    },
    /// A raw capture without a single record.
    #[error(
        "no record of a Flock of Birds in this file; expected pieces that begin at bytes with bit 7 set, 6 to 26 bytes long, or a \
             log with lines `TIME : (LEVEL) N. receive[COUNT] DATA`"
    )]
    NoRecords,
}

/// Decodes a capture; tells a log from raw bytes by itself: a file with one line of a log is a log.
///
/// Records have no checksum. Raw bytes that are no Flock's at all may hold pieces that look like records: see the warnings and
/// the share of [`Summary::bytes_skipped`].
///
/// # Errors
/// An empty file, a broken line of a log, raw bytes without any record.
pub fn decode(file: &[u8], options: Options) -> Result<Decoded, CaptureError> {
    if file.is_empty() {
        return Err(CaptureError::Empty);
    }
    if log::is_log(file) { follow::decode(&log::parse(file)?, options) } else { raw::decode(file, options) }
}
