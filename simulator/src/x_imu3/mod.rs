//! Virtual x-IMU3 units: one alone, or a chain behind a multiplexer.
//!
//! What comes in: commands. What goes out: answers, and data messages at the rates that are set. Each unit
//! samples on a clock of its own; the time stamps of all are of one clock.
//!
//! - `command`: what each command does
//! - `tests`: the real driver on it

mod command;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::time::Duration;

use posed_drivers::Timestamp;
use posed_drivers::x_imu3::wire::{self, LF, Lines, MUX};
use serde_json::Value;

use crate::chassis::{Chassis, Unit};
use crate::device::{Pace, shown_s};
use crate::faults::Fault;
use crate::inertial::{GRAVITY_M_S2, Imu, Inertial};

/// Nominal time between two inertial samples, s, and how far a unit's own may be from it.
const SAMPLE_S: f64 = 2.5e-3;
const SAMPLE_ERROR: f64 = 0.003;
/// The same of the magnetometer.
const MAGNETOMETER_S: f64 = 0.05;
const MAGNETOMETER_ERROR: f64 = 0.08;
/// From a command to its answer.
const ANSWER: Duration = Duration::from_millis(3);
/// Samples between two messages of the temperature.
const TEMPERATURE_SAMPLES: u64 = 400;
/// A line that is so far behind loses data messages, s.
const MOST_BACKLOG_S: f64 = 0.05;

/// One unit.
#[derive(Debug)]
pub(crate) struct Member {
    /// Channel, or 0 without a multiplexer.
    address: u16,
    imu: Imu,
    serial: String,
    /// Settings in force, by plain key.
    settings: BTreeMap<String, Value>,
    /// Settings written and not yet in force.
    written: BTreeMap<String, Value>,
    written_at: Option<Timestamp>,
    samples: Pace,
    next_sample: u64,
    magnetometer: Pace,
    next_magnetometer: u64,
    /// Samples since the last inertial message.
    pending: Vec<Inertial>,
    cycle: u64,
    leave_out: u32,
    battery_percent: f64,
}

impl Member {
    pub(crate) fn new(device: usize, address: u16, imu: Imu, chassis: &mut Chassis) -> Self {
        let mut pace = |nominal_s: f64, error: f64| {
            let start = Timestamp::from_secs_f64(nominal_s * chassis.random.uniform());
            Pace::new(start, 0, nominal_s * (1.0 + error * (2.0 * chassis.random.uniform() - 1.0)), 0.0)
        };
        Self {
            address,
            imu,
            serial: format!("6A3F{:02X}{address:02X}", device + 1),
            settings: command::defaults(),
            written: BTreeMap::new(),
            written_at: None,
            samples: pace(SAMPLE_S, SAMPLE_ERROR),
            next_sample: 0,
            magnetometer: pace(MAGNETOMETER_S, MAGNETOMETER_ERROR),
            next_magnetometer: 0,
            pending: Vec::new(),
            cycle: 0,
            leave_out: 0,
            battery_percent: 80.0,
        }
    }

    fn number(&self, key: &str) -> u64 {
        self.settings.get(key).and_then(Value::as_u64).unwrap_or_default()
    }

    fn poll_timeout(&self) -> Timestamp {
        let next = self.samples.time(self.next_sample).min(self.magnetometer.time(self.next_magnetometer));
        self.written_at.map_or(next, |at| at.min(next))
    }
}

/// Units on one link; see the module.
#[derive(Debug)]
pub(crate) struct XImu3 {
    members: Vec<Member>,
    lines: Lines,
    answers: std::collections::VecDeque<(Timestamp, Vec<u8>)>,
    /// When the units' time was 0.
    clock_start: Timestamp,
    is_on_network: bool,
    /// They send something else than they were set to, until then.
    wrong_until: Option<Timestamp>,
}

impl XImu3 {
    pub(crate) fn new(members: Vec<Member>, is_on_network: bool) -> Self {
        Self {
            members,
            lines: Lines::default(),
            answers: std::collections::VecDeque::new(),
            clock_start: Timestamp::ZERO,
            is_on_network,
            wrong_until: None,
        }
    }

    /// Microseconds of the units' common clock.
    fn time_us(&self, chassis: &Chassis, t: Timestamp) -> u64 {
        (shown_s(self.clock_start, t, chassis.config.drift_ppm).max(0.0) * 1e6).round() as u64
    }

    /// A data message of a unit; `cycle` where it is the record of a measurement.
    fn send(
        &self,
        chassis: &mut Chassis,
        t: Timestamp,
        k: usize,
        letter: u8,
        values: &[f64],
        cycle: Option<u64>,
    ) {
        let member = &self.members[k];
        let time_us = self.time_us(chassis, t);
        let mut out = Vec::new();
        if member.settings.get("binarymodeenabled").and_then(Value::as_bool).unwrap_or(true) {
            let mut data = time_us.to_le_bytes().to_vec();
            data.extend(values.iter().flat_map(|&value| (value as f32).to_le_bytes()));
            wire::binary(member.address, letter, &data, &mut out);
        } else {
            out.extend(prefix(member.address));
            out.push(letter);
            out.extend(format!(",{time_us}").bytes());
            for value in values {
                out.extend(format!(",{:.4}", value.clamp(-999_999.999_9, 999_999.999_9)).bytes());
            }
            out.push(LF);
        }
        let at = t + chassis.config.measurement_delay;
        match cycle {
            Some(cycle) => chassis.record(at, &out, cycle, Some(member.address)),
            None => chassis.answer(at, &out),
        }
    }

    /// A message that holds text.
    fn send_text(&self, chassis: &mut Chassis, t: Timestamp, k: usize, letter: u8, text: &str) {
        let mut data = self.time_us(chassis, t).to_le_bytes().to_vec();
        data.extend(text.bytes());
        let mut out = Vec::new();
        wire::binary(self.members[k].address, letter, &data, &mut out);
        chassis.answer(t, &out);
    }

    fn is_quiet(&self, chassis: &Chassis, k: usize, t: Timestamp) -> bool {
        !chassis.is_on() || chassis.is_gone(self.members[k].address, t)
    }

    /// An inertial sample of a unit, and the messages that it completes.
    fn sample(&mut self, chassis: &mut Chassis, k: usize, t: Timestamp) {
        let is_quiet = self.is_quiet(chassis, k, t);
        let is_wrong = self.wrong_until.is_some_and(|until| t < until);
        let member = &mut self.members[k];
        let index = member.next_sample;
        member.next_sample += 1;
        let measured = member.imu.measure(t, SAMPLE_S);
        member.pending.push(measured);
        let every = member.number("inertialmessageratedivisor");
        // A unit without inertial messages still has cycles, for the truth.
        let period = if every == 0 { 8 } else { every };
        if member.pending.len() as u64 >= period {
            let samples = std::mem::take(&mut member.pending);
            let cycle = member.cycle;
            member.cycle += 1;
            let first = member.samples.time((index + 1).saturating_sub(samples.len() as u64));
            let middle = Timestamp::from_nanos((first.as_nanos() + t.as_nanos()) / 2);
            let row = member.imu.truth(middle);
            let address = member.address;
            let left_out = member.leave_out > 0;
            member.leave_out = member.leave_out.saturating_sub(1);
            chassis.truth(middle, cycle, vec![row]);
            if every > 0
                && let Some(mean) = Inertial::mean(&samples)
            {
                let late = chassis.transmitter.backlog_s(t) > MOST_BACKLOG_S;
                if is_quiet || is_wrong || left_out || late {
                    chassis.lose(cycle, Some(address));
                } else {
                    let angular_velocity_deg_s = mean.angular_velocity_rad_s.map(f64::to_degrees);
                    let specific_force_g = mean.specific_force_m_s2 / GRAVITY_M_S2;
                    let values = [
                        angular_velocity_deg_s.x,
                        angular_velocity_deg_s.y,
                        angular_velocity_deg_s.z,
                        specific_force_g.x,
                        specific_force_g.y,
                        specific_force_g.z,
                    ];
                    self.send(chassis, t, k, b'I', &values, Some(cycle));
                }
            }
        }
        if is_quiet {
            return;
        }
        let every = self.members[k].number("ahrsmessageratedivisor");
        if every > 0
            && (index + 1).is_multiple_of(every)
            && chassis.transmitter.backlog_s(t) <= MOST_BACKLOG_S
        {
            let kind = if is_wrong { 2 } else { self.members[k].number("ahrsmessagetype") };
            let (letter, values) = self.attitude(k, kind, &measured);
            self.send(chassis, t, k, letter, &values, None);
        }
        if (index + 1).is_multiple_of(TEMPERATURE_SAMPLES) {
            self.send(chassis, t, k, b'T', &[25.0], None);
        }
    }

    /// The message of the orientation: letter and values.
    fn attitude(&self, k: usize, kind: u64, measured: &Inertial) -> (u8, Vec<f64>) {
        let q = match self.members[k].number("ahrsaxesconvention") {
            // North, west, up.
            0 => {
                let rotation =
                    nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, -std::f64::consts::FRAC_PI_2);
                rotation * measured.orientation
            }
            _ => measured.orientation,
        };
        match kind {
            0 => (b'Q', vec![q.w, q.i, q.j, q.k]),
            1 => {
                let m = q.to_rotation_matrix();
                (b'R', m.matrix().transpose().iter().copied().collect())
            }
            2 => {
                let (roll, pitch, yaw) = q.euler_angles();
                (b'A', [roll, pitch, yaw].map(f64::to_degrees).into())
            }
            3 => (b'L', (measured.linear_acceleration_m_s2 / GRAVITY_M_S2).iter().copied().collect()),
            _ => (b'E', (q * measured.linear_acceleration_m_s2 / GRAVITY_M_S2).iter().copied().collect()),
        }
    }
}

/// The channel bytes that lead to a unit.
fn prefix(address: u16) -> Vec<u8> {
    address
        .to_be_bytes()
        .into_iter()
        .filter(|&channel| channel != 0)
        .flat_map(|channel| [MUX, channel])
        .collect()
}

impl Unit for XImu3 {
    fn reset(&mut self, _chassis: &mut Chassis, t: Timestamp) {
        self.lines = Lines::default();
        self.answers.clear();
        self.clock_start = t;
        for member in &mut self.members {
            member.settings = command::defaults();
            member.written.clear();
            member.written_at = None;
        }
    }

    fn receive(&mut self, chassis: &mut Chassis, t: Timestamp, bytes: &[u8]) {
        self.lines.push(bytes);
        let mut lines = std::mem::take(&mut self.lines);
        while let Some(line) = lines.find() {
            self.command(chassis, t, lines.line(line));
        }
        self.lines = lines;
    }

    fn step(&mut self, chassis: &mut Chassis, t: Timestamp) {
        if let Some((at, bytes)) = self.answers.pop_front_if(|(at, _)| *at <= t) {
            if chassis.is_on() {
                chassis.answer(at, &bytes);
            }
            return;
        }
        let Some(k) = (0..self.members.len()).min_by_key(|&k| self.members[k].poll_timeout()) else { return };
        let member = &mut self.members[k];
        if member.written_at.is_some_and(|at| at <= t) {
            command::apply(member);
        } else if member.samples.time(member.next_sample) <= t {
            self.sample(chassis, k, t);
        } else {
            let index = member.next_magnetometer;
            member.next_magnetometer += 1;
            let every = member.number("magnetometermessageratedivisor");
            if every > 0 && (index + 1).is_multiple_of(every) && !self.is_quiet(chassis, k, t) {
                // The last sample's field would do, but a magnetometer alone has its own noise.
                let field = self.members[k].imu.measure(t, MAGNETOMETER_S).magnetic_field;
                self.send(chassis, t, k, b'M', field.as_slice(), None);
            }
        }
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        let answer = self.answers.front().map(|&(t, _)| t);
        self.members.iter().map(Member::poll_timeout).chain(answer).min()
    }

    fn fault(&mut self, chassis: &mut Chassis, t: Timestamp, fault: &Fault) -> bool {
        let named =
            fault.address().and_then(|of| self.members.iter().position(|member| member.address == of));
        match (fault, named) {
            (Fault::BirdDies { .. }, Some(_)) => {}
            (Fault::Error { code, .. }, Some(k)) => {
                if chassis.is_on() {
                    self.send_text(chassis, t, k, b'F', &format!("Error {code}."));
                }
            }
            (Fault::Button { .. }, Some(k)) => {
                if chassis.is_on() {
                    self.send_text(chassis, t, k, b'N', "Button pressed.");
                }
            }
            (Fault::LowBattery { .. }, Some(k)) => {
                self.members[k].battery_percent = 3.0;
                if chassis.is_on() {
                    self.send(chassis, t, k, b'B', &[self.members[k].battery_percent, 3.4, 0.0], None);
                    self.send_text(chassis, t, k, b'N', "Battery low.");
                }
            }
            (Fault::CounterRestart { .. }, _) => self.clock_start = t,
            (Fault::LostPeriods { count, .. }, _) => {
                self.members.iter_mut().for_each(|member| member.leave_out = *count);
            }
            (Fault::WrongOutput { .. }, _) => {
                self.wrong_until = Some(fault.until());
            }
            _ => return false,
        }
        true
    }
}

/// What a unit on a network broadcasts once a second, so that hosts find it.
pub(crate) fn announcement(name: &str, address: std::net::SocketAddr, host: std::net::SocketAddr) -> String {
    serde_json::json!({
        "sync": 0,
        "name": name,
        "sn": "6A3F0100",
        "ip": address.ip().to_string(),
        "port": 7000,
        // Where it sends to, and where it listens.
        "send": host.port(),
        "receive": address.port(),
        "rssi": 100,
        "battery": 80,
        "status": 0,
    })
    .to_string()
}
