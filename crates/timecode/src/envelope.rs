//! Where a clock that others read late lies on the host's: the line under the soonest of its readings ([`posed_geometry::soonest`]).
//!
//! The clock of radios (`posed_pipeline::clock`) argues alike, but expects tens of milliseconds of delay even in the soonest, and corrects
//! for them: a sound card in the same machine has none.

use posed_geometry::soonest::{Kept, Soonest, Under};
use posed_state::Plain;

/// Blocks that count: a minute follows a crystal that warms up.
const BLOCKS: usize = 120;
/// Time that blocks must span before their drift is believed, s.
const DRIFTS_AFTER_S: f64 = 8.0;
/// What is expected of delays in the soonest readings before any is known, s, and how many blocks that counts as.
const EXPECTED_S: f64 = 1e-3;
const EXPECTED_BLOCKS: f64 = 2.0;
/// What remains unknown with no delay at all, s.
const FLOOR_S: f64 = 5e-5;
/// Readings of so many blocks that are all late by so much are of a clock that has jumped, s.
const LOST_BLOCKS: usize = 8;
const LOST_S: f64 = 5e-3;

/// How far a clock may be off.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub(crate) struct Crystal {
    /// Drift that may be, as a share.
    pub(crate) most: f64,
    /// Drift that is usual, as a standard deviation: what counts before it is measured.
    pub(crate) usual: f64,
    /// How long readings count before the drift is measured, s.
    pub(crate) recent_s: f64,
}

/// The clock of a sound card: crystals are good to 100 ppm.
pub(crate) const SOUND_CARD: Crystal = Crystal { most: 5e-4, usual: 1e-4, recent_s: 3.0 };
/// Time code itself as a clock: it may be slowed down by 0.1 % without saying so.
pub(crate) const CODE: Crystal = Crystal { most: 1.5e-3, usual: 1e-3, recent_s: 1.0 };

/// Host time is the clock's, plus `offset_s` at `at_s`, plus `drift` for each second since.
#[derive(Clone, Copy, Debug, Plain)]
pub(crate) struct Line {
    pub(crate) at_s: f64,
    pub(crate) offset_s: f64,
    pub(crate) drift: f64,
    /// Standard deviations: of the offset, and of the drift.
    pub(crate) sigma_s: f64,
    pub(crate) drift_sigma: f64,
}

impl Line {
    /// Host time at a time of the clock, s.
    pub(crate) fn host_s(&self, clock_s: f64) -> f64 {
        clock_s + self.offset_s + self.drift * (clock_s - self.at_s)
    }
}

/// The line under the readings of one clock.
#[derive(Clone, Debug, Plain)]
pub(crate) struct Envelope {
    crystal: Crystal,
    soonest: Soonest,
    line: Option<Line>,
}

impl Envelope {
    pub(crate) fn new(crystal: Crystal) -> Self {
        Self { crystal, soonest: Soonest::new(BLOCKS), line: None }
    }

    /// Begins anew with another clock.
    pub(crate) fn restart(&mut self, crystal: Crystal) {
        self.crystal = crystal;
        self.soonest.clear();
        self.line = None;
    }

    pub(crate) fn line(&self) -> Option<Line> {
        self.line
    }

    /// How long it has been read, s of the clock.
    pub(crate) fn span_s(&self) -> f64 {
        self.soonest.span_s()
    }

    /// Takes a reading: a time of the clock, and the host's by when it was read. The clock's must rise.
    pub(crate) fn push(&mut self, clock_s: f64, read_by_s: f64) {
        let offset_s = read_by_s - clock_s;
        if self.soonest.begins(clock_s) && self.is_lost() {
            self.soonest.clear();
        }
        let drift = self.line.map_or(0.0, |line| line.drift);
        match self.soonest.keep(clock_s, offset_s, drift) {
            Kept::Late => {}
            Kept::Sooner => self.line = self.fit(Some(drift)),
            Kept::Begun => self.line = self.fit(None),
        }
    }

    /// Whether the latest blocks are all so late that the clock lies elsewhere.
    fn is_lost(&self) -> bool {
        self.line.is_some_and(|line| {
            self.soonest.are_late(LOST_BLOCKS, |at_s, offset_s| at_s + offset_s - line.host_s(at_s) > LOST_S)
        })
    }

    /// The line under the soonest readings, whose drift is found once a block.
    fn fit(&self, drift: Option<f64>) -> Option<Line> {
        let Crystal { most, usual, recent_s } = self.crystal;
        let span_s = self.span_s();
        let knows_drift = span_s >= DRIFTS_AFTER_S;
        let Under { at_s, least_s, drift, count, excess_s } =
            self.soonest.under(drift, knows_drift.then_some(most), recent_s)?;
        let late_s = (excess_s + EXPECTED_BLOCKS * EXPECTED_S) / (count + EXPECTED_BLOCKS);
        let before_drift_s = if knows_drift { 0.0 } else { usual * 0.5 * span_s.min(recent_s) };
        let sigma_s = libm::hypot(libm::hypot(FLOOR_S, 0.5 * late_s), before_drift_s);
        let drift_sigma = if knows_drift { (2.0 * late_s / span_s).min(usual) } else { usual };
        Some(Line { at_s, offset_s: least_s, drift, sigma_s, drift_sigma })
    }
}
