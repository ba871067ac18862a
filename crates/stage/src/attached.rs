//! An IMU that is attached to a magnetic sensor.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which sensor it is, and how it sits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AttachedImu {
    /// Name of the sensor that it is, on an inertial device.
    pub sensor: String,
    /// Unit quaternion that turns the IMU's coordinates into the magnetic sensor's, scalar first; absent: `stage.align` finds it,
    /// and until then the two stay apart.
    pub quat_wxyz: Option<[f64; 4]>,
    /// From the magnetic sensor to the IMU, the magnetic sensor's axes, m.
    #[serde(default)]
    pub offset_m: [f64; 3],
    /// Capture time of a magnetic record on the IMU's clock minus the one it is given, ms.
    #[serde(default)]
    #[schemars(range(min = -200.0, max = 200.0))]
    pub clock_offset_ms: f64,
}
