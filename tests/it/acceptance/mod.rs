//! What has to hold for the deterministic part, end to end: virtual devices, their bytes, the pipeline, its outputs.
//!
//! Everything runs in simulated time from seeds. A pose is *wrong* if it is published as `ok` or `repaired` and
//! lies further from the truth than the scene's noise explains.

#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "tests print what they measure")]

mod clock;
mod damage;
mod determinism;
mod devices;
mod judge;
mod many;
mod radios;
mod supervised;

use posed_simulator::faults::Fault;
use posed_simulator::motion::{Motion, Orbit};
use posed_simulator::scenario::{BodySpec, DeviceScenario, Scenario, SensorScenario};

use posed_rig::{Rig, stage};

/// A device of the stage by its number, at 100 Hz, with faults.
fn device(number: usize, faults: Vec<Fault>) -> DeviceScenario {
    DeviceScenario { name: format!("d{number}"), rate_hz: 100.0, faults, ..DeviceScenario::default() }
}

/// A hand's motion: up to 1.3 m/s, 7 m/s^2 and 260 degrees/s, 0.3 to 0.9 m before the transmitter.
fn hand(number: usize) -> Motion {
    Motion::Orbit(Orbit {
        center_m: [0.55, 0.0, 0.0],
        radius_m: [0.2, 0.25, 0.15],
        phase_deg: 77.0 * number as f64,
        period_s: 2.0 + 0.13 * (number % 5) as f64,
        turn_deg: [40.0, 30.0, 70.0],
        turn_period_s: 1.7,
        ..Orbit::default()
    })
}

/// A scene in which each of these sensors moves like a hand of its own.
fn scene(seed: u64, sigma_signal_per_m3: f64, sensors: &[&str], devices: Vec<DeviceScenario>) -> Scenario {
    let name = |sensor: &str| format!("hand of {sensor}");
    let body = |(number, sensor): (usize, &&str)| BodySpec { name: name(sensor), motion: hand(number) };
    let rides = |sensor: &&str| SensorScenario {
        name: (*sensor).into(),
        body: name(sensor),
        segment: None,
        offset_m: [0.0; 3],
        mount_quat_wxyz: [1.0, 0.0, 0.0, 0.0],
    };
    Scenario {
        seed,
        sigma_signal_per_m3,
        bodies: sensors.iter().enumerate().map(body).collect(),
        sensors: sensors.iter().map(rides).collect(),
        devices,
        ..Scenario::default()
    }
}

/// Sigma of the signals: a quiet Flock, and a noisy one (1 mm across the ray at 1 m).
const QUIET: f64 = 2e-4;
const NOISY: f64 = 1.3e-3;

/// Two birds in group mode at 100 Hz with hands' motion.
fn pair(seed: u64, noise: f64, device: DeviceScenario) -> Rig {
    Rig::new(&stage(&[2]), &scene(seed, noise, &["s0-0", "s0-1"], vec![device]))
}
