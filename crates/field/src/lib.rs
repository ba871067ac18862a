//! The field: where metal bends a magnetic tracker's world, and how to bend it back.
//!
//! What comes in: a recording of a pole with sensors at measured distances, moved through the stage; surveyed points if
//! there are any. What goes out: a [`FieldMap`], and from it a [`Corrector`] that corrects every pose at once, with an
//! honest uncertainty. What it never does: estimate the spacing from the readings, or give out a map that does not make
//! unseen readings better.
//!
//! ```text
//! PoleRun -> outliers -> solve: select (search, fit, held-out blocks) -> anchors -> FieldMap -> Corrector
//! ```
//! ```
//! use nalgebra::Vector3;
//! use posed_field::{PoleReading, PoleRun, solve};
//!
//! // Three sensors 0.3 m apart on a pole that only slides along x: not enough to see a field.
//! let sensors: Vec<String> = ["low", "middle", "high"].map(str::to_owned).into();
//! let reading = |x: f64, k: usize| PoleReading { position_m: Vector3::new(x, 0.0, 0.3 * k as f64), orientation: None };
//! let rows = (0..50).flat_map(|t| (0..3).map(move |k| (0.1 * t as f64, k, reading(0.01 * t as f64, k))));
//! let run = PoleRun::new(sensors, 0.3, rows)?;
//! assert_eq!(run.frames.len(), 50);
//! let solution = solve(run, &[], &mut |_| ());
//! assert!(!solution.report.reasons.is_empty(), "a map is refused, with reasons");
//! # Ok::<(), posed_field::PoleError>(())
//! ```
//! A pole sees lengths, so a map that moves everything rigidly is invisible to it; anchors fix that, and so does a
//! model of the metal, for which the transmitter is where it is.

mod anchors;
mod arrows;
mod corrector;
mod coverage;
mod estimate;
mod fit;
mod grid;
mod guide;
mod hull;
mod joint_range;
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
pub use corrector::{Corrected, Corrector};
pub use coverage::Ask;
pub use estimate::noise as estimate_noise;
pub use grid::Shape;
pub use guide::{Guide, Progress};
pub use hull::Hull;
pub use joint_range::JointRange;
pub use known::{fit_known, refit_known};
pub use limbs::{Bone, Joint, Limbs, Way, solve_limbs};
pub use map::{Aligned, FieldMap, Uncertainty, VERSION};
pub use noise::FieldNoise;
pub use outliers::{Reason as RejectReason, Rejected, reject};
pub use picture::svg;
pub use pole::{PoleError, PoleFrame, PoleReading, PoleRun};
pub use prepared::Prepared;
pub use problem::{MAX_SENSORS, line as fit_line, side_basis};
pub use report::{CandidateModel, Code, Reason, Report};
pub use solve::{Solution, refit_pole, solve};
pub use watch::{Cause, Warning, Watch, WatchSettings, WatchedPosition};
