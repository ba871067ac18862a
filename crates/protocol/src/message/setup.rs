//! Setting up a stage: what its file says and what is wrong with it; what answers at the ports.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use posed_drivers::flock::Family;
use posed_drivers::flock::wire::Addressing;
use posed_stage::edit::{Change, Table};

/// A stage file, as it is or as it would be with changes, and what is wrong with it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Setup {
    /// Name of the file.
    pub file: String,
    /// Which contents of the file this was made from; `setup.save` is refused where it has others by then.
    pub revision: String,
    /// Why it cannot be changed from here; null where it can.
    pub why_not: Option<String>,
    /// The text, with a placeholder for every secret.
    pub toml: String,
    /// The stage's name; empty where none stands there.
    pub name: String,
    /// Its devices, in their order.
    pub devices: Vec<SetupDevice>,
    /// Its sensors, in their order.
    pub sensors: Vec<SetupSensor>,
    /// Its bodies, in their order.
    pub bodies: Vec<SetupBody>,
    /// What is wrong: the stage cannot run like this. As `posed check` says it.
    pub problems: Vec<SetupProblem>,
    /// What works, but hardly as it was meant.
    pub warnings: Vec<SetupProblem>,
}

/// A device of a stage file; texts that are not there are empty.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SetupDevice {
    /// Its name.
    pub name: String,
    /// Its driver.
    pub driver: String,
    /// Its port.
    pub port: String,
}

/// A sensor of a stage file; texts that are not there are empty.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SetupSensor {
    /// Its name.
    pub name: String,
    /// Its device, by name.
    pub device: String,
    /// Its address on the device.
    pub address: u16,
    /// The body that wears it, by name; null: the only one.
    pub body: Option<String>,
    /// The segment that it sits on, as its `segment` or its name says; null: on none.
    pub segment: Option<String>,
}

/// A body of a stage file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SetupBody {
    /// Its name.
    pub name: String,
    /// Height of the person, m; null where it is not given.
    pub height_m: Option<f64>,
}

/// Something that is wrong with a stage file, or doubtful.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SetupProblem {
    /// Line of the text, from 1.
    pub line: usize,
    /// The key it is about; may be empty.
    pub key: String,
    /// What is wrong.
    pub message: String,
    /// What to do about it.
    pub fix: String,
    /// What it is about, where it is a device, a sensor or a body; null: something else.
    pub table: Option<Table>,
    /// Which one, by the name that stands there.
    pub name: Option<String>,
}

/// The `result` of a job of `setup.find`, of `posed doctor` likewise; grows while ports answer.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Found {
    /// What was found at each port.
    pub ports: Vec<FoundPort>,
}

/// What was found at one port.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FoundPort {
    /// The port as a stage file names it.
    pub port: String,
    /// Port of this computer that the device sends to, where it has a certain one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub local_port: Option<u16>,
    /// The device of this stage that the port belongs to, by name: it is not asked. Absent where there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// The driver that understands what is there; null where nothing answers.
    pub driver: Option<String>,
    /// Software revision, such as `3.67`.
    pub revision: Option<String>,
    /// Model as the unit writes it.
    pub model: Option<String>,
    /// Line rate at which it answers, bit/s.
    pub baud: Option<u32>,
    /// How units on the bus are numbered.
    pub addressing: Option<Addressing>,
    /// Which of Ascension's units it is, where it is no Flock of Birds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub family: Option<Family>,
    /// Measurement rate, Hz.
    pub rate_hz: Option<f64>,
    /// Units that have a sensor, by rising address.
    pub sensors: Vec<FoundSensor>,
    /// What is wrong.
    pub problem: Option<String>,
    /// What to do about it.
    pub fix: Option<String>,
    /// The changes that add the device with its sensors to the stage file; none where nothing usable answers.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub adds: Vec<Change>,
}

/// One unit with a sensor.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FoundSensor {
    /// Address on the device; 0 is a stand-alone unit.
    pub address: u16,
    /// Serial number, where the device reports one; a SlimeVR tracker's network address.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
}
