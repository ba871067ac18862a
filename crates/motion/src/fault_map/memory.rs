//! One sensor's recent past: hemisphere inversions, jumps and stuck words.
//!
//! What comes in: its position, frame by frame. What goes out: a class and a cause. What it never does: look at other
//! sensors, but for whether any of them moves.
//!
//! A flip is an event: the position jumps, and one of its mirror images does not. Between flips a sensor keeps its side. A jump
//! is an event too: from then on the sensor is elsewhere, until another jump takes it back.

use posed_state::Plain;
use serde::{Deserialize, Serialize};

use posed_fusion::faults::{Cause, Evidence, Label, Mirror, Repeats, Repetition};

use super::joints::Place;
use super::side::{Side, Ways};

/// A mirror image must be so many times nearer than the position itself.
const FLIP_RATIO: f64 = 0.3;
/// A sensor that was missing, or whose words were stuck, for longer has no memory of its side.
const MEMORY_FRAMES: u32 = 30;
/// What a sensor may have moved while it was missing or stuck, at most, in steps.
const BLIND_STEPS: f64 = 10.0;
/// A sensor that jumped is believed again once it has been where the others allow it for so many frames, or soon if
/// it was not there before.
const BELIEVED_FRAMES: u32 = 50;
const BELIEVED_SOON_FRAMES: u32 = 15;
/// Or where the map finds nothing unusual there either: two judges need less time than one.
const BELIEVED_BY_BOTH_FRAMES: u32 = 10;
/// For so many frames after a jump, smaller steps may take it back too.
const YOUNG_FRAMES: u32 = 3;
/// It is back where this share of the jump, or less, is left.
const BACK_SHARE: f64 = 0.5;

pub(super) type Point = [f64; 3];

/// What is known of a sensor before a stream begins.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub(super) struct Habit {
    /// What its position deviates from a steady motion at most, m a frame.
    pub(super) jump_m: f64,
    /// Longest usual step, m a frame.
    pub(super) step_m: f64,
    /// Where it is when it is clean, on average, m.
    pub(super) home_m: Point,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Plain)]
pub(super) struct Memory {
    words: Repetition<Point>,
    /// Latest position on the clean side, and its latest step.
    here: Point,
    step: Point,
    missing: u32,
    stuck: u32,
    side: Side,
    /// What speaks for the vertical mirror in the latest frame, if it was followed there.
    through: Option<Through>,
    pub(super) moved: bool,
    away: Option<Away>,
    /// Where it was expected when it jumped in the latest frame.
    left: Option<Point>,
}

/// How a sensor would have come through the vertical mirror.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
struct Through {
    /// The side on which it was before, and where it is now if it is still there.
    side: Side,
    same: Point,
    /// How far it went from where it was expected, and what had happened before.
    ways: Ways,
    away: Option<Away>,
    /// It jumped, and its image did not.
    jumped: bool,
}

/// A jump that was not taken back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Plain)]
struct Away {
    by: Point,
    /// Frames in a row in which the others allowed it, and frames before those in which they did not.
    fitting: u32,
    unfitting: u32,
    /// Of the former, those in a row in which the map was content too.
    content: u32,
}

impl Memory {
    /// Where it is, on the clean side; `None` while it is missing.
    pub(super) fn here(&self) -> Option<Point> {
        (self.words.last().is_some() && self.missing == 0).then_some(self.here)
    }

    pub(super) fn miss(&mut self) {
        self.missing = self.missing.saturating_add(1);
        self.moved = false;
        self.through = None;
    }

    pub(super) fn take(&mut self, p: Point, habit: &Habit, others_move: bool) -> Label {
        if self.missing > MEMORY_FRAMES {
            *self = Self::default();
        }
        let first = self.words.last().is_none();
        let blind = std::mem::take(&mut self.missing) + self.words.stood_still();
        let evidence = if others_move { Evidence::OthersMove } else { Evidence::None };
        let repeats = self.words.take(p, evidence);
        self.moved = repeats == Repeats::Changed && !first;
        self.through = None;
        if repeats == Repeats::Stuck {
            self.stuck = self.stuck.saturating_add(1);
            return Label::anomalous(Cause::Stuck);
        }
        let nobody_knows = std::mem::take(&mut self.stuck) > MEMORY_FRAMES;
        if nobody_knows {
            *self = Self { words: self.words, moved: self.moved, ..Self::default() };
        }
        if first || nobody_knows {
            self.begin(p, habit);
        } else {
            self.follow(p, blind, habit);
        }
        self.label()
    }

    /// Nothing to compare with but where it usually is.
    fn begin(&mut self, p: Point, habit: &Habit) {
        let ways = Ways::of(p, habit.home_m);
        let is_nearer = |image: f64| image < FLIP_RATIO * ways.same;
        let side = Side::CLEAN;
        self.through = Some(Through { side, same: p, ways, away: None, jumped: is_nearer(ways.image) });
        let inverted = is_nearer(distance(Mirror::Point.apply(p), habit.home_m));
        self.side = if inverted { side.through(Mirror::Point) } else { side };
        self.here = self.side.undo(p);
    }

    /// Where it was expected, if it has just jumped away from there.
    pub(super) fn left(&self) -> Option<Point> {
        self.left
    }

    /// It is back, or was never away.
    pub(super) fn believe(&mut self) -> Label {
        self.away = None;
        self.label()
    }

    /// Whether it jumped to where its image in the vertical mirror did not.
    pub(super) fn has_jumped_through(&self) -> bool {
        self.through.is_some_and(|through| through.jumped)
    }

    /// Whether it would be seen to go through it.
    pub(super) fn shows(&self, habit: &Habit) -> bool {
        self.through.is_some_and(|through| through.ways.shows(2.0 * habit.jump_m))
    }

    /// Has gone through it with the others if it may have, and did not jump; its label then.
    pub(super) fn follow_through(&mut self, habit: &Habit) -> Option<Label> {
        let Through { side, same, away, .. } =
            self.through.filter(|through| through.ways.may_follow(2.0 * habit.jump_m))?;
        self.side = side.through(Mirror::Vertical);
        self.here = Mirror::Vertical.apply(same);
        (self.step, self.left, self.away) = ([0.0; 3], None, away);
        Some(self.label())
    }

    /// Takes what the joints say of a position: more than it can know alone. Its label then.
    pub(super) fn settle(&mut self, p: Point, place: Place) -> Label {
        let Some(side) = place.side() else {
            // It goes on as it would: it may come back unseen.
            return Label::anomalous(if self.is_away() { Cause::Jump } else { Cause::Bone });
        };
        self.away = None;
        self.left = None;
        if side != self.side {
            (self.side, self.step, self.here) = (side, [0.0; 3], side.undo(p));
        }
        self.label()
    }

    fn label(&self) -> Label {
        match self.away {
            None => self.side.label(self.here),
            Some(_) => Label::anomalous(Cause::Jump),
        }
    }

    /// Whether it jumped and was not seen to come back.
    pub(super) fn is_away(&self) -> bool {
        self.away.is_some()
    }

    /// Takes in whether a sensor that jumped is where the others allow it, and whether the map finds nothing unusual
    /// there either: two judges need less time than one.
    pub(super) fn judge(&mut self, fits: bool, content: bool) {
        let Some(away) = &mut self.away else { return };
        if !fits {
            away.unfitting += 1;
            (away.fitting, away.content) = (0, 0);
            return;
        }
        away.fitting += 1;
        away.content = if content { away.content + 1 } else { 0 };
        let came_back = away.unfitting > away.fitting && away.fitting >= BELIEVED_SOON_FRAMES;
        if came_back || away.content >= BELIEVED_BY_BOTH_FRAMES || away.fitting >= BELIEVED_FRAMES {
            self.away = None;
        }
    }

    /// Decides on which side it is, and whether it jumped.
    fn follow(&mut self, p: Point, blind: u32, habit: &Habit) {
        let expected: Point = match blind {
            0 => std::array::from_fn(|c| self.here[c] + self.step[c]),
            _ => self.here,
        };
        let reach = habit.jump_m + habit.step_m * f64::from(blind).min(BLIND_STEPS);
        let same = self.side.undo(p);
        let ways = Ways::of(same, expected);
        let comes_through = |image: f64| ways.same > reach && image < FLIP_RATIO * ways.same;
        let jumped = comes_through(ways.image);
        self.through = Some(Through { side: self.side, same, ways, away: self.away, jumped });
        // Near the transmitter both images are near: it stays on its side.
        let flipped = comes_through(distance(Mirror::Point.apply(same), expected));
        if flipped {
            self.side = self.side.through(Mirror::Point);
        }
        let now = self.side.undo(p);
        let off: Point = std::array::from_fn(|c| now[c] - expected[c]);
        let jumped = blind == 0 && norm(off) > reach;
        self.left = None;
        let young = self.away.is_some_and(|away| away.fitting + away.unfitting < YOUNG_FRAMES);
        if jumped || young {
            let total = self.away.map_or(off, |away| std::array::from_fn(|c| away.by[c] + off[c]));
            // One bad word is a jump there and back.
            let back = self.away.is_some_and(|away| norm(total) < BACK_SHARE * norm(away.by));
            let old = self.away.unwrap_or_default();
            self.left = (jumped && !back).then_some(expected);
            self.away = (!back).then_some(Away {
                by: total,
                fitting: if jumped { 0 } else { old.fitting },
                content: if jumped { 0 } else { old.content },
                ..old
            });
        }
        self.step = if jumped || flipped || blind > 0 {
            [0.0; 3]
        } else {
            std::array::from_fn(|c| now[c] - self.here[c])
        };
        self.here = now;
    }
}

pub(super) fn distance(a: Point, b: Point) -> f64 {
    norm([a[0] - b[0], a[1] - b[1], a[2] - b[2]])
}

fn norm(p: Point) -> f64 {
    (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt()
}
