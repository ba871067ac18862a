//! SlimeVR trackers, and apps that imitate them, over UDP, where this is their server, or by radio through a receiver on USB.
//!
//! ```text
//! envelopes ─> datagrams ─> wire::parse ─> SlimeVrSession (handshake, sensors, order, pings) ─> Sample
//!                  └> reports ─> hid::packets ─┘          (registration, battery, signal)
//! ```
//! A tracker is its network address, whichever way it comes: the report of a receiver is a datagram of [`hid::RECEIVER`]. The reports were written from the
//! firmware and have not been tried on a real receiver; what its protocol is to become is not here.
//!
//! Trackers send orientation and acceleration without gravity that they have computed themselves, and no
//! time: samples are numbered by packet only. Their protocol has no checksum of its own; UDP has one.

pub mod hid;
mod order;
pub mod session;
pub mod wire;

pub use session::{Settings, SlimeVrSession};
