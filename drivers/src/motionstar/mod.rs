//! Ascension MotionStar and MotionStar Wireless: BirdNet packets over TCP or UDP.
//!
//! ```text
//! bytes ─> Packets ─> MotionStarSession (wake, status, set up, run) ─> records ─> Sample
//! ```
//! A MotionStar on RS-232 is a Flock of Birds: see [`crate::flock`].

pub mod probe;
pub mod session;
pub mod wire;

pub use session::{MotionStarSession, Settings};
