//! The daemon: everything that owns a thread, a socket, a file or a clock.

pub mod clock;
pub mod inbox;
pub mod server;
