//! From a scenario to a device of any kind and its link.

use std::collections::BTreeSet;
use std::time::Duration;

use posed_drivers::polhemus::wire::Model;
use posed_drivers::x_imu3::wire;

use super::build::transmitter_in_room;
use super::{DeviceScenario, DeviceSpec, Personality, Scenario, ScenarioError, StageSpec, invalid};
use crate::chassis::{Config, Powered};
use crate::device::{Device, Sensor};
use crate::fastrak::{Fastrak, Stylus};
use crate::flock::VirtualFlock;
use crate::inertial::{FilterErrors, Imu, ImuErrors};
use crate::line::{Line, LineConfig};
use crate::magnetic::{Scene, Station};
use crate::motionstar::{Bird, MotionStar};
use crate::open_imu::{self, OpenImu};
use crate::polhemus::{self, Polhemus};
use crate::random::{Purpose, Random};
use crate::slimevr::receiver::{RadioTracker, Receiver};
use crate::slimevr::{self, SlimeVr};
use crate::stage::Link;
use crate::udp_network::UdpNetwork;
use crate::vrpn::{Target, Vrpn};
use crate::witmotion::WitMotion;
use crate::x_imu3::{self, XImu3};
use crate::xbus::{Tracker, Xbus};

/// Rate of a link that is no serial line, bit/s.
const NETWORK_BAUD: u32 = 100_000_000;
/// A device and its link.
type Built = (Box<dyn Device>, Link);

/// What a device is built from.
struct Parts<'a> {
    scenario: &'a Scenario,
    stage: &'a StageSpec,
    index: usize,
    spec: &'a DeviceSpec,
    given: DeviceScenario,
    /// Sensors by address.
    sensors: Vec<(u16, Sensor)>,
}

impl Scenario {
    /// The `index`-th device of the stage.
    pub(crate) fn device(
        &self,
        stage: &StageSpec,
        index: usize,
        riders: &[Sensor],
    ) -> Result<Built, ScenarioError> {
        let spec = &stage.devices[index];
        let given = self.devices.iter().find(|given| given.name == spec.name).cloned().unwrap_or_default();
        let mut sensors: Vec<(u16, Sensor)> = Vec::new();
        for (sensor, rider) in
            stage.sensors.iter().zip(riders).filter(|(sensor, _)| sensor.device == spec.name)
        {
            if sensors.iter().any(|&(taken, _)| taken == sensor.address) {
                let problem = format!("address {} is taken twice", sensor.address);
                return Err(invalid(format!("device.{}", spec.name), problem));
            }
            sensors.push((sensor.address, rider.clone()));
        }
        sensors.sort_by_key(|&(address, _)| address);
        let parts = Parts { scenario: self, stage, index, spec, given, sensors };
        let device: Box<dyn Device> = match spec.driver.as_str() {
            "flock-of-birds" => return self.virtual_flock(stage, index, riders),
            "xbus" => Box::new(parts.xbus()?),
            "x-imu3" => Box::new(parts.x_imu3()?),
            "slimevr" => parts.slimevr()?,
            "motionstar" => Box::new(parts.motionstar()?),
            "open-imu" => Box::new(parts.open_imu()?),
            "fastrak" => Box::new(parts.fastrak()?),
            "polhemus" => Box::new(parts.polhemus()?),
            "vrpn" => Box::new(parts.vrpn()?),
            "witmotion" => Box::new(parts.witmotion()?),
            driver => {
                return Err(parts.wrong(format!(
                    "driver `{driver}` cannot be simulated, only flock-of-birds, xbus, x-imu3, slimevr, motionstar, \
                     fastrak, polhemus, vrpn, witmotion and open-imu"
                )));
            }
        };
        Ok((device, parts.link()))
    }

    fn virtual_flock(
        &self,
        stage: &StageSpec,
        index: usize,
        riders: &[Sensor],
    ) -> Result<Built, ScenarioError> {
        let (flock, line) = self.flock(stage, index, riders)?;
        let noise = flock.units.iter().map(|unit| {
            let sensor = unit.sensor.as_ref().map_or(usize::MAX, |sensor| sensor.index);
            Random::new(self.seed, Purpose::Signals(sensor & 0xFFFF_FFFF))
        });
        let noise = noise.collect();
        let faults = flock.faults.clone();
        let flock = VirtualFlock::new(flock, noise, Random::new(self.seed, Purpose::Device(index)));
        let line = Line::new(line, faults, Random::new(self.seed, Purpose::Faults(index)));
        Ok((Box::new(flock), Link::Line(line)))
    }
}

impl Parts<'_> {
    fn wrong(&self, problem: impl Into<String>) -> ScenarioError {
        invalid(format!("device.{}", self.spec.name), problem)
    }

    fn is_on_network(&self) -> bool {
        self.spec.port().starts_with("tcp://") || self.spec.port().starts_with("udp://")
    }

    fn baud(&self) -> u32 {
        if self.spec.has_line() { self.spec.baud } else { NETWORK_BAUD }
    }

    fn link(&self) -> Link {
        let random = Random::new(self.scenario.seed, Purpose::Faults(self.index));
        // A report is whole or not there, as a datagram.
        if self.spec.port().starts_with("udp://")
            || self.spec.port() == "websocket"
            || self.spec.is_receiver()
        {
            let jitter = Duration::from_secs_f64(self.given.radio_jitter_ms.max(0.0) * 1e-3);
            return Link::UdpNetwork(UdpNetwork::new(&self.given.faults, jitter, random));
        }
        let config = LineConfig {
            baud: self.baud(),
            // A network delivers what was sent in one go at once.
            fifo_bytes: if self.is_on_network() { usize::MAX } else { self.given.fifo_bytes.max(1) },
            burst: Duration::from_secs_f64(self.given.burst_ms.max(0.0) * 1e-3),
        };
        Link::Line(Line::new(config, self.given.faults.clone(), random))
    }

    fn config(&self) -> Config {
        let duration = |ms: f64| Duration::from_secs_f64(ms.max(0.0) * 1e-3);
        Config {
            device: self.index,
            baud: self.baud(),
            drift_ppm: self.given.drift_ppm,
            boot: duration(self.given.boot_ms),
            measurement_delay: duration(self.spec.measurement_delay_ms),
            faults: self.given.faults.clone(),
        }
    }

    fn random(&self) -> Random {
        Random::new(self.scenario.seed, Purpose::Device(self.index))
    }

    /// The inertial sensor at an address, if the stage has one there.
    fn imu(&self, address: u16, filter: impl FnOnce(FilterErrors) -> FilterErrors) -> Option<Imu> {
        let (_, sensor) = self.sensors.iter().find(|&&(at, _)| at == address)?;
        let errors = ImuErrors::of(self.given.imu);
        let errors = ImuErrors { filter: filter(errors.filter), ..errors };
        let name = &self.stage.sensors[sensor.index].name;
        let random = Random::new(self.scenario.seed, Purpose::Signals(sensor.index));
        Some(Imu::new(sensor.clone(), self.scenario.earth.felt_by(name), &errors, random))
    }

    fn xbus(&self) -> Result<Powered<Xbus>, ScenarioError> {
        let highest = self.sensors.last().map_or(1, |&(address, _)| address);
        let personality = match self.given.xbus {
            Some(personality) => personality,
            None if self.sensors.len() > 1 || highest > 1 => Personality::Chain,
            None => Personality::Mti,
        };
        let is_chain = personality == Personality::Chain;
        let lowest = self.sensors.first().map_or(1, |&(address, _)| address);
        if is_chain && (lowest == 0 || highest > 20) {
            return Err(self.wrong("trackers of a chain have the addresses 1 to 20"));
        }
        if !is_chain && self.sensors.len() > 1 {
            return Err(self.wrong("a stand-alone tracker has one sensor, at address 1"));
        }
        let addresses = if is_chain { 1..=highest } else { lowest..=lowest };
        let trackers = addresses.map(|address| {
            let imu = self.imu(address, |errors| errors).map(|imu| imu.sampled(self.given.sampling));
            Tracker::new(self.index, address, imu)
        });
        let trackers = trackers.collect();
        Ok(Powered::new(self.config(), self.random(), |chassis| Xbus::new(personality, trackers, chassis)))
    }

    fn x_imu3(&self) -> Result<Powered<XImu3>, ScenarioError> {
        let alone = self.sensors.len() == 1;
        if !self.sensors.iter().all(|&(address, _)| wire::is_address(address) && (alone || address != 0)) {
            return Err(self.wrong("units have the address 0 (alone) or channel bytes other than 10 and 94"));
        }
        let imus = self.sensors.iter().filter_map(|&(address, _)| Some((address, self.imu(address, |e| e)?)));
        let imus: Vec<(u16, Imu)> = imus.collect();
        Ok(Powered::new(self.config(), self.random(), |chassis| {
            let members =
                imus.into_iter().map(|(address, imu)| x_imu3::Member::new(self.index, address, imu, chassis));
            let members = members.collect();
            XImu3::new(members, self.is_on_network())
        }))
    }

    /// Network address of a tracker: that of the stage, or one of its own.
    fn mac(&self, number: u16) -> Result<[u8; 6], ScenarioError> {
        let own = [0xA4, 0xCF, 0x12, 0xD4, self.index as u8, number as u8];
        match self.spec.serials.get(usize::from(number) - 1) {
            Some(text) => parse_mac(text)
                .ok_or_else(|| self.wrong(format!("`{text}` is no network address like A4:CF:12:D4:E5:F6"))),
            None => Ok(own),
        }
    }

    fn slimevr(&self) -> Result<Box<dyn Device>, ScenarioError> {
        let is_radio = self.spec.is_receiver();
        if !self.spec.port().starts_with("udp://") && !is_radio {
            return Err(self.wrong("SlimeVR trackers come over udp://HOST:PORT, or through /dev/hidrawN"));
        }
        let numbers: BTreeSet<u16> = self.sensors.iter().map(|&(address, _)| address & 0xFF).collect();
        if !numbers.iter().all(|number| (1..=64).contains(number)) {
            return Err(
                self.wrong("the address of a sensor is 256 * sensor + tracker, trackers from 1 to 64")
            );
        }
        // No magnetometer is trusted: each heading is what it is.
        let imu = |address| self.imu(address, |errors| FilterErrors { any_heading: true, ..errors });
        if is_radio {
            if let Some(&(address, _)) = self.sensors.iter().find(|&&(address, _)| address > 64) {
                return Err(self.wrong(format!("address {address}: a tracker with radio has one sensor")));
            }
            let mut trackers = Vec::new();
            for number in numbers {
                trackers.extend(imu(number).map(|imu| (number, imu)));
            }
            let macs: Vec<[u8; 6]> =
                trackers.iter().map(|&(number, _)| self.mac(number)).collect::<Result<_, _>>()?;
            return Ok(Box::new(Powered::new(self.config(), self.random(), |chassis| {
                let trackers = trackers.into_iter().zip(macs);
                let trackers =
                    trackers.map(|((number, imu), mac)| RadioTracker::new(number, mac, imu, chassis));
                Receiver::new(trackers.collect())
            })));
        }
        let mut trackers = Vec::new();
        for number in numbers {
            let sensors = self.sensors.iter().filter(|&&(address, _)| address & 0xFF == number);
            let sensors = sensors.filter_map(|&(address, _)| Some(((address >> 8) as u8, imu(address)?)));
            trackers.push((number, self.mac(number)?, sensors.collect()));
        }
        Ok(Box::new(Powered::new(self.config(), self.random(), |chassis| {
            let trackers = trackers
                .into_iter()
                .map(|(number, mac, sensors)| slimevr::Tracker::new(number, mac, sensors, chassis));
            SlimeVr::new(trackers.collect())
        })))
    }

    fn open_imu(&self) -> Result<Powered<OpenImu>, ScenarioError> {
        let carrier = match self.spec.port() {
            "websocket" => open_imu::Carrier::Browser,
            port if port.starts_with("udp://") && port.ends_with(":9302") => {
                open_imu::Carrier::Lines { on_wire: false }
            }
            port if port.starts_with("udp://") => open_imu::Carrier::Osc,
            _ => open_imu::Carrier::Lines { on_wire: true },
        };
        let numbers: BTreeSet<u16> = self.sensors.iter().map(|&(address, _)| address & 0xFF).collect();
        if !numbers.iter().all(|number| (1..=64).contains(number)) {
            return Err(self.wrong("the address of a sensor is 256 * sensor + device, devices from 1 to 64"));
        }
        let devices = numbers.into_iter().map(|number| {
            let id = self.spec.devices.get(usize::from(number) - 1).cloned();
            let sensors = self.sensors.iter().filter(|&&(address, _)| address & 0xFF == number);
            let sensors = sensors.filter_map(|&(address, _)| {
                let imu = self.imu(address, |errors| FilterErrors { any_heading: true, ..errors })?;
                Some(((address >> 8) as u8, imu))
            });
            (number, id.unwrap_or_else(|| format!("device-{number}")), sensors.collect::<Vec<_>>())
        });
        let devices: Vec<_> = devices.collect();
        Ok(Powered::new(self.config(), self.random(), |chassis| {
            let boards = devices
                .into_iter()
                .map(|(number, id, sensors)| open_imu::Board::new(number, id, carrier, sensors, chassis));
            OpenImu::new(boards.collect())
        }))
    }

    /// The magnetic sensors of a device whose addresses end at `most`.
    fn stations(&self, most: u16) -> Result<Vec<Station>, ScenarioError> {
        if !self.sensors.iter().all(|&(address, _)| (1..=most).contains(&address)) {
            return Err(self.wrong(format!("addresses are 1 to {most}")));
        }
        let station = |(address, sensor): &(u16, Sensor)| {
            let random = Random::new(self.scenario.seed, Purpose::Signals(sensor.index));
            Station::new(*address, sensor.clone(), random)
        };
        Ok(self.sensors.iter().map(station).collect())
    }

    fn scene(&self) -> Scene {
        let transmitter_in_room = transmitter_in_room(self.stage);
        Scene {
            tracker: self.scenario.tracker(&transmitter_in_room, true),
            transmitter_in_room,
            disturbed_above_m: self.scenario.disturbed_above_mm * 1e-3,
        }
    }

    fn motionstar(&self) -> Result<Powered<MotionStar>, ScenarioError> {
        let birds = self.stations(126)?.into_iter().map(Bird::new).collect();
        let rate_hz = self.given.rate_hz;
        Ok(Powered::new(self.config(), self.random(), |chassis| {
            MotionStar::new(birds, self.scene(), rate_hz, chassis)
        }))
    }

    fn fastrak(&self) -> Result<Powered<Fastrak>, ScenarioError> {
        let stations = self.stations(4)?.into_iter().map(Stylus::new).collect();
        Ok(Powered::new(self.config(), self.random(), |chassis| {
            Fastrak::new(stations, self.scene(), chassis)
        }))
    }

    fn polhemus(&self) -> Result<Powered<Polhemus>, ScenarioError> {
        let (model, most) = if self.given.patriot { (Model::Patriot, 2) } else { (Model::Liberty, 16) };
        let ports = self.stations(most)?.into_iter().map(polhemus::Port::new).collect();
        Ok(Powered::new(self.config(), self.random(), |chassis| {
            Polhemus::new(model, ports, self.scene(), chassis)
        }))
    }

    fn witmotion(&self) -> Result<Powered<WitMotion>, ScenarioError> {
        let only = self.sensors.first().filter(|_| self.sensors.len() == 1).map(|&(address, _)| address);
        let imu = only.filter(|&address| address == 0).and_then(|address| self.imu(address, |errors| errors));
        let imu = imu.ok_or_else(|| self.wrong("a device is one sensor, at address 0"))?;
        Ok(Powered::new(self.config(), self.random(), |chassis| WitMotion::new(0, imu, chassis)))
    }

    fn vrpn(&self) -> Result<Powered<Vrpn>, ScenarioError> {
        let names = self.spec.serials.clone();
        if !self.sensors.iter().all(|&(address, _)| (1..=names.len()).contains(&usize::from(address & 0xFF)))
        {
            return Err(self.wrong(
                "the address of a sensor is 256 * sensor + tracker, trackers as many as `trackers` names",
            ));
        }
        let target = |(address, sensor): &(u16, Sensor)| {
            let random = Random::new(self.scenario.seed, Purpose::Signals(sensor.index));
            Target::new(*address, sensor.clone(), random)
        };
        let targets: Vec<Target> = self.sensors.iter().map(target).collect();
        Ok(Powered::new(self.config(), self.random(), |chassis| {
            Vrpn::new(names, targets, transmitter_in_room(self.stage), self.given.rate_hz, chassis)
        }))
    }
}

fn parse_mac(text: &str) -> Option<[u8; 6]> {
    let bytes: Option<Vec<u8>> =
        text.split([':', '-']).map(|part| u8::from_str_radix(part, 16).ok()).collect();
    bytes?.try_into().ok()
}
