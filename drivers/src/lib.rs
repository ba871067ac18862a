//! Sans-IO drivers for motion trackers.
//!
//! What comes in: bytes with the time at which they were read, line events, timer expiries. What goes
//! out: [`Sample`]s, bytes to transmit, the state of the link. What a session never does: read a clock,
//! sleep, open a port, start a thread. Only [`port`] touches the operating system.

pub mod flock;
pub mod port;
pub mod sample;
pub mod session;

pub use sample::{Arrival, DeviceTime, Measurement, Sample, Timestamp};
pub use session::{Counters, LineEvent, Output, SensorInfo, Session, State};
