//! Which read delivered which byte, and how many cycles bytes are that none delivered whole.
//!
//! What comes in: reads, by stamp and length. What goes out: the [`Arrival`] of the record that begins at
//! a given place of the stream. It never looks at the bytes.

use std::collections::VecDeque;

use posed_state::Plain;

use crate::sample::{Arrival, Timestamp};

/// Reads that are kept; a record that spans more of them gets the oldest one's stamp.
const KEPT: usize = 4096;

#[derive(Clone, Copy, Debug, Plain)]
struct Read {
    /// Place in the stream of the first byte.
    start: u64,
    t_read: Timestamp,
    t_previous_read: Option<Timestamp>,
}

/// The reads that may still hold the first byte of a record.
#[derive(Clone, Debug, Default, Plain)]
pub(crate) struct Arrivals {
    reads: VecDeque<Read>,
    end: u64,
}

impl Arrivals {
    /// Forgets all reads: the port was opened anew. Places in the stream go on.
    pub(crate) fn reopen(&mut self) {
        self.reads.clear();
    }

    /// Notes that `len` bytes were read at `now`.
    pub(crate) fn read(&mut self, now: Timestamp, len: usize) {
        if len == 0 {
            return;
        }
        let t_previous_read = self.reads.back().map(|read| read.t_read);
        if self.reads.len() == KEPT {
            self.reads.pop_front();
        }
        self.reads.push_back(Read { start: self.end, t_read: now, t_previous_read });
        self.end += len as u64;
    }

    /// Arrival of the record whose first byte is at `offset`; reads before it are forgotten.
    ///
    /// Places must not go back. `None` before any read.
    pub(crate) fn of(&mut self, offset: u64) -> Option<Arrival> {
        while self.reads.len() > 1 && self.reads[1].start <= offset {
            self.reads.pop_front();
        }
        let read = self.reads.front()?;
        let read_end = self.reads.get(1).map_or(self.end, |next| next.start);
        Some(Arrival {
            t_read: read.t_read,
            t_previous_read: read.t_previous_read,
            bytes_after: read_end.saturating_sub(offset + 1).min(u32::MAX.into()) as u32,
            cycle_bytes_before: 0,
            split: false,
            after_loss: false,
        })
    }
}

/// Whole cycles, of `cycle_len` bytes, that are nearest to what damaged bytes leave beside those of a `part` of a cycle.
pub(crate) fn whole_cycles(damaged: u64, part: u64, cycle_len: u64) -> u64 {
    damaged.saturating_sub(part).saturating_add(cycle_len / 2) / cycle_len
}

/// Whether cycles may be missing that damaged bytes do not show: they are not as many as the `passed_bytes` of the records that were
/// passed over, or they are more than those of one record, `len`. What is left of several that lost bytes is as long as a whole number of
/// them by chance.
pub(crate) fn hides_losses(damaged: u64, passed_bytes: u64, len: u64) -> bool {
    damaged > 0 && (damaged != passed_bytes || damaged > len)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_stamped_by_the_read_of_its_first_byte() {
        let t = Timestamp::from_nanos;
        let mut arrivals = Arrivals::default();
        assert_eq!(arrivals.of(0), None);
        arrivals.read(t(10), 4);
        arrivals.read(t(20), 0);
        arrivals.read(t(30), 6);
        let first = arrivals.of(1).unwrap();
        assert_eq!((first.t_read, first.t_previous_read, first.bytes_after), (t(10), None, 2));
        let second = arrivals.of(4).unwrap();
        assert_eq!((second.t_read, second.t_previous_read, second.bytes_after), (t(30), Some(t(10)), 5));
    }
}
