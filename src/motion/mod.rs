//! What a motion means: where it changes, which exercise it is.
//!
//! What comes in: poses, angles or raw signals, frame by frame. What goes out: events with the frame they speak about
//! and the frame at which they were decided. What it never does: change a pose, look at a clock, allocate once warm.

pub mod exercise;
pub mod keyframes;
pub mod segments;
