//! The daemon: everything that owns a thread, a socket, a file or a clock.
//!
//! Ports push what they read into one [`inbox`]; the fusion thread takes it from there, records it, pushes it through the
//! pipeline and hands the outputs to the server.

pub mod clock;
pub mod inbox;
pub mod recorder;
