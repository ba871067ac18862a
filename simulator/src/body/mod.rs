//! A simulated person who wears IMUs: postures over time, and what each sensor measures.
//!
//! ```text
//! script(t) ──> posture ──> kinematics ──> pose of every sensor ──> angular velocity, specific force, field ──> errors ──> sample
//! ```
//! In: a seed, a script, errors. Out: samples and the truth. It follows the table of `docs/body.md` with kinematics of
//! its own and never uses `posed`'s.

mod everyday;
mod gait;
mod kinematics;
pub mod programme;
mod script;
mod strap;
pub mod take;
#[cfg(test)]
mod tests;
mod wearer;

pub(crate) use strap::Strap;

pub use kinematics::{Build, Placement, Posture, SEGMENT_NAMES, SEGMENTS, TrueBody};
pub use script::{Activity, BlockSpan, Mistake, Script};
pub use wearer::{Disturbance, Sample, SensorErrors, Truth, Wearer, WearerSpec};
