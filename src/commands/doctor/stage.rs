//! A stage file for the devices that answered.

use posed_drivers::flock::wire::Addressing;
use posed_stage::Stage;

use super::PortReport;
use crate::commands::Error;

/// Writes a stage with every device that answered and every sensor it has.
///
/// # Errors
/// No device has a sensor.
pub(super) fn text(ports: &[PortReport]) -> Result<String, Error> {
    let usable: Vec<&PortReport> =
        ports.iter().filter(|port| port.driver.is_some() && !port.sensors.is_empty()).collect();
    if usable.is_empty() {
        return Err(Error::Failed("no device has a sensor, so there is no stage to write".to_owned()));
    }
    let mut text = String::from(
        "# Written by `posed doctor`. Every key is explained in config/README.md.\n\nname = \"Stage\"\n",
    );
    let mut sensors = String::new();
    let mut drivers: Vec<&str> = Vec::new();
    for port in usable {
        let driver = port.driver.unwrap_or_default();
        drivers.push(driver);
        let (short, unit) = names(driver);
        let device = match drivers.iter().filter(|other| **other == driver).count() {
            1 => short.to_owned(),
            n => format!("{short}-{n}"),
        };
        let prefix = if device == short { String::new() } else { format!("{device}-") };
        text.push_str(&format!(
            "\n[[device]]\nname = {}\ndriver = {}\nport = {}\n",
            quoted(&device),
            quoted(driver),
            quoted(&port.port)
        ));
        if let Some(local_port) = port.local_port {
            text.push_str(&format!("local_port = {local_port}\n"));
        }
        if let Some(baud) = port.baud {
            text.push_str(&format!("baud = {baud}\n"));
        }
        if driver == "flock-of-birds" {
            text.push_str("format = \"position-quaternion\"\n");
            text.push_str("hemisphere = \"forward\"          # the half-space around the transmitter that the sensors start in\n");
            match port.addressing {
                Some(Addressing::Expanded) => text.push_str("addressing = \"expanded\"\n"),
                Some(Addressing::SuperExpanded) => text.push_str("addressing = \"super-expanded\"\n"),
                Some(Addressing::Normal) | None => {}
            }
        }
        // The device lists who its trackers are, and its sensors have their places in that list.
        let by_list = matches!(driver, "slimevr" | "vrpn");
        if by_list {
            let mut listed: Vec<String> = Vec::new();
            for tracker in port.sensors.iter().filter_map(|sensor| sensor.serial.as_deref()).map(quoted) {
                if !listed.contains(&tracker) {
                    listed.push(tracker);
                }
            }
            text.push_str(&format!("trackers = [{}]\n", listed.join(", ")));
        }
        for sensor in &port.sensors {
            let name = format!("{prefix}{unit}-{}", sensor.address);
            sensors.push_str(&format!(
                "\n[[sensor]]\nname = {}\ndevice = {}\naddress = {}\n",
                quoted(&name),
                quoted(&device),
                sensor.address
            ));
            if let Some(serial) = sensor.serial.as_deref().filter(|_| !by_list) {
                sensors.push_str(&format!("serial = {}\n", quoted(serial)));
            }
        }
    }
    text.push_str(&sensors);
    // What is written must be what `check` and `run` take.
    Stage::parse(&text)
        .map_err(|problems| Error::Failed(format!("cannot write a stage for this: {problems}")))?;
    Ok(text)
}

/// What a driver's devices and their sensors are called.
fn names(driver: &str) -> (&str, &str) {
    match driver {
        "flock-of-birds" => ("flock", "bird"),
        "motionstar" => ("star", "star"),
        "fastrak" => ("fastrak", "station"),
        "xbus" => ("chain", "tracker"),
        "x-imu3" => ("imu", "imu"),
        "slimevr" => ("trackers", "slime"),
        "vrpn" => ("mocap", "seen"),
        other => (other, "sensor"),
    }
}

/// A TOML string.
fn quoted(text: &str) -> String {
    toml::Value::from(text).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::doctor::SensorReport;

    fn port(port: &str, addresses: &[u16]) -> PortReport {
        PortReport {
            port: port.to_owned(),
            driver: Some("flock-of-birds"),
            baud: Some(57_600),
            addressing: Some(Addressing::Expanded),
            sensors: addresses
                .iter()
                .map(|address| SensorReport { address: *address, serial: None })
                .collect(),
            ..PortReport::default()
        }
    }

    #[test]
    fn a_written_stage_holds_what_answered() {
        let text =
            text(&[port("/dev/ttyUSB0", &[1, 20]), port("/dev/tty\"odd", &[0]), port("/dev/ttyS0", &[])])
                .unwrap();
        let stage = Stage::parse(&text).unwrap();
        let devices: Vec<&str> = stage.devices.iter().map(|device| device.name.as_str()).collect();
        assert_eq!(devices, ["flock", "flock-2"]);
        assert_eq!((stage.devices[0].baud, stage.devices[1].port.as_str()), (57_600, "/dev/tty\"odd"));
        let sensors: Vec<(&str, u16)> = stage.sensors.iter().map(|s| (s.name.as_str(), s.address)).collect();
        assert_eq!(sensors, [("bird-1", 1), ("bird-20", 20), ("flock-2-bird-0", 0)]);
    }

    #[test]
    fn every_kind_of_device_makes_a_stage_that_is_taken() {
        let report = |driver, port: &str, sensors: &[(u16, &str)]| PortReport {
            port: port.to_owned(),
            driver: Some(driver),
            sensors: sensors
                .iter()
                .map(|(address, serial)| SensorReport {
                    address: *address,
                    serial: Some((*serial).to_owned()),
                })
                .collect(),
            ..PortReport::default()
        };
        let ports = [
            PortReport {
                baud: Some(460_800),
                ..report("xbus", "/dev/ttyUSB0", &[(1, "00342D07"), (2, "00342D08")])
            },
            PortReport {
                local_port: Some(8001),
                ..report("x-imu3", "udp://10.0.0.7:9000", &[(0, "6A3F20C1")])
            },
            report("x-imu3", "/dev/ttyACM0", &[(0, "6A3F20C2")]),
            report("slimevr", "udp://0.0.0.0:6969", &[(1, "A4:CF:12:D4:E5:F6")]),
            PortReport {
                sensors: vec![SensorReport { address: 2, serial: None }],
                ..report("motionstar", "tcp://10.0.0.8:6000", &[])
            },
            PortReport {
                sensors: vec![SensorReport { address: 1, serial: None }],
                ..report("fastrak", "/dev/ttyUSB1", &[])
            },
            report("vrpn", "tcp://10.0.0.9:3883", &[(1, "Head"), (2, "Wand \"A\""), (258, "Wand \"A\"")]),
        ];
        let stage = Stage::parse(&text(&ports).unwrap()).unwrap();
        let drivers: Vec<&str> = stage.devices.iter().map(|device| device.driver.word()).collect();
        assert_eq!(drivers, ["xbus", "x-imu3", "x-imu3", "slimevr", "motionstar", "fastrak", "vrpn"]);
        assert_eq!((stage.devices[2].name.as_str(), stage.devices[1].local_port), ("imu-2", Some(8001)));
        assert_eq!(stage.sensors[1].serial.as_deref(), Some("00342D08"));
    }

    #[test]
    fn a_stage_without_a_sensor_is_not_written() {
        assert!(text(&[port("/dev/ttyUSB0", &[])]).is_err());
    }
}
