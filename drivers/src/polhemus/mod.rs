//! Polhemus Liberty and Patriot over RS-232 or USB, binary or as text.
//!
//! ```text
//! bytes ─> Splitter (records of one list, answers) ─> stamps (frame, ms) ─> PolhemusSession ─> Sample
//! ```
//! A record has no checksum. It counts when header, length, terminator and quaternion fit, and when its frame count and its time have gone on
//! together; behind damage the header of the next one must be there, too. The same bytes come from the USB port (`crate::port`).
//! Not here: the Latus and its markers, VIPER, G4; a Fastrak has a driver of its own ([`crate::fastrak`]). It was written from
//! published drivers and vendor headers, and has not been tried on a real unit.

pub mod probe;
pub mod session;
mod stamps;
pub mod wire;

pub use session::{PolhemusSession, Settings};
