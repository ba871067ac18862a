//! Virtual trackers: truth in, device bytes out.

pub mod faults;
pub mod flock;
pub mod line;
pub mod magnetic;
pub mod motion;
mod random;
pub mod scenario;
pub mod stage;
#[cfg(test)]
mod testing;
pub mod truth;
