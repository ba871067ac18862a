//! WitMotion sensors with a serial line (WT901, JY901, HWT901B, HWT905, BWT901CL and their like).
//!
//! ```text
//! bytes ─> Splitter (whole groups: acceleration, angular velocity, angle, quaternion) ─> WitMotionSession ─> Sample
//! ```
//! A frame has a sum of one byte, no number and no time; a sample is a group of four that follow on each other with right sums, so that
//! lost and added bytes cannot pass. The quaternion is held against the angles: the sources disagree on its order. Not here: Bluetooth
//! Low Energy and its frames of 20 bytes, Modbus, CAN, the JY61, which cannot be asked, and the magnetometer, of whose scale the
//! sources disagree. It was written from the maker's code and has not been tried on a real unit.

pub mod probe;
pub mod session;
pub mod wire;

pub use session::{Settings, WitMotionSession};
