//! The live session with one x-IMU3 or a chain of them: set-up, stream, recovery, each unit by itself.
//!
//! What comes in: line events, bytes, timeouts. What goes out: samples, commands, the state of the link.
//! What it never does: store settings in a unit; they hold until it is switched off.
//!
//! A unit is asked who it is, configured, one command at a time, and believed from then on; silence
//! or a restart lead back to the first question. One unit never waits for another.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::data::{self, Data};
use super::unit::{Clock, Expired, Inferred, Unit};
use super::wire::{self, Body, Lines};
use crate::arrivals::Arrivals;
use crate::flock::SettingsError;
use crate::outbox::Outbox;
use crate::sample::{DeviceTime, Sample, Timestamp};
use crate::session::{Condition, Counters, LineEvent, Loss, Output, SensorInfo, Session, State};

/// Inertial sample rate of a unit, Hz; messages are averages of a whole number of samples.
const SAMPLE_RATE_HZ: f64 = 400.0;

/// Settings of x-IMU3 units; every key has a default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Inertial messages per second, 4 to 400; the nearest one that divides 400.
    #[schemars(range(min = 4.0, max = 400.0))]
    pub rate_hz: f64,
    /// Whether units also send the orientation that they compute.
    pub orientation: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self { rate_hz: 100.0, orientation: true }
    }
}

impl Settings {
    /// Checks values that the types cannot.
    ///
    /// # Errors
    /// The first value out of its range, by key.
    pub fn validate(&self) -> Result<(), SettingsError> {
        if (4.0..=SAMPLE_RATE_HZ).contains(&self.rate_hz) {
            Ok(())
        } else {
            Err(SettingsError { key: "rate_hz", expected: "4 to 400" })
        }
    }

    /// How much earlier than it is sent an inertial message is true, s: it is the average of several samples of 2.5 ms. The
    /// device time of inertial samples is dated back by it, their arrival is not.
    pub fn averaging_s(&self) -> f64 {
        0.5 * f64::from(self.divisor() - 1) / SAMPLE_RATE_HZ
    }

    /// Samples that one message is the average of.
    fn divisor(&self) -> u32 {
        (SAMPLE_RATE_HZ / self.rate_hz).round() as u32
    }

    /// What each unit receives, in this order.
    pub(crate) fn commands(&self) -> Vec<(String, Value)> {
        let divisor = self.divisor();
        [
            ("ping", Value::Null),
            ("binary_mode_enabled", json!(true)),
            ("ahrs_message_type", json!(0)),
            // East, north, up.
            ("ahrs_axes_convention", json!(1)),
            ("inertial_message_rate_divisor", json!(divisor)),
            ("magnetometer_message_rate_divisor", json!(1)),
            ("ahrs_message_rate_divisor", json!(if self.orientation { divisor } else { 0 })),
            ("high_g_accelerometer_message_rate_divisor", json!(0)),
            ("apply", Value::Null),
        ]
        .map(|(key, value)| (key.to_owned(), value))
        .into()
    }
}

/// A live session with one unit, or with all units of a chain. Samples are in sensor axes; orientations are the unit's own,
/// sensor to east-north-up.
///
/// There is no checksum: messages must have the length of their letter, values that can be measured, and a time stamp that fits
/// the host's clock within 1 s. Losses are estimated from gaps of the time stamps.
#[derive(Clone, Debug, posed_state::State)]
pub struct XImu3Session {
    #[state(keep)]
    settings: Settings,
    #[state(keep)]
    commands: Vec<(String, Value)>,
    open: bool,
    units: Vec<Unit>,
    lines: Lines,
    scratch: Vec<u8>,
    arrivals: Arrivals,
    outbox: Outbox,
    refused_bytes: u64,
    sensors: Vec<SensorInfo>,
    losses: Vec<Loss>,
    conditions: Vec<Condition>,
}

impl XImu3Session {
    /// A session for the units `wanted`: `[0]` for one without a multiplexer, else channel bytes (`256 * outer + inner` behind
    /// two multiplexers), in any order. Closed until the line opens.
    ///
    /// # Errors
    /// A setting is out of its range; `wanted` is empty, names a unit twice, 0 beside others, or what is no address
    /// ([`super::wire::is_address`]).
    pub fn new(settings: Settings, wanted: &[u16]) -> Result<Self, SettingsError> {
        settings.validate()?;
        let mut addresses = wanted.to_vec();
        addresses.sort_unstable();
        addresses.dedup();
        let alone = addresses == [0];
        let usable = addresses.iter().all(|&address| wire::is_address(address) && (alone || address != 0));
        if addresses.is_empty() || addresses.len() != wanted.len() || !usable {
            let expected = "0 alone, or different channel bytes other than 10 and 94";
            return Err(SettingsError { key: "address", expected });
        }
        Ok(Self {
            commands: settings.commands(),
            settings,
            open: false,
            units: addresses.iter().map(|&address| Unit::new(address)).collect(),
            lines: Lines::default(),
            scratch: Vec::new(),
            arrivals: Arrivals::default(),
            outbox: Outbox::new(),
            refused_bytes: 0,
            sensors: addresses.iter().map(|&address| SensorInfo { address, serial: None }).collect(),
            conditions: addresses.iter().map(|&address| Condition::unknown(address)).collect(),
            losses: addresses.iter().map(|&address| Loss { address, ..Loss::default() }).collect(),
        })
    }

    fn period_us(&self) -> u64 {
        u64::from(self.settings.divisor()) * 2500
    }

    fn ask(&mut self, index: usize) {
        let unit = &self.units[index];
        let (key, value) = &self.commands[unit.step()];
        self.outbox.transmit(wire::command(unit.address, key, value));
    }

    fn line(&mut self, now: Timestamp, line: &[u8], offset: u64) {
        let mut scratch = std::mem::take(&mut self.scratch);
        let accepted = match wire::parse(line, &mut scratch) {
            Some(message) => match self.units.iter().position(|unit| unit.address == message.address) {
                Some(index) => self.message(now, index, message.body, offset),
                None => {
                    let address = message.address;
                    self.outbox.warn(now, 0x1_0000 + u32::from(address), || {
                        format!("unit {address} sends, but the stage file does not know it")
                    });
                    true
                }
            },
            None => false,
        };
        self.scratch = scratch;
        if !accepted {
            self.outbox.counters.rejected += 1;
            self.refused_bytes += line.len() as u64 + 1;
        }
    }

    /// Takes a message of a unit; false when it is damaged.
    fn message(&mut self, now: Timestamp, index: usize, body: Body<'_>, offset: u64) -> bool {
        if let Body::Command(json) = body {
            return match wire::answer(json) {
                Some((key, value)) => {
                    self.answer(now, index, &key, &value);
                    true
                }
                None => false,
            };
        }
        let Some(stamped) = data::decode(&body) else { return false };
        if let Data::Error(text) | Data::Notification(text) = stamped.data {
            let (address, kind) = (self.units[index].address, u32::from(stamped.data.letter()));
            if text.starts_with(wire::BUTTON_PRESSED) {
                self.outbox.pressed(address);
            }
            self.outbox.warn(now, kind << 16 | u32::from(address), || {
                format!("unit {address} reports: {}", String::from_utf8_lossy(text))
            });
            return true;
        }
        let Ok(measurement) = stamped.data.measurement() else { return false };
        if !self.units[index].is_running() {
            return true;
        }
        let period_us = self.period_us();
        let unit = &mut self.units[index];
        match unit.clock.check(now, stamped.time_us) {
            Clock::Plausible => {}
            Clock::Doubtful => return false,
            Clock::Restarted(since_s) => {
                let address = unit.address;
                self.losses[index].lost += (since_s * 1e6 / period_us as f64) as u64;
                self.losses[index].estimated = true;
                self.outbox.warn(now, 0x2_0000 + u32::from(address), || {
                    format!("unit {address} has restarted or set its clock; setting it up again")
                });
                self.start_unit(now, index);
                return true;
            }
        }
        let condition = &mut self.conditions[index];
        match stamped.data {
            Data::Battery([percent, volts, _]) => {
                (condition.battery, condition.battery_v) =
                    (Some((percent / 100.0).clamp(0.0, 1.0)), Some(volts));
            }
            Data::Rssi([_, strength_dbm]) => condition.signal_dbm = Some(strength_dbm),
            _ => {}
        }
        let mut time_us = stamped.time_us;
        if let Data::Inertial { .. } = stamped.data {
            // The others come beside it: a unit that sends them alone was set to something else.
            unit.received(now, period_us);
            // Lost messages leave a gap in time; the unit does not number them.
            if let Inferred::Lost(count) = unit.clock.gap(stamped.time_us, period_us) {
                self.losses[index].lost += count;
                self.losses[index].estimated = true;
            }
            // An average of n samples, stamped with the last one's time, is true in their middle.
            time_us = time_us.saturating_sub((period_us - 2500) / 2);
        }
        self.outbox.counters.records += 1;
        if let Some(measurement) = measurement
            && let Some(arrival) = self.arrivals.of(offset)
        {
            let address = self.units[index].address;
            let t_device = DeviceTime::Counter { ticks: time_us, tick_s: 1e-6 };
            self.outbox.sample(Sample { address, arrival, t_device, measurement });
        }
        self.outbox.streaming();
        true
    }

    fn answer(&mut self, now: Timestamp, index: usize, key: &str, value: &Value) {
        let address = self.units[index].address;
        let Some((requested, wanted)) = self.units[index].asking().map(|step| &self.commands[step]) else {
            return;
        };
        if key != wire::plain_key(requested) {
            return;
        }
        if let Some(serial) = value.get("sn").and_then(Value::as_str) {
            self.sensors[index].serial = Some(serial.to_owned());
        }
        let error = value.get("error").and_then(Value::as_str);
        let differs = !wanted.is_null() && !same(wanted, value);
        if error.is_some() || differs {
            let reported = error.map_or_else(|| format!("keeps {value}"), str::to_owned);
            let kind = 0x10_0000 + (u32::from(address) << 4) + self.units[index].step() as u32;
            self.outbox.warn(now, kind, || {
                format!("unit {address} was set to {requested} = {wanted} and answers: {reported}")
            });
        }
        let period_us = self.period_us();
        if self.units[index].answered(now, self.commands.len(), period_us) {
            self.ask(index);
        }
    }

    fn start_unit(&mut self, now: Timestamp, index: usize) {
        self.conditions[index] = Condition::unknown(self.units[index].address);
        self.units[index].ask_from_start(now);
        self.ask(index);
        self.update_state();
    }

    /// A line with no running unit is silent or connecting.
    fn update_state(&mut self) {
        if !self.open || self.units.iter().any(Unit::is_running) {
            return;
        }
        if self.units.iter().all(Unit::is_missing) {
            self.outbox.silent(
                "no unit answers; check power, cable and baud rate (115200 unless set otherwise), and on a chain the \
                 channels",
            );
        } else if !matches!(self.outbox.state(), State::Silent { .. }) {
            self.outbox.connecting("asking the units what they are");
        }
    }
}

/// Whether a value in force is the one asked for: numbers by value, whatever their form.
fn same(a: &Value, b: &Value) -> bool {
    a == b || a.as_f64().is_some_and(|a| b.as_f64() == Some(a))
}

impl Session for XImu3Session {
    fn handle_line(&mut self, now: Timestamp, event: &LineEvent) {
        match event {
            LineEvent::Opened { .. } => {
                self.lines.interrupt();
                self.arrivals.reopen();
                self.open = true;
                self.outbox.connecting("the port is open");
                for index in 0..self.units.len() {
                    self.start_unit(now, index);
                }
            }
            LineEvent::Closed { reason } => {
                self.lines.interrupt();
                self.open = false;
                self.units.iter_mut().for_each(Unit::close);
                for condition in &mut self.conditions {
                    *condition = Condition::unknown(condition.address);
                }
                self.outbox.connecting(reason.clone());
            }
            LineEvent::Dropped { bytes } => {
                self.lines.lose();
                self.refused_bytes += bytes;
            }
        }
    }

    fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        self.arrivals.read(now, bytes.len());
        // The messages lie in the lines while the session changes.
        let mut lines = std::mem::take(&mut self.lines);
        lines.push(bytes);
        while let Some(line) = lines.find() {
            self.line(now, lines.line(line), line.offset);
        }
        self.lines = lines;
    }

    fn handle_timeout(&mut self, now: Timestamp) {
        for index in 0..self.units.len() {
            let address = self.units[index].address;
            match self.units[index].handle_timeout(now) {
                Expired::No => {}
                Expired::Ask => self.ask(index),
                Expired::Silent => {
                    self.outbox.warn(now, 0x3_0000 + u32::from(address), || {
                        format!("unit {address} is silent; check its battery and cable")
                    });
                    self.start_unit(now, index);
                }
                Expired::Missing => {
                    self.outbox.warn(now, 0x4_0000 + u32::from(address), || {
                        format!("unit {address} does not answer; trying again each second")
                    });
                    self.update_state();
                }
            }
        }
    }

    fn poll_output(&mut self) -> Option<Output> {
        self.outbox.poll()
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        self.units.iter().filter_map(Unit::poll_timeout).min()
    }

    fn state(&self) -> &State {
        self.outbox.state()
    }

    fn counters(&self) -> Counters {
        let bytes_skipped = self.refused_bytes + self.lines.bytes_skipped();
        Counters { bytes_skipped, ..self.outbox.counters }
    }

    fn sensors(&self) -> &[SensorInfo] {
        &self.sensors
    }

    fn rate_hz(&self) -> Option<f64> {
        Some(SAMPLE_RATE_HZ / f64::from(self.settings.divisor()))
    }

    fn losses(&self) -> &[Loss] {
        &self.losses
    }

    fn conditions(&self) -> &[Condition] {
        &self.conditions
    }
}
