//! IMUs that are attached to magnetic sensors: each is one, and belongs to one.

use super::super::Stage;
use super::super::problem::Notes;
use super::{Item, suggest};

pub(super) fn check(root: &Item<'_, '_>, stage: &Stage, notes: &mut Notes<'_>) {
    let imus: Vec<&str> =
        stage.sensors.iter().filter(|s| stage.is_imu(s)).map(|sensor| sensor.name.as_str()).collect();
    let mut taken: Vec<&str> = Vec::new();
    for (parsed, sensor) in stage.sensors.iter().zip(&root.items("sensor")) {
        let Some(imu) = sensor.item("imu") else { continue };
        if stage.is_imu(parsed) {
            let fix = "write `imu` at the sensor of the magnetic tracker";
            notes.problem(&imu.header, "imu", "this sensor is an IMU itself", fix);
        }
        if imu.has("quat_wxyz") && stage.transmitter.pose_in_room.is_none() {
            let message = "without `transmitter.pose_in_room` nobody knows where gravity points";
            let fix = "add it, or leave `quat_wxyz` out: `stage.align` finds both";
            notes.problem(&imu.header, "quat_wxyz", message, fix);
        }
        let Some(name) = imu.text("sensor") else { continue };
        if !imus.contains(&name.value) {
            let message = format!("there is no IMU `{}`", name.value);
            notes.problem(
                &name.at,
                "sensor",
                message,
                suggest(name.value, &imus, "add a [[sensor]] of an inertial device"),
            );
        } else if taken.contains(&name.value) {
            let message = format!("`{}` is attached to another sensor already", name.value);
            notes.problem(&name.at, "sensor", message, "give each magnetic sensor an IMU of its own");
        }
        taken.push(name.value);
    }
}
