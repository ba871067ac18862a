//! Virtual trackers: truth in, device bytes out.

pub mod magnetic;
pub mod motion;
mod random;
