//! What the stage tracks, as a stream of named columns: what exercises are taught from and counted in.
//!
//! What comes in: an estimate. What goes out: one row of numbers, none where a sensor has no pose that may be used.
//! What it never does: hand out a coasting or a suspect pose. Live, in recordings and in files the columns have the
//! same names, so an exercise taught in one is counted in the others.

use crate::layout::BodyLayout;
use crate::output::{Body, Estimate};
use crate::{BodyIndex, Stage};

/// A body that is older than the estimate by more than this counts as absent, s.
pub const BODY_AGE_S: f64 = 0.05;

/// Columns of one sensor, behind its name: position in the room (m) and orientation (sensor to room).
const PARTS: [&str; 7] = ["_x_m", "_y_m", "_z_m", "_qw", "_qx", "_qy", "_qz"];

/// Names of the columns of these sensors, seven each: `NAME_x_m, NAME_y_m, NAME_z_m` (position in the room, m) and
/// `NAME_qw, NAME_qx, NAME_qy, NAME_qz` (sensor to room).
pub fn columns<'a>(sensors: impl IntoIterator<Item = &'a str>) -> Vec<String> {
    let of = |name: &str| PARTS.map(|part| format!("{name}{part}"));
    sensors.into_iter().flat_map(of).collect()
}

/// Columns of what an inertial sensor measured, behind its name, in sensor axes: specific force (m/s², +g upwards at rest) and
/// angular velocity (rad/s).
const INERTIAL_PARTS: [&str; 6] = ["_ax", "_ay", "_az", "_gx", "_gy", "_gz"];

/// Names of the columns of what these inertial sensors measured, six each, sensor axes: `NAME_ax, NAME_ay, NAME_az` (specific
/// force, m/s², +g upwards at rest) and `NAME_gx, NAME_gy, NAME_gz` (angular velocity, rad/s).
pub fn inertial_columns<'a>(sensors: impl IntoIterator<Item = &'a str>) -> Vec<String> {
    let of = |name: &str| INERTIAL_PARTS.map(|part| format!("{name}{part}"));
    sensors.into_iter().flat_map(of).collect()
}

/// Names of all columns of a stage: the poses of its sensors ([`columns`]), what its inertial sensors measured
/// ([`inertial_columns`]) where the stage has no body, then the angles of its body ([`BodyLayout::columns`]). A row of them is
/// what [`write()`], [`InertialColumns::append`] and [`BodyColumns::append`] write, in this order.
pub fn columns_of(stage: &Stage) -> Vec<String> {
    let mut columns = columns(stage.sensors.iter().map(|sensor| sensor.name.as_str()));
    columns.extend(InertialColumns::of(stage).names(stage));
    columns.extend(BodyColumns::of(stage).names(stage));
    columns
}

/// What stands in front of the names of a body's angles, `NAME.`: nothing where the stage has one body.
pub fn prefix_of(stage: &Stage, body: BodyIndex) -> String {
    let name = stage.bodies.get(usize::from(body)).filter(|_| stage.bodies.len() > 1);
    name.map_or_else(String::new, |body| format!("{}.", body.name))
}

/// The column that a channel of an exercise is where the body with this [`prefix_of`] does it, `columns` being those of the stage ([`columns_of`]): a joint is that
/// body's, and everything else is as it is called.
pub fn column_of(channel: &str, prefix: &str, columns: &[String]) -> String {
    let joint = format!("{prefix}{channel}");
    if columns.contains(&joint) { joint } else { channel.to_owned() }
}

/// Those of [`columns_of`] that describe who exercises: of this body, not those of sensors that nobody or somebody else wears, which
/// may move for ever. All where nobody wears any.
pub fn columns_of_wearer(stage: &Stage, body: BodyIndex) -> Vec<String> {
    let Some(layout) = BodyLayout::of(stage, body) else { return columns_of(stage) };
    let on_body = |sensor: &&crate::Sensor| {
        stage.wearer_of(sensor) == Some(body)
            && layout.segments.iter().any(|segment| segment.name == sensor.sits_on())
    };
    let mut columns = columns(stage.sensors.iter().filter(on_body).map(|sensor| sensor.name.as_str()));
    let prefix = prefix_of(stage, body);
    columns.extend(layout.columns().map(|column| format!("{prefix}{column}")));
    columns
}

/// Whether this is how a column of a sensor goes on behind the sensor's name: `_x_m` or `_gz`, for example.
pub fn is_part(text: &str) -> bool {
    PARTS.iter().chain(&INERTIAL_PARTS).any(|part| *part == text)
}

/// Appends one sensor's seven values to `row`, in the order of [`columns`]: position in the room, m, and sensor to room, scalar
/// first. What is absent is `None` in each of its columns; an inertial sensor has no position.
pub fn append(position_m: Option<[f64; 3]>, orientation_wxyz: Option<[f64; 4]>, row: &mut Vec<Option<f64>>) {
    row.extend(position_m.map_or([None; 3], |position| position.map(Some)));
    row.extend(orientation_wxyz.map_or([None; 4], |orientation| orientation.map(Some)));
}

/// Writes the poses of all sensors of an estimate to `row`, in the order of [`columns`], in place of what was in it. A pose that
/// may not be used as good ([`crate::output::SensorEstimate::usable_pose`]) is `None` in all its columns.
pub fn write(estimate: &Estimate, row: &mut Vec<Option<f64>>) {
    row.clear();
    for sensor in &estimate.sensors {
        let pose = sensor.usable_pose();
        append(pose.and_then(|pose| pose.position_m), pose.map(|pose| pose.orientation_wxyz), row);
    }
}

/// What single inertial sensors measured, a wrist watch for example: which sensors these are. The sensors of a body
/// are none: their movement is in its angles.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct InertialColumns(Vec<usize>);

impl InertialColumns {
    /// The inertial sensors of a stage; none where a body of it has a [`BodyLayout`].
    pub fn of(stage: &Stage) -> Self {
        if BodyLayout::all(stage).iter().any(Option::is_some) {
            return Self::default();
        }
        let sensors = stage.sensors.iter().enumerate();
        Self(sensors.filter(|(_, sensor)| stage.is_imu(sensor)).map(|(index, _)| index).collect())
    }

    /// The columns' names ([`inertial_columns`]); `stage` is the one that these were made of.
    pub fn names(&self, stage: &Stage) -> Vec<String> {
        inertial_columns(self.0.iter().filter_map(|index| Some(stage.sensors.get(*index)?.name.as_str())))
    }

    /// Index of each sensor in the stage file, rising.
    pub fn sensors(&self) -> &[usize] {
        &self.0
    }

    /// Appends the newest record of each sensor to what [`write()`] wrote, as the unit measured it: its intrinsics are not
    /// applied. `None` where the sensor's state is not usable, or the record lacks the value.
    pub fn append(&self, estimate: &Estimate, row: &mut Vec<Option<f64>>) {
        for index in &self.0 {
            let sensor = estimate.sensors.get(*index).filter(|sensor| sensor.state.is_usable());
            let inertial = sensor.and_then(|sensor| sensor.measured?.inertial).unwrap_or_default();
            append_inertial(inertial.specific_force_m_s2, inertial.angular_velocity_rad_s, row);
        }
    }
}

/// Appends what one inertial sensor measured, six values in sensor axes, in the order of [`inertial_columns`]; what is absent is
/// `None`.
pub fn append_inertial(
    specific_force_m_s2: Option<[f64; 3]>,
    angular_velocity_rad_s: Option<[f64; 3]>,
    row: &mut Vec<Option<f64>>,
) {
    for vector in [specific_force_m_s2, angular_velocity_rad_s] {
        row.extend(vector.map_or([None; 3], |vector| vector.map(Some)));
    }
}

/// The bodies' part of the columns of a stage: which angles there are, body by body.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct BodyColumns(Vec<Vec<usize>>);

impl BodyColumns {
    /// The angles of a stage's bodies that their sensors can show; none without a [`BodyLayout`].
    pub fn of(stage: &Stage) -> Self {
        let shown = |layout: Option<BodyLayout>| layout.map_or_else(Vec::new, |layout| layout.shown_angles);
        Self(BodyLayout::all(stage).into_iter().map(shown).collect())
    }

    /// The columns' names, `elbow_r_flexion_deg` and so on, with [`prefix_of`] in front; `stage` is the one that these were made of.
    pub fn names(&self, stage: &Stage) -> Vec<String> {
        let of = |(index, layout): (BodyIndex, Option<BodyLayout>)| {
            let prefix = prefix_of(stage, index);
            let columns: Vec<String> = layout.iter().flat_map(BodyLayout::columns).collect();
            columns.into_iter().map(move |column| format!("{prefix}{column}"))
        };
        (0..).zip(BodyLayout::all(stage)).flat_map(of).collect()
    }

    /// Appends the bodies' angles, degrees, in the order of [`Self::names`], to what [`write()`] and
    /// [`InertialColumns::append`] wrote of the estimate; `latest` gives the newest of a body. An angle that is not known is `None`; all are where there is no body,
    /// or it is older than the estimate by more than [`BODY_AGE_S`].
    pub fn append<'a>(
        &self,
        latest: impl Fn(BodyIndex) -> Option<&'a Body>,
        estimate: &Estimate,
        row: &mut Vec<Option<f64>>,
    ) {
        let fresh = |body: &&Body| estimate.t_valid.seconds_since(body.t_valid) <= BODY_AGE_S;
        for (index, angles) in (0..).zip(&self.0) {
            let body = latest(index).filter(fresh);
            row.extend(angles.iter().map(|angle| Some(body?.angles_rad[*angle]?.to_degrees())));
        }
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

    #[test]
    fn a_single_inertial_sensor_gives_what_it_measured_and_the_sensors_of_a_body_do_not() {
        let text = "name = \"s\"\n[[device]]\nname = \"chain\"\ndriver = \"xbus\"\nport = \"auto\"\n\
                    [[sensor]]\nname = \"watch\"\ndevice = \"chain\"\naddress = 1\n";
        let stage: Stage = toml::from_str(text).unwrap();
        let columns = columns_of(&stage);
        assert_eq!(columns[7..], ["ax", "ay", "az", "gx", "gy", "gz"].map(|axis| format!("watch_{axis}")));
        let measured = |state| SensorEstimate {
            state,
            measured: Some(crate::output::Measured {
                t_valid: posed_drivers::Timestamp::default(),
                position_m: None,
                clipped: false,
                orientation_wxyz: None,
                button: None,
                inertial: Some(crate::output::Inertial {
                    angular_velocity_rad_s: Some([4.0, 5.0, 6.0]),
                    specific_force_m_s2: Some([1.0, 2.0, 3.0]),
                    ..Default::default()
                }),
            }),
            ..SensorEstimate::default()
        };
        let row = |state| {
            let mut row = Vec::new();
            let estimate = Estimate { sensors: vec![measured(state)], ..Estimate::default() };
            write(&estimate, &mut row);
            InertialColumns::of(&stage).append(&estimate, &mut row);
            row
        };
        assert_eq!(row(SensorState::Ok)[7..], [1.0, 2.0, 3.0, 4.0, 5.0, 6.0].map(Some));
        assert_eq!(row(SensorState::Stuck)[7..], [None; 6]);
        let with_body = format!(
            "{text}segment = \"forearm_r\"\n[body]\nskeleton = \"human\"\nheight_m = 1.8\nmounting = \"calibrate\"\n"
        );
        let with_body: Stage = toml::from_str(&with_body).unwrap();
        assert_eq!(InertialColumns::of(&with_body), InertialColumns::default());
    }

    #[test]
    fn a_wearer_has_no_channels_of_what_nobody_wears() {
        let text = "name = \"s\"\n[[device]]\nname = \"flock\"\ndriver = \"flock-of-birds\"\nport = \"auto\"\n\
                    [[sensor]]\nname = \"forearm_r\"\ndevice = \"flock\"\naddress = 1\n\
                    [[sensor]]\nname = \"wand\"\ndevice = \"flock\"\naddress = 2\n";
        let free: Stage = toml::from_str(text).unwrap();
        assert_eq!(columns_of_wearer(&free, 0), columns_of(&free));
        let with_body: Stage = toml::from_str(&format!("{text}[body]\nheight_m = 1.8\n")).unwrap();
        let all = columns_of(&with_body);
        let expected: Vec<String> = all.iter().filter(|name| !name.starts_with("wand")).cloned().collect();
        assert_eq!(columns_of_wearer(&with_body, 0), expected);
        assert_eq!(expected.len(), all.len() - PARTS.len());
    }
}
