//! Records that a unit owes: by time alone, for whole cycles that were lost leave no other trace.
//!
//! What comes in: when records arrive. What goes out: how many cycles never will. Bursts of an adapter and a late host hold
//! records back and then give them all at once, so a pause alone proves nothing: lost is what is still owed a moment later.

use std::time::Duration;

use posed_state::Plain;

use crate::sample::Timestamp;

/// What is held back somewhere is here that soon after the pause; several bursts of an adapter fit in, each of which may hold
/// another part of a cycle back.
const SETTLE: Duration = Duration::from_millis(150);
/// Part of a cycle by which the pace may be off meanwhile. A part is held back by bursts, a cycle that is owed as a whole is lost.
const SLACK: f64 = 0.2;
/// Over which the unit's pace is measured: first, to have it soon, and then.
const FIRST_WINDOW_S: f64 = 0.5;
const WINDOW_S: f64 = 2.0;
/// Share by which a window may measure too fast a pace, since bursts shift its ends.
const TOO_FAST: f64 = 0.03;
/// Share by which the pace is forgotten with each window: one with losses must not count for long, a slower unit shall.
const FORGET: f64 = 0.01;

/// See the module.
#[derive(Clone, Copy, Debug, Default, PartialEq, Plain)]
pub(crate) struct Debt {
    last: Option<Timestamp>,
    /// Records per second as measured; `None` until the first window is full. A slow line, or one of text, has less than the
    /// unit's nominal rate.
    pace_hz: Option<f64>,
    /// Where the window began, and its records since.
    window: Option<(Timestamp, u64)>,
    owed: f64,
    /// Until when what is owed may be held back, and the least of it since.
    doubt: Option<(Timestamp, f64)>,
}

impl Debt {
    /// The stream begins anew: nothing is owed, the pace is known.
    pub(crate) fn forgive(&mut self) {
        *self = Self { pace_hz: self.pace_hz, ..Self::default() };
    }

    /// A record came, and `passed` others before it are known to be lost; `nominal_hz` is the most that the unit sends, all
    /// `stations` together. Returns the cycles that are lost besides.
    pub(crate) fn record(&mut self, now: Timestamp, passed: u64, stations: usize, nominal_hz: f64) -> u64 {
        let elapsed_s = self.last.replace(now).map_or(0.0, |last| now.seconds_since(last));
        self.measure_pace(now, 1 + passed, nominal_hz);
        let Some(pace_hz) = self.pace_hz else { return 0 };
        let due = elapsed_s * pace_hz;
        // Of a pause none is forgiven: it may be what is looked for.
        let forgiven = if self.doubt.is_none() { TOO_FAST * due.min(1.0) } else { 0.0 };
        self.owed = (self.owed + due - forgiven - (1 + passed) as f64).max(0.0);
        self.settle(now, stations as f64)
    }

    fn measure_pace(&mut self, now: Timestamp, records: u64, nominal_hz: f64) {
        let (began, before) = *self.window.get_or_insert((now, 0));
        let elapsed_s = now.seconds_since(began);
        let least_s = if self.pace_hz.is_some() { WINDOW_S } else { FIRST_WINDOW_S };
        if elapsed_s < least_s {
            // The first record ends the period before the window.
            let records = if began == now && before == 0 { 0 } else { records };
            self.window = Some((began, before + records));
            return;
        }
        let measured_hz = (before + records) as f64 / elapsed_s;
        let known_hz = self.pace_hz.unwrap_or(0.0) * (1.0 - FORGET);
        self.pace_hz = Some(measured_hz.max(known_hz).min(nominal_hz));
        self.window = Some((now, 0));
    }

    fn settle(&mut self, now: Timestamp, stations: f64) -> u64 {
        match self.doubt {
            None if self.owed > 0.5 * stations => self.doubt = Some((now + SETTLE, self.owed)),
            None => {}
            Some((until, least)) if now < until => self.doubt = Some((until, least.min(self.owed))),
            Some((_, least)) => {
                self.doubt = None;
                let cycles = (least.min(self.owed) / stations + SLACK).floor();
                self.owed = (self.owed - cycles * stations).max(0.0);
                return cycles as u64;
            }
        }
        0
    }
}
