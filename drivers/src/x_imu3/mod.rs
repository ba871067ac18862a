//! x-io x-IMU3, alone or as a chain behind a multiplexer, over serial, TCP or UDP.
//!
//! ```text
//! bytes ─> Lines ─> wire::parse ─> data::decode ─> XImu3Session ─> Sample
//! ```
//! The stream is the same over every link, and a `.ximu3` log file is that stream. There is no checksum: a
//! message counts only when its length fits its letter exactly and its numbers can be measured.

pub mod data;
pub mod probe;
pub mod session;
mod unit;
pub mod wire;

pub use session::{Settings, XImu3Session};
