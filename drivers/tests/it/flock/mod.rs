//! The Flock of Birds.

mod bench;
mod capture;
mod faults;
mod session;
mod wire;
