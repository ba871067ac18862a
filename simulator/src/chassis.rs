//! What a powered unit is made of, whatever it speaks: power, stalls, its fault script, its transmitter.
//!
//! What comes in: what [`Device`] says. What goes to the [`Unit`] inside: bytes that it can hear, its own timers,
//! faults that only it understands. The unit sends through the [`Chassis`].

use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;

use posed_drivers::Timestamp;

use crate::device::{Device, DeviceOutput, Transmitter, moments};
use crate::faults::{Fault, FaultHit};
use crate::random::Random;
use crate::truth::{Loss, TruthCycle, TruthRow};

/// What every unit receives.
#[derive(Clone, Debug)]
pub(crate) struct Config {
    /// Index in the stage's list of devices.
    pub(crate) device: usize,
    /// Rate of its link, bit/s.
    pub(crate) baud: u32,
    /// How much slower than nominal its clock runs, parts per million.
    pub(crate) drift_ppm: f64,
    /// From power or reset to the first command that is understood.
    pub(crate) boot: Duration,
    /// From measurement to the record's first bit.
    pub(crate) measurement_delay: Duration,
    /// What goes wrong.
    pub(crate) faults: Vec<Fault>,
}

/// A protocol's own behaviour.
pub(crate) trait Unit: fmt::Debug + Send {
    /// It has just got power, or was reset: settings are those that it starts with. It hears nothing until
    /// [`Unit::start`].
    fn reset(&mut self, chassis: &mut Chassis, t: Timestamp);

    /// It has started.
    fn start(&mut self, _chassis: &mut Chassis, _t: Timestamp) {}

    /// Bytes of the host.
    fn receive(&mut self, chassis: &mut Chassis, t: Timestamp, bytes: &[u8]);

    /// The host sets the RTS line.
    fn set_rts(&mut self, _chassis: &mut Chassis, _t: Timestamp, _asserted: bool) {}

    /// Does what is due at `t`. It is called whether the unit is on or not: measurement cycles never end.
    fn step(&mut self, chassis: &mut Chassis, t: Timestamp);

    /// When something of its own happens next.
    fn poll_timeout(&self) -> Option<Timestamp>;

    /// A fault begins; false where it means nothing to this unit. Power and stalls are the chassis' business.
    fn fault(&mut self, chassis: &mut Chassis, t: Timestamp, fault: &Fault) -> bool;
}

/// What a unit sends and knows through.
#[derive(Debug)]
pub(crate) struct Chassis {
    pub(crate) config: Config,
    pub(crate) random: Random,
    pub(crate) transmitter: Transmitter,
    moments: VecDeque<(Timestamp, Fault)>,
    booting: Option<Timestamp>,
    /// It does nothing until then; what it has heard meanwhile.
    stalled: Option<Timestamp>,
    waiting: Vec<u8>,
    output: VecDeque<DeviceOutput>,
}

impl Chassis {
    fn new(config: Config, random: Random) -> Self {
        Self {
            transmitter: Transmitter::new(config.baud),
            moments: moments(&config.faults),
            config,
            random,
            booting: None,
            stalled: None,
            waiting: Vec::new(),
            output: VecDeque::new(),
        }
    }

    /// Whether it has started and does not stall.
    pub(crate) fn is_on(&self) -> bool {
        self.booting.is_none() && self.stalled.is_none()
    }

    /// Whether a sensor is gone at `t`.
    pub(crate) fn is_gone(&self, address: u16, t: Timestamp) -> bool {
        self.config.faults.iter().any(|fault| {
            matches!(*fault, Fault::BirdDies { address: gone, .. } if gone == address) && fault.is_active(t)
        })
    }

    /// Puts an answer on the wire.
    pub(crate) fn answer(&mut self, t: Timestamp, bytes: &[u8]) {
        let wire = self.transmitter.answer(t, bytes);
        self.output.push_back(DeviceOutput::Send(wire));
    }

    /// Puts a record on the wire; `address` is absent where it holds those of all sensors.
    pub(crate) fn record(&mut self, t: Timestamp, bytes: &[u8], cycle: u64, address: Option<u16>) {
        let wire = self.transmitter.record(t, bytes, cycle, address);
        self.output.push_back(DeviceOutput::Send(wire));
    }

    /// Something else goes out.
    pub(crate) fn emit(&mut self, output: DeviceOutput) {
        self.output.push_back(output);
    }

    /// A record is never sent.
    pub(crate) fn lose(&mut self, cycle: u64, address: Option<u16>) {
        self.output.push_back(DeviceOutput::Lost(Loss { cycle, address }));
    }

    /// The ground truth.
    pub(crate) fn truth(&mut self, t: Timestamp, cycle: u64, sensors: Vec<TruthRow>) {
        let device = self.config.device;
        self.output.push_back(DeviceOutput::Truth(TruthCycle { t, device, cycle, sensors }));
    }

    /// A fault hits something in a cycle.
    pub(crate) fn hit(&mut self, t: Timestamp, fault: &Fault, cycle: Option<u64>) {
        let hit = FaultHit { t, fault: fault.name(), address: fault.address(), cycle, byte: None };
        self.output.push_back(DeviceOutput::Fault(hit));
    }

    /// Everything that was going on ends, as by a loss of power, and the unit begins to start.
    pub(crate) fn power_cycle(&mut self, t: Timestamp) {
        self.transmitter.stop(t);
        self.waiting.clear();
        self.stalled = None;
        self.booting = Some(t + self.config.boot);
        self.output.push_back(DeviceOutput::Cut(t));
    }
}

/// A unit in its chassis.
#[derive(Debug)]
pub(crate) struct Powered<U> {
    chassis: Chassis,
    unit: U,
}

impl<U: Unit> Powered<U> {
    /// A unit that gets power at the stage's epoch.
    pub(crate) fn new(config: Config, random: Random, unit: impl FnOnce(&mut Chassis) -> U) -> Self {
        let mut chassis = Chassis::new(config, random);
        let unit = unit(&mut chassis);
        let mut powered = Self { chassis, unit };
        powered.chassis.booting = Some(Timestamp::ZERO + powered.chassis.config.boot);
        powered.unit.reset(&mut powered.chassis, Timestamp::ZERO);
        powered
    }

    fn step(&mut self, due: Timestamp) {
        let Self { chassis, unit } = self;
        if let Some((t, fault)) = chassis.moments.pop_front_if(|(t, _)| *t <= due) {
            match fault {
                Fault::Stall { duration_s, .. } => {
                    chassis.stalled = Some(t + Duration::from_secs_f64(duration_s.max(0.0)));
                    chassis.hit(t, &fault, None);
                }
                Fault::PowerCycle { .. } | Fault::Unplug { .. } => {
                    chassis.power_cycle(t);
                    unit.reset(chassis, t);
                    chassis.hit(t, &fault, None);
                }
                _ => {
                    if unit.fault(chassis, t, &fault) {
                        chassis.hit(t, &fault, None);
                    }
                }
            }
        } else if chassis.booting.is_some_and(|t| t <= due) {
            chassis.booting = None;
            unit.start(chassis, due);
        } else if chassis.stalled.is_some_and(|t| t <= due) {
            chassis.stalled = None;
            let bytes = std::mem::take(&mut chassis.waiting);
            unit.receive(chassis, due, &bytes);
        } else {
            unit.step(chassis, due);
        }
    }
}

impl<U: Unit> Device for Powered<U> {
    fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        self.handle_timeout(now);
        if self.chassis.booting.is_some() {
        } else if self.chassis.stalled.is_some() {
            self.chassis.waiting.extend(bytes);
        } else {
            self.unit.receive(&mut self.chassis, now, bytes);
        }
    }

    fn handle_rts(&mut self, now: Timestamp, asserted: bool) {
        self.handle_timeout(now);
        self.unit.set_rts(&mut self.chassis, now, asserted);
    }

    fn handle_timeout(&mut self, now: Timestamp) {
        while let Some(due) = self.poll_timeout().filter(|&due| due <= now) {
            self.step(due);
        }
    }

    fn poll_output(&mut self) -> Option<DeviceOutput> {
        self.chassis.output.pop_front()
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        let moment = self.chassis.moments.front().map(|&(t, _)| t);
        [moment, self.chassis.booting, self.chassis.stalled, self.unit.poll_timeout()]
            .into_iter()
            .flatten()
            .min()
    }
}
