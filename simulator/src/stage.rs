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

use crate::device::{Device, DeviceOutput};
use crate::faults::FaultHit;
use crate::line::{Line, LineOutput};
use crate::scenario::{Scenario, ScenarioError, StageSpec};
use crate::truth::{Loss, TruthCycle};
use crate::udp_network::UdpNetwork;

/// What a device gives to the host, or tells those who watch the simulation.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    /// Bytes that the host can read now.
    Data(Vec<u8>),
    /// The port is gone.
    Unplugged,
    /// The port is back.
    Replugged,
    /// Ground truth of a measurement cycle, when it is measured: before its record can be read.
    Truth(TruthCycle),
    /// A fault of the script hit something.
    Fault(FaultHit),
    /// A record will not reach the host, or not as it was measured.
    Lost(Loss),
}

/// An output with its time and its device.
#[derive(Clone, Debug, PartialEq)]
pub struct Event {
    /// When, on the stage's clock.
    pub t: Timestamp,
    /// Index in the stage's list of devices.
    pub device: usize,
    /// What happened.
    pub output: Output,
}

/// What is between a device and its host.
#[derive(Debug)]
pub(crate) enum Link {
    /// A serial line, or a TCP connection: a stream of bytes.
    Line(Line),
    /// A network: datagrams.
    UdpNetwork(UdpNetwork),
}

impl Link {
    fn is_plugged(&self) -> bool {
        match self {
            Self::Line(line) => line.is_plugged() && line.rates_agree(),
            Self::UdpNetwork(udp_network) => udp_network.is_plugged(),
        }
    }

    fn handle_timeout(&mut self, now: Timestamp) {
        match self {
            Self::Line(line) => line.handle_timeout(now),
            Self::UdpNetwork(udp_network) => udp_network.handle_timeout(now),
        }
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        match self {
            Self::Line(line) => line.poll_timeout(),
            Self::UdpNetwork(udp_network) => udp_network.poll_timeout(),
        }
    }

    fn poll_output(&mut self) -> Option<(Timestamp, LineOutput)> {
        match self {
            Self::Line(line) => line.poll_output(),
            Self::UdpNetwork(udp_network) => udp_network.poll_output(),
        }
    }
}

/// A device and its link, without IO. Times are those of the stage's clock and must not go backwards.
#[derive(Debug)]
pub struct VirtualDevice {
    index: usize,
    name: String,
    driver: String,
    port: String,
    device: Box<dyn Device>,
    link: Link,
    output: VecDeque<Event>,
}

impl VirtualDevice {
    /// Name of the device in the stage.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its driver's name, as in the stage file.
    pub fn driver(&self) -> &str {
        &self.driver
    }

    /// Its port in the stage; `auto` of SlimeVR trackers is the address where all their servers listen.
    pub fn port(&self) -> &str {
        &self.port
    }

    /// The rate that the host has set on its port, bit/s; one that is off by more than 2 % makes garbage of what the device
    /// sends, and loses what the host sends. Until it is set, the rates agree. A device on UDP takes no notice.
    pub fn set_host_baud(&mut self, baud: u32) {
        if let Link::Line(line) = &mut self.link {
            line.set_host_baud(baud);
        }
    }

    /// Bytes of the host arrive at `now`, after everything that was due before. They are lost while the port is unplugged.
    pub fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        self.handle_timeout(now);
        if self.link.is_plugged() {
            self.device.handle_bytes(now, bytes);
            self.handle_timeout(now);
        }
    }

    /// The host sets the RTS line (`true` = asserted), where there is one: on a Flock, asserted holds the unit in reset.
    pub fn handle_rts(&mut self, now: Timestamp, asserted: bool) {
        self.handle_timeout(now);
        if self.link.is_plugged() {
            self.device.handle_rts(now, asserted);
            self.handle_timeout(now);
        }
    }

    /// Does everything that is due at or before `now`.
    pub fn handle_timeout(&mut self, now: Timestamp) {
        self.drain(now);
        while let Some(due) = self.poll_timeout().filter(|&due| due <= now) {
            self.device.handle_timeout(due);
            self.drain(due);
            self.link.handle_timeout(due);
            self.drain(due);
        }
        self.device.handle_timeout(now);
    }

    /// When something happens next; `None`: never, unless bytes arrive.
    pub fn poll_timeout(&self) -> Option<Timestamp> {
        [self.device.poll_timeout(), self.link.poll_timeout()].into_iter().flatten().min()
    }

    /// The next output, in the order in which it came about, until `None`.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.output.pop_front()
    }

    /// Hands the device's bytes to the link, and everything else out.
    fn drain(&mut self, now: Timestamp) {
        let device = self.index;
        while let Some(output) = self.device.poll_output() {
            let (t, output) = match output {
                DeviceOutput::Send(bytes) => {
                    match &mut self.link {
                        Link::Line(line) => line.send(&bytes),
                        Link::UdpNetwork(udp_network) => udp_network.send(None, &bytes),
                    }
                    continue;
                }
                DeviceOutput::SendFrom(peer, bytes) => {
                    if let Link::UdpNetwork(udp_network) = &mut self.link {
                        udp_network.send(Some(peer), &bytes);
                    }
                    continue;
                }
                DeviceOutput::Cut(t) => {
                    if let Link::Line(line) = &mut self.link {
                        line.cut_after(t);
                    }
                    continue;
                }
                DeviceOutput::Truth(cycle) => (cycle.t, Output::Truth(cycle)),
                DeviceOutput::Fault(hit) => (now, Output::Fault(hit)),
                DeviceOutput::Lost(loss) => (now, Output::Lost(loss)),
            };
            self.output.push_back(Event { t, device, output });
        }
        while let Some((t, output)) = self.link.poll_output() {
            let output = match output {
                LineOutput::Data(bytes) => Output::Data(bytes),
                LineOutput::Unplugged => Output::Unplugged,
                LineOutput::Replugged => Output::Replugged,
                LineOutput::Fault(hit) => Output::Fault(hit),
                LineOutput::Lost(loss) => Output::Lost(loss),
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
    /// Builds the devices of a stage, which get power at the stage's epoch; paths in the scenario are relative to `folder`. The
    /// same stage, scenario and input give the same bytes.
    ///
    /// # Errors
    /// The first thing in the scenario that makes no sense, a device or an address that cannot be simulated, or a file of motion
    /// that cannot be read.
    pub fn new(stage: &StageSpec, scenario: &Scenario, folder: &Path) -> Result<Self, ScenarioError> {
        scenario.check(stage)?;
        let riders = scenario.riders(stage, folder)?;
        let mut devices = Vec::new();
        for (index, device) in stage.devices.iter().enumerate() {
            let (unit, link) = scenario.device(stage, index, &riders)?;
            devices.push(VirtualDevice {
                index,
                name: device.name.clone(),
                driver: device.driver.clone(),
                port: device.port().to_owned(),
                device: unit,
                link,
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

    /// The host writes to a device at `now`, which must not lie before the last step. The answers come with the next
    /// [`VirtualStage::step`].
    ///
    /// # Panics
    /// If there is no such device.
    pub fn write(&mut self, device: usize, now: Timestamp, bytes: &[u8]) {
        self.devices[device].handle_bytes(now, bytes);
    }

    /// Lets time pass: everything that is due at or before `until` happens, as fast as the processor allows.
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

    /// When something happens next in any device; `None`: never, unless the host writes.
    pub fn poll_timeout(&self) -> Option<Timestamp> {
        self.devices.iter().filter_map(VirtualDevice::poll_timeout).min()
    }

    /// The next event, until `None`: in the order of times within a step, steps one after the other.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }
}
