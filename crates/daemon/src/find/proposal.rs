//! What to write into a stage file for devices that answered.

use serde_json::{Map, Value, json};

use posed_drivers::Found;
use posed_drivers::flock::wire::Addressing;
use posed_protocol::{FoundPort, FoundSensor};
use posed_stage::edit::{Change, Table};
use posed_stage::{Device, Driver};

/// Notes at each port that has a usable device the changes that add it and every sensor it has. No name is one of `taken`, and none comes
/// twice.
pub fn propose<'p>(ports: impl IntoIterator<Item = &'p mut FoundPort>, taken: &[&str]) {
    let mut taken: Vec<String> = taken.iter().map(|&name| name.to_owned()).collect();
    for port in ports {
        if let Some(driver) = port.driver.clone()
            && !port.sensors.is_empty()
        {
            port.adds = additions(port, &driver, &mut taken);
        }
    }
}

/// Sensors that send to a device of the stage without being on it, with the changes that add them; `None` where there are none. No name is one
/// of `taken`.
pub fn newcomers(device: &Device, found: &[Found], taken: &[&str]) -> Option<FoundPort> {
    let Driver::OpenImu(settings) = &device.driver else { return None };
    let taken: Vec<String> = taken.iter().map(|&name| name.to_owned()).collect();
    let serial = |found: &Found| match found.sensor {
        0 => found.id.clone(),
        sensor => format!("{}/{sensor}", found.id),
    };
    let coming = found.iter().map(|found| {
        let called = serial(found).replace('/', "-");
        Newcomer { id: found.id.clone(), sensor: found.sensor, called }
    });
    let Joined { listed, addresses, sensors } = join(&device.name, &settings.devices, coming, taken);
    let set = (listed.len() > settings.devices.len()).then(|| list(&device.name, listed));
    (!sensors.is_empty()).then(|| FoundPort {
        port: device.port.clone(),
        driver: Some(device.driver.word().to_owned()),
        model: found.iter().find_map(|found| found.name.clone()).filter(|_| found.len() == 1),
        sensors: addresses
            .into_iter()
            .zip(found)
            .map(|(address, found)| FoundSensor { address, serial: Some(serial(found)) })
            .collect(),
        adds: set.into_iter().chain(sensors).collect(),
        ..FoundPort::default()
    })
}

/// A sensor that is to join a device of the open format: whose it is, and what to call it.
pub(crate) struct Newcomer {
    pub(crate) id: String,
    pub(crate) sensor: u8,
    pub(crate) called: String,
}

/// How newcomers join: the list of identifiers with theirs, and for each its address and the change that adds its sensor.
pub(crate) struct Joined {
    pub(crate) listed: Vec<String>,
    pub(crate) addresses: Vec<u16>,
    pub(crate) sensors: Vec<Change>,
}

/// Has newcomers join the device of this name, which lists these identifiers. No name is one of `taken`.
pub(crate) fn join(
    device: &str,
    listed: &[String],
    newcomers: impl IntoIterator<Item = Newcomer>,
    mut taken: Vec<String>,
) -> Joined {
    let mut joined = Joined { listed: listed.to_vec(), addresses: Vec::new(), sensors: Vec::new() };
    for Newcomer { id, sensor, called } in newcomers {
        // One whose identifier stands there already has lost its sensor only.
        let known = joined.listed.iter().position(|known| *known == id).unwrap_or_else(|| {
            joined.listed.push(id);
            joined.listed.len() - 1
        });
        let address = u16::from(sensor) << 8 | (known as u16 + 1);
        let name = take(&called, &mut taken);
        let keys = [("name", json!(name)), ("device", json!(device)), ("address", json!(address))];
        let keys = keys.map(|(key, value)| (key.to_owned(), value)).into_iter().collect();
        joined.addresses.push(address);
        joined.sensors.push(Change::Add { table: Table::Sensor, keys });
    }
    joined
}

/// The change that gives a device of the open format this list of identifiers.
pub(crate) fn list(device: &str, listed: Vec<String>) -> Change {
    let (name, key) = (device.to_owned(), "devices".to_owned());
    Change::Set { table: Table::Device, name, key, value: Some(json!(listed)) }
}

fn additions(port: &FoundPort, driver: &str, taken: &mut Vec<String>) -> Vec<Change> {
    let (short, unit) = names(driver);
    let device = take(short, taken);
    let mut keys = Map::new();
    let mut set = |key: &str, value: Value| _ = keys.insert(key.to_owned(), value);
    set("name", json!(device));
    set("driver", json!(driver));
    set("port", json!(port.port));
    if let Some(local_port) = port.local_port {
        set("local_port", json!(local_port));
    }
    if let Some(baud) = port.baud {
        set("baud", json!(baud));
    }
    if driver == "flock-of-birds" {
        set("format", json!("position-quaternion"));
        // The half-space around the transmitter that the sensors start in.
        set("hemisphere", json!("forward"));
        if let Some(addressing @ (Addressing::Expanded | Addressing::SuperExpanded)) = port.addressing {
            set("addressing", json!(addressing));
        }
        if let Some(family) = port.family {
            set("family", json!(family));
        }
    }
    // The device lists who its trackers are, and its sensors have their places in that list.
    let list = match driver {
        "slimevr" | "vrpn" => Some("trackers"),
        "open-imu" => Some("devices"),
        _ => None,
    };
    if let Some(list) = list {
        let mut listed: Vec<&str> = Vec::new();
        for tracker in port.sensors.iter().filter_map(|sensor| sensor.serial.as_deref()) {
            // The second sensor of a board is `board/1`.
            let device = if driver == "open-imu" { tracker.split('/').next() } else { Some(tracker) };
            listed.extend(device.filter(|device| !listed.contains(device)));
        }
        set(list, json!(listed));
    }
    let mut changes = vec![Change::Add { table: Table::Device, keys }];
    let prefix = if device == short { String::new() } else { format!("{device}-") };
    for sensor in &port.sensors {
        let name = take(&format!("{prefix}{unit}-{}", sensor.address), taken);
        let mut keys = Map::new();
        keys.insert("name".to_owned(), json!(name));
        keys.insert("device".to_owned(), json!(device));
        keys.insert("address".to_owned(), json!(sensor.address));
        if let Some(serial) = sensor.serial.as_deref().filter(|_| list.is_none()) {
            keys.insert("serial".to_owned(), json!(serial));
        }
        changes.push(Change::Add { table: Table::Sensor, keys });
    }
    changes
}

/// A name that nothing has yet: this one, or this one with a number.
pub fn free(name: &str, taken: &[String]) -> String {
    let mut all = std::iter::once(name.to_owned()).chain((2..).map(|n| format!("{name}-{n}")));
    all.find(|name| !taken.contains(name)).unwrap_or_default()
}

/// The same, which is taken from now on.
fn take(name: &str, taken: &mut Vec<String>) -> String {
    let found = free(name, taken);
    taken.push(found.clone());
    found
}

/// What a driver's devices and their sensors are called.
fn names(driver: &str) -> (&str, &str) {
    match driver {
        "flock-of-birds" => ("flock", "bird"),
        "motionstar" => ("star", "star"),
        "fastrak" => ("fastrak", "station"),
        "polhemus" => ("polhemus", "station"),
        "xbus" => ("chain", "tracker"),
        "x-imu3" => ("imu", "imu"),
        "slimevr" => ("trackers", "slime"),
        "vrpn" => ("mocap", "seen"),
        "open-imu" => ("boards", "board"),
        "witmotion" => ("imu", "imu"),
        other => (other, "sensor"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posed_stage::Stage;
    use posed_stage::edit::edit;

    fn text(ports: &[FoundPort], taken: &[&str]) -> String {
        let mut ports = ports.to_vec();
        propose(&mut ports, taken);
        let changes: Vec<Change> = ports.into_iter().flat_map(|port| port.adds).collect();
        edit("name = \"Stage\"\n", &changes).unwrap()
    }

    fn port(port: &str, addresses: &[u16]) -> FoundPort {
        FoundPort {
            port: port.to_owned(),
            driver: Some("flock-of-birds".to_owned()),
            baud: Some(57_600),
            addressing: Some(Addressing::Expanded),
            sensors: addresses
                .iter()
                .map(|address| FoundSensor { address: *address, serial: None })
                .collect(),
            ..FoundPort::default()
        }
    }

    #[test]
    fn a_written_stage_holds_what_answered() {
        let text = text(
            &[port("/dev/ttyUSB0", &[1, 20]), port("/dev/tty\"odd", &[0]), port("/dev/ttyS0", &[])],
            &[],
        );
        let stage = Stage::parse(&text).unwrap();
        let devices: Vec<&str> = stage.devices.iter().map(|device| device.name.as_str()).collect();
        assert_eq!(devices, ["flock", "flock-2"]);
        assert_eq!((stage.devices[0].baud, stage.devices[1].port.as_str()), (57_600, "/dev/tty\"odd"));
        let sensors: Vec<(&str, u16)> = stage.sensors.iter().map(|s| (s.name.as_str(), s.address)).collect();
        assert_eq!(sensors, [("bird-1", 1), ("bird-20", 20), ("flock-2-bird-0", 0)]);
    }

    #[test]
    fn every_kind_of_device_makes_a_stage_that_is_taken() {
        let report = |driver, port: &str, sensors: &[(u16, &str)]| FoundPort {
            port: port.to_owned(),
            driver: Some(str::to_owned(driver)),
            sensors: sensors
                .iter()
                .map(|(address, serial)| FoundSensor {
                    address: *address,
                    serial: Some((*serial).to_owned()),
                })
                .collect(),
            ..FoundPort::default()
        };
        let ports = [
            FoundPort {
                baud: Some(460_800),
                ..report("xbus", "/dev/ttyUSB0", &[(1, "00342D07"), (2, "00342D08")])
            },
            FoundPort {
                local_port: Some(8001),
                ..report("x-imu3", "udp://10.0.0.7:9000", &[(0, "6A3F20C1")])
            },
            report("x-imu3", "/dev/ttyACM0", &[(0, "6A3F20C2")]),
            report("slimevr", "udp://0.0.0.0:6969", &[(1, "A4:CF:12:D4:E5:F6")]),
            FoundPort {
                sensors: vec![FoundSensor { address: 2, serial: None }],
                ..report("motionstar", "tcp://10.0.0.8:6000", &[])
            },
            FoundPort {
                sensors: vec![FoundSensor { address: 1, serial: None }],
                ..report("fastrak", "/dev/ttyUSB1", &[])
            },
            report(
                "open-imu",
                "udp://0.0.0.0:9301",
                &[(1, "esp-7f3a"), (2, "esp-7f3b"), (0x101, "esp-7f3a/1")],
            ),
            FoundPort {
                baud: Some(115_200),
                sensors: vec![FoundSensor { address: 16, serial: None }],
                ..report("polhemus", "/dev/ttyUSB2", &[])
            },
            FoundPort {
                baud: Some(9_600),
                sensors: vec![FoundSensor { address: 0, serial: None }],
                ..report("witmotion", "/dev/ttyUSB3", &[])
            },
            report("vrpn", "tcp://10.0.0.9:3883", &[(1, "Head"), (2, "Wand \"A\""), (258, "Wand \"A\"")]),
        ];
        let stage = Stage::parse(&text(&ports, &[])).unwrap();
        let drivers: Vec<&str> = stage.devices.iter().map(|device| device.driver.word()).collect();
        assert_eq!(
            drivers,
            [
                "xbus",
                "x-imu3",
                "x-imu3",
                "slimevr",
                "motionstar",
                "fastrak",
                "open-imu",
                "polhemus",
                "witmotion",
                "vrpn"
            ]
        );
        assert_eq!((stage.devices[2].name.as_str(), stage.devices[1].local_port), ("imu-2", Some(8001)));
        assert_eq!(stage.sensors[1].serial.as_deref(), Some("00342D08"));
    }

    #[test]
    fn names_that_stand_in_the_file_are_not_proposed_again() {
        let text = text(&[port("/dev/ttyUSB0", &[1, 2])], &["flock", "flock-2-bird-2"]);
        let stage = Stage::parse(&text).unwrap();
        assert_eq!(stage.devices[0].name, "flock-2");
        let sensors: Vec<&str> = stage.sensors.iter().map(|sensor| sensor.name.as_str()).collect();
        assert_eq!(sensors, ["flock-2-bird-1", "flock-2-bird-2-2"]);
    }

    #[test]
    fn who_sends_to_a_port_of_the_stage_can_be_added_to_it() {
        let text = "name = \"s\"\n[[device]]\nname = \"boards\"\ndriver = \"open-imu\"\nport = \"udp://0.0.0.0:9301\"\ndevices = [\"a\"]\n\
                    [[sensor]]\nname = \"hand\"\ndevice = \"boards\"\naddress = 1\n";
        let stage = Stage::parse(text).unwrap();
        let found =
            |id: &str, sensor| Found { id: id.to_owned(), sensor, name: None, place: None, rate_hz: None };
        assert_eq!(newcomers(&stage.devices[0], &[], &[]), None);
        let port = newcomers(&stage.devices[0], &[found("a", 1), found("b", 0)], &["b"]).unwrap();
        let stage = Stage::parse(&edit(text, &port.adds).unwrap()).unwrap();
        let sensors: Vec<(&str, u16)> =
            stage.sensors.iter().map(|sensor| (sensor.name.as_str(), sensor.address)).collect();
        assert_eq!(sensors, [("hand", 1), ("a-1", 0x101), ("b-2", 2)]);
        let Driver::OpenImu(settings) = &stage.devices[0].driver else { panic!() };
        assert_eq!(settings.devices, ["a", "b"]);
    }

    #[test]
    fn what_has_no_sensor_is_not_proposed() {
        assert_eq!(text(&[port("/dev/ttyUSB0", &[])], &[]), "name = \"Stage\"\n");
    }
}
