//! Whether the frame count and the time of a record can be true: without a checksum this finds most damage to them, and what stands in
//! for a record.

use posed_state::Plain;

use crate::sample::Timestamp;

/// Greatest difference between the unit's clock and the host's that bursts and queues explain, s.
const MOST_APART_S: f64 = 1.0;
/// How far a unit's own rate may be from the nominal one, and what whole milliseconds cut off, ms.
const RATE_ERROR: f64 = 0.25;
const CUT_OFF_MS: f64 = 2.0;

/// Unwrapped counts, and when they came.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub(super) struct Stamp {
    at: Timestamp,
    pub(super) time_ms: u64,
    pub(super) frame: u64,
}

/// What is known of a record's counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Judged {
    /// They go on from the ones before.
    GoesOn(Stamp),
    /// Two in a row fit each other and none before: the unit has begun to count anew.
    Anew(Stamp),
    /// Neither: the record may be damaged.
    Doubtful,
}

/// See the module.
#[derive(Clone, Copy, Debug, Default, Plain)]
pub(super) struct Stamps {
    last: Option<Stamp>,
    doubtful: Option<Stamp>,
}

impl Stamps {
    /// Judges the counts of a record that came at `now`; a frame takes `period_ms`.
    pub(super) fn judge(&mut self, now: Timestamp, time_ms: u32, frame: u32, period_ms: f64) -> Judged {
        let after = |stamp: Stamp| {
            let ms = time_ms.wrapping_sub(stamp.time_ms as u32);
            let frames = frame.wrapping_sub(stamp.frame as u32);
            let due_ms = f64::from(frames) * period_ms;
            let in_step = (f64::from(ms) - due_ms).abs() <= CUT_OFF_MS + RATE_ERROR * due_ms;
            let on_time = (f64::from(ms) * 1e-3 - now.seconds_since(stamp.at)).abs() <= MOST_APART_S;
            let (time_ms, frame) = (stamp.time_ms + u64::from(ms), stamp.frame + u64::from(frames));
            (in_step && on_time && (frames > 0 || ms == 0)).then_some(Stamp { at: now, time_ms, frame })
        };
        if let Some(stamp) = self.last.and_then(after) {
            *self = Self { last: Some(stamp), doubtful: None };
            return Judged::GoesOn(stamp);
        }
        let here = Stamp { at: now, time_ms: time_ms.into(), frame: frame.into() };
        match self.doubtful.replace(here).and_then(after) {
            Some(stamp) => {
                *self = Self { last: Some(stamp), doubtful: None };
                Judged::Anew(stamp)
            }
            None => Judged::Doubtful,
        }
    }
}
