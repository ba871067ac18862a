//! Filters: from checked measurements to orientations, joint angles and poses, with covariances.
//!
//! What comes in: measurements, each at its own capture time, checked by `faults`. What goes out: estimates
//! at any time asked for. What they never do: decide what is a device's fault or on which side of the transmitter a
//! sensor is (they only gate), ask for the time, allocate per sample.

pub mod ahrs;
pub mod aided;
pub mod align;
pub mod body;
pub mod chain;
mod half;
pub mod intrinsics;
mod level;
pub mod limb;
pub mod mounting;
#[cfg(test)]
mod testing;
mod track;
mod tracker;

pub use track::{Track, Tuning};
pub use tracker::{Tracker, Verdict};
