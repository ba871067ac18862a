//! How a rigid segment moves at one time by the sensor on it, and what is felt at its other points.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use posed_geometry::so3::lever;

/// What one sensor shows of its segment.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moving {
    /// Segment to room.
    pub(super) q_room_segment: UnitQuaternion<f64>,
    /// Segment's axes, rad/s, rad/s², m/s².
    pub(super) angular_velocity_rad_s: Vector3<f64>,
    pub(super) accel_rad_s2: Vector3<f64>,
    pub(super) specific_force_m_s2: Vector3<f64>,
}

impl Moving {
    /// Specific force at a point so far from the sensor, segment's axes, m: in the room, m/s².
    pub(super) fn at(&self, from_sensor_m: &Vector3<f64>) -> Vector3<f64> {
        self.q_room_segment * (self.specific_force_m_s2 + self.lever() * from_sensor_m)
    }

    /// Derivative of the specific force by the place at which it is felt, segment's axes, 1/s².
    pub(super) fn lever(&self) -> Matrix3<f64> {
        lever(&self.angular_velocity_rad_s, &self.accel_rad_s2)
    }
}
