//! The `[simulation]` table of a stage file: its types and their check. `build` makes virtual devices of it.

mod build;
mod devices;
mod spec;
#[cfg(test)]
mod tests;

use posed_drivers::flock::wire::Addressing;
use posed_drivers::xbus::Sampling;
use serde::{Deserialize, Serialize};

pub use spec::{DeviceSpec, SensorSpec, StageSpec};

use crate::body::take::TakeError;
use crate::faults::Fault;
use crate::inertial::{EarthSpec, ImuClass};
use crate::motion::Motion;

/// No time is later, no duration longer: some thirty years, s.
const LAST_S: f64 = 1e9;

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
    /// Magnetic field that inertial sensors feel; the room's x is east, its y north.
    pub earth: EarthSpec,
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
            earth: EarthSpec::default(),
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
    /// When it begins, s; absent: it was there from the beginning.
    pub from_s: Option<f64>,
    /// When it ends, s; absent: never.
    pub until_s: Option<f64>,
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
    /// When it is brought in, s; absent: it was there from the beginning.
    pub from_s: Option<f64>,
    /// When it is taken away, s; absent: never.
    pub until_s: Option<f64>,
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
    /// Measurement rate of a Flock or a MotionStar at power-up and of a VRPN server, Hz; the others have one of their own.
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
    /// How good inertial sensors are.
    pub imu: ImuClass,
    /// What the radio of a device behind `udp://` or a websocket adds at most to the time of a datagram, ms: any time up to it is as likely,
    /// and none of a unit's datagrams overtakes another.
    pub radio_jitter_ms: f64,
    /// What samples of an `xbus` device are of its period.
    pub sampling: Sampling,
    /// What answers as `xbus`; absent: an MTi where there is one sensor, else a chain.
    pub xbus: Option<Personality>,
    /// A `polhemus` unit is a Patriot, with 60 frames per second, and no Liberty, with 240.
    pub patriot: bool,
    /// What goes wrong.
    #[serde(rename = "fault")]
    pub faults: Vec<Fault>,
}

/// What speaks the Xbus protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Personality {
    /// A stand-alone tracker with output configuration and MTData2.
    Mti,
    /// An older stand-alone tracker with output mode and MTData.
    Mtx,
    /// An Xbus Master with a chain of trackers.
    Chain,
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
            imu: ImuClass::default(),
            radio_jitter_ms: 0.0,
            sampling: Sampling::default(),
            xbus: None,
            patriot: false,
            faults: Vec::new(),
        }
    }
}

/// Why a scenario was refused.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// A value makes no sense.
    #[error("simulation.{key}: {problem}")]
    Invalid {
        /// Path of the key below `simulation`.
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
        source: TakeError,
    },
}

fn invalid(key: impl Into<String>, problem: impl Into<String>) -> ScenarioError {
    ScenarioError::Invalid { key: key.into(), problem: problem.into() }
}

impl Scenario {
    /// Checks numbers, and names against the stage. It opens no file; that a body has a sensor's segment and that a device can
    /// have its sensors' addresses, [`VirtualStage::new`](crate::stage::VirtualStage::new) checks. The numbers of `excitation`
    /// and `hum` are taken as they are.
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
            if (0.0..=LAST_S).contains(&value) {
                Ok(())
            } else {
                Err(invalid(key, format!("{value} should not be below 0, nor above {LAST_S}")))
            }
        };
        not_negative("sigma_signal_per_m3", self.sigma_signal_per_m3)?;
        positive("min_range_m", self.min_range_m)?;
        positive("max_range_m", self.max_range_m.unwrap_or(1.0))?;
        positive("disturbed_above_mm", self.disturbed_above_mm)?;
        positive("duration_s", self.duration_s.unwrap_or(1.0))?;
        for metal in &self.metal {
            positive("metal.radius_m", metal.radius_m)?;
            not_negative("metal.from_s", metal.from_s.unwrap_or(0.0))?;
            positive("metal.until_s", metal.until_s.unwrap_or(1.0) - metal.from_s.unwrap_or(0.0))
                .map_err(|_| invalid("metal.until_s", "should be later than from_s"))?;
        }
        if let Some(floor) = &self.floor
            && !(0.0..=1.0).contains(&floor.strength)
        {
            return Err(invalid("floor.strength", "should be between 0 and 1"));
        }
        for other in &self.earth.disturbances {
            not_negative("earth.disturbance.at_s", other.at_s)?;
            not_negative("earth.disturbance.ramp_s", other.ramp_s)?;
            positive("earth.disturbance.duration_s", other.duration_s)?;
            if let Some(name) =
                other.sensors.iter().find(|name| !stage.sensors.iter().any(|s| s.name == **name))
            {
                return Err(invalid(
                    "earth.disturbance.sensors",
                    format!("the stage has no sensor `{name}`"),
                ));
            }
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
                return Err(invalid(key("rate_hz"), "a tracker measures at 14 to 144 Hz"));
            }
            not_negative(&key("burst_ms"), device.burst_ms)?;
            not_negative(&key("boot_ms"), device.boot_ms)?;
            if device.drift_ppm.abs() > 1e4 || device.drift_ppm.is_nan() {
                return Err(invalid(key("drift_ppm"), "should be within 10000 parts per million"));
            }
            for fault in &device.faults {
                let (start_s, end_s) = fault.span_s();
                let ends = fault.is_for_good() || end_s <= LAST_S;
                if !((0.0..=LAST_S).contains(&start_s) && end_s >= start_s && ends) {
                    let problem = format!("{} should begin at 0 s or later and end after that", fault.name());
                    return Err(invalid(key("fault"), problem));
                }
                if let Fault::Bursts { burst_ms, .. } = *fault {
                    not_negative(&key("fault.burst_ms"), burst_ms)?;
                }
            }
        }
        Ok(())
    }
}
