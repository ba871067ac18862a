//! Samples and frames to poses: filters.
//!
//! What comes in: measurements with their time. What goes out: orientations, joint angles, poses, with their
//! covariance. What they never do: decide what is a fault of a device (they only gate), ask for the time, or allocate per sample.

pub mod ahrs;
pub mod chain;
pub mod hinge;
pub mod intrinsics;
pub mod limb;
pub mod mounting;
