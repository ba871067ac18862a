//! Body-worn inertial sensors: from the true motion to what a real one would report.
//!
//! ```text
//! pose(t) ──> kinematics ──> angular velocity, specific force ──> errors ──> measurement
//!                 earth ──> magnetic field ──────────────┘
//!                 pose(t) ──> attitude filter's error ──> orientation
//! ```
//! What comes in: a sensor on a moving body, a time. What goes out: what it measures there, and the truth. It
//! knows no protocol.

mod earth;
mod errors;
mod imu;

pub use earth::{DisturbanceSpec, EarthSpec};
pub use errors::{AxisErrors, FilterErrors, ImuClass, ImuErrors};
pub(crate) use imu::{Imu, Inertial};

/// Standard gravity, m/s²: the one that the program under test assumes too.
pub use posed_geometry::GRAVITY_M_S2;
