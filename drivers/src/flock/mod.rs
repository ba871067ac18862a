//! Ascension Flock of Birds over RS-232.

pub mod wire;
