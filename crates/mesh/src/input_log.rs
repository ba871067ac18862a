//! The newest entries of the input log, numbered, for who fuses them on another machine.
//!
//! In: entries, on the fusion thread. Out: runs of them, for zenoh's thread and for who has missed some. Memory is bounded: who
//! falls further behind than this reaches has to begin anew.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use super::wire::{Bytes, LogChunk};
use posed_stage::input::Entry;

/// Memory for entries: ten seconds of a cut, and far more, of any stage.
const MOST_BYTES: usize = 32 << 20;
/// Entries that are sent together at most, and their bytes.
const CHUNK_ENTRIES: usize = 256;
const CHUNK_BYTES: usize = 1 << 20;

/// The log; clones share it.
#[derive(Clone, Debug)]
pub(crate) struct Log {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    run: i64,
    ring: Mutex<Ring>,
    filled: Condvar,
    /// Whether somebody follows it.
    wanted: AtomicBool,
}

#[derive(Debug, Default)]
struct Ring {
    /// Number of the oldest entry.
    first: u64,
    entries: VecDeque<Vec<u8>>,
    bytes: usize,
    ended: bool,
}

impl Log {
    pub(super) fn new(run: i64) -> Self {
        let (ring, filled) = (Mutex::default(), Condvar::new());
        Self { shared: Arc::new(Shared { run, ring, filled, wanted: AtomicBool::new(false) }) }
    }

    /// Appends an entry.
    fn append(&self, entry: &Entry) {
        // An entry is made of plain maps and numbers: it can be written.
        let bytes = rmp_serde::to_vec_named(entry).unwrap_or_default();
        let mut ring = self.ring();
        ring.bytes += bytes.len();
        ring.entries.push_back(bytes);
        while ring.bytes > MOST_BYTES
            && let Some(oldest) = ring.entries.pop_front()
        {
            ring.bytes -= oldest.len();
            ring.first += 1;
        }
        drop(ring);
        self.shared.filled.notify_one();
    }

    /// Number that the next entry gets.
    pub(super) fn next(&self) -> u64 {
        self.ring().next()
    }

    /// Entries from number `from` on, or from the oldest one if that is newer; waits until there is one and somebody follows.
    /// `None` at the end.
    pub(super) fn wait_from(&self, from: u64) -> Option<LogChunk> {
        let mut ring = self.ring();
        loop {
            if ring.ended {
                return None;
            }
            if ring.next() > from {
                return Some(ring.chunk(from, self.shared.run));
            }
            ring = self.shared.filled.wait(ring).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Entries from number `from` on, none if there are none yet; it begins later if that is no longer kept.
    pub(super) fn from(&self, from: u64) -> LogChunk {
        self.ring().chunk(from, self.shared.run)
    }

    /// Wakes who waits, for the last time.
    pub(super) fn end(&self) {
        self.ring().ended = true;
        self.shared.filled.notify_all();
    }

    pub(super) fn want(&self, wanted: bool) {
        self.shared.wanted.store(wanted, Ordering::Relaxed);
    }

    pub(super) fn is_wanted(&self) -> bool {
        self.shared.wanted.load(Ordering::Relaxed)
    }

    fn ring(&self) -> MutexGuard<'_, Ring> {
        // Every change is complete before anything in it could panic.
        self.shared.ring.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl posed_daemon::Observer for Log {
    fn on_entry(&mut self, entry: &Entry) {
        self.append(entry);
    }
}

impl Ring {
    fn next(&self) -> u64 {
        self.first + self.entries.len() as u64
    }

    fn chunk(&self, from: u64, run: i64) -> LogChunk {
        let first = from.max(self.first);
        let skip = usize::try_from(first - self.first).unwrap_or(usize::MAX);
        let mut bytes = 0;
        let fits = |entry: &&Vec<u8>| {
            let fits = bytes < CHUNK_BYTES;
            bytes += entry.len();
            fits
        };
        let entries = self.entries.iter().skip(skip).take(CHUNK_ENTRIES).take_while(fits);
        LogChunk { run, first, entries: entries.map(|entry| Bytes(entry.clone())).collect() }
    }
}

#[cfg(test)]
mod tests {
    use posed_drivers::Timestamp;

    use super::*;
    use posed_stage::input::Input;

    fn chunk(n: usize, len: usize) -> Entry {
        let input = Input::Bytes { device: 0, bytes: vec![n as u8; len] };
        Entry { t: Timestamp::from_nanos(n as i64), input }
    }

    #[test]
    fn entries_beyond_the_memory_for_them_are_the_oldest_and_the_newest_are_whole() {
        let log = Log::new(7);
        let (count, len) = (40, 1 << 20);
        for n in 0..count {
            log.append(&chunk(n, len));
        }
        let kept = log.ring().entries.len();
        let bytes = log.ring().bytes;
        assert!((MOST_BYTES - 2 * len..=MOST_BYTES).contains(&bytes), "{bytes} bytes");
        assert_eq!(log.next(), count as u64);
        // Who asks for an older one learns it from the number of the first that there is.
        let oldest = log.from(0);
        assert_eq!(oldest.first, (count - kept) as u64);
        for n in count - kept..count {
            let entry = &log.from(n as u64).entries[0].0;
            assert_eq!(rmp_serde::from_slice::<Entry>(entry).unwrap(), chunk(n, len));
        }
    }

    #[test]
    fn it_gives_what_is_requested_and_begins_later_where_that_is_gone() {
        let log = Log::new(7);
        for n in 0..400 {
            log.append(&chunk(n, 10));
        }
        let some = log.from(100);
        assert_eq!((some.run, some.first, some.entries.len()), (7, 100, CHUNK_ENTRIES));
        let read: Entry = rmp_serde::from_slice(&some.entries[5].0).unwrap();
        assert_eq!(read, chunk(105, 10));
        assert_eq!(log.from(400).entries.len(), 0);
        assert_eq!(log.from(9000).entries.len(), 0);
        for n in 0..40 {
            log.append(&chunk(n, 1 << 20));
        }
        let gone = log.wait_from(100).unwrap();
        assert!(gone.first > 400 && gone.first <= 440, "{}", gone.first);
        assert_eq!(gone.entries.len(), 1, "large ones go alone");
        assert_eq!(log.next(), 440);
        log.end();
        assert!(log.wait_from(439).is_none());
    }
}
