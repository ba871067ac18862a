//! From a scenario to physics, bodies and units.

use std::path::Path;
use std::time::Duration;

use nalgebra::{Isometry3, Unit, Vector3};
use posed_drivers::flock::Family;
use posed_drivers::flock::family::INPUTS;
use posed_drivers::flock::wire::Addressing;

use super::{ExcitationSpec, Material, MetalSpec, Scenario, ScenarioError, SensorSpec, StageSpec, invalid};
use crate::device::Sensor;
use crate::flock::{FlockConfig, UnitConfig};
use crate::line::LineConfig;
use crate::magnetic::{
    Environment, Excitation, Floor, Hum, Passing, Sphere, Tracker, conductor_response, iron_response,
};
use crate::motion::{Body, Motion, Orbit, quaternion};

impl Scenario {
    /// Physics in transmitter axes.
    pub(super) fn tracker(&self, room_from_transmitter: &Isometry3<f64>, extended: bool) -> Tracker {
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
        let sphere = |metal: &MetalSpec| Sphere {
            center_m: (transmitter_from_room * nalgebra::Point3::from(metal.center_m)).coords,
            radius_m: metal.radius_m,
            response: response(metal.material, metal.radius_m),
        };
        let passes = |metal: &&MetalSpec| metal.from_s.is_some() || metal.until_s.is_some();
        let spheres = self.metal.iter().filter(|metal| !passes(metal)).map(sphere);
        let passing = self.metal.iter().filter(passes).map(|metal| Passing {
            sphere: sphere(metal),
            from_s: metal.from_s.unwrap_or(0.0),
            until_s: metal.until_s.unwrap_or(f64::INFINITY),
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
            passing: passing.collect(),
            sigma_signal: self.sigma_signal_per_m3,
            hum: self.hum.map(|hum| Hum {
                frequency_hz: hum.frequency_hz,
                amplitude: transmitter_from_room.rotation * Vector3::from(hum.amplitude_per_m3),
                phase_rad: 0.0,
                from_s: hum.from_s.unwrap_or(f64::NEG_INFINITY),
                until_s: hum.until_s.unwrap_or(f64::INFINITY),
            }),
            max_range_m: self.max_range_m.unwrap_or(if extended { 3.0 } else { 1.2 }),
            min_range_m: self.min_range_m,
        }
    }

    /// Reads the files of motion, relative to `folder`.
    ///
    /// # Errors
    /// One cannot be read or holds no motion; the error names the body and the file.
    pub fn check_files(&self, folder: &Path) -> Result<(), ScenarioError> {
        self.moving(folder).map(|_| ())
    }

    /// The bodies by their names.
    fn moving(&self, folder: &Path) -> Result<Vec<(&str, Body)>, ScenarioError> {
        let mut bodies = Vec::new();
        for spec in &self.bodies {
            let body = Body::new(spec.motion.clone(), folder)
                .map_err(|source| ScenarioError::Motion { body: spec.name.clone(), source })?;
            bodies.push((spec.name.as_str(), body));
        }
        Ok(bodies)
    }

    /// Reads the files of motion and finds the body of each sensor of the stage.
    pub(crate) fn riders(&self, stage: &StageSpec, folder: &Path) -> Result<Vec<Sensor>, ScenarioError> {
        let bodies = self.moving(folder)?;
        let transmitter = transmitter_in_room(stage);
        let rider = |(index, sensor): (usize, &SensorSpec)| {
            let Some(given) = self.sensors.iter().find(|given| given.name == sensor.name) else {
                let device = stage.devices.iter().find(|device| device.name == sensor.device);
                let hemisphere = device.and_then(|device| device.hemisphere);
                let body = Body::new(Motion::Orbit(default_orbit(index, &transmitter, hemisphere)), folder)
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
        let guidance = device.family == Family::Guidance;
        if guidance && !birds.iter().all(|(address, _)| INPUTS.contains(address)) {
            return Err(wrong("addresses are 1 to 4".to_owned()));
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
        let extended_range = given.extended_range.unwrap_or(!has_first) && !guidance;
        let last = if guidance { *INPUTS.end() } else { highest };
        let addresses = if stand_alone { 0..=0 } else { 1..=last };
        let units = addresses.map(|address| UnitConfig {
            sensor: birds.iter().find(|&&(bird, _)| bird == address).map(|(_, sensor)| sensor.clone()),
            extended_controller: address == 1 && extended_range && !has_first,
            transmitter: address <= 1,
        });
        let transmitter_in_room = transmitter_in_room(stage);
        let duration = |ms: f64| Duration::from_secs_f64(ms.max(0.0) * 1e-3);
        let flock = FlockConfig {
            device: index,
            family: device.family,
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
}

pub(super) fn transmitter_in_room(stage: &StageSpec) -> Isometry3<f64> {
    stage.transmitter_in_room.map_or_else(Isometry3::identity, |(position, orientation)| {
        Isometry3::from_parts(position.into(), quaternion(orientation))
    })
}

/// A curve of its own for each sensor that the scenario leaves out: half a metre from the transmitter, where its host looks for it.
fn default_orbit(index: usize, transmitter: &Isometry3<f64>, hemisphere: Option<[f64; 3]>) -> Orbit {
    let direction = hemisphere.and_then(|direction| Vector3::from(direction).try_normalize(0.0));
    let center = transmitter * nalgebra::Point3::from(0.5 * direction.unwrap_or_else(Vector3::x));
    Orbit {
        center_m: center.coords.into(),
        radius_m: [0.12, 0.15, 0.1],
        phase_deg: 77.0 * index as f64,
        period_s: 5.0 + 0.7 * (index % 5) as f64,
        ..Orbit::default()
    }
}
