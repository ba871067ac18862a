//! `replay.track`: a few channels of a whole recording, thinned out, so that runs can be overlaid.
//!
//! In: a recording of the daemon's one folder. Out: the answer, when it is read, from a thread of its own. One recording is read at a time, and
//! never more of it kept than twice what is answered.

use std::path::Path;
use std::sync::{Mutex, TryLockError};

use super::recordings;
use super::server::Reply;
use posed_protocol::{Answer, Tracked};
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
        thinned.push(t_s, indices.iter().map(|index| *recording.row().get((*index)?)?));
    }
    let (t_s, values): (Vec<f64>, Vec<Vec<Option<f64>>>) = thinned.rows.into_iter().unzip();
    // A channel that the recording does not have is empty, so that recordings of different stages can be compared.
    Ok(Tracked::Rows { t_s, values })
}

/// Evenly chosen rows of a stream whose length nobody knows: every k-th, with k doubled when there are too many.
struct Thinned {
    most: usize,
    every: usize,
    seen: usize,
    rows: Vec<(f64, Vec<Option<f64>>)>,
}

impl Thinned {
    fn new(most: usize) -> Self {
        Self { most, every: 1, seen: 0, rows: Vec::new() }
    }

    fn push(&mut self, t_s: f64, row: impl Iterator<Item = Option<f64>>) {
        if self.seen.is_multiple_of(self.every) {
            if self.rows.len() == self.most {
                let mut at = 0;
                self.rows.retain(|_| {
                    at += 1;
                    at % 2 == 1
                });
                self.every *= 2;
            }
            if self.seen.is_multiple_of(self.every) {
                self.rows.push((t_s, row.collect()));
            }
        }
        self.seen += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_is_evenly_spread_and_never_too_much() {
        for length in [0, 1, 9, 10, 11, 20, 21, 1000] {
            let mut thinned = Thinned::new(10);
            for k in 0..length {
                thinned.push(k as f64, std::iter::once(Some(k as f64)));
                assert!(thinned.rows.len() <= 10);
            }
            let steps: Vec<f64> = thinned.rows.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
            assert!(steps.windows(2).all(|pair| pair[0] == pair[1]), "{length}: {steps:?}");
            assert!(thinned.rows.len() >= length.min(5), "{length}");
        }
    }
}
