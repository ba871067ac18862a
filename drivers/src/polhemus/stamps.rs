//! Whether the frame count and the time of a record can be true: without a checksum this finds most damage to them, and what stands in
//! for a record. And when a frame was measured: the unit's time is cut to whole milliseconds, a quarter of a Liberty's frame, but the frames that it
//! counts lie evenly within them.

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
    /// The unit's time where its frames lie evenly: within the millisecond that it states, µs.
    pub(super) time_us: f64,
}

/// A time within a millisecond, as near to `time_us` as that allows, µs.
fn within(time_ms: u64, time_us: f64) -> f64 {
    let begin_us = time_ms as f64 * 1e3;
    time_us.clamp(begin_us, begin_us + 999.0)
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
            let time_us = within(time_ms, stamp.time_us + due_ms * 1e3);
            let fits = in_step && on_time && (frames > 0 || ms == 0);
            fits.then_some(Stamp { at: now, time_ms, frame, time_us })
        };
        if let Some(stamp) = self.last.and_then(after) {
            *self = Self { last: Some(stamp), doubtful: None };
            return Judged::GoesOn(stamp);
        }
        let time_us = within(time_ms.into(), f64::from(time_ms) * 1e3 + 500.0);
        let here = Stamp { at: now, time_ms: time_ms.into(), frame: frame.into(), time_us };
        match self.doubtful.replace(here).and_then(after) {
            Some(stamp) => {
                *self = Self { last: Some(stamp), doubtful: None };
                Judged::Anew(stamp)
            }
            None => Judged::Doubtful,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_lie_evenly_within_the_milliseconds_that_the_unit_states() {
        let (mut stamps, mut before, mut steps) = (Stamps::default(), None, Vec::new());
        for frame in 0..600_u32 {
            let true_ms = 17.3 + f64::from(frame) * 1000.0 / 240.0;
            let now = Timestamp::from_secs_f64(true_ms * 1e-3);
            let judged = stamps.judge(now, true_ms as u32, frame, 1000.0 / 240.0);
            let (Judged::GoesOn(stamp) | Judged::Anew(stamp)) = judged else { continue };
            assert_eq!((stamp.time_us / 1e3) as u32, true_ms as u32);
            steps.extend(before.replace(stamp.time_us).map(|before| stamp.time_us - before));
        }
        // Once the milliseconds have shown where in them the frames lie.
        let off_us = steps[24..].iter().map(|step| (step - 1e6 / 240.0).abs()).fold(0.0, f64::max);
        assert!(steps.len() > 590 && off_us < 1.0, "{off_us}");
    }
}
