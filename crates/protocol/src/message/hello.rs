//! The first message on every connection.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Topic;
use posed_stage::{Pose, Role, Skeleton};

/// Who speaks, and what there is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Hello {
    /// Version of the daemon.
    pub version: String,
    /// Name of the stage.
    pub stage: String,
    /// The stage's epoch: UTC in RFC 3339 with nanoseconds.
    pub epoch_utc: String,
    /// The bodies that wear sensors, in the stage's order.
    #[serde(default)]
    pub bodies: Vec<HelloBody>,
    /// The first body's skeleton; null on a stage without a body.
    pub skeleton: Option<Skeleton>,
    /// Its height, m: gives the lengths of the segments; null where it is not known.
    pub height_m: Option<f64>,
    /// Topics that this stage publishes.
    pub topics: Vec<Topic>,
    /// The stage's sensors, in the order of the `sensors` message.
    pub sensors: Vec<HelloSensor>,
    /// Magnetic transmitter to room, as the stage file has it; a `field` event tells when it is changed.
    pub transmitter: Pose,
    /// Whether the stage file says how the transmitter stands; without, `transmitter` is where the room's axes are taken from.
    #[serde(default)]
    pub transmitter_given: bool,
    /// What this client may do.
    pub role: Role,
    /// Number of the newest event, 0 before the first: what a client that starts now has not missed.
    pub last_event_id: u64,
}

/// Who wears sensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HelloBody {
    /// Its name.
    pub name: String,
    /// Colour that it is to be drawn in, `#rrggbb`.
    pub color: String,
    /// Its skeleton.
    pub skeleton: Skeleton,
    /// Its height, m: gives the lengths of its segments; null where it is not known.
    pub height_m: Option<f64>,
}

/// A sensor by name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct HelloSensor {
    /// Its name.
    pub name: String,
    /// Its device's name.
    pub device: String,
    /// Whether it is a magnetic tracker's, and so measures positions.
    pub magnetic: bool,
}
