//! SlimeVR trackers, and apps that imitate them, over UDP: this is their server.
//!
//! ```text
//! envelopes ─> datagrams ─> wire::parse ─> SlimeVrSession (handshake, sensors, order, pings) ─> Sample
//! ```
//! Trackers send orientation and acceleration without gravity that they have computed themselves, and no
//! time: samples are numbered by packet only. Their protocol has no checksum of its own; UDP has one.

mod order;
pub mod session;
pub mod wire;

pub use session::{Settings, SlimeVrSession};
