//! What a motion means: offline and live analysis of poses, angles and raw signals.

pub mod exercise;
//! What a stream of poses means: where a motion changes.
//!
//! What comes in: poses and frames. What goes out: events with the frame they speak about and the frame at which
//! they were decided. What it never does: change a pose, look at a clock, allocate once warm.

pub mod keyframes;
