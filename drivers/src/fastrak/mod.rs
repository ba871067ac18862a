//! Polhemus Fastrak, and trackers that speak its language, over RS-232.
//!
//! ```text
//! bytes ─> Splitter (binary or text records) ─> FastrakSession ─> Sample
//! ```
//! A record has no checksum and no mark of its own: it counts when header, length and terminator fit, and the
//! quaternion is one. The Liberty and the Patriot have another language and a driver of their own ([`crate::polhemus`]).

pub mod probe;
pub mod session;
pub mod wire;

pub use session::{FastrakSession, Settings};
