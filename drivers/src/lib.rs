//! Sans-IO drivers for motion trackers.
//!
//! What comes in: bytes with the time at which they were read, line events, timer expiries. What goes
//! out: [`Sample`]s, bytes to transmit, the state of the link. What a session never does: read a clock,
//! sleep, open a port, start a thread. Only [`port`] touches the operating system.

mod arrivals;
pub mod cut;
pub mod datagram;
mod debt;
pub mod fastrak;
pub mod flock;
pub mod fuzzing;
pub mod link;
pub mod motionstar;
pub mod open_imu;
mod outbox;
pub mod polhemus;
pub mod port;
pub mod probe;
pub mod rate;
pub mod sample;
pub mod serial;
pub mod session;
pub mod slimevr;
mod turns;
pub mod vrpn;
pub mod witmotion;
pub mod x_imu3;
pub mod xbus;

pub use sample::{Arrival, DeviceTime, Measurement, Sample, Timestamp};
pub use session::{Condition, Counters, Found, LineEvent, Loss, Output, SensorInfo, Session, State};
