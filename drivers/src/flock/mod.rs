//! Ascension Flock of Birds over RS-232.
