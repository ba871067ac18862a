//! What a motion means: offline and live analysis of poses, angles and raw signals.

pub mod exercise;
