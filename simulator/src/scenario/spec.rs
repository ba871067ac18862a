//! What the simulator needs to know of a stage.

use posed_drivers::flock::Family;
use posed_drivers::flock::wire::Hemisphere;
use serde::{Deserialize, Deserializer, Serialize};

/// The parts of a stage file that the simulator needs, without the types of its reader. Nothing in it is checked.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StageSpec {
    /// Position (m) and quaternion (w, x, y, z) of the transmitter in the room, transmitter to room; absent: the room's axes are
    /// the tracker's.
    pub transmitter_in_room: Option<([f64; 3], [f64; 4])>,
    /// Devices, in the stage's order.
    pub devices: Vec<DeviceSpec>,
    /// Sensors, in the stage's order.
    pub sensors: Vec<SensorSpec>,
}

impl StageSpec {
    /// Picks what the simulator needs out of a stage: anything that is written like a stage file.
    ///
    /// # Errors
    /// A key is missing or of another kind than in a stage file.
    pub fn of(stage: &impl Serialize) -> Result<Self, serde_json::Error> {
        #[derive(Deserialize)]
        struct File {
            #[serde(default)]
            transmitter: Transmitter,
            #[serde(default)]
            device: Vec<DeviceSpec>,
            #[serde(default)]
            sensor: Vec<SensorSpec>,
        }
        #[derive(Default, Deserialize)]
        struct Transmitter {
            pose_in_room: Option<Pose>,
        }
        #[derive(Deserialize)]
        struct Pose {
            position_m: [f64; 3],
            orientation_wxyz: [f64; 4],
        }
        let file: File = serde_json::from_value(serde_json::to_value(stage)?)?;
        Ok(Self {
            transmitter_in_room: file
                .transmitter
                .pose_in_room
                .map(|pose| (pose.position_m, pose.orientation_wxyz)),
            devices: file.device,
            sensors: file.sensor,
        })
    }
}

/// A device of the stage; by its keys in a stage file.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct DeviceSpec {
    /// Its name, by which a scenario and the sensors name it.
    pub name: String,
    /// Its driver: `flock-of-birds`, `xbus`, `x-imu3`, `slimevr`, `motionstar`, `fastrak`, `polhemus`, `vrpn`, `witmotion`, `open-imu`.
    pub driver: String,
    /// Its port: `tcp://...` and `udp://...` name a network, anything else a serial line; empty by default. `auto` of SlimeVR is
    /// `udp://127.0.0.1:6969`.
    #[serde(default)]
    pub port: String,
    /// What its units call themselves, in the order of their numbers, where the stage names them: network addresses like
    /// `A4:CF:12:D4:E5:F6` (SlimeVR; a unit without one gets an address of its own), names of trackers (VRPN).
    #[serde(default, rename = "trackers")]
    pub serials: Vec<String>,
    /// Identifiers of its devices, in the order of their numbers (open-imu).
    #[serde(default)]
    pub devices: Vec<String>,
    /// Line rate, bit/s: 115 200 where a stage file has none, 0 in the `Default` of this type.
    #[serde(default = "usual_baud")]
    pub baud: u32,
    /// Constant delay from measurement to the record's first bit, ms; below 0 counts as 0, the default.
    #[serde(default)]
    pub measurement_delay_ms: f64,
    /// Which of Ascension's units it is (flock-of-birds).
    #[serde(default)]
    pub family: Family,
    /// Half-space around the transmitter in which its host looks for its sensors, as a direction in the transmitter's axes; absent:
    /// forward, along x. Sensors that no scenario moves move there.
    #[serde(default, deserialize_with = "direction")]
    pub hemisphere: Option<[f64; 3]>,
}

/// A half-space, by its word (Flock, MotionStar) or by its direction (Fastrak, Polhemus).
fn direction<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<[f64; 3]>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum HalfSpace {
        Word(Hemisphere),
        Direction([f64; 3]),
    }
    Ok(Some(match HalfSpace::deserialize(deserializer)? {
        HalfSpace::Word(hemisphere) => hemisphere.direction(),
        HalfSpace::Direction(direction) => direction,
    }))
}

impl DeviceSpec {
    /// Its port; SlimeVR trackers that are to be found anywhere call where all servers listen.
    pub(crate) fn port(&self) -> &str {
        if self.driver == "slimevr" && self.port == "auto" { "udp://127.0.0.1:6969" } else { &self.port }
    }

    /// Whether it is a receiver on USB, by its port: its reports come in envelopes.
    pub(crate) fn is_receiver(&self) -> bool {
        self.driver == "slimevr" && self.port.contains("/hidraw")
    }

    /// Whether a serial line limits what it sends: also behind a serial server on a network.
    pub(crate) fn has_line(&self) -> bool {
        let has_socket = matches!(self.driver.as_str(), "motionstar" | "x-imu3" | "vrpn");
        let by_tcp = has_socket && self.port().starts_with("tcp://");
        !by_tcp && !self.is_receiver() && !self.port().starts_with("udp://") && self.port() != "websocket"
    }
}

fn usual_baud() -> u32 {
    115_200
}

/// A sensor of the stage; by its keys in a stage file.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct SensorSpec {
    /// Its name, by which a scenario names it.
    pub name: String,
    /// Name of its device.
    pub device: String,
    /// Address on the device, as in the stage file: the driver says what it means.
    pub address: u16,
}
