//! What the reads of a line tell of the bytes in them.
//!
//! What comes in: the arrivals of records, in order. What goes out: the bounds that each sets to the time at
//! which its cycle began. What it never does: look at the model; a bound holds whatever that says.
//!
//! A read shows that its bytes were on the host's side by then, and that they were not at the read before. A
//! host that is late with a read stamps it too late: harmless for the first, but what the adapter keeps for
//! its next burst was there already, so the second must not use the late stamp. The reads before and after
//! show where it should have been, since an adapter delivers at regular times.
//!
//! Whether bytes take their time is another question. On a serial line the n-th byte of a cycle comes n byte
//! times after its first bit; behind a pseudo-terminal or a network all may come at once. Until a read is seen that
//! ends within a record, or the port is known to have a wire, both are possible.

use posed_drivers::{Arrival, Timestamp};
use posed_state::Plain;

/// Intervals of reads of which the middle one is the usual.
const INTERVALS: usize = 31;
/// So many records in two pieces prove a wire; one may be a host that looked in the middle of a copy.
const SPLITS: u32 = 4;
/// Bytes that a UART may keep from the read before: half of the usual buffer.
const HELD_BYTES: f64 = 7.0;

/// What one arrival reports about the time at which cycle `x` was measured; seconds from the clock's origin.
#[derive(Clone, Copy, Debug)]
pub(super) struct Evidence {
    pub(super) x: f64,
    /// Not later than this, wire or not.
    pub(super) upper: f64,
    /// Not later than this, if there is a wire; the same as `upper` once that is known.
    pub(super) paced: f64,
    /// When the cycle began, if nothing but its own earlier bytes had to wait.
    pub(super) prompt: f64,
    /// Not before this.
    pub(super) lower: Option<f64>,
    pub(super) bytes_after: u32,
    /// Nothing of a later cycle was read with it.
    pub(super) alone: bool,
    pub(super) t_read: Timestamp,
}

/// The latest reads, and whether there is a wire.
#[derive(Clone, Debug, Plain)]
pub(super) struct Reads {
    latest: Option<Timestamp>,
    /// The read before the latest one.
    previous: Option<Timestamp>,
    /// The read before [`Arrival::t_previous_read`] of the latest arrival, where a record began in that.
    before_previous: Option<Timestamp>,
    /// Ring of the latest intervals, ns.
    intervals: Vec<i64>,
    next: usize,
    usual_ns: i64,
    splits: u32,
    wire: bool,
    /// Most bytes in front of a record of its cycle, and fewest behind a first byte: together a cycle, if
    /// cycles come whole.
    most_before: u32,
    least_after: u32,
    /// Bytes behind the latest cycle's first record, if that was in the latest read.
    begun_after: Option<u32>,
    /// Fewest bytes from one cycle to the next in one read; 0 before a read held two.
    cycle_bytes: u32,
    #[state(skip)]
    scratch: Vec<i64>,
}

impl Reads {
    pub(super) fn new() -> Self {
        Self {
            latest: None,
            previous: None,
            before_previous: None,
            intervals: Vec::with_capacity(INTERVALS),
            next: 0,
            usual_ns: i64::MAX,
            splits: 0,
            wire: false,
            most_before: 0,
            least_after: u32::MAX,
            begun_after: None,
            cycle_bytes: 0,
            scratch: Vec::with_capacity(INTERVALS),
        }
    }

    /// The port has modem lines: there is a wire behind it.
    pub(super) fn know_wire(&mut self) {
        self.wire = true;
    }

    /// Takes the arrival of a record; returns whether it has shown that there is a wire.
    pub(super) fn push(&mut self, arrival: &Arrival) -> bool {
        if self.latest != Some(arrival.t_read) {
            let follows = self.latest.is_some() && arrival.t_previous_read == self.latest;
            self.before_previous = self.previous.filter(|_| follows);
            self.latest = Some(arrival.t_read);
            self.begun_after = None;
            self.previous = arrival.t_previous_read;
            if let Some(previous) = arrival.t_previous_read {
                self.interval(arrival.t_read.as_nanos().saturating_sub(previous.as_nanos()));
            }
        }
        if arrival.cycle_bytes_before == 0 {
            if let Some(bytes @ 1..) =
                self.begun_after.and_then(|begun| begun.checked_sub(arrival.bytes_after))
            {
                self.cycle_bytes = if self.cycle_bytes == 0 { bytes } else { self.cycle_bytes.min(bytes) };
            }
            self.begun_after = Some(arrival.bytes_after);
        }
        self.most_before = self.most_before.max(arrival.cycle_bytes_before);
        self.least_after = self.least_after.min(arrival.bytes_after);
        self.splits += u32::from(arrival.split && self.splits < SPLITS);
        let shown = !self.wire && self.splits >= SPLITS;
        self.wire |= shown;
        shown
    }

    fn interval(&mut self, interval_ns: i64) {
        if self.intervals.len() < INTERVALS {
            self.intervals.push(interval_ns);
        } else {
            self.intervals[self.next] = interval_ns;
        }
        self.next = (self.next + 1) % INTERVALS;
        self.scratch.clear();
        self.scratch.extend(&self.intervals);
        let middle = self.scratch.len() / 2;
        self.usual_ns = *self.scratch.select_nth_unstable(middle).1;
    }

    /// The bounds that an arrival sets to its cycle `x`; seconds from `origin`.
    pub(super) fn evidence(&self, arrival: &Arrival, origin: Timestamp, x: f64, byte_s: f64) -> Evidence {
        let before = f64::from(arrival.cycle_bytes_before);
        let after = f64::from(arrival.bytes_after);
        let read_s = arrival.t_read.seconds_since(origin);
        let since = |ns: i64| Timestamp::from_nanos(ns).seconds_since(origin);
        // The first byte itself takes its time on the line, after those of the lower addresses.
        let paced = read_s - (before + 1.0 + after) * byte_s;
        let upper = if self.wire { paced } else { read_s - byte_s };
        // An adapter without a wire's pace may have kept the cycle until its last byte was there.
        let whole = f64::from(self.most_before) + f64::from(self.least_after);
        let held = if self.wire { HELD_BYTES } else { HELD_BYTES.max(whole - before) };
        let first_byte = arrival.t_previous_read.map(|previous| {
            let by_next = arrival.t_read.as_nanos().saturating_sub(self.usual_ns);
            let by_last = self.after(self.before_previous);
            since(previous.as_nanos().min(by_next).min(by_last)) - (before + 1.0 + held) * byte_s
        });
        // The byte behind the last one of the read had not come yet.
        let next_byte = arrival.split.then(|| {
            let read = arrival.t_read.as_nanos().min(self.after(arrival.t_previous_read));
            since(read) - (before + 2.0 + after + HELD_BYTES) * byte_s
        });
        let lower =
            first_byte.map_or(next_byte, |first| Some(next_byte.map_or(first, |next| next.max(first))));
        let prompt = read_s - (before + 1.0) * byte_s;
        let alone = before + after < f64::from(self.cycle_bytes);
        let (bytes_after, t_read) = (arrival.bytes_after, arrival.t_read);
        Evidence { x, upper, paced, prompt, lower, bytes_after, alone, t_read }
    }

    /// When the read after one at `t` was due, ns.
    fn after(&self, t: Option<Timestamp>) -> i64 {
        t.map_or(i64::MAX, |t| t.as_nanos().saturating_add(self.usual_ns))
    }
}
