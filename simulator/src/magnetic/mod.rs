//! Physics of a magnetic tracker: where a sensor believes to be.
//!
//! What comes in: the true pose of a sensor in the transmitter frame, the metal around it. What goes
//! out: the pose that a device solves from nine noisy signals. It knows no bytes, no records, no clock.
//!
//! All lengths are metres; fields and signals are in units of mu0 m / 4 pi, so that the field of the
//! source at distance r is of the order of r^-3 (unit 1/m^3). The transmitter frame is that of the
//! tracker: +x forward, +y right, +z down.

mod dipole;
mod metal;
mod station;
mod tracker;

pub use dipole::{Solution, field_matrix, signal_matrix, solve};
pub use metal::{Environment, Excitation, Floor, Sphere, conductor_response, iron_response};
pub(crate) use station::{Scene, Station};
pub use tracker::{Hum, Passing, Reading, Signal, Tracker};
