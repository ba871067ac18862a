//! What the stage tracks, as a stream of named columns: what exercises are taught from and counted in.
//!
//! What comes in: an estimate. What goes out: one row of numbers, none where a sensor has no pose that may be used.
//! What it never does: hand out a coasting or a suspect pose. Live, in recordings and in files the columns have the
//! same names, so an exercise taught in one is counted in the others.

use crate::layout::BodyLayout;
use crate::output::{Body, Estimate};
use crate::stage::Stage;

/// A body older than this against the estimate's time is none, s.
pub(crate) const BODY_AGE_S: f64 = 0.05;

/// Columns of one sensor, behind its name: position in the room (m) and orientation (sensor to room).
const PARTS: [&str; 7] = ["_x_m", "_y_m", "_z_m", "_qw", "_qx", "_qy", "_qz"];

/// Names of the columns of these sensors: `NAME_x_m, NAME_y_m, NAME_z_m, NAME_qw, NAME_qx, NAME_qy, NAME_qz` each.
pub fn columns<'a>(sensors: impl IntoIterator<Item = &'a str>) -> Vec<String> {
    let of = |name: &str| PARTS.map(|part| format!("{name}{part}"));
    sensors.into_iter().flat_map(of).collect()
}

/// Names of all columns of a stage: those of its sensors, then the angles of its body.
pub fn columns_of(stage: &Stage) -> Vec<String> {
    let mut columns = columns(stage.sensors.iter().map(|sensor| sensor.name.as_str()));
    columns.extend(BodyLayout::of(stage).iter().flat_map(BodyLayout::columns));
    columns
}

/// Appends one sensor's values, in the order of [`columns`]; an inertial sensor has no position.
pub(crate) fn append(
    position_m: Option<[f64; 3]>,
    orientation_wxyz: Option<[f64; 4]>,
    row: &mut Vec<Option<f64>>,
) {
    row.extend(position_m.map_or([None; 3], |position| position.map(Some)));
    row.extend(orientation_wxyz.map_or([None; 4], |orientation| orientation.map(Some)));
}

/// Writes the values of all sensors of an estimate to `row`, in the order of [`columns`].
pub fn write(estimate: &Estimate, row: &mut Vec<Option<f64>>) {
    row.clear();
    for sensor in &estimate.sensors {
        let pose = sensor.usable_pose();
        append(pose.and_then(|pose| pose.position_m), pose.map(|pose| pose.orientation_wxyz), row);
    }
}

/// The body's part of the columns of a stage: which angles there are.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct BodyColumns(Vec<usize>);

impl BodyColumns {
    /// Of a stage; none without a body.
    pub fn of(stage: &Stage) -> Self {
        Self(BodyLayout::of(stage).map_or_else(Vec::new, |layout| layout.shown_angles))
    }

    /// Appends the body's angles, degrees, to what [`write()`] wrote of the estimate; none where the body is older than it by
    /// more than 50 ms.
    pub fn append(&self, body: Option<&Body>, estimate: &Estimate, row: &mut Vec<Option<f64>>) {
        let fresh = |body: &&Body| estimate.t_valid.seconds_since(body.t_valid) <= BODY_AGE_S;
        let body = body.filter(fresh);
        row.extend(self.0.iter().map(|angle| Some(body?.angles_rad[*angle]?.to_degrees())));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::{PoseEstimate, SensorEstimate, SensorState};

    #[test]
    fn a_row_has_a_value_per_column_and_none_of_a_suspect_pose() {
        let pose = PoseEstimate {
            position_m: Some([1.0, 2.0, 3.0]),
            orientation_wxyz: [1.0, 0.0, 0.0, 0.0],
            velocity_m_s: Some([0.0; 3]),
            angular_velocity_rad_s: [0.0; 3],
            covariance: [0.0; 21],
            sigma_m: Some(0.0),
        };
        let sensor = |state| SensorEstimate {
            state,
            pose: Some(pose),
            measured: None,
            fault: None,
            ..SensorEstimate::default()
        };
        let sensors = vec![sensor(SensorState::Ok), sensor(SensorState::Suspect)];
        let mut row = vec![None];
        write(&Estimate { sensors, ..Estimate::default() }, &mut row);
        let columns = columns(["left", "right"]);
        assert_eq!(columns.len(), row.len());
        assert_eq!((columns[2].as_str(), row[2]), ("left_z_m", Some(3.0)));
        assert_eq!((columns[10].as_str(), row[10]), ("right_qw", None));
    }
}
