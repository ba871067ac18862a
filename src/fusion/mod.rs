//! Filters: from checked measurements to poses with covariances.
//!
//! What comes in: measurements, each at its own capture time, checked by `faults`. What goes out: estimates
//! at any time asked for. What it never does: decide on which side of the transmitter a sensor is.

mod half;
mod level;
mod track;
mod tracker;

pub use track::{Track, Tuning};
pub use tracker::{Tracker, Verdict};
