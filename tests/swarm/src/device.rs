//! The devices of a stage: what kind, at what port, how they behave, and how far they can be held to the truth.

use posed_drivers::{fastrak, flock, motionstar, open_imu, polhemus, slimevr, witmotion, x_imu3, xbus};
use posed_simulator::faults::Fault;
use posed_simulator::inertial::ImuClass;
use posed_simulator::scenario::{DeviceScenario, Personality};
use schemars::schema_for;
use serde_json::Value;

use crate::dice::Dice;
use crate::settings::Setting;

/// How far a device can be held to the truth.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Honesty {
    /// What is published of it can be compared: its settings do not say of the device what is not so.
    pub(crate) judged: bool,
    /// It streams again once nothing is wrong with it.
    pub(crate) returns: bool,
    /// It measures more seldom than a limb can be followed by a gyroscope, 10 Hz.
    pub(crate) seldom: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Flock,
    Fastrak,
    MotionStar,
    Xbus,
    XImu3,
    SlimeVr,
    Polhemus,
    WitMotion,
    OpenImu,
}

const KINDS: [Kind; 9] = [
    Kind::Flock,
    Kind::Fastrak,
    Kind::MotionStar,
    Kind::Xbus,
    Kind::XImu3,
    Kind::SlimeVr,
    Kind::Polhemus,
    Kind::WitMotion,
    Kind::OpenImu,
];

/// A device as it stands before its settings are drawn.
pub(crate) struct Device {
    pub(crate) kind: Kind,
    pub(crate) port: String,
    pub(crate) baud: u32,
    pub(crate) addresses: Vec<u16>,
    pub(crate) modem_lines: bool,
    pub(crate) behaviour: DeviceScenario,
}

impl Kind {
    pub(crate) fn word(self) -> &'static str {
        match self {
            Self::Flock => "flock-of-birds",
            Self::Fastrak => "fastrak",
            Self::MotionStar => "motionstar",
            Self::Xbus => "xbus",
            Self::XImu3 => "x-imu3",
            Self::SlimeVr => "slimevr",
            Self::Polhemus => "polhemus",
            Self::WitMotion => "witmotion",
            Self::OpenImu => "open-imu",
        }
    }

    pub(crate) fn schema(self) -> Value {
        let schema = match self {
            Self::Flock => schema_for!(flock::Settings),
            Self::Fastrak => schema_for!(fastrak::Settings),
            Self::MotionStar => schema_for!(motionstar::Settings),
            Self::Xbus => schema_for!(xbus::Settings),
            Self::XImu3 => schema_for!(x_imu3::Settings),
            Self::SlimeVr => schema_for!(slimevr::Settings),
            Self::Polhemus => schema_for!(polhemus::Settings),
            Self::WitMotion => schema_for!(witmotion::Settings),
            Self::OpenImu => schema_for!(open_imu::Settings),
        };
        schema.to_value()
    }

    /// Whether its host sets nothing at it, so that what it sends wrongly it goes on sending.
    pub(crate) fn is_left_alone(self) -> bool {
        matches!(self, Self::SlimeVr | Self::OpenImu | Self::WitMotion)
    }

    pub(crate) fn is_magnetic(self) -> bool {
        matches!(self, Self::Flock | Self::Fastrak | Self::MotionStar | Self::Polhemus)
    }

    /// Whether bytes can be damaged so that nothing on the wire shows it. In a Flock's records bit 7 is known. An Xbus message has a
    /// sum of one byte, which two flips of one bit in it leave as it was: always those of bit 7, half of the others.
    pub(crate) fn cannot_see(self, fault: &Fault) -> bool {
        match fault {
            Fault::DataBitFlips(bytes) => self != Self::Xbus || bytes.count > 1,
            Fault::Bit7Flips(bytes) => self != Self::Flock && (self != Self::Xbus || bytes.count > 1),
            _ => false,
        }
    }

    /// What a setting says of the device, where it is not what the virtual device is.
    pub(crate) fn honesty(self, Setting { key, value }: &Setting) -> Honesty {
        let judged = match key.as_str() {
            // The hands move before the transmitter, and the units send what they were built to.
            "hemisphere" => value.as_str() == Some("forward"),
            "quaternion_sense" => value.as_str() == Some("vendor"),
            // An answer holds the latest measurement, and nobody can tell for how long it has waited.
            "mode" => value.as_str() != Some("point"),
            _ => true,
        };
        let returns = match key.as_str() {
            // They name other hardware than there is.
            "units" | "addressing" | "transmitter_address" | "transmitter_number" => false,
            // The unit has another one, and says so.
            "range_in" => value.as_integer() != Some(144),
            // Nobody has set it up.
            "mode" => value.as_str() != Some("listen"),
            "hemisphere" | "quaternion_sense" => judged,
            _ => true,
        };
        let seldom = key == "rate_hz" && value.as_float().is_some_and(|rate_hz| rate_hz < 10.0);
        Honesty { judged, returns, seldom }
    }
}

pub(crate) fn device(dice: &mut Dice, index: usize) -> Device {
    let kind = *dice.pick(&KINDS);
    let serial = || format!("/dev/ttyUSB{index}");
    let tcp = || format!("tcp://127.0.0.1:{}", 6000 + index);
    let udp = || format!("udp://127.0.0.1:{}", 7000 + index);
    let count = 1 + dice.below(4) as u16;
    let mut xbus = None;
    let (port, baud, addresses): (String, u32, Vec<u16>) = match kind {
        Kind::Flock if count == 1 && dice.chance(0.5) => (serial(), 115_200, vec![0]),
        // A line that is full holds records back for a time that nobody can know.
        Kind::Flock => (serial(), 115_200, (1..=count).collect()),
        Kind::Fastrak => (serial(), 115_200, (1..=count).collect()),
        Kind::MotionStar => (if dice.chance(0.5) { tcp() } else { udp() }, 115_200, (1..=count).collect()),
        Kind::Xbus if count == 1 => {
            xbus = Some(*dice.pick(&[Personality::Mti, Personality::Mtx, Personality::Chain]));
            (serial(), *dice.pick(&[115_200, 921_600]), vec![1])
        }
        Kind::Xbus => (serial(), 921_600, (1..=count).collect()),
        Kind::XImu3 if count > 2 => (serial(), 115_200, (1..=count - 1).collect()),
        Kind::XImu3 => (if dice.chance(0.5) { serial() } else { udp() }, 115_200, vec![0]),
        // Through a receiver on USB, or by a network.
        Kind::SlimeVr if dice.chance(0.3) => (format!("/dev/hidraw{index}"), 115_200, (1..=count).collect()),
        Kind::SlimeVr => (udp(), 115_200, (1..=count).collect()),
        // A line that carries all stations at 240 Hz.
        Kind::Polhemus => (serial(), 921_600, (1..=count).collect()),
        Kind::WitMotion => (serial(), 115_200, vec![0]),
        Kind::OpenImu => {
            let port = if dice.chance(0.3) { "websocket".to_owned() } else { udp() };
            (port, 115_200, (1..=count).collect())
        }
    };
    let on_line = port.starts_with("/dev/tty");
    let behaviour = DeviceScenario {
        name: format!("d{index}"),
        rate_hz: *dice.pick(&[100.0, 103.3, 120.0, 60.0, 50.0]),
        drift_ppm: dice.range(-100.0, 100.0),
        burst_ms: *dice.pick(&[0.0, 0.0, 0.0, 1.0, 16.0]),
        fifo_bytes: *dice.pick(&[1, 8, 8, 8, 64, 64, 4096, 4096]),
        boot_ms: dice.range(100.0, 1500.0),
        imu: *dice.pick(&[ImuClass::Ideal, ImuClass::Mtx, ImuClass::Mtx, ImuClass::Mpu]),
        xbus,
        ..DeviceScenario::default()
    };
    Device { kind, port, baud, addresses, modem_lines: on_line && dice.chance(0.5), behaviour }
}

impl Device {
    /// Its table in the stage file, as the device number `at`; its settings are not in it.
    pub(crate) fn table(&self, at: usize, delay_ms: f64) -> toml::Table {
        let mut table = toml::Table::new();
        table.insert("name".into(), format!("d{at}").into());
        table.insert("driver".into(), self.kind.word().into());
        table.insert("port".into(), self.port.clone().into());
        table.insert("baud".into(), i64::from(self.baud).into());
        if self.kind == Kind::SlimeVr {
            // Without a list they are numbered as they come, and nobody can say which is which.
            let name = |number: &u16| toml::Value::String(format!("A4:CF:12:D4:{at:02X}:{number:02X}"));
            table.insert("trackers".into(), self.addresses.iter().map(name).collect::<Vec<_>>().into());
        }
        if self.kind == Kind::OpenImu {
            let name = |number: &u16| toml::Value::String(format!("board-{at}-{number}"));
            table.insert("devices".into(), self.addresses.iter().map(name).collect::<Vec<_>>().into());
        }
        if delay_ms > 0.0 {
            table.insert("measurement_delay_ms".into(), delay_ms.into());
        }
        table
    }
}
