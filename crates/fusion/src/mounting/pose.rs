//! Mounting from static poses.
//!
//! In: for each held pose, how the segment stands and what the sensor measured at rest. Out: sensor to segment. With
//! a heading known, one pose is enough; with gravity alone it takes two in which gravity differs.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::Refused;
use posed_geometry::so3;

/// Poses that disagree by more are to be repeated, degrees.
const LIMIT_DEG: f64 = 5.0;
/// Gravity must differ by at least so much between two poses, degrees.
const DIFFERENT_DEG: f64 = 20.0;

/// One held pose of one segment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseObservation {
    /// Segment to room in the pose.
    pub q_room_segment: UnitQuaternion<f64>,
    /// Sensor to room at rest; its heading counts only where `heading` is true.
    pub q_room_sensor: UnitQuaternion<f64>,
    /// Whether the sensor's heading is trusted.
    pub heading: bool,
}

/// Sensor-to-segment alignment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mounting {
    /// Turns sensor coordinates into segment coordinates.
    pub q_segment_sensor: UnitQuaternion<f64>,
    /// Largest departure of a pose from it, degrees: of the rotation with a heading, of gravity without; at most 5.
    pub residual_deg: f64,
}

/// The rotation that explains all poses best: Wahba's problem over the directions that each pose shows, all with one weight.
/// One pose is enough with a trusted heading; `docs/methods/mounting.md`.
///
/// # Errors
/// [`Refused::TooShort`] without a pose, [`Refused::SamePoses`] where no heading is trusted and gravity differs by less than
/// 20 degrees or is nearly opposite, [`Refused::Disagree`] where a pose departs by more than 5 degrees.
pub fn mounting_from_poses(poses: &[PoseObservation]) -> Result<Mounting, Refused> {
    if poses.is_empty() {
        return Err(Refused::TooShort { found: 0, needed: 1 });
    }
    let headed = poses.iter().any(|pose| pose.heading);
    let down = |pose: &PoseObservation| pose.q_room_segment.inverse() * Vector3::z();
    let spread = poses.iter().map(|pose| down(pose).angle(&down(&poses[0]))).fold(0.0, f64::max).to_degrees();
    if !headed && spread.min(180.0 - spread) < DIFFERENT_DEG {
        return Err(Refused::SamePoses { needed_deg: DIFFERENT_DEG });
    }
    let mut profile = Matrix3::zeros();
    for pose in poses {
        for direction in directions(pose) {
            let segment = pose.q_room_segment.inverse() * direction;
            let sensor = pose.q_room_sensor.inverse() * direction;
            profile += segment * sensor.transpose();
        }
    }
    let svd = profile.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Err(Refused::SamePoses { needed_deg: DIFFERENT_DEG });
    };
    let sign = Vector3::new(1.0, 1.0, (u * v_t).determinant().signum());
    let matrix = u * Matrix3::from_diagonal(&sign) * v_t;
    let q_segment_sensor = UnitQuaternion::from_matrix(&matrix);
    let residual_deg = poses.iter().map(|pose| departure(pose, &q_segment_sensor)).fold(0.0, f64::max);
    if residual_deg > LIMIT_DEG {
        return Err(Refused::Disagree { found_deg: residual_deg, limit_deg: LIMIT_DEG });
    }
    Ok(Mounting { q_segment_sensor, residual_deg })
}

/// The room's directions that a pose shows: the vertical, and all three with a heading.
fn directions(pose: &PoseObservation) -> impl Iterator<Item = Vector3<f64>> + use<> {
    let count = if pose.heading { 3 } else { 1 };
    [Vector3::z(), Vector3::x(), Vector3::y()].into_iter().take(count)
}

/// How far a pose is from the mounting, degrees.
fn departure(pose: &PoseObservation, mounting: &UnitQuaternion<f64>) -> f64 {
    let predicted = pose.q_room_segment * mounting;
    let error = if pose.heading {
        so3::log(&(predicted * pose.q_room_sensor.inverse())).norm()
    } else {
        (predicted.inverse() * Vector3::z()).angle(&(pose.q_room_sensor.inverse() * Vector3::z()))
    };
    error.to_degrees()
}
