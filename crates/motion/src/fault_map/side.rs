//! On which side of the transmitter a sensor is taken to be.
//!
//! What comes in: positions, and the mirrors that a sensor went through. What goes out: the position on the clean side, the label
//! of one that is not there, and what speaks for the vertical mirror. What it never does: remember; [`super::memory`] does live,
//! [`super::learning`] with hindsight.
//!
//! Both mirrors turn the vertical axis, and one of them the others, too. Which side of a recording is the clean one is known
//! only at its end, so that a sensor may be found to have gone through both.

use posed_fusion::faults::{Cause, Label, Mirror};
use posed_state::Plain;

use super::memory::{Point, distance};

/// Fewer sensors than this are no figure that goes through a mirror.
const FIGURE: usize = 3;
/// Images that are no farther apart are one place, m.
const SAME_M: f64 = 0.1;

/// The axes that are mirrored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Plain)]
pub(super) struct Side {
    horizontal: bool,
    vertical: bool,
}

impl Side {
    /// Nothing is mirrored.
    pub(super) const CLEAN: Self = Self { horizontal: false, vertical: false };
    /// All of them, by how likely they are.
    pub(super) const ALL: [Self; 4] = [
        Self::CLEAN,
        Self { horizontal: true, vertical: true },
        Self { horizontal: false, vertical: true },
        Self { horizontal: true, vertical: false },
    ];

    /// Where a mirror leads from here.
    pub(super) fn through(self, mirror: Mirror) -> Self {
        self.beside(match mirror {
            Mirror::Point => Self { horizontal: true, vertical: true },
            Mirror::Vertical => Self { horizontal: false, vertical: true },
        })
    }

    /// This one, seen from another that is the clean one.
    pub(super) fn beside(self, other: Self) -> Self {
        Self { horizontal: self.horizontal ^ other.horizontal, vertical: self.vertical ^ other.vertical }
    }

    /// The position on the clean side.
    pub(super) fn undo(self, [x, y, z]: Point) -> Point {
        let turned = |value: f64, is: bool| if is { -value } else { value };
        [turned(x, self.horizontal), turned(y, self.horizontal), turned(z, self.vertical)]
    }

    /// What a position is whose place on the clean side this is.
    pub(super) fn label(self, here: Point) -> Label {
        match (self.horizontal, self.vertical) {
            (false, false) => Label::CLEAN,
            // Beside the plane both images are the same place.
            (false, true) if 2.0 * here[2].abs() < SAME_M => Label::CLEAN,
            (true, true) => Label::inverted(Mirror::Point),
            (false, true) => Label::inverted(Mirror::Vertical),
            // No tracker does that.
            (true, false) => Label::anomalous(Cause::Jump),
        }
    }
}

/// How a sensor would have come through the vertical mirror, m.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub(super) struct Ways {
    /// How far it went, as it is and mirrored.
    pub(super) same: f64,
    pub(super) image: f64,
    /// How far its image is from it.
    apart: f64,
}

impl Ways {
    /// To here from where it was, or was expected.
    pub(super) fn of(here: Point, before: Point) -> Self {
        let image = Mirror::Vertical.apply(here);
        Self { same: distance(here, before), image: distance(image, before), apart: distance(image, here) }
    }

    /// Whether the mirror would be seen: its image is elsewhere.
    pub(super) fn shows(&self, limit_m: f64) -> bool {
        self.apart > limit_m
    }

    /// Whether it may have gone through with the others: its image is not much farther from where it was.
    pub(super) fn may_follow(&self, limit_m: f64) -> bool {
        self.image < self.same + limit_m
    }
}

/// Whether a figure has gone through the vertical mirror: so many sensors jumped there, of those that would show it. By itself a sensor
/// that jumps there has jumped: it may come back beside the plane, where nobody sees it.
pub(super) fn goes_through(jumped: usize, shown: usize) -> bool {
    jumped >= FIGURE && 3 * jumped >= 2 * shown
}
