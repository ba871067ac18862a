//! Virtual trackers: truth in, device bytes out.
//!
//! ```text
//! scenario ──> motion ──> magnetic, ──> device ──> line,   ──> host (pseudo-terminal, stream, sockets)
//!              (truth)    inertial      (bytes)    network
//!                 │       (physics)                (faults)
//!                 └───────────────────────────────────────> truth (file, `truth` topic)
//! ```
//!
//! Everything but [`host`] is without IO and clock, seeded, and steps through simulated time as fast as
//! the processor allows ([`stage::VirtualStage`]). This package uses the drivers' encoders and never
//! `posed`: truth does not come from the code under test.

pub mod actions;
pub mod body;
mod bvh;
mod chassis;
pub mod device;
mod ease;
pub mod exercises;
mod fastrak;
pub mod faults;
pub mod figure;
pub mod flock;
pub mod gesture;
pub mod host;
pub mod inertial;
pub mod line;
pub mod magnetic;
pub mod motion;
mod motion_file;
mod motionstar;
mod open_imu;
mod polhemus;
mod port;
pub mod primitives;
pub mod pty;
mod random;
pub mod scenario;
mod slimevr;
mod sockets;
pub mod stage;
#[cfg(test)]
mod testing;
pub mod truth;
pub mod udp_network;
mod upper_body;
mod vrpn;
mod witmotion;
mod x_imu3;
mod xbus;
