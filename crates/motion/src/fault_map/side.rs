//! On which side of the transmitter a sensor is taken to be.
//!
//! What comes in: positions, and the mirrors that a sensor went through. What goes out: the position on the clean side, and the label
//! of one that is not there. What it never does: decide; [`super::memory`] does live, [`super::learning`] with hindsight.
//!
//! Both mirrors turn the vertical axis, and one of them the others, too. Which side of a recording is the clean one is known
//! only at its end, so that a sensor may be found to have gone through both.

use posed_fusion::faults::{Cause, Label, Mirror};
use posed_state::Plain;

use super::memory::Point;

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
        // Beside the plane both images are the same place.
        let same = self == Self::CLEAN.through(Mirror::Vertical) && 2.0 * here[2].abs() < SAME_M;
        match (self.horizontal, self.vertical) {
            _ if same => Label::CLEAN,
            (false, false) => Label::CLEAN,
            (true, true) => Label::inverted(Mirror::Point),
            (false, true) => Label::inverted(Mirror::Vertical),
            // No tracker does that.
            (true, false) => Label::anomalous(Cause::Jump),
        }
    }
}
