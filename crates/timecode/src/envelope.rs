//! Where a clock that others read late lies on the host's: a line under the times of its readings.
//!
//! Nothing is read before it was sent, and most of it soon after: of each half second the soonest reading counts, and the line that
//! lies under all of them, as high as it can, is the clock. The clock of radios (`posed_pipeline::clock`) argues alike, but expects
//! tens of milliseconds of delay even in the soonest, and corrects for them: a sound card in the same machine has none.

use posed_state::Plain;

/// How long the soonest reading of a block is looked for, s, and how many blocks count: a minute follows a crystal that warms up.
const BLOCK_S: f64 = 0.5;
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

#[derive(Clone, Copy, Debug, Plain)]
struct Block {
    begun_s: f64,
    soonest_s: f64,
    offset_s: f64,
}

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
    blocks: Vec<Block>,
    line: Option<Line>,
}

impl Envelope {
    pub(crate) fn new(crystal: Crystal) -> Self {
        Self { crystal, blocks: Vec::with_capacity(BLOCKS), line: None }
    }

    /// Begins anew with another clock.
    pub(crate) fn restart(&mut self, crystal: Crystal) {
        self.crystal = crystal;
        self.blocks.clear();
        self.line = None;
    }

    pub(crate) fn line(&self) -> Option<Line> {
        self.line
    }

    /// How long it has been read, s of the clock.
    pub(crate) fn span_s(&self) -> f64 {
        self.blocks
            .first()
            .zip(self.blocks.last())
            .map_or(0.0, |(first, last)| last.soonest_s - first.soonest_s)
    }

    /// Takes a reading: a time of the clock, and the host's by when it was read. The clock's must rise.
    pub(crate) fn push(&mut self, clock_s: f64, read_by_s: f64) {
        let offset_s = read_by_s - clock_s;
        match self.blocks.last_mut().filter(|block| clock_s - block.begun_s < BLOCK_S) {
            Some(block) => {
                let drift = self.line.map_or(0.0, |line| line.drift);
                if offset_s - drift * clock_s < block.offset_s - drift * block.soonest_s {
                    (block.soonest_s, block.offset_s) = (clock_s, offset_s);
                    self.line = self.fit(Some(drift));
                }
            }
            None => {
                if self.is_lost() {
                    self.blocks.clear();
                }
                if self.blocks.len() == BLOCKS {
                    self.blocks.remove(0);
                }
                self.blocks.push(Block { begun_s: clock_s, soonest_s: clock_s, offset_s });
                self.line = self.fit(None);
            }
        }
    }

    /// Whether the latest blocks are all so late that the clock lies elsewhere.
    fn is_lost(&self) -> bool {
        let Some(line) = self.line.filter(|_| self.blocks.len() > LOST_BLOCKS) else { return false };
        let late = |block: &Block| block.soonest_s + block.offset_s - line.host_s(block.soonest_s) > LOST_S;
        self.blocks.iter().rev().take(LOST_BLOCKS).all(late)
    }

    /// Of all lines that no block lies under, the one that is highest in the middle of their time. The drift is found once a block.
    fn fit(&self, drift: Option<f64>) -> Option<Line> {
        let Crystal { most, usual, recent_s } = self.crystal;
        let at_s = self.blocks.last()?.soonest_s;
        let span_s = self.span_s();
        let knows_drift = span_s >= DRIFTS_AFTER_S;
        let blocks = || self.blocks.iter().filter(|block| knows_drift || at_s - block.soonest_s <= recent_s);
        let offset_s = |block: &Block, drift: f64| block.offset_s + drift * (at_s - block.soonest_s);
        let under = |drift: f64| blocks().map(|block| offset_s(block, drift)).fold(f64::INFINITY, f64::min);
        let drift = drift.filter(|_| knows_drift).unwrap_or_else(|| {
            if !knows_drift {
                return 0.0;
            }
            // The height in the middle is a concave function of the drift: a search in thirds finds its top.
            let height = |drift: f64| under(drift) - drift * 0.5 * span_s;
            let (mut low, mut high) = (-most, most);
            for _ in 0..40 {
                let third = (high - low) / 3.0;
                if height(low + third) < height(high - third) {
                    low += third;
                } else {
                    high -= third;
                }
            }
            0.5 * (low + high)
        });
        let least_s = under(drift);
        let count = blocks().count() as f64;
        let excess_s = blocks().map(|block| offset_s(block, drift) - least_s).sum::<f64>();
        let late_s = (excess_s + EXPECTED_BLOCKS * EXPECTED_S) / (count + EXPECTED_BLOCKS);
        let before_drift_s = if knows_drift { 0.0 } else { usual * 0.5 * span_s.min(recent_s) };
        let sigma_s = libm::hypot(libm::hypot(FLOOR_S, 0.5 * late_s), before_drift_s);
        let drift_sigma = if knows_drift { (2.0 * late_s / span_s).min(usual) } else { usual };
        Some(Line { at_s, offset_s: least_s, drift, sigma_s, drift_sigma })
    }
}
