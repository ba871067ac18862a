//! The stuck test: the one detector of repeated samples.
//!
//! What comes in: the words of one device, sample by sample as it sent them, and what speaks for that they should have
//! changed ([`Evidence`]). What goes out: [`Repeats`]. What it never does: compare with a tolerance, or look at the clock.
//!
//! Repetition alone is no fault. The noise of an IMU changes its words at all times, so that one that repeats them is stuck.
//! A magnetic sensor hardly ever repeats itself either, but near the transmitter its noise is below the words' step, and at
//! rest it may send the same for minutes. That is a fault where the words should have changed: because the sensor itself
//! moved, or because others move and this one's words used to change.

use posed_state::Plain;

/// Weight of one sample in the habit of changing, and the habit from which on repetition is unusual; both without unit.
const HABIT_WEIGHT: f64 = 1.0 / 64.0;
const CHANGING: f64 = 0.5;

/// What a device sends in one sample, and how often it may repeat it.
pub trait Words: Copy + PartialEq {
    /// So many equal samples in a row, the first included, are stuck where the words should have changed.
    const STUCK_SAMPLES: u32;
}

/// A position of a magnetic sensor (x, y, z), m.
impl Words for [f64; 3] {
    const STUCK_SAMPLES: u32 = 5;
}

/// What speaks for that a sample should differ from the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Evidence {
    /// Nothing: what rests may repeat itself.
    None,
    /// Nothing, but nobody saw it come to rest: that it repeats itself becomes no habit.
    Unseen,
    /// Other sensors move: it counts against a sensor whose words usually change.
    OthersMove,
    /// The sensor itself has moved, or its noise changes its words at all times.
    Certain,
}

/// How a sample stands to those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Repeats {
    /// It is the first, or differs from the one before.
    Changed,
    /// It is the same, and nothing says that it should not be.
    Rests,
    /// It is the same and should not be, but is so not yet for [`Words::STUCK_SAMPLES`].
    Suspect,
    /// It is the same again and again, and should not be.
    Stuck,
}

/// The samples of one device.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Repetition<W> {
    last: Option<W>,
    /// Equal samples in a row, the latest included.
    run: u32,
    /// Share of samples that differed from the one before; starts at one: presumed to change.
    habit: f64,
    /// The words should have changed since they last did; stays until they do.
    overdue: bool,
    /// Words that were stuck, while they may still be: a damaged sample between them is no change.
    stuck: Option<W>,
    /// Samples since then that were others.
    others: u32,
}

impl<W> Default for Repetition<W> {
    fn default() -> Self {
        Self { last: None, run: 0, habit: 1.0, overdue: false, stuck: None, others: 0 }
    }
}

impl<W: Words> Repetition<W> {
    /// Takes the next sample. A sample that is missing is not taken; equal words beside a gap are a repetition.
    pub fn take(&mut self, words: W, evidence: Evidence) -> Repeats {
        let last = self.last.replace(words);
        if last != Some(words) && self.overdue && self.run >= W::STUCK_SAMPLES {
            (self.stuck, self.others) = (last, 0);
        }
        if self.stuck == Some(words) && last != Some(words) {
            (self.run, self.overdue) = (W::STUCK_SAMPLES, true);
            return Repeats::Stuck;
        }
        self.others = self.others.saturating_add(1);
        self.stuck = self.stuck.filter(|_| self.others < W::STUCK_SAMPLES);
        if last != Some(words) {
            self.habit += HABIT_WEIGHT * (1.0 - self.habit);
            self.run = 1;
            self.overdue = false;
            return Repeats::Changed;
        }
        self.run = self.run.saturating_add(1);
        let long = self.run >= W::STUCK_SAMPLES;
        self.overdue |= match evidence {
            Evidence::None | Evidence::Unseen => false,
            Evidence::OthersMove => long && self.habit > CHANGING,
            Evidence::Certain => true,
        };
        match (self.overdue, long) {
            (true, true) => Repeats::Stuck,
            (true, false) => Repeats::Suspect,
            (false, _) => {
                if evidence != Evidence::Unseen {
                    self.habit -= HABIT_WEIGHT * self.habit;
                }
                Repeats::Rests
            }
        }
    }

    /// The latest sample; `None` before the first.
    pub fn last(&self) -> Option<W> {
        self.last
    }

    /// Whether the latest sample repeats the one before though the words used to change: what is begun with such samples may begin
    /// with a device that is stuck. A sensor that rests from the beginning has that habit after 44 samples; one that was seen to move and
    /// that nobody saw come to rest must change once.
    pub fn may_be_stuck(&self) -> bool {
        self.run >= 2 && self.habit > CHANGING
    }

    /// For how many samples the words have stood still, where that is as long as a stuck device's; else 0.
    pub fn stood_still(&self) -> u32 {
        if self.run >= W::STUCK_SAMPLES { self.run - 1 } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HERE: [f64; 3] = [0.4, 0.1, -0.2];

    #[test]
    fn repetition_is_stuck_by_evidence_and_length() {
        let mut repetition = Repetition::default();
        let taken: Vec<_> = (0..6).map(|_| repetition.take(HERE, Evidence::Certain)).collect();
        use Repeats::{Changed, Rests, Stuck, Suspect};
        assert_eq!(taken, [Changed, Suspect, Suspect, Suspect, Stuck, Stuck]);
        // What is stuck stays so until the words change.
        assert_eq!((repetition.take(HERE, Evidence::None), repetition.stood_still()), (Stuck, 6));
        assert_eq!(repetition.take([0.0; 3], Evidence::None), Changed);
        assert_eq!((repetition.take([0.0; 3], Evidence::OthersMove), repetition.stood_still()), (Rests, 0));
    }

    #[test]
    fn a_damaged_sample_between_stuck_ones_is_no_change() {
        use Repeats::{Changed, Rests, Stuck};
        let mut repetition = Repetition::default();
        (0..5).for_each(|_| _ = repetition.take(HERE, Evidence::Certain));
        let damaged = [0.9, 0.1, -0.2];
        let take = |words| repetition.take(words, Evidence::None);
        assert_eq!(
            [HERE, damaged, HERE, HERE, damaged, HERE].map(take),
            [Stuck, Changed, Stuck, Stuck, Changed, Stuck]
        );
        // Where it moves again it may come by and rest there.
        let mut take = |words| repetition.take(words, Evidence::None);
        (0..5).for_each(|k| assert_eq!(take([f64::from(k); 3]), Changed));
        assert_eq!([HERE, HERE].map(take), [Changed, Rests]);
    }

    #[test]
    fn what_often_rests_may_rest_while_others_move() {
        let mut repetition = Repetition::default();
        for _ in 0..100 {
            repetition.take(HERE, Evidence::None);
        }
        assert_eq!(repetition.take(HERE, Evidence::OthersMove), Repeats::Rests);
        assert_eq!(repetition.take(HERE, Evidence::Certain), Repeats::Stuck);
    }
}
