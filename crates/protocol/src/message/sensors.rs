//! Topic `sensors`: poses of one frame.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use posed_stage::output::{FrameLabel, SensorLabel, SensorState};

/// Body of `sensors`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Sensors {
    /// Capture time that the poses belong to, s; rises strictly.
    pub t_s: f64,
    /// Number of the frame (field `quality`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<u64>,
    /// Standard deviation of the capture time itself, s (field `quality`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_t_s: Option<f64>,
    /// What the fault map reports about the frame (field `fault`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fault: Option<FrameLabel>,
    /// The subscribed sensors, in the stage file's order.
    pub sensors: Vec<SensorEntry>,
}

/// One sensor in one frame. `name` and `state` are always there; the others as `fields` asks for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SensorEntry {
    /// Its name.
    pub name: String,
    /// Its device's name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// How far to trust it; only `ok`, `repaired` and `extrapolated` are poses to use.
    pub state: SensorState,
    /// Filtered position in the room, m; null where there is no estimate, and for sensors that measure none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_m: Option<[f64; 3]>,
    /// Sensor to room, unit quaternion, scalar first; null where there is no estimate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Root mean square of the expected 3-D position error, m; null where there is no position.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_m: Option<f64>,
    /// The raw record, unfiltered, in device axes; null where none arrived.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<Measured>,
    /// Velocity in the room, m/s; null where there is no position.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub velocity_m_s: Option<[f64; 3]>,
    /// Angular velocity in sensor axes, rad/s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub angular_velocity_rad_s: Option<[f64; 3]>,
    /// Covariance of (position in room, m; rotation error in sensor axes, rad): the 21 numbers of the upper triangle
    /// of the 6 x 6 matrix, row by row.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub covariance: Option<Vec<f64>>,
    /// More on how good the pose is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quality: Option<Quality>,
    /// What the fault map reports about it; absent where the stage has none, or not for this sensor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fault: Option<SensorLabel>,
    /// The statistic of key poses; absent where they are not looked for, or not of this sensor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub change: Option<Change>,
}

/// The statistic of key poses: it speaks of an earlier frame, since it needs the frames around it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Change {
    /// Capture time of the frame that it speaks of, s.
    pub t_s: f64,
    /// How clear a change of motion there would be: without unit, comparable between sensors; with `method = "paper"`, m a frame.
    pub score: f64,
    /// What a peak must exceed to be a key pose; with `method = "paper"`, a share of the mean motion before it.
    pub threshold: f64,
}

/// A raw record in device axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Measured {
    /// Capture time of this record, s.
    pub t_s: f64,
    /// Position in device axes, m; null in orientation-only formats.
    pub position_m: Option<[f64; 3]>,
    /// Sensor to device axes; null in position-only formats.
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Button byte; null where button mode is off.
    pub button: Option<u8>,
    /// Angular rate of a body-worn sensor in its own axes, rad/s; this and the following only where the record holds them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub angular_velocity_rad_s: Option<[f64; 3]>,
    /// Specific force in sensor axes (+g on the axis that points up, at rest), m/s².
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub specific_force_m_s2: Option<[f64; 3]>,
    /// Acceleration in sensor axes with gravity taken out by the device, m/s².
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub linear_acceleration_m_s2: Option<[f64; 3]>,
    /// Magnetic field in sensor axes, about 1 at the place of calibration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub magnetic_field: Option<[f64; 3]>,
}

/// How good a pose is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Quality {
    /// Root mean square of the expected rotation error, rad.
    pub sigma_rotation_rad: f64,
    /// No record of this frame is in the pose: the IMU that is attached to the sensor carries it on, for half a second at most.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub coasted: bool,
}
