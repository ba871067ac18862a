//! Recordings: MCAP files of the input log and, where wanted, of all that follows from it.
//!
//! What comes in: entries, messages and bytes in the order in which the fusion thread saw and made them. What goes
//! out: a file that other programs open, the same entries in the same order, and what a replay of them says. Messages that a
//! file does not hold are made anew from its log ([`Take`]).
//! What it never does: own a thread or a clock, or hide a hole in the log.
//!
//! ```
//! use posed_recording::table::{Imu, TableReader};
//!
//! let text = "t,ax,ay,az,gx,gy,gz\n0.00,0,0,9.80665,0,0,0.1\n0.01,0,0,9.80665,,,\n";
//! let imu = Imu::from_table(TableReader::new("imu.csv", text.as_bytes())?, None)?;
//! assert_eq!(imu.rows.len(), 2);
//! assert_eq!(imu.rows[1].gyro_rad_s, None, "an empty cell is no value");
//! # Ok::<(), posed_recording::table::TableError>(())
//! ```
//!
//! # Layout of a file
//! Profile `posed`. In front, outside of any chunk: the attachments `stage.toml`, `models.msgpack`
//! (models swapped in before), `snapshot/pipeline` and `snapshot/publisher` (state, for a recording begun mid-run),
//! then the metadata record `posed` (version, epoch, names, content). Then chunks with these topics:
//!
//! | topic | encoding | holds |
//! |---|---|---|
//! | `/input/DEVICE/bytes` | raw | a chunk as read |
//! | `/input/DEVICE/line` | MessagePack | a [`LineEvent`](posed_drivers::LineEvent) |
//! | `/input/timer` | empty | a deadline has passed |
//! | `/input/segmentation_network` | bytes | a trained network's file |
//! | `/input/model`, `/input/request`, `/input/truth` | MessagePack | a model in full, what a client asked, ground truth |
//! | `/output/DEVICE/bytes` | raw | what was transmitted |
//! | `/posed/TOPIC` | JSON | a message as the websocket publishes it at the full rate |
//! | `/tf`, `/scene/...`, `/log`, ... | JSON | the same for viewers, see [`posed_protocol::foxglove`]; skipped by our own reader |
//! | `/columns` | MessagePack | what moves and what happens, as columns, for readers without a pipeline, see [`Columns`]; skipped as well |
//! | `/input/log` | bundle | pieces of the topics of `/input` and `/output`, in order |
//!
//! By its content (`[recording] content` of the stage file) a file is one of two kinds. `full` has all of these but the last.
//! `log` has `/input/log` in the place of the topics of the log, which are declared and have no messages of their own, no
//! `/posed/TOPIC`, and of the viewers' channels `/tf` and `/scene` thinned out, and `/log`. A piece of a bundle has a time, its
//! bytes as in the topic, and a place: 0 timer, 1 model, 2 request, 3 network, 4 truth, and for device n 16 + 3 n bytes, and
//! after that line and transmitted; `src/bundle.rs` has the bytes.
//!
//! `log_time` is the epoch in UTC plus the entry's time, to the nanosecond. `sequence` of the input topics is one
//! counter over all of them, of a bundle that of its first entry: file order and counter say the same, and a gap is a hole. The
//! others count by topic.
//! Behind the chunks of one that was ended in order is the attachment `digest.json`: what happens in it, see [`Digester`].
//! The last record is the metadata `posed.end`, whose `reason` states why the recording ended.

pub mod animation;
mod atomic_file;
mod brief;
mod bundle;
mod chunks;
mod columns;
mod compare;
mod digest;
pub mod export;
mod index;
mod info;
mod look;
mod mcap_file;
mod outline;
pub mod raw_poses;
mod reader;
mod records;
mod repair;
mod replay;
mod scribe;
mod sink;
mod summary;
pub mod table;
mod take;
mod thinned;
mod timecode;
mod writer;

mod ending;
mod header;
mod machine;
pub mod movement;
#[cfg(any(test, feature = "testing"))]
pub mod testing;
#[cfg(test)]
mod tests;

pub use atomic_file::{AtomicFile, sync_folder_of};
pub use brief::Brief;
pub use chunks::Chunks;
pub use columns::{Block, Columns};
pub use compare::{Comparison, Difference, Golden, GoldenError, is_replayed};
pub use digest::{Digester, digest_file, keep_digest, make_digest, read_digest};
pub use ending::{Ending, ReadError};
pub use header::{Header, Snapshot};
pub use info::Info;
pub use look::Looker;
pub use machine::{Machine, MachineError};
pub use outline::Outline;
pub use reader::{Item, Message, Reader};
pub use repair::{RepairError, Repaired, repair};
pub use replay::{Mapping, Replayable, Verdict, VerifyError, verify};
pub use scribe::Scribe;
pub use take::Take;
pub use thinned::Thinned;
pub use timecode::{TimecodeInfo, TimecodeTrack};
pub use writer::{WriteError, Writer};

/// Largest chunk that is written, and largest record that a reader believes without having seen a file of that size, bytes.
pub const MAX_RECORD_BYTES: usize = 64 << 20;

/// Largest entry, message or attachment that is written, bytes: the chunk around it fits into a record.
pub const MAX_PIECE_BYTES: usize = MAX_RECORD_BYTES - (2 << 20);

/// Whether a file is named like a recording (`.mcap`, in letters of either case) rather than like a table; the file is not looked
/// at.
pub fn is_recording(path: &std::path::Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("mcap"))
}
