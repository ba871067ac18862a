//! A clock whose readings come late, now more, now less: the soonest of them, and the line under them.
//!
//! What comes in: times of the clock, and by how much the host's time of the reading is ahead of each. What goes out: the line that lies under
//! all readings, as high as it can. Nothing is read before it was sent, so the soonest say where the clock lies, and the rest says how rare
//! they are. What it never does: judge how late even the soonest are; that is the business of who knows the way that they took.

use posed_state::Plain;

/// How long the soonest reading of a block is looked for, s.
pub const BLOCK_S: f64 = 0.5;

/// The soonest reading of some time.
#[derive(Clone, Copy, Debug, Plain)]
struct Block {
    /// Time of the clock at which it began.
    begun_s: f64,
    /// Time of the clock of the soonest, and host time less that.
    soonest_s: f64,
    offset_s: f64,
}

/// What a reading changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kept {
    /// Nothing: a sooner one of its block is known.
    Late,
    /// It is the soonest of its block.
    Sooner,
    /// It begins a block.
    Begun,
}

/// The soonest readings of the latest blocks. It allocates nothing per reading.
#[derive(Clone, Debug, Plain)]
pub struct Soonest {
    most: usize,
    blocks: Vec<Block>,
}

/// The line under the readings: the offset is `least_s` at the clock's time `at_s`, and grows by `drift` each second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Under {
    /// Time of the clock of the latest block's soonest, s.
    pub at_s: f64,
    /// Offset there, s.
    pub least_s: f64,
    /// Change of the offset per second.
    pub drift: f64,
    /// Blocks that count.
    pub count: f64,
    /// How far they lie above the line, s, in sum.
    pub excess_s: f64,
}

impl Soonest {
    /// None yet; the latest `most` blocks are kept, at least one.
    pub fn new(most: usize) -> Self {
        Self { most, blocks: Vec::with_capacity(most) }
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.blocks.clear();
    }

    /// Number of blocks.
    pub fn blocks(&self) -> usize {
        self.blocks.len()
    }

    /// From the first block's soonest to the last one's, s of the clock.
    pub fn span_s(&self) -> f64 {
        let ends = self.blocks.first().zip(self.blocks.last());
        ends.map_or(0.0, |(first, last)| last.soonest_s - first.soonest_s)
    }

    /// Whether a reading at this time of the clock begins a block.
    pub fn begins(&self, clock_s: f64) -> bool {
        self.blocks.last().is_none_or(|block| clock_s - block.begun_s >= BLOCK_S)
    }

    /// Takes a reading; the clock's times must rise. Of a block that one is the soonest which lies lowest over a line with this `drift`.
    pub fn keep(&mut self, clock_s: f64, offset_s: f64, drift: f64) -> Kept {
        if self.begins(clock_s) {
            if self.blocks.len() == self.most {
                self.blocks.remove(0);
            }
            self.blocks.push(Block { begun_s: clock_s, soonest_s: clock_s, offset_s });
            return Kept::Begun;
        }
        match self.blocks.last_mut() {
            Some(block) if offset_s - drift * clock_s < block.offset_s - drift * block.soonest_s => {
                (block.soonest_s, block.offset_s) = (clock_s, offset_s);
                Kept::Sooner
            }
            _ => Kept::Late,
        }
    }

    /// Whether there are more than `count` blocks, and the soonest of the latest `count` are all late, by their clock's time and offset.
    pub fn are_late(&self, count: usize, late: impl Fn(f64, f64) -> bool) -> bool {
        let mut latest = self.blocks.iter().rev().take(count);
        self.blocks.len() > count && latest.all(|block| late(block.soonest_s, block.offset_s))
    }

    /// Of all lines that no block lies under, the one that is highest in the middle of their time; `None` before the first block.
    ///
    /// `most_drift` is the largest drift that can be; `None` where none can be known yet: then it is 0, and only blocks of the latest `recent_s`
    /// count. A `drift` that was found before is kept, for a search costs forty looks at every block.
    pub fn under(&self, drift: Option<f64>, most_drift: Option<f64>, recent_s: f64) -> Option<Under> {
        let at_s = self.blocks.last()?.soonest_s;
        let span_s = self.span_s();
        let is_recent = |block: &&Block| most_drift.is_some() || at_s - block.soonest_s <= recent_s;
        let blocks = || self.blocks.iter().filter(is_recent);
        let offset_s = |block: &Block, drift: f64| block.offset_s + drift * (at_s - block.soonest_s);
        let under = |drift: f64| blocks().map(|block| offset_s(block, drift)).fold(f64::INFINITY, f64::min);
        let searched = |most: f64| {
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
        };
        let drift = most_drift.map_or(0.0, |most| drift.unwrap_or_else(|| searched(most)));
        let least_s = under(drift);
        let excess_s = blocks().map(|block| offset_s(block, drift) - least_s).sum();
        Some(Under { at_s, least_s, drift, count: blocks().count() as f64, excess_s })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Readings 50 times a second of a clock with this drift, of which one in ten is not late.
    fn readings(drift: f64, seconds: u32) -> Soonest {
        let mut soonest = Soonest::new(64);
        for n in 0..50 * seconds {
            let clock_s = f64::from(n) * 0.02;
            let late_s = f64::from(n % 10) * 0.01;
            soonest.keep(clock_s, 3.0 + drift * clock_s + late_s, 0.0);
        }
        soonest
    }

    #[test]
    fn the_line_lies_under_the_soonest_at_the_clocks_drift() {
        for drift in [-2e-4, 0.0, 1e-4] {
            let soonest = readings(drift, 20);
            let under = soonest.under(None, Some(5e-4), 5.0).unwrap();
            assert!((under.drift - drift).abs() < 1e-6, "{under:?}");
            assert!((under.least_s - 3.0 - drift * under.at_s).abs() < 1e-5, "{under:?}");
            assert_eq!((under.count, soonest.blocks()), (40.0, 40));
            assert!(under.excess_s < 1e-4, "{under:?}");
            // What was found is kept; what cannot be known is not believed.
            assert_eq!(soonest.under(Some(under.drift), Some(5e-4), 5.0), Some(under));
            let early = soonest.under(Some(1.0), None, 5.1).unwrap();
            assert_eq!((early.drift, early.count), (0.0, 11.0));
        }
        assert_eq!(Soonest::new(1).under(None, None, 1.0), None);
    }

    #[test]
    fn the_oldest_block_goes_and_blocks_that_are_all_late_are_seen() {
        let mut soonest = readings(0.0, 40);
        assert_eq!(soonest.blocks(), 64);
        assert!((soonest.span_s() - 31.6).abs() < 1e-9);
        let is_late = |_: f64, offset_s: f64| offset_s > 3.5;
        assert!(!soonest.are_late(8, is_late));
        for n in 0..8 {
            assert!(soonest.begins(40.0 + f64::from(n)));
            assert_eq!(soonest.keep(40.0 + f64::from(n), 4.0, 0.0), Kept::Begun);
            assert_eq!(soonest.keep(40.1 + f64::from(n), 4.1, 0.0), Kept::Late);
            assert_eq!(soonest.keep(40.2 + f64::from(n), 3.9, 0.0), Kept::Sooner);
        }
        assert!(soonest.are_late(8, is_late) && !soonest.are_late(9, is_late));
        soonest.clear();
        assert!(!soonest.are_late(0, is_late));
    }
}
