//! What devices send in one sample, as the stuck test compares it.

use nalgebra::Vector3;
use posed_geometry::repetition::Words;
use posed_state::Plain;

use super::MeasuredPose;

/// A pose of a magnetic sensor.
impl Words for MeasuredPose {
    const STUCK_SAMPLES: u32 = 5;
}

/// What an IMU sends of its motion. The magnetometer is left out: it is often slower than the gyro.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct ImuWords {
    /// Angular velocity, sensor axes, rad/s.
    pub angular_velocity_rad_s: Vector3<f64>,
    /// Specific force, or acceleration without gravity where the unit sends that only; sensor axes, m/s².
    pub acceleration_m_s2: Option<Vector3<f64>>,
}

impl Words for ImuWords {
    const STUCK_SAMPLES: u32 = 11;
}
