//! Virtual trackers: truth in, device bytes out.
//!
//! ```text
//! scenario ──> motion ──> magnetic ──> flock ──> line ──> host (pseudo-terminal, stream)
//!              (truth)    (physics)    (bytes)  (faults)
//!                 └──────────────────────────────────────> truth (file, `truth` topic)
//! ```
//!
//! Everything but [`host`] is without IO and clock, seeded, and steps through simulated time as fast as
//! the processor allows ([`stage::VirtualStage`]). This package uses the drivers' encoders and never
//! `posed`: truth does not come from the code under test.

pub mod faults;
pub mod figure;
pub mod flock;
pub mod gesture;
pub mod host;
pub mod line;
pub mod magnetic;
pub mod motion;
pub mod pty;
mod random;
pub mod scenario;
pub mod stage;
#[cfg(test)]
mod testing;
pub mod truth;
