//! Fusion of a stage on this machine, from its input log: the same pipeline, the same entries, the same messages.
//!
//! In: where the stage's pipeline stood, and every entry after that, in order. Out: items with the stamps that they get at the stage
//! too. A thread of its own, as at the stage. What comes out of order is asked for again; nothing is left out.

use std::thread::JoinHandle;

use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use tokio::sync::mpsc;

use crate::wire::{Begin, Bytes, LogChunk};
use posed_daemon::server::{Incoming, Item};
use posed_protocol::{Payload, Selection, unpack};
use posed_recording::Machine;
use posed_stage::input::Entry;
use posed_stage::output::Output;

/// Entries that wait for the thread; more are asked for again.
const ENTRIES: usize = 1 << 14;

/// A stage that is being fused; ends when dropped.
pub(super) struct Fuser {
    /// Number of the next entry.
    next: u64,
    entries: Option<Sender<Bytes>>,
    thread: Option<JoinHandle<()>>,
}

/// What came of a run of entries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Taken {
    /// All of it was taken, or known already.
    All,
    /// Entries before it are missing, from this number on.
    Missing(u64),
}

impl Fuser {
    /// Goes on where the stage stood; gives the newest event up to there too.
    pub(super) fn start(begin: &Begin, items: mpsc::Sender<Incoming>) -> Result<(Self, u64), String> {
        let (_, machine) = Machine::as_recorded(&begin.header).map_err(|error| error.to_string())?;
        let last_event_id = machine.publisher.last_event_id();
        let (entries, taken) = bounded(ENTRIES);
        #[expect(clippy::disallowed_methods, reason = "the hub owns the threads that fuse")]
        let thread = std::thread::Builder::new()
            .name("fusion".to_owned())
            .spawn(move || run(machine, &taken, &items))
            .map_err(|error| format!("the system gives no thread for fusion: {error}"))?;
        Ok((Self { next: begin.next, entries: Some(entries), thread: Some(thread) }, last_event_id))
    }

    /// Number of the next entry that it needs.
    pub(super) fn next(&self) -> u64 {
        self.next
    }

    /// Takes a run of entries.
    pub(super) fn take(&mut self, chunk: LogChunk) -> Taken {
        if chunk.first > self.next {
            return Taken::Missing(self.next);
        }
        let known = usize::try_from(self.next - chunk.first).unwrap_or(usize::MAX);
        for entry in chunk.entries.into_iter().skip(known) {
            // Full: what follows is asked for again, once there is room.
            if let Some(entries) = &self.entries
                && let Err(TrySendError::Full(_)) = entries.try_send(entry)
            {
                return Taken::Missing(self.next);
            }
            self.next += 1;
        }
        Taken::All
    }
}

impl Drop for Fuser {
    fn drop(&mut self) {
        self.entries = None;
        // It ends by itself: its clients may be gone, and nobody waits for it.
        drop(self.thread.take());
    }
}

/// The thread: until no more entries can come, or nobody takes what is said.
fn run(mut machine: Machine, taken: &Receiver<Bytes>, items: &mpsc::Sender<Incoming>) {
    for Bytes(bytes) in taken {
        let entry: Entry = match unpack(&bytes) {
            Ok(entry) => entry,
            Err(error) => {
                // To go on without it would be a silent wrong pose.
                tracing::error!("an entry of the input log cannot be read, fusion ends: {error}");
                return;
            }
        };
        let mut gone = false;
        let Machine { pipeline, publisher } = &mut machine;
        pipeline.push(&entry, &mut |output| {
            let Some(payload) = Payload::of(&output) else { return };
            let stamp = publisher.skip(&payload);
            if let Some(item) = owned(&output) {
                gone |= items.blocking_send(Incoming { item, stamp, held: Selection::whole() }).is_err();
            }
        });
        if gone {
            return;
        }
    }
}

fn owned(output: &Output<'_>) -> Option<Item> {
    Some(match output {
        Output::Estimate(estimate) => Item::Estimate((*estimate).clone()),
        Output::Body(body) => Item::Body(Box::new((*body).clone())),
        Output::Truth(truth) => Item::Truth(Box::new((*truth).clone())),
        Output::Outcome(outcome) => Item::Outcome(Box::new((*outcome).clone())),
        Output::Timecode(timecode) => Item::Timecode(**timecode),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chunk(first: usize, until: usize) -> LogChunk {
        let entries = (first..until).map(|n| Bytes(n.to_le_bytes().to_vec())).collect();
        LogChunk { run: 0, first: first as u64, entries }
    }

    #[test]
    fn entries_beyond_those_that_may_wait_are_asked_for_again_and_none_is_left_out_or_doubled() {
        let (entries_in, entries) = bounded(ENTRIES);
        let (all, past) = (ENTRIES + 300, ENTRIES as u64);
        let mut fuser = Fuser { next: 0, entries: Some(entries_in), thread: None };
        assert_eq!(fuser.take(chunk(0, all)), Taken::Missing(past));
        // Nor does a later run of them go past those that are missing.
        assert_eq!(fuser.take(chunk(all, all + 10)), Taken::Missing(past));
        let mut fused: Vec<Vec<u8>> = entries.try_iter().map(|Bytes(bytes)| bytes).collect();
        assert_eq!(fuser.take(chunk(ENTRIES - 5, all)), Taken::All);
        assert_eq!(fuser.next(), all as u64);
        fused.extend(entries.try_iter().map(|Bytes(bytes)| bytes));
        assert!(fused.into_iter().eq((0..all).map(|n| n.to_le_bytes().to_vec())));
    }
}
