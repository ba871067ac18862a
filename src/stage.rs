//! The stage file: which devices and sensors there are, and who may look.
//!
//! TOML; unknown keys are errors; every key carries its unit. `config/README.md` is the reference.

use serde::{Deserialize, Serialize};

/// A stage file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// Shown to clients.
    pub name: String,
    /// Ticks of the stage clock per second; absent: the ticks follow the fastest device.
    pub frame_rate_hz: Option<f64>,
    /// How long a frame waits for its last sensors, ms.
    #[serde(default = "default_frame_wait_ms")]
    pub frame_wait_ms: f64,
    /// The magnetic transmitter.
    #[serde(default)]
    pub transmitter: Transmitter,
    /// Devices, in the order of `DeviceIndex`.
    #[serde(default, rename = "device")]
    pub devices: Vec<Device>,
    /// Sensors, in the order of `SensorIndex`.
    #[serde(default, rename = "sensor")]
    pub sensors: Vec<Sensor>,
    /// Websocket, page and metrics.
    #[serde(default)]
    pub server: Server,
    /// Where recordings go and come from.
    #[serde(default)]
    pub recording: Recording,
    /// What `posed demo` and `posed simulate` put in the devices' place; checked by the simulator.
    #[serde(default)]
    #[schemars(with = "Option<serde_json::Map<String, serde_json::Value>>")]
    pub simulation: Option<toml::Table>,
}

fn default_frame_wait_ms() -> f64 {
    5.0
}

/// The magnetic transmitter.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Transmitter {
    /// Transmitter to room; absent: the room's axes are the tracker's own.
    pub pose_in_room: Option<Pose>,
}

/// A pose: the named frame in the room.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Pose {
    /// Position, m.
    pub position_m: [f64; 3],
    /// Unit quaternion, scalar first.
    pub orientation_wxyz: [f64; 4],
}

/// One device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Device {
    /// Unique name.
    pub name: String,
    /// Path of a serial port, `tcp://HOST:PORT`, `udp://HOST:PORT` or `auto`.
    pub port: String,
    /// Line rate, bit/s.
    #[serde(default = "default_baud")]
    pub baud: u32,
    /// Constant delay from measurement to the record's first byte, ms.
    #[serde(default)]
    pub measurement_delay_ms: f64,
    /// The driver and its settings.
    #[serde(flatten)]
    pub driver: Driver,
}

fn default_baud() -> u32 {
    115_200
}

/// A driver by name, with its settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(tag = "driver", rename_all = "kebab-case")]
pub enum Driver {
    /// Ascension Flock of Birds. (Settings: `posed_drivers::flock::Settings`, to be joined here.)
    FlockOfBirds {},
}

/// One sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Unique name; a segment's name gives it a role.
    pub name: String,
    /// Name of its device.
    pub device: String,
    /// Address on the device; 0 is a stand-alone unit.
    pub address: u16,
}

/// Websocket, page and metrics.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Server {
    /// Address to listen on; absent: 127.0.0.1:8787. Anything but loopback needs a token.
    pub listen: Option<String>,
    /// Who may do what.
    #[serde(default, rename = "token")]
    pub tokens: Vec<Token>,
    /// Origins of browser pages that may connect, beside the daemon's own.
    #[serde(default)]
    pub allowed_origins: Vec<String>,
    /// Certificate and key for TLS.
    pub tls: Option<Tls>,
}

/// An access token.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Token {
    /// The secret, at least 16 characters.
    pub secret: String,
    /// What its bearer may do.
    pub role: Role,
}

/// What a client may do.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, schemars::JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Subscribe.
    Watch,
    /// Subscribe and request.
    Operate,
}

/// TLS by files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Tls {
    /// PEM file with the certificate chain.
    pub certificate: std::path::PathBuf,
    /// PEM file with the private key.
    pub key: std::path::PathBuf,
}

/// Where recordings live.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Recording {
    /// The one folder that `record.start` writes to and `replay.list` reads; absent: `recordings` beside the stage file.
    pub folder: Option<std::path::PathBuf>,
}
