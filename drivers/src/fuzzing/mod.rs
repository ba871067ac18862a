//! What the fuzz targets run, one function per driver; ordinary tests run the same over the committed corpus and seeded bytes.
//!
//! Each takes any bytes: [`HEAD`] of them choose settings at, within and beyond their limits, the others are a [`script`] of what
//! happens on the line. The same bytes go to the decoder, to the probe that looks for such a device, and to a session. None may
//! panic, and each checks what holds for every input: what comes out does not depend on how the bytes were cut, messages survive
//! being written again, and samples are numbers. Each returns how many samples the session published.

mod fastrak;
mod flock;
mod head;
mod motionstar;
mod open_imu;
mod polhemus;
mod script;
mod slimevr;
mod vrpn;
mod witmotion;
mod x_imu3;
mod xbus;

pub use fastrak::fastrak;
pub use flock::flock;
pub use head::HEAD;
pub use motionstar::motionstar;
pub use open_imu::open_imu;
pub use polhemus::polhemus;
pub use slimevr::slimevr;
pub use vrpn::vrpn;
pub use witmotion::witmotion;
pub use x_imu3::x_imu3;
pub use xbus::xbus;
