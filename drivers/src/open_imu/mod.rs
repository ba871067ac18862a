//! Our own small format for inertial sensors that people build, and for phones: three carriers, one session.
//!
//! ```text
//! serial, tcp://  bytes ─> Lines ──────┐
//! udp://          envelopes ───────────┼─> wire::{json, osc, csv} ─> OpenImuSession (identity, order, clock) ─> Sample
//! websocket       envelopes (one text) ┘
//! ```
//! Devices send gyro, acceleration, field and orientation in SI units, each with a number and the time of the device's own clock. A line has
//! a checksum of one byte; messages over UDP and the websocket have that of their network only.

pub mod probe;
pub mod session;
mod unit;
pub mod wire;

pub use session::{Carrier, OpenImuSession, Settings};
