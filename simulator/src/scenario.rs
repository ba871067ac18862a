//! The `[simulation]` table of a stage file, and how it becomes virtual devices.

use std::path::Path;
use std::time::Duration;

use nalgebra::{Isometry3, Unit, Vector3};
use posed_drivers::flock::wire::Addressing;
use serde::{Deserialize, Serialize};

use crate::faults::Fault;
use crate::flock::{FlockConfig, Sensor, UnitConfig};
use crate::line::LineConfig;
use crate::magnetic::{
    Environment, Excitation, Floor, Hum, Sphere, Tracker, conductor_response, iron_response,
};
use crate::motion::{Body, FileError, Motion, Orbit, quaternion};

/// What is simulated in the devices' place. Every key has a default; `Scenario::default()` is a clean, quiet stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Scenario {
    /// Same seed, same bytes.
    pub seed: u64,
    /// When the simulation ends, s; absent: never.
    pub duration_s: Option<f64>,
    /// Standard deviation of each of the nine signals, in units of mu0 m / 4 pi, 1/m^3: position noise
    /// across the ray is 0.745 times this times r^4 (metres), along it 0.136 times.
    pub sigma_signal_per_m3: f64,
    /// Beyond this the words repeat, m; absent: 1.2, with extended range 3.
    pub max_range_m: Option<f64>,
    /// Nearer than this the signals saturate, m.
    pub min_range_m: f64,
    /// Distortion above this makes a measurement `disturbed` in the truth, mm.
    pub disturbed_above_mm: f64,
    /// How the transmitter is driven, which decides what conductors answer.
    pub excitation: ExcitationSpec,
    /// Metal in the floor.
    pub floor: Option<FloorSpec>,
    /// Stray field of the mains.
    pub hum: Option<HumSpec>,
    /// Metal objects.
    pub metal: Vec<MetalSpec>,
    /// Moving bodies.
    #[serde(rename = "body")]
    pub bodies: Vec<BodySpec>,
    /// Which sensor rides on what; sensors left out wander each on its own curve before the transmitter.
    #[serde(rename = "sensor")]
    pub sensors: Vec<SensorScenario>,
    /// Behaviour of the devices.
    #[serde(rename = "device")]
    pub devices: Vec<DeviceScenario>,
}

impl Default for Scenario {
    fn default() -> Self {
        Self {
            seed: 1,
            duration_s: None,
            sigma_signal_per_m3: 2e-4,
            max_range_m: None,
            min_range_m: 0.15,
            disturbed_above_mm: 20.0,
            excitation: ExcitationSpec::default(),
            floor: None,
            hum: None,
            metal: Vec::new(),
            bodies: Vec::new(),
            sensors: Vec::new(),
            devices: Vec::new(),
        }
    }
}

/// How a transmitter is driven.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum ExcitationSpec {
    /// Direct current pulses, as in a Flock.
    PulsedDc {
        /// From the step of the current to the sample, ms.
        sample_delay_ms: f64,
    },
    /// Alternating current.
    Ac {
        /// Carrier frequency, Hz.
        frequency_hz: f64,
    },
}

impl Default for ExcitationSpec {
    fn default() -> Self {
        Self::PulsedDc { sample_delay_ms: 2.3 }
    }
}

/// What an object or a floor is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Material {
    /// Soft magnetic steel.
    Iron,
    /// 3.5e7 S/m.
    Aluminium,
    /// 5.8e7 S/m.
    Copper,
    /// A perfect conductor.
    Conductor,
}

/// A metal floor, horizontal in the room.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FloorSpec {
    /// Its height in the room, m.
    pub z_m: f64,
    /// Strength of the image, 0 to 1.
    pub strength: f64,
    /// Iron, or a conductor of any kind.
    pub material: Material,
}

/// Stray field of the mains at the sensors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HumSpec {
    /// 50 or 60 Hz.
    pub frequency_hz: f64,
    /// Amplitude along the room's axes, in units of mu0 m / 4 pi, 1/m^3.
    pub amplitude_per_m3: [f64; 3],
}

/// A metal object, as a sphere.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MetalSpec {
    /// Centre in the room, m.
    pub center_m: [f64; 3],
    /// Radius, m.
    pub radius_m: f64,
    /// What it is made of.
    pub material: Material,
}

/// A body in motion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BodySpec {
    /// Unique name.
    pub name: String,
    /// How it moves.
    pub motion: Motion,
}

/// What a sensor rides on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SensorScenario {
    /// Name of the stage's sensor.
    pub name: String,
    /// Name of a body.
    pub body: String,
    /// Segment of the body: `forearm` of a curl, a joint of a BVH file; absent: the body's only or first one.
    pub segment: Option<String>,
    /// Where it sits on the segment, segment axes, m.
    #[serde(default)]
    pub offset_m: [f64; 3],
    /// How it sits: sensor to segment.
    #[serde(default = "identity")]
    pub mount_quat_wxyz: [f64; 4],
}

fn identity() -> [f64; 4] {
    [1.0, 0.0, 0.0, 0.0]
}

/// Behaviour of one device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DeviceScenario {
    /// Name of the stage's device.
    pub name: String,
    /// Measurement rate at power-up, Hz.
    pub rate_hz: f64,
    /// How much slower than nominal its clock runs, parts per million.
    pub drift_ppm: f64,
    /// The USB adapter delivers only every so many milliseconds; 0: at once.
    pub burst_ms: f64,
    /// Bytes that the UART collects before it hands them over.
    pub fifo_bytes: usize,
    /// From power or reset to the first command that is understood, ms.
    pub boot_ms: f64,
    /// Software revision.
    pub revision: [u8; 2],
    /// Address mode switches; absent: what the highest address needs.
    pub addressing: Option<Addressing>,
    /// An extended range transmitter; absent: if the stage has no sensor at address 1, where its controller then is.
    pub extended_range: Option<bool>,
    /// What goes wrong.
    #[serde(rename = "fault")]
    pub faults: Vec<Fault>,
}

impl Default for DeviceScenario {
    fn default() -> Self {
        Self {
            name: String::new(),
            rate_hz: 103.3,
            drift_ppm: 0.0,
            burst_ms: 0.0,
            fifo_bytes: 8,
            boot_ms: 1000.0,
            revision: [3, 67],
            addressing: None,
            extended_range: None,
            faults: Vec::new(),
        }
    }
}

/// The parts of a stage file that the simulator needs, without the types of its reader.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StageSpec {
    /// Position (m) and quaternion (w, x, y, z) of the transmitter in the room; absent: the room's axes are the tracker's.
    pub transmitter_in_room: Option<([f64; 3], [f64; 4])>,
    /// Devices, in the stage's order.
    pub devices: Vec<DeviceSpec>,
    /// Sensors, in the stage's order.
    pub sensors: Vec<SensorSpec>,
}

/// A device of the stage.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceSpec {
    /// Its name.
    pub name: String,
    /// Its driver: `flock-of-birds`.
    pub driver: String,
    /// Line rate, bit/s.
    pub baud: u32,
    /// Constant delay from measurement to the record's first bit, ms.
    pub measurement_delay_ms: f64,
}

/// A sensor of the stage.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorSpec {
    /// Its name.
    pub name: String,
    /// Name of its device.
    pub device: String,
    /// Address on the device.
    pub address: u16,
}

/// Why a scenario was refused.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// A value makes no sense.
    #[error("simulation.{key}: {problem}")]
    Invalid {
        /// Path of the key.
        key: String,
        /// What is wrong and what to write.
        problem: String,
    },
    /// A file of motion was refused.
    #[error("simulation.body.{body}.motion: {source}")]
    Motion {
        /// Name of the body.
        body: String,
        /// Why.
        source: FileError,
    },
}

pub(crate) fn invalid(key: impl Into<String>, problem: impl Into<String>) -> ScenarioError {
    ScenarioError::Invalid { key: key.into(), problem: problem.into() }
}

impl Scenario {
    /// Checks all numbers and names against the stage.
    ///
    /// # Errors
    /// The first key that is wrong.
    pub fn check(&self, stage: &StageSpec) -> Result<(), ScenarioError> {
        let positive = |key: &str, value: f64| {
            if value.is_finite() && value > 0.0 {
                Ok(())
            } else {
                Err(invalid(key, format!("{value} should be above 0")))
            }
        };
        let not_negative = |key: &str, value: f64| {
            if value.is_finite() && value >= 0.0 {
                Ok(())
            } else {
                Err(invalid(key, format!("{value} should not be below 0")))
            }
        };
        not_negative("sigma_signal_per_m3", self.sigma_signal_per_m3)?;
        positive("min_range_m", self.min_range_m)?;
        positive("max_range_m", self.max_range_m.unwrap_or(1.0))?;
        positive("disturbed_above_mm", self.disturbed_above_mm)?;
        positive("duration_s", self.duration_s.unwrap_or(1.0))?;
        for metal in &self.metal {
            positive("metal.radius_m", metal.radius_m)?;
        }
        if let Some(floor) = &self.floor
            && !(0.0..=1.0).contains(&floor.strength)
        {
            return Err(invalid("floor.strength", "should be between 0 and 1"));
        }
        for body in &self.bodies {
            body.motion.check().map_err(|problem| invalid(format!("body.{}.motion", body.name), problem))?;
            if self.bodies.iter().filter(|other| other.name == body.name).count() > 1 {
                return Err(invalid("body.name", format!("`{}` stands there twice", body.name)));
            }
        }
        for sensor in &self.sensors {
            if !stage.sensors.iter().any(|known| known.name == sensor.name) {
                return Err(invalid("sensor.name", format!("the stage has no sensor `{}`", sensor.name)));
            }
            if !self.bodies.iter().any(|body| body.name == sensor.body) {
                return Err(invalid(
                    format!("sensor.{}.body", sensor.name),
                    format!("there is no [[simulation.body]] with the name `{}`", sensor.body),
                ));
            }
        }
        for device in &self.devices {
            if !stage.devices.iter().any(|known| known.name == device.name) {
                return Err(invalid("device.name", format!("the stage has no device `{}`", device.name)));
            }
            let key = |key: &str| format!("device.{}.{key}", device.name);
            if !(14.0..=144.0).contains(&device.rate_hz) {
                return Err(invalid(key("rate_hz"), "a Flock measures at 14 to 144 Hz"));
            }
            not_negative(&key("burst_ms"), device.burst_ms)?;
            not_negative(&key("boot_ms"), device.boot_ms)?;
            if !(device.drift_ppm.abs() <= 1e4) {
                return Err(invalid(key("drift_ppm"), "should be within 10000 parts per million"));
            }
            for fault in &device.faults {
                let (start_s, end_s) = fault.span_s();
                if !start_s.is_finite() || start_s < 0.0 || !(end_s >= start_s) {
                    let problem = format!("{} should begin at 0 s or later and end after that", fault.name());
                    return Err(invalid(key("fault"), problem));
                }
            }
        }
        Ok(())
    }

    /// Physics in transmitter axes.
    fn tracker(&self, room_from_transmitter: &Isometry3<f64>, extended: bool) -> Tracker {
        let transmitter_from_room = room_from_transmitter.inverse();
        let excitation = match self.excitation {
            ExcitationSpec::PulsedDc { sample_delay_ms } => {
                Excitation::PulsedDc { sample_delay_s: sample_delay_ms * 1e-3 }
            }
            ExcitationSpec::Ac { frequency_hz } => Excitation::Ac { frequency_hz },
        };
        let response = |material, radius_m| match material {
            Material::Iron => iron_response(200.0),
            Material::Aluminium => conductor_response(excitation, 3.5e7, radius_m),
            Material::Copper => conductor_response(excitation, 5.8e7, radius_m),
            Material::Conductor => -1.0,
        };
        let spheres = self.metal.iter().map(|metal| Sphere {
            center_m: (transmitter_from_room * nalgebra::Point3::from(metal.center_m)).coords,
            radius_m: metal.radius_m,
            response: response(metal.material, metal.radius_m),
        });
        let floor = self.floor.map(|floor| {
            let height_m = room_from_transmitter.translation.z - floor.z_m;
            let up = transmitter_from_room.rotation * Vector3::z();
            Floor {
                normal: Unit::new_normalize(up * height_m.signum()),
                distance_m: height_m.abs(),
                strength: if floor.material == Material::Iron { floor.strength } else { -floor.strength },
            }
        });
        Tracker {
            environment: Environment { spheres: spheres.collect(), floor },
            sigma_signal: self.sigma_signal_per_m3,
            hum: self.hum.map(|hum| Hum {
                frequency_hz: hum.frequency_hz,
                amplitude: transmitter_from_room.rotation * Vector3::from(hum.amplitude_per_m3),
                phase_rad: 0.0,
            }),
            max_range_m: self.max_range_m.unwrap_or(if extended { 3.0 } else { 1.2 }),
            min_range_m: self.min_range_m,
        }
    }

    /// Reads the files of motion and finds the body of each sensor of the stage.
    pub(crate) fn riders(&self, stage: &StageSpec, folder: &Path) -> Result<Vec<Sensor>, ScenarioError> {
        let mut bodies = Vec::new();
        for spec in &self.bodies {
            let body = Body::new(spec.motion.clone(), folder)
                .map_err(|source| ScenarioError::Motion { body: spec.name.clone(), source })?;
            bodies.push((spec.name.as_str(), body));
        }
        let transmitter = transmitter_in_room(stage);
        let rider = |(index, sensor): (usize, &SensorSpec)| {
            let Some(given) = self.sensors.iter().find(|given| given.name == sensor.name) else {
                let body = Body::new(Motion::Orbit(default_orbit(index, &transmitter)), folder)
                    .map_err(|source| ScenarioError::Motion { body: sensor.name.clone(), source })?;
                return Ok(Sensor { index, body, segment: 0, mount: Isometry3::identity() });
            };
            let body = bodies.iter().find(|(name, _)| *name == given.body).map(|(_, body)| body.clone());
            let body =
                body.ok_or_else(|| invalid("sensor.body", format!("there is no body `{}`", given.body)))?;
            let segment = match &given.segment {
                None => Some(0),
                Some(name) => body.segments().iter().position(|segment| segment == name),
            };
            let segment = segment.ok_or_else(|| {
                let key = format!("sensor.{}.segment", given.name);
                invalid(key, format!("body `{}` has the segments {}", given.body, body.segments().join(", ")))
            })?;
            let mount = Isometry3::from_parts(given.offset_m.into(), quaternion(given.mount_quat_wxyz));
            Ok(Sensor { index, body, segment, mount })
        };
        stage.sensors.iter().enumerate().map(rider).collect()
    }

    /// The flock and the line of the `index`-th device.
    pub(crate) fn flock(
        &self,
        stage: &StageSpec,
        index: usize,
        riders: &[Sensor],
    ) -> Result<(FlockConfig, LineConfig), ScenarioError> {
        let device = &stage.devices[index];
        let wrong = |problem: String| invalid(format!("device.{}", device.name), problem);
        if device.driver != "flock-of-birds" {
            return Err(wrong(format!(
                "driver `{}` cannot be simulated yet, only flock-of-birds",
                device.driver
            )));
        }
        let given = self.devices.iter().find(|given| given.name == device.name).cloned().unwrap_or_default();
        let mut birds: Vec<(u8, Sensor)> = Vec::new();
        for (sensor, rider) in
            stage.sensors.iter().zip(riders).filter(|(sensor, _)| sensor.device == device.name)
        {
            let address = u8::try_from(sensor.address).ok().filter(|&address| address <= 126);
            let address = address.ok_or_else(|| wrong(format!("address {} is above 126", sensor.address)))?;
            if birds.iter().any(|&(taken, _)| taken == address) {
                return Err(wrong(format!("address {address} is taken twice")));
            }
            birds.push((address, rider.clone()));
        }
        let stand_alone = birds.iter().any(|&(address, _)| address == 0);
        if stand_alone && birds.len() > 1 {
            return Err(wrong("address 0 is a stand-alone unit and has no neighbours".to_owned()));
        }
        let highest = birds.iter().map(|&(address, _)| address).max().unwrap_or(1);
        let addressing = given.addressing.unwrap_or(match highest {
            0..=14 => Addressing::Normal,
            15..=30 => Addressing::Expanded,
            _ => Addressing::SuperExpanded,
        });
        if highest > addressing.max_address() {
            return Err(wrong(format!("address {highest} does not fit {addressing:?} addressing")));
        }
        let has_first = birds.iter().any(|&(address, _)| address <= 1);
        let extended_range = given.extended_range.unwrap_or(!has_first);
        let addresses = if stand_alone { 0..=0 } else { 1..=highest };
        let units = addresses.map(|address| UnitConfig {
            sensor: birds.iter().find(|&&(bird, _)| bird == address).map(|(_, sensor)| sensor.clone()),
            extended_controller: address == 1 && extended_range && !has_first,
            transmitter: address <= 1,
        });
        let transmitter_in_room = transmitter_in_room(stage);
        let duration = |ms: f64| Duration::from_secs_f64(ms.max(0.0) * 1e-3);
        let flock = FlockConfig {
            device: index,
            baud: device.baud,
            stand_alone,
            units: units.collect(),
            addressing,
            revision: given.revision,
            extended_range,
            rate_hz: given.rate_hz,
            drift_ppm: given.drift_ppm,
            measurement_delay: duration(device.measurement_delay_ms),
            boot: duration(given.boot_ms),
            transmitter_in_room,
            tracker: self.tracker(&transmitter_in_room, extended_range),
            disturbed_above_m: self.disturbed_above_mm * 1e-3,
            faults: given.faults.clone(),
        };
        let line = LineConfig {
            baud: device.baud,
            fifo_bytes: given.fifo_bytes.max(1),
            burst: duration(given.burst_ms),
        };
        Ok((flock, line))
    }

    /// The faults of a device, by name.
    pub(crate) fn faults(&self, device: &str) -> Vec<Fault> {
        self.devices
            .iter()
            .find(|given| given.name == device)
            .map_or_else(Vec::new, |given| given.faults.clone())
    }
}

fn transmitter_in_room(stage: &StageSpec) -> Isometry3<f64> {
    stage.transmitter_in_room.map_or_else(Isometry3::identity, |(position, orientation)| {
        Isometry3::from_parts(position.into(), quaternion(orientation))
    })
}

/// A curve of its own for each sensor that the scenario leaves out: half a metre before the transmitter.
fn default_orbit(index: usize, transmitter: &Isometry3<f64>) -> Orbit {
    let center = transmitter * nalgebra::Point3::new(0.5, 0.0, 0.0);
    Orbit {
        center_m: center.coords.into(),
        radius_m: [0.12, 0.15, 0.1],
        phase_deg: 77.0 * index as f64,
        period_s: 5.0 + 0.7 * (index % 5) as f64,
        ..Orbit::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stage() -> StageSpec {
        let sensor = |name: &str, address| SensorSpec { name: name.into(), device: "flock".into(), address };
        StageSpec {
            transmitter_in_room: Some(([0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0])),
            devices: vec![DeviceSpec {
                name: "flock".into(),
                driver: "flock-of-birds".into(),
                baud: 115_200,
                measurement_delay_ms: 0.0,
            }],
            sensors: vec![sensor("upper_arm_r", 1), sensor("forearm_r", 2), sensor("wand", 3)],
        }
    }

    #[test]
    fn the_demo_is_understood() {
        let scenario: Scenario = toml::from_str(include_str!("../resources/demo-simulation.toml")).unwrap();
        scenario.check(&stage()).unwrap();
        let riders = scenario.riders(&stage(), Path::new(".")).unwrap();
        let (flock, _) = scenario.flock(&stage(), 0, &riders).unwrap();
        assert_eq!(flock.units.len(), 3);
        assert!(!flock.extended_range && !flock.stand_alone);
    }

    #[test]
    fn an_empty_table_is_a_quiet_stage() {
        let scenario: Scenario = toml::from_str("").unwrap();
        assert_eq!(scenario, Scenario::default());
        assert!(scenario.riders(&stage(), Path::new(".")).unwrap().len() == 3);
    }

    #[test]
    fn every_fault_can_be_written() {
        let text = "[[device]]\nname = 'flock'\nfault = [\
            { kind = 'lost-bytes', count = 50, start_s = 5, end_s = 15 },\
            { kind = 'inserted-bytes', count = 50, start_s = 5, end_s = 15 },\
            { kind = 'bit7-flips', count = 50, start_s = 5, end_s = 15 },\
            { kind = 'data-bit-flips', count = 50, start_s = 5, end_s = 15 },\
            { kind = 'bursts', start_s = 5, end_s = 15, burst_ms = 16 },\
            { kind = 'unplug', at_s = 5, duration_s = 2 },\
            { kind = 'phase-cut', at_s = 5 },\
            { kind = 'stall', at_s = 5 },\
            { kind = 'power-cycle', at_s = 5 },\
            { kind = 'bird-dies', address = 2, at_s = 5 },\
            { kind = 'hemisphere-flip', address = 2, at_s = 5, duration_s = 0.5 },\
            { kind = 'out-of-range', address = 2, at_s = 5, duration_s = 0.5 },\
            { kind = 'bad-matrix', address = 2, at_s = 5, duration_s = 0.5 },\
            { kind = 'error', address = 1, at_s = 5, code = 13, detail = 2 } ]\n";
        let scenario: Scenario = toml::from_str(text).unwrap();
        assert_eq!(scenario.devices[0].faults.len(), 14);
        scenario.check(&stage()).unwrap();
        let again: Scenario = toml::from_str(&toml::to_string(&scenario).unwrap()).unwrap();
        assert_eq!(again, scenario);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let problem = |text: &str| match toml::from_str::<Scenario>(text) {
            Err(error) => error.message().to_owned(),
            Ok(scenario) => match scenario.check(&stage()) {
                Err(error) => error.to_string(),
                Ok(()) => scenario.riders(&stage(), Path::new("/none")).unwrap_err().to_string(),
            },
        };
        let body = "[[body]]\nname = 'arm'\nmotion.kind = 'curl'\n";
        assert!(problem("sede = 3").contains("unknown field `sede`"));
        assert!(problem("min_range_m = 0").contains("min_range_m: 0 should be above 0"));
        assert!(problem("[[device]]\nname = 'flok'").contains("no device `flok`"));
        assert!(problem("[[device]]\nname = 'flock'\nrate_hz = 500").contains("14 to 144 Hz"));
        assert!(problem("[[sensor]]\nname = 'wand'\nbody = 'x'").contains("no [[simulation.body]]"));
        assert!(problem(&format!("{body}motion.period_s = 0\n")).contains("period_s"));
        assert!(problem(&format!("{body}motion.perod_s = 1\n")).contains("perod_s"));
        assert!(
            problem(&format!("{body}[[sensor]]\nname = 'wand'\nbody = 'arm'\nsegment = 'hand'\n"))
                .contains("has the segments upper_arm, forearm")
        );
        assert!(
            problem("[[body]]\nname = 'a'\nmotion = { kind = 'file', path = 'a.bvh' }\n")
                .contains("/none/a.bvh")
        );
        let fault = "[[device]]\nname = 'flock'\nfault = [{ kind = 'stall', at_s = -1 }]\n";
        assert!(problem(fault).contains("should begin at 0 s or later"), "{}", problem(fault));
    }

    #[test]
    fn without_a_bird_at_address_1_an_extended_range_controller_is_there() {
        let mut stage = stage();
        for sensor in &mut stage.sensors {
            sensor.address += 1;
        }
        let scenario = Scenario::default();
        let riders = scenario.riders(&stage, Path::new(".")).unwrap();
        let (flock, _) = scenario.flock(&stage, 0, &riders).unwrap();
        assert!(flock.extended_range && flock.units[0].extended_controller);
        assert_eq!(flock.units.len(), 4);
        assert!(flock.units[0].sensor.is_none());
    }

    #[test]
    fn the_floor_lies_below_the_transmitter_whatever_its_axes() {
        let scenario = Scenario {
            floor: Some(FloorSpec { z_m: 0.0, strength: 0.1, material: Material::Iron }),
            ..Scenario::default()
        };
        let tracker = scenario.tracker(&transmitter_in_room(&stage()), false);
        let floor = tracker.environment.floor.unwrap();
        assert_eq!(floor.distance_m, 1.0);
        assert!((floor.normal.into_inner() - Vector3::new(0.0, 0.0, -1.0)).norm() < 1e-12, "z is down");
    }
}
