//! The field: where metal bends a magnetic tracker's world, and how to bend it back.
//!
//! What comes in: a recording of a pole with sensors at measured distances, waved through the stage; surveyed points if
//! there are any. What goes out: a [`FieldMap`], and from it a [`Corrector`] that corrects every pose at once, with an
//! honest uncertainty. What it never does: estimate the spacing from the readings, or give out a map that does not make
//! unseen readings better.
//!
//! ```text
//! PoleRun -> outliers -> solve: select (search, fit, held-out blocks) -> anchors -> FieldMap -> Corrector
//! ```
//! A pole sees lengths, so a map that moves everything rigidly is invisible to it; anchors fix that, and so does a
//! model of the metal, for which the transmitter is where it is.

mod anchors;
mod arrows;
pub mod cascade;
mod coverage;
mod estimate;
mod fit;
mod grid;
mod guide;
mod hull;
mod known;
mod limbs;
mod map;
pub mod model;
mod noise;
mod orientation;
mod outliers;
mod patch;
mod picture;
mod pole;
mod prepared;
mod problem;
mod report;
mod search;
mod select;
mod solve;
mod trust;
mod watch;

pub use anchors::{Anchor, LEAST_ANCHORS, rigid};
pub use arrows::arrows;
pub use grid::Shape;
pub use guide::{Guide, Progress};
pub use hull::Hull;
pub use known::{fit_known, refit_known};
pub use limbs::{Bone, Joint, Limbs, solve_limbs};
pub use map::{Aligned, Corrected, Corrector, FieldMap, Uncertainty, VERSION};
pub use noise::FieldNoise;
pub use outliers::{Reason as RejectReason, Rejected, reject};
pub use picture::svg;
pub use pole::{PoleError, PoleFrame, PoleReading, PoleRun};
pub use prepared::Prepared;
pub use problem::MAX_SENSORS;
pub use report::{Code, Reason, Report, Tried};
pub use solve::{Solution, refit_pole, solve};
pub use watch::{Cause, Seen, Warning, Watch, WatchSettings};
