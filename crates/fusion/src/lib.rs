//! Filters: from checked measurements to orientations, joint angles and poses, with covariances.
//!
//! What comes in: measurements, each at its own capture time, checked by `faults`. What goes out: estimates
//! at any time asked for. What they never do: decide what is a device's fault or on which side of the transmitter a
//! sensor is (they only gate), ask for the time, allocate per sample.
//!
//! | module | estimates | from |
//! |---|---|---|
//! | [`ahrs`] | orientation of an IMU | angular velocity, specific force, magnetic field |
//! | [`Track`], [`Tracker`] | pose of a magnetic sensor | its poses |
//! | [`aided`], [`align`] | pose of a sensor with both, and how the two sit | poses and an IMU |
//! | [`limb`], [`body`] | joint angles of a limb, of a whole body | IMUs on its segments |
//! | [`chain`], [`mounting`] | hinges, and how sensors sit | IMUs, movement |
//! | [`intrinsics`] | biases, scales, misalignments of an IMU | rests |
//! | [`faults`], [`noise`] | what is wrong with a measurement, how noisy it is | a prediction |
//!
//! ```
//! use nalgebra::Vector3;
//! use posed_fusion::ahrs::{Ahrs, ImuSample, Params};
//! use posed_geometry::GRAVITY_M_S2;
//!
//! // At rest, its y axis up: rolled by 90 degrees.
//! let mut filter = Ahrs::new(Params::default());
//! let sample = ImuSample { gyro_rad_s: Vector3::zeros(), accel_m_s2: Vector3::y() * GRAVITY_M_S2, mag: None };
//! let orientation = (0..100).map(|_| filter.push(&sample, 0.01)).last().expect("a hundred samples");
//! assert!((orientation * Vector3::y() - Vector3::z()).norm() < 1e-3);
//! ```

pub mod ahrs;
pub mod aided;
pub mod align;
pub mod body;
pub mod chain;
pub mod faults;
mod half;
pub mod intrinsics;
mod level;
pub mod limb;
pub mod mounting;
pub mod noise;
#[cfg(test)]
mod testing;
mod track;
mod tracker;

pub use track::{Track, Tuning};
pub use tracker::Tracker;
