//! A stage file for the devices that answered.

use posed::stage::Stage;
use posed_drivers::flock::wire::Addressing;

use super::PortReport;
use crate::cli::Error;

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
    for (n, port) in usable.iter().enumerate() {
        let (device, prefix) = match n {
            0 => ("flock".to_owned(), String::new()),
            n => (format!("flock-{}", n + 1), format!("flock-{}-", n + 1)),
        };
        let driver = port.driver.unwrap_or_default();
        text.push_str(&format!(
            "\n[[device]]\nname = {}\ndriver = {}\nport = {}\n",
            quoted(&device),
            quoted(driver),
            quoted(&port.port)
        ));
        if let Some(baud) = port.baud {
            text.push_str(&format!("baud = {baud}\n"));
        }
        text.push_str("format = \"position-quaternion\"\n");
        text.push_str("hemisphere = \"forward\"          # the half-space around the transmitter that the sensors start in\n");
        match port.addressing {
            Some(Addressing::Expanded) => text.push_str("addressing = \"expanded\"\n"),
            Some(Addressing::SuperExpanded) => text.push_str("addressing = \"super-expanded\"\n"),
            Some(Addressing::Normal) | None => {}
        }
        for sensor in &port.sensors {
            let name = format!("{prefix}bird-{}", sensor.address);
            sensors.push_str(&format!(
                "\n[[sensor]]\nname = {}\ndevice = {}\naddress = {}\n",
                quoted(&name),
                quoted(&device),
                sensor.address
            ));
        }
    }
    text.push_str(&sensors);
    // What is written must be what `check` and `run` take.
    Stage::parse(&text)
        .map_err(|problems| Error::Failed(format!("cannot write a stage for this: {problems}")))?;
    Ok(text)
}

/// A TOML string.
fn quoted(text: &str) -> String {
    toml::Value::from(text).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::doctor::SensorReport;

    fn port(port: &str, addresses: &[u8]) -> PortReport {
        PortReport {
            port: port.to_owned(),
            driver: Some("flock-of-birds"),
            baud: Some(57_600),
            addressing: Some(Addressing::Expanded),
            sensors: addresses.iter().map(|address| SensorReport { address: *address }).collect(),
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
    fn a_stage_without_a_sensor_is_not_written() {
        assert!(text(&[port("/dev/ttyUSB0", &[])]).is_err());
    }
}
