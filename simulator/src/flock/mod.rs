//! A virtual Flock of Birds: one chain of units on one serial line; or a 3D Guidance unit, as far as its driver goes.
//!
//! What comes in: the host's bytes and the passing of time. What goes out: the bytes of the units, with the
//! time of each on the wire, and the truth of every measurement cycle. No clock, no port, no thread:
//! see [`Device`].
//!
//! - `unit`: one unit's settings, parameters and last measurement
//! - `command`: what each command does
//! - `measure`: the measurement cycle
//! - `send`: records and answers onto the wire

#[cfg(test)]
mod captures;
mod command;
mod measure;
mod send;
#[cfg(test)]
mod tests;
mod unit;

use std::collections::VecDeque;
use std::time::Duration;

use nalgebra::Isometry3;
use posed_drivers::Timestamp;
use posed_drivers::flock::Family;
use posed_drivers::flock::wire::{Addressing, CommandParser};

use crate::device::{Device, DeviceOutput, Sensor, moments};
use crate::faults::{Fault, FaultHit};
use crate::magnetic::Tracker;
use crate::random::Random;
use unit::{Measured, Unit};

/// One unit of the chain.
#[derive(Clone, Debug)]
pub struct UnitConfig {
    /// Its sensor; absent where none is plugged in.
    pub sensor: Option<Sensor>,
    /// It is an extended range controller.
    pub extended_controller: bool,
    /// A transmitter is plugged in.
    pub transmitter: bool,
}

/// However short a unit is without power, it takes so long until it measures again, s: drivers wait for one or two.
const LEAST_BOOT_S: f64 = 1.0;

/// A chain of units.
#[derive(Clone, Debug)]
pub struct FlockConfig {
    /// Index in the stage's list of devices.
    pub device: usize,
    /// What it is; a 3D Guidance unit has one unit here for each of its inputs.
    pub family: Family,
    /// Line rate, bit/s; 0 counts as 1.
    pub baud: u32,
    /// The only unit stands alone (address 0); else the units have addresses 1, 2, ...
    pub stand_alone: bool,
    /// The units, in the order of their addresses.
    pub units: Vec<UnitConfig>,
    /// Address mode switches.
    pub addressing: Addressing,
    /// Software revision: integer part, fraction.
    pub revision: [u8; 2],
    /// An extended range transmitter: words are fractions of 144 inches.
    pub extended_range: bool,
    /// Nominal measurement rate at power-up, Hz; the host may set another one.
    pub rate_hz: f64,
    /// How much slower than nominal the unit's clock runs, parts per million.
    pub drift_ppm: f64,
    /// From measurement to the record's first bit, constant.
    pub measurement_delay: Duration,
    /// From power or reset to the first command that is understood.
    pub boot: Duration,
    /// Transmitter to room, m.
    pub transmitter_in_room: Isometry3<f64>,
    /// Field, metal, noise and limits of range, in the transmitter frame.
    pub tracker: Tracker,
    /// A distortion above this makes a measurement `disturbed`, m.
    pub disturbed_above_m: f64,
    /// What goes wrong; the units leave faults of the line to [`crate::line`].
    pub faults: Vec<Fault>,
}

/// What a unit is busy with; input waits meanwhile.
#[derive(Debug)]
enum Job {
    /// Then send these bytes.
    Answer(Vec<u8>),
    /// Then send a record of this unit, or of all of them in group mode.
    Point(usize),
    /// Then the first so many units are configured.
    AutoConfig(u8),
    /// A stall of the script.
    Nothing,
}

/// A frame that was measured and waits for the constant delay to pass.
#[derive(Debug)]
struct Ready {
    at: Timestamp,
    cycle: u64,
    units: Vec<Option<Measured>>,
}

/// A chain of units on a line; see the module. Power comes at the stage's epoch; noise, phase and settling are seeded.
///
/// Modelled: commands and their delays, the measurement clock, range and saturation, settling after a start, the script's faults.
/// Not modelled: the units' filters, synchronisation and metal detection; their settings are kept and change nothing.
#[derive(Debug)]
pub struct VirtualFlock {
    config: FlockConfig,
    units: Vec<Unit>,
    /// Noise of each unit's sensor.
    noise: Vec<Random>,
    random: Random,
    now: Timestamp,
    /// The reset line holds the first unit.
    held: bool,
    /// Power-up or reset goes on until then.
    booting: Option<Timestamp>,
    /// Auto-configured, or stand-alone.
    configured: bool,
    group: bool,
    streaming: bool,
    /// Cycles per streamed frame.
    report_every: u16,
    asleep: bool,
    xoff: bool,
    factory_test: bool,
    rate_hz: f64,
    parser: CommandParser,
    input: VecDeque<u8>,
    busy: Option<(Timestamp, Job)>,
    /// Start of cycle `origin.1`; later ones follow at the period.
    origin: (Timestamp, u64),
    next_cycle: u64,
    /// Cycle of the last streamed or skipped frame.
    last_frame: Option<u64>,
    ready: VecDeque<Ready>,
    /// Cycle of the units' present measurements.
    present_cycle: u64,
    /// When the last byte handed to the line has left.
    line_free: Timestamp,
    /// Answers held back by XOFF.
    held_back: Vec<u8>,
    /// Momentary faults still to come, next one first.
    moments: VecDeque<(Timestamp, Fault)>,
    output: VecDeque<DeviceOutput>,
}

impl VirtualFlock {
    /// A flock that is powered at the stage's epoch.
    ///
    /// `noise` are the random numbers of each unit's sensor.
    pub(crate) fn new(config: FlockConfig, noise: Vec<Random>, mut random: Random) -> Self {
        let units: Vec<Unit> = (0..config.units.len()).map(|i| Unit::new(&config, i, &mut random)).collect();
        let phase = Duration::from_secs_f64(random.uniform() / config.rate_hz);
        let mut flock = Self {
            units,
            noise,
            random,
            now: Timestamp::ZERO,
            held: false,
            booting: None,
            configured: false,
            group: false,
            streaming: false,
            report_every: 1,
            asleep: false,
            xoff: false,
            factory_test: false,
            rate_hz: config.rate_hz,
            parser: CommandParser::new(config.addressing),
            input: VecDeque::new(),
            busy: None,
            origin: (Timestamp::ZERO + phase, 0),
            next_cycle: 0,
            last_frame: None,
            ready: VecDeque::new(),
            present_cycle: 0,
            line_free: Timestamp::ZERO,
            held_back: Vec::new(),
            moments: moments(&config.faults),
            output: VecDeque::new(),
            config,
        };
        flock.parser.family = flock.config.family;
        flock.power_up(Timestamp::ZERO);
        flock
    }

    /// Does the one thing that is due at `due`.
    fn step(&mut self, due: Timestamp) {
        if self.moments.front().is_some_and(|&(t, _)| t <= due) {
            if let Some((t, fault)) = self.moments.pop_front() {
                self.moment(t, &fault);
            }
        } else if self.booting.is_some_and(|t| t <= due) {
            self.booting = None;
        } else if self.busy.as_ref().is_some_and(|&(t, _)| t <= due) {
            if let Some((t, job)) = self.busy.take() {
                self.finish(t, job);
                self.work(t);
            }
        } else if self.ready.front().is_some_and(|ready| ready.at <= due) {
            if let Some(ready) = self.ready.pop_front() {
                self.publish(ready);
            }
        } else {
            self.measure_cycle(due);
        }
    }

    /// A momentary fault of the script.
    fn moment(&mut self, t: Timestamp, fault: &Fault) {
        let address = fault.address();
        let hit = FaultHit { t, fault: fault.name(), address, cycle: None, byte: None };
        let unit = address.and_then(|address| self.unit_of(u8::try_from(address).ok()));
        match *fault {
            Fault::Stall { duration_s, .. } => {
                let until = t + Duration::from_secs_f64(duration_s.max(0.0));
                // What it was busy with waits for the end of the stall too.
                let job = self.busy.take().map_or(Job::Nothing, |(_, job)| job);
                self.busy = Some((until, job));
            }
            Fault::PowerCycle { .. } | Fault::Unplug { .. } => {
                self.stop(t);
                self.power_up(t);
            }
            Fault::BirdDies { address, .. } if unit.is_some() => match self.config.family {
                Family::Flock => self.set_error(0, 13, address as u8),
                Family::Guidance => self.set_error(0, 5, 0),
            },
            Fault::Error { code, detail, .. } => {
                if let Some(unit) = unit {
                    self.set_error(unit, code, detail);
                }
            }
            Fault::BirdDies { .. } => {}
            // It has neither battery nor counter.
            _ => return,
        }
        self.output.push_back(DeviceOutput::Fault(hit));
    }

    /// Everything that was going on ends, as by a loss of power.
    fn stop(&mut self, t: Timestamp) {
        self.streaming = false;
        self.busy = None;
        self.input.clear();
        self.parser.reset();
        self.ready.clear();
        self.held_back.clear();
        self.xoff = false;
        self.line_free = self.line_free.min(t);
        self.output.push_back(DeviceOutput::Cut(t));
    }

    /// All units start with their power-up settings.
    fn power_up(&mut self, t: Timestamp) {
        for index in 0..self.units.len() {
            self.reset_unit(index);
        }
        self.configured = self.config.stand_alone;
        self.boot(t);
    }

    /// The first unit starts: its own state and that of the chain which it masters.
    fn boot(&mut self, t: Timestamp) {
        self.group = false;
        self.streaming = false;
        self.asleep = false;
        self.factory_test = false;
        self.report_every = 1;
        self.set_rate(t, self.config.rate_hz);
        self.booting = Some(t + self.config.boot);
        self.settle_from(t + self.config.boot);
    }

    fn reset_unit(&mut self, index: usize) {
        self.units[index] = Unit::new(&self.config, index, &mut self.random);
    }

    /// All units have just started and give bad measurements for a while.
    fn settle_from(&mut self, t: Timestamp) {
        for unit in &mut self.units {
            unit.started = Some(t);
        }
    }

    /// Index of the unit that a prefix names; without one the unit on the line.
    fn unit_of(&self, to: Option<u8>) -> Option<usize> {
        match to {
            None => Some(0),
            Some(address) => self.units.iter().position(|unit| unit.address == address),
        }
    }

    /// Whether a unit answers on the bus; inputs of a 3D Guidance unit always do.
    fn is_accessible(&self, unit: usize, t: Timestamp) -> bool {
        self.config.family == Family::Guidance || !self.is_dead(unit, t)
    }

    /// Whether the script has switched a unit off, or pulled the sensor of an input.
    fn is_dead(&self, unit: usize, t: Timestamp) -> bool {
        let address = u16::from(self.units[unit].address);
        self.config.faults.iter().any(|fault| {
            let (from_s, until_s) = fault.span_s();
            let until_s = until_s.max(from_s + LEAST_BOOT_S.max(self.config.boot.as_secs_f64()));
            matches!(*fault, Fault::BirdDies { address: dead, .. } if dead == address)
                && (from_s..until_s).contains(&t.as_secs_f64())
        })
    }

    /// Whether a unit measures: the master only once it has configured its chain.
    fn is_running(&self, unit: usize) -> bool {
        !self.asleep && (unit > 0 || self.configured)
    }

    fn set_error(&mut self, unit: usize, code: u8, detail: u8) {
        let unit = &mut self.units[unit];
        unit.error = [code, detail];
        unit.error_waiting = true;
        if posed_drivers::flock::wire::value::error(code).1
            == posed_drivers::flock::wire::value::ErrorClass::Fatal
        {
            self.streaming = false;
            self.asleep = true;
        }
    }
}

impl Device for VirtualFlock {
    fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        self.handle_timeout(now);
        if self.held || self.booting.is_some() {
            return;
        }
        self.input.extend(bytes);
        self.work(now);
    }

    fn handle_rts(&mut self, now: Timestamp, asserted: bool) {
        self.handle_timeout(now);
        // What the line does to a 3D Guidance unit is not known.
        let asserted = asserted && self.config.family == Family::Flock;
        match (self.held, asserted) {
            (false, true) => {
                self.held = true;
                self.stop(now);
            }
            (true, false) => {
                self.held = false;
                self.reset_unit(0);
                self.configured = self.config.stand_alone;
                self.boot(now);
            }
            _ => {}
        }
    }

    fn handle_timeout(&mut self, now: Timestamp) {
        while let Some(due) = self.poll_timeout().filter(|&due| due <= now) {
            self.now = self.now.max(due);
            self.step(due);
        }
        self.now = self.now.max(now);
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        let moment = self.moments.front().map(|&(t, _)| t);
        let busy = self.busy.as_ref().map(|&(t, _)| t);
        let ready = self.ready.front().map(|ready| ready.at);
        let cycle = Some(self.cycle_time(self.next_cycle));
        [moment, self.booting, busy, ready, cycle].into_iter().flatten().min()
    }

    fn poll_output(&mut self) -> Option<DeviceOutput> {
        self.output.pop_front()
    }
}
