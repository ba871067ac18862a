//! Devices, the sensors on them, and whether their line can carry what they are asked for.

use super::super::port::{PortAddress, PortAddressError};
use super::super::problem::Notes;
use super::{At, Item, suggest, unique};

/// Line rates of the Flock's switches.
const FLOCK_BAUDS: [u32; 7] = [2400, 4800, 9600, 19_200, 38_400, 57_600, 115_200];
/// Measurement rate of a Flock that nobody has changed, Hz.
const FLOCK_RATE_HZ: f64 = 103.3;

pub(super) fn check(root: &Item<'_, '_>, notes: &mut Notes<'_>) {
    let devices = root.items("device");
    let sensors = root.items("sensor");
    unique(&devices, "name", "device", notes);
    unique(&sensors, "name", "sensor", notes);
    ports(&devices, &sensors, notes);

    let names: Vec<&str> = devices.iter().filter_map(|device| Some(device.text("name")?.value)).collect();
    for sensor in &sensors {
        if let Some(device) = sensor.text("device").filter(|device| !names.contains(&device.value)) {
            let fix = suggest(device.value, &names, "add a [[device]] with this name");
            notes.problem(&device.at, "device", format!("there is no device `{}`", device.value), fix);
        }
    }
    // A sensor with a wrong device may belong to one that seems to have none.
    let all_placed = sensors.iter().all(|s| s.text("device").is_some_and(|d| names.contains(&d.value)));
    for device in &devices {
        let Some(name) = device.text("name") else { continue };
        let mine: Vec<&Item<'_, '_>> =
            sensors.iter().filter(|s| s.text("device").is_some_and(|d| d.value == name.value)).collect();
        addresses_differ(&mine, name.value, notes);
        if mine.is_empty() && all_placed {
            let fix = "add a [[sensor]] with its address, or remove the device";
            notes.problem(&name.at, "name", format!("device `{}` has no sensor", name.value), fix);
        }
        if device.text("driver").is_some_and(|driver| driver.value == "flock-of-birds") {
            flock(device, &mine, notes);
        }
    }
}

fn ports(devices: &[Item<'_, '_>], sensors: &[Item<'_, '_>], notes: &mut Notes<'_>) {
    let mut seen: Vec<(At<&str>, Option<&str>)> = Vec::new();
    for device in devices {
        let Some(port) = device.text("port") else { continue };
        if let Err(error) = port.value.parse::<PortAddress>() {
            let fix = match error {
                PortAddressError::Relative => {
                    format!("write \"/dev/{}\", or \"auto\"", port.value.trim_start_matches("dev/"))
                }
                PortAddressError::Usb => {
                    "write \"usb://0f44:ff20\" for a Liberty, or \"usb://0f44:ef20\" for a Patriot".to_owned()
                }
                PortAddressError::Scheme | PortAddressError::Host | PortAddressError::Number => {
                    "write \"tcp://HOST:PORT\" or \"udp://HOST:PORT\"".to_owned()
                }
                PortAddressError::Empty => {
                    "write \"/dev/ttyUSB0\", \"auto\", \"tcp://HOST:PORT\" or \"udp://HOST:PORT\"".to_owned()
                }
            };
            notes.problem(&port.at, "port", error.to_string(), fix);
            continue;
        }
        let driver = device.text("driver").map(|driver| driver.value);
        let name = device.text("name").map(|name| name.value);
        let has_serial =
            sensors.iter().any(|s| s.has("serial") && s.text("device").map(|device| device.value) == name);
        // Serial numbers tell devices of one kind apart, wherever they are plugged in.
        if port.value == "auto" && has_serial {
            continue;
        }
        // Two devices may both be looked for, if the answers distinguish them.
        let taken = seen.iter().find(|(earlier, other)| {
            earlier.value == port.value && (port.value != "auto" || *other == driver)
        });
        if let Some((earlier, _)) = taken {
            let line = notes.line(earlier.at.start);
            let (message, fix) = if port.value == "auto" {
                (
                    format!("line {line} looks for the same kind of device"),
                    "give at least one of the two its port, or its sensors their `serial`",
                )
            } else {
                (
                    format!("`{}` is the port of another device in line {line}", port.value),
                    "give each device a port of its own",
                )
            };
            notes.problem(&port.at, "port", message, fix);
        } else {
            seen.push((port, driver));
        }
    }
}

fn addresses_differ(sensors: &[&Item<'_, '_>], device: &str, notes: &mut Notes<'_>) {
    let mut seen: Vec<At<i64>> = Vec::new();
    for sensor in sensors {
        let Some(address) = sensor.integer("address") else { continue };
        match seen.iter().find(|earlier| earlier.value == address.value) {
            Some(earlier) => {
                let line = notes.line(earlier.at.start);
                let message = format!("address {} on `{device}` is taken in line {line}", address.value);
                notes.problem(
                    &address.at,
                    "address",
                    message,
                    "give each sensor of a device its own address",
                );
            }
            None => seen.push(address),
        }
    }
}

fn flock(device: &Item<'_, '_>, sensors: &[&Item<'_, '_>], notes: &mut Notes<'_>) {
    // A socket has no line rate that matters here.
    let serial = device.text("port").is_none_or(|port| !port.value.contains("://"));
    if let Some(baud) = device.integer("baud").filter(|_| serial)
        && !FLOCK_BAUDS.iter().any(|rate| i64::from(*rate) == baud.value)
    {
        let near = FLOCK_BAUDS
            .iter()
            .min_by_key(|rate| i64::from(**rate).saturating_sub(baud.value).saturating_abs());
        let rates: Vec<String> = FLOCK_BAUDS.iter().map(ToString::to_string).collect();
        let message = format!("{} is no rate of a Flock of Birds", baud.value);
        let near = near.copied().unwrap_or(115_200);
        notes.problem(
            &baud.at,
            "baud",
            message,
            format!("write {near}, if its switches are set so; it has {}", rates.join(", ")),
        );
    }
    let (last, mode) = match device.text("addressing").map(|mode| mode.value) {
        Some("normal") => (14, "normal"),
        Some("expanded") => (30, "expanded"),
        _ => (126, "super-expanded"),
    };
    for sensor in sensors {
        let Some(address) = sensor.integer("address") else { continue };
        if address.value == 0 && sensors.len() > 1 {
            let message =
                format!("address 0 is a stand-alone unit, and this device has {} sensors", sensors.len());
            notes.problem(
                &address.at,
                "address",
                message,
                "write its address on the bus, from 1 on, as its switches are set",
            );
        } else if address.value > last {
            let message =
                format!("address {} is beyond {last}, the last one in {mode} addressing", address.value);
            let fix = match address.value {
                15..=30 => "set addressing = \"expanded\" on the device, if its switches are set so",
                31..=126 => "set addressing = \"super-expanded\" on the device, if its switches are set so",
                _ => "write the address that the switches are set to",
            };
            notes.problem(&address.at, "address", message, fix);
        }
    }
    if serial {
        line_budget(device, sensors, notes);
    }
}

/// Warns when a cycle's records do not fit the line; the unit then skips whole cycles.
fn line_budget(device: &Item<'_, '_>, sensors: &[&Item<'_, '_>], notes: &mut Notes<'_>) {
    let data_bytes = match device.text("format").map_or("position-quaternion", |format| format.value) {
        "position" | "angles" => 6,
        "matrix" => 18,
        "quaternion" => 8,
        "position-angles" => 12,
        "position-matrix" => 24,
        "position-quaternion" => 14,
        _ => return,
    };
    let group = usize::from(
        sensors.len() > 1 || sensors.iter().any(|s| s.integer("address").is_some_and(|a| a.value > 0)),
    );
    let bytes = sensors.len() * (data_bytes + usize::from(device.bool("button")) + group);
    let baud = device.integer("baud").map_or(115_200, |baud| baud.value);
    let cycle_hz = device.number("measurement_rate_hz").map_or(FLOCK_RATE_HZ, |rate| rate.value);
    let cycles = device.integer("report_every_cycles").map_or(1, |cycles| cycles.value.max(1));
    let report_hz = cycle_hz / cycles as f64;
    // Ten bits on the line for each byte.
    let possible_hz = baud as f64 / (10.0 * bytes as f64);
    if baud > 0 && bytes > 0 && possible_hz < report_hz {
        let at = device.get("baud").map_or(device.header.clone(), |baud| baud.span());
        let message = format!(
            "{} records of together {bytes} bytes fit {possible_hz:.0} times per second on this line, not {report_hz:.0}",
            sensors.len()
        );
        notes.warning(
            &at,
            "baud",
            message,
            "raise baud, choose a shorter format, or report every second cycle",
        );
    }
}
