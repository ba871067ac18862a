//! What a driver accepts: its settings, the addresses of its sensors, and where its device can be.
//!
//! The driver itself has the word: what is accepted here is what a pipeline can be made of.

use super::super::driver::Driver;
use super::super::problem::Notes;
use super::super::{Device, PortAddress, Stage};
use super::Item;

pub(super) fn check(root: &Item<'_, '_>, stage: &Stage, notes: &mut Notes<'_>) {
    let (devices, sensors) = (root.items("device"), root.items("sensor"));
    for (device, item) in stage.devices.iter().zip(&devices) {
        port(device, item, notes);
        let of_device = || stage.sensors.iter().zip(&sensors).filter(|(s, _)| s.device == device.name);
        let wanted: Vec<u16> = of_device().map(|(sensor, _)| sensor.address).collect();
        if !wanted.is_empty()
            && let Err(error) = device.driver.check(&wanted)
        {
            // An address stands in the table of a sensor, all other keys in that of the device.
            let place = match error.key {
                "address" => of_device().next().and_then(|(_, item)| item.get("address")),
                key => item.get(key),
            };
            let at = place.map_or(item.header.clone(), |value| value.span());
            let message = format!("the driver {} cannot work so", device.driver.word());
            notes.problem(&at, error.key, message, format!("write {}", error.expected));
        }
        let has_gyro = matches!(
            device.driver,
            Driver::Xbus(_) | Driver::XImu3(_) | Driver::OpenImu(_) | Driver::WitMotion(_)
        );
        let keys = [
            ("magnetometer", device.driver.measures_field(), "no magnetic field to send"),
            ("gyro_delay_ms", has_gyro, "no rate gyro of its own"),
        ];
        for (_, item) in of_device() {
            for (key, _, lacks) in keys.iter().filter(|(_, has, _)| !has) {
                if let Some(value) = item.get(key) {
                    let message = format!("a sensor of {} has {lacks}", device.driver.word());
                    notes.problem(&value.span(), key, message, "remove the key");
                }
            }
        }
    }
}

fn port(device: &Device, item: &Item<'_, '_>, notes: &mut Notes<'_>) {
    let Ok(address) = device.port.parse::<PortAddress>() else { return };
    let at = |key| item.get(key).map_or(item.header.clone(), |value| value.span());
    if let Err(instead) = device.driver.check_port(&address) {
        let message = format!("{} cannot be at `{}`", device.driver.word(), device.port);
        notes.problem(&at("port"), "port", message, format!("write {instead}"));
    }
    let serves = matches!(device.driver, Driver::SlimeVr(_) | Driver::OpenImu(_));
    let connects = matches!(address, PortAddress::Udp { .. }) && !serves;
    if device.local_port.is_some() && !connects {
        let fix = "remove the key; it is for devices at udp://HOST:PORT";
        notes.problem(&at("local_port"), "local_port", "this port has no other end to choose", fix);
    }
}
