//! `replay.track`: a few channels of a whole recording, thinned out, so that runs can be overlaid.
//!
//! In: a recording of the daemon's one folder. Out: the answer, when it is read, from a thread of its own. One recording is read at a time, and
//! never more of it kept than twice what is answered.

use std::path::Path;
use std::sync::{Mutex, TryLockError};

use super::recordings;
use super::server::Reply;
use posed_protocol::{Answer, Tracked};
use posed_recording::Thinned;
use posed_recording::table::{RecordedStreams, TableError};

/// Rows that are answered at most.
const ROWS: usize = 2000;
/// Channels at a time.
const COLUMNS: usize = 6;

/// Held by who reads one.
static READING: Mutex<()> = Mutex::new(());

/// Reads `columns` of the recording `name` in `folder` and answers; without columns, which ones there are.
pub(super) fn answer(folder: &Path, name: &str, columns: Vec<String>, reply: Reply) {
    if columns.len() > COLUMNS {
        return reply.error("bad_request", format!("columns: give {COLUMNS} at most"));
    }
    let path = match recordings::find(folder, name) {
        Ok(path) => path,
        Err(error) => return reply.refuse(error.into()),
    };
    #[expect(clippy::disallowed_methods, reason = "a long recording keeps nobody waiting but who asked")]
    let thread = std::thread::Builder::new().name("track".into()).spawn(move || {
        let alone = match READING.try_lock() {
            Ok(alone) => alone,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => {
                return reply.error("busy", "another recording is being read; ask again in a moment");
            }
        };
        let read = if columns.is_empty() { names(&path) } else { track(&path, &columns) };
        // Who has this answer may ask for the next one at once.
        drop(alone);
        match read {
            Ok(answer) => reply.ok(Some(Answer::Tracked(answer))),
            Err(error) => reply.error("failed", error.to_string()),
        }
    });
    if let Err(error) = thread {
        tracing::error!("the system gives no thread: {error}");
    }
}

fn names(path: &Path) -> Result<Tracked, TableError> {
    Ok(Tracked::Channels { columns: RecordedStreams::open(path, None)?.columns().to_vec() })
}

fn track(path: &Path, columns: &[String]) -> Result<Tracked, TableError> {
    let mut recording = RecordedStreams::open(path, None)?;
    let indices: Vec<Option<usize>> =
        columns.iter().map(|column| recording.columns().iter().position(|known| known == column)).collect();
    let mut thinned = Thinned::new(ROWS);
    while let Some(t_s) = recording.next_row()? {
        let row = || indices.iter().map(|index| *recording.row().get((*index)?)?).collect();
        thinned.push(|| (t_s, row()));
    }
    let (t_s, values): (Vec<f64>, Vec<Vec<Option<f64>>>) = thinned.into_kept().into_iter().unzip();
    // A channel that the recording does not have is empty, so that recordings of different stages can be compared.
    Ok(Tracked::Rows { t_s, values })
}
