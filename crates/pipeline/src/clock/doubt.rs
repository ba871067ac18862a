//! Whether the count of a cycle can be believed.
//!
//! What comes in: counts with their reads. What goes out: whether a count is believed, doubted, or that of a device that
//! began anew. What it never does: believe a count that speaks of a time after its own read.
//!
//! A damaged packet may hold any count. A cycle cannot have been measured after it was read, nor before the cycle in front of
//! it: a count that says so is wrong, or the device has begun anew. In the second case the counts that follow agree with it.

use posed_drivers::Timestamp;
use posed_state::Plain;

/// A count may be ahead of its read by this once the line is settled, s: more than what a network gains on its fastest read.
const AHEAD_S: f64 = 5e-3;
/// And before, s: the first reads may have been late by so much.
const AHEAD_AT_FIRST_S: f64 = 0.1;
/// So many doubted counts in a row that agree are a device that began anew.
const AGREEING: u32 = 3;
/// Counts agree where they rise as the time of their reads does, to this, s: a host may be late.
const LATE_S: f64 = 0.25;

/// What is thought of a count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Opinion {
    Believed,
    /// It is of the cycle that was doubted before.
    DoubtedAgain,
    Doubted,
    BeganAnew,
}

/// The latest count that was doubted.
#[derive(Clone, Copy, Debug, Plain)]
struct Doubted {
    raw: u64,
    t_read: Timestamp,
    agreeing: u32,
}

/// The counts of one device.
#[derive(Clone, Copy, Debug, Default, Plain)]
pub(super) struct Doubt(Option<Doubted>);

/// One count, and what speaks against it.
pub(super) struct Count {
    pub(super) raw: u64,
    /// The latest one that was believed.
    pub(super) last: u64,
    /// Time of one count, s.
    pub(super) tick_s: f64,
    /// By how much it lies ahead of its read, s.
    pub(super) ahead_s: f64,
    /// Whether the line is settled.
    pub(super) settled: bool,
    pub(super) t_read: Timestamp,
}

impl Doubt {
    pub(super) fn judge(&mut self, count: &Count) -> Opinion {
        let Count { raw, last, tick_s, ahead_s, settled, t_read } = *count;
        if self.0.is_some_and(|doubted| doubted.raw == raw) {
            return Opinion::DoubtedAgain;
        }
        let limit_s = if settled { AHEAD_S } else { AHEAD_AT_FIRST_S };
        if raw >= last && ahead_s <= limit_s {
            self.0 = None;
            return Opinion::Believed;
        }
        let agrees = |before: &Doubted| {
            let counted_s = raw.checked_sub(before.raw).map(|counts| counts as f64 * tick_s);
            counted_s
                .is_some_and(|counted_s| (counted_s - t_read.seconds_since(before.t_read)).abs() < LATE_S)
        };
        let agreeing = self.0.filter(agrees).map_or(1, |before| before.agreeing + 1);
        if agreeing >= AGREEING {
            self.0 = None;
            return Opinion::BeganAnew;
        }
        self.0 = Some(Doubted { raw, t_read, agreeing });
        Opinion::Doubted
    }
}
