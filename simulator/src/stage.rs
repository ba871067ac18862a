//! All virtual devices of a stage, without IO: stepped by hand in simulated time, or by [`crate::host`] in real time.
//!
//! ```
//! use posed_drivers::Timestamp;
//! use posed_simulator::scenario::{DeviceSpec, Scenario, SensorSpec, StageSpec};
//! use posed_simulator::stage::{Output, VirtualStage};
//!
//! let spec = StageSpec {
//!     devices: vec![DeviceSpec {
//!         name: "flock".into(),
//!         driver: "flock-of-birds".into(),
//!         baud: 115_200,
//!         ..DeviceSpec::default()
//!     }],
//!     sensors: vec![SensorSpec { name: "wand".into(), device: "flock".into(), address: 0 }],
//!     ..StageSpec::default()
//! };
//! let mut stage = VirtualStage::new(&spec, &Scenario::default(), ".".as_ref()).unwrap();
//! let second = |s| Timestamp::from_secs_f64(s);
//! stage.step(second(2.0));
//! stage.write(0, second(2.0), b"B"); // POINT
//! stage.step(second(2.1));
//! let mut bytes = Vec::new();
//! while let Some(event) = stage.poll_event() {
//!     if let Output::Data(data) = event.output {
//!         bytes.extend(data);
//!     }
//! }
//! assert_eq!(bytes.len(), 12, "a position and three angles");
//! assert_eq!(bytes[0] & 0x80, 0x80);
//! ```

use std::collections::VecDeque;
use std::path::Path;

use posed_drivers::Timestamp;

use crate::faults::FaultHit;
use crate::flock::{FlockOutput, VirtualFlock};
use crate::line::{Line, LineOutput};
use crate::random::{Purpose, Random};
use crate::scenario::{Scenario, ScenarioError, StageSpec};
use crate::truth::TruthCycle;

/// What a device gives to the host, or tells those who watch the simulation.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    /// Bytes that the host can read now.
    Data(Vec<u8>),
    /// The port is gone.
    Unplugged,
    /// The port is back.
    Replugged,
    /// Truth of a measurement cycle.
    Truth(TruthCycle),
    /// A fault hit something.
    Fault(FaultHit),
}

/// An output, its time and its device.
#[derive(Clone, Debug, PartialEq)]
pub struct Event {
    /// When.
    pub t: Timestamp,
    /// Index in the stage's list of devices.
    pub device: usize,
    /// What.
    pub output: Output,
}

/// A device and its line.
#[derive(Debug)]
pub struct VirtualDevice {
    index: usize,
    name: String,
    driver: String,
    flock: VirtualFlock,
    line: Line,
    output: VecDeque<Event>,
}

impl VirtualDevice {
    /// Name of the device in the stage.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its driver's name.
    pub fn driver(&self) -> &str {
        &self.driver
    }

    /// The units, for a look inside.
    pub fn flock(&self) -> &VirtualFlock {
        &self.flock
    }

    /// The rate that the host has set on its port; another one than the device's makes garbage of all bytes.
    pub fn set_host_baud(&mut self, baud: u32) {
        self.line.set_host_baud(baud);
    }

    /// Bytes of the host arrive at `now`.
    pub fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        self.handle_timeout(now);
        if self.line.is_plugged() && self.line.rates_agree() {
            self.flock.handle_bytes(now, bytes);
            self.handle_timeout(now);
        }
    }

    /// The host sets the RTS line, where there is one: asserted holds the unit in reset.
    pub fn handle_rts(&mut self, now: Timestamp, asserted: bool) {
        self.handle_timeout(now);
        if self.line.is_plugged() {
            self.flock.handle_rts(now, asserted);
            self.handle_timeout(now);
        }
    }

    /// Does everything that is due at or before `now`.
    pub fn handle_timeout(&mut self, now: Timestamp) {
        self.drain(now);
        while let Some(due) = self.poll_timeout().filter(|&due| due <= now) {
            self.flock.handle_timeout(due);
            self.drain(due);
            self.line.handle_timeout(due);
            self.drain(due);
        }
        self.flock.handle_timeout(now);
    }

    /// When something happens next.
    pub fn poll_timeout(&self) -> Option<Timestamp> {
        [self.flock.poll_timeout(), self.line.poll_timeout()].into_iter().flatten().min()
    }

    /// The next output, until `None`.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.output.pop_front()
    }

    /// Hands the flock's bytes to the line, and everything else out.
    fn drain(&mut self, now: Timestamp) {
        let device = self.index;
        while let Some(output) = self.flock.poll_output() {
            let (t, output) = match output {
                FlockOutput::Send(bytes) => {
                    self.line.send(&bytes);
                    continue;
                }
                FlockOutput::Cut(t) => {
                    self.line.cut_after(t);
                    continue;
                }
                FlockOutput::Truth(cycle) => (cycle.t, Output::Truth(cycle)),
                FlockOutput::Fault(hit) => (now, Output::Fault(hit)),
            };
            self.output.push_back(Event { t, device, output });
        }
        while let Some((t, output)) = self.line.poll_output() {
            let output = match output {
                LineOutput::Data(bytes) => Output::Data(bytes),
                LineOutput::Unplugged => Output::Unplugged,
                LineOutput::Replugged => Output::Replugged,
                LineOutput::Fault(hit) => Output::Fault(hit),
            };
            self.output.push_back(Event { t: t.min(now), device, output });
        }
    }
}

/// All devices of a stage; see the module.
#[derive(Debug)]
pub struct VirtualStage {
    devices: Vec<VirtualDevice>,
    events: VecDeque<Event>,
}

impl VirtualStage {
    /// Builds the devices of a stage; paths in the scenario are relative to `folder`.
    ///
    /// # Errors
    /// The first thing in the scenario that makes no sense, or a file of motion that cannot be read.
    pub fn new(stage: &StageSpec, scenario: &Scenario, folder: &Path) -> Result<Self, ScenarioError> {
        scenario.check(stage)?;
        let riders = scenario.riders(stage, folder)?;
        let mut devices = Vec::new();
        for (index, device) in stage.devices.iter().enumerate() {
            let (flock, line) = scenario.flock(stage, index, &riders)?;
            let noise = flock.units.iter().map(|unit| {
                let sensor = unit.sensor.as_ref().map_or(usize::MAX, |sensor| sensor.index);
                Random::new(scenario.seed, Purpose::Signals(sensor & 0xFFFF_FFFF))
            });
            let noise = noise.collect();
            devices.push(VirtualDevice {
                index,
                name: device.name.clone(),
                driver: device.driver.clone(),
                flock: VirtualFlock::new(flock, noise, Random::new(scenario.seed, Purpose::Device(index))),
                line: Line::new(
                    line,
                    scenario.faults(&device.name),
                    Random::new(scenario.seed, Purpose::Faults(index)),
                ),
                output: VecDeque::new(),
            });
        }
        Ok(Self { devices, events: VecDeque::new() })
    }

    /// The devices, in the stage's order.
    pub fn devices(&self) -> &[VirtualDevice] {
        &self.devices
    }

    /// The devices one by one, for those who run each on its own.
    pub fn into_devices(self) -> Vec<VirtualDevice> {
        self.devices
    }

    /// One device, for a host that sets its lines.
    ///
    /// # Panics
    /// If there is no such device.
    pub fn device_mut(&mut self, device: usize) -> &mut VirtualDevice {
        &mut self.devices[device]
    }

    /// The host writes to a device at `now`.
    ///
    /// # Panics
    /// If there is no such device.
    pub fn write(&mut self, device: usize, now: Timestamp, bytes: &[u8]) {
        self.devices[device].handle_bytes(now, bytes);
    }

    /// Lets time pass: everything that is due at or before `until` happens.
    pub fn step(&mut self, until: Timestamp) {
        for device in &mut self.devices {
            device.handle_timeout(until);
        }
        let fresh = self.events.len();
        for device in &mut self.devices {
            self.events.extend(std::iter::from_fn(|| device.poll_event()));
        }
        self.events.make_contiguous()[fresh..].sort_by_key(|event| event.t);
    }

    /// When something happens next.
    pub fn poll_timeout(&self) -> Option<Timestamp> {
        self.devices.iter().filter_map(VirtualDevice::poll_timeout).min()
    }

    /// The next event in the order of times, until `None`.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }
}
