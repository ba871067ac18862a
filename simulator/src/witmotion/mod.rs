//! A virtual WitMotion sensor on a serial line.
//!
//! What comes in: five-byte commands that write and read registers. What goes out: groups of frames at the rate that is set, and
//! the registers that were asked for. Registers are locked; what is written into a locked one is lost without a word.

#[cfg(test)]
mod tests;

use std::time::Duration;

use posed_drivers::Timestamp;
use posed_drivers::witmotion::wire::{self, Group, RATES, kind, register};

use crate::chassis::{Chassis, Unit};
use crate::device::Pace;
use crate::faults::Fault;
use crate::inertial::Imu;

/// A line that is so far behind leaves groups out, s.
const MOST_BACKLOG_S: f64 = 0.05;
/// The registers lock themselves again.
const UNLOCKED: Duration = Duration::from_secs(10);
/// From a question to its answer.
const ANSWER: Duration = Duration::from_millis(2);
/// Bytes of a command.
const COMMAND: usize = 5;

/// A sensor; see the module.
#[derive(Debug)]
pub(crate) struct WitMotion {
    address: u16,
    imu: Imu,
    registers: Vec<u16>,
    unlocked_until: Timestamp,
    input: Vec<u8>,
    pace: Pace,
    next_cycle: u64,
    leave_out: u32,
    wrong_until: Option<Timestamp>,
}

impl WitMotion {
    pub(crate) fn new(address: u16, imu: Imu, chassis: &mut Chassis) -> Self {
        let start = Timestamp::from_secs_f64(0.1 * chassis.random.uniform());
        Self {
            address,
            imu,
            registers: vec![0; 256],
            unlocked_until: Timestamp::ZERO,
            input: Vec::new(),
            pace: Pace::new(start, 0, 0.1, chassis.config.drift_ppm),
            next_cycle: 0,
            leave_out: 0,
            wrong_until: None,
        }
    }

    fn period_s(&self) -> f64 {
        let code = self.registers[usize::from(register::RATE)];
        RATES.iter().find(|(_, of)| *of == code).map_or(0.1, |(rate_hz, _)| 1.0 / rate_hz)
    }

    fn command(&mut self, chassis: &mut Chassis, t: Timestamp, register: u8, value: u16) {
        let at = usize::from(register);
        match register {
            register::KEY => self.unlocked_until = if value == wire::KEY { t + UNLOCKED } else { t },
            0x27 => {
                let from = usize::from(value & 0xFF);
                let words =
                    std::array::from_fn(|k| self.registers.get(from + k).copied().unwrap_or(0) as i16);
                let mut answer = Vec::new();
                wire::frame(kind::REGISTERS, words, &mut answer);
                chassis.answer(t + ANSWER, &answer);
            }
            _ if t >= self.unlocked_until => {}
            _ => {
                self.registers[at] = value;
                if register == register::RATE {
                    let next = self.pace.time(self.next_cycle).max(t);
                    self.pace = Pace::new(next, self.next_cycle, self.period_s(), chassis.config.drift_ppm);
                }
                if register == register::OUTPUT {
                    self.wrong_until = None;
                }
            }
        }
    }

    fn cycle(&mut self, chassis: &mut Chassis, t: Timestamp) {
        let cycle = self.next_cycle;
        self.next_cycle += 1;
        let measured = self.imu.measure(t, self.period_s());
        chassis.truth(t, cycle, vec![self.imu.truth(t)]);
        let is_left_out = self.leave_out > 0;
        self.leave_out = self.leave_out.saturating_sub(1);
        let late = chassis.transmitter.backlog_s(t) > MOST_BACKLOG_S;
        if is_left_out || late || !chassis.is_on() || chassis.is_gone(self.address, t) {
            return chassis.lose(cycle, Some(self.address));
        }
        let q = measured.orientation;
        let (roll, pitch, yaw) = q.euler_angles();
        let group = Group {
            specific_force_m_s2: measured.specific_force_m_s2.into(),
            angular_velocity_rad_s: measured.angular_velocity_rad_s.into(),
            angles_rad: [roll, pitch, yaw],
            quaternion: [q.w, q.i, q.j, q.k],
        };
        let mut frames = Vec::new();
        group.encode(&mut frames);
        let output = self.registers[usize::from(register::OUTPUT)];
        let is_wrong = self.wrong_until.is_some_and(|until| t < until);
        let sent = |frame: &&[u8]| {
            output >> (frame[1] - 0x50) & 1 == 1 && !(is_wrong && frame[1] == kind::QUATERNION)
        };
        let bytes = frames.chunks(wire::FRAME).filter(sent).collect::<Vec<_>>().concat();
        chassis.record(t + chassis.config.measurement_delay, &bytes, cycle, Some(self.address));
    }
}

impl Unit for WitMotion {
    fn reset(&mut self, chassis: &mut Chassis, t: Timestamp) {
        self.input.clear();
        self.registers = vec![0; 256];
        self.registers[usize::from(register::OUTPUT)] = 0x000E;
        self.registers[usize::from(register::RATE)] = 0x06;
        self.registers[4] = 0x06;
        self.unlocked_until = Timestamp::ZERO;
        self.wrong_until = None;
        let next = self.pace.time(self.next_cycle).max(t);
        self.pace = Pace::new(next, self.next_cycle, self.period_s(), chassis.config.drift_ppm);
    }

    fn receive(&mut self, chassis: &mut Chassis, t: Timestamp, bytes: &[u8]) {
        self.input.extend(bytes);
        while let Some(&command) = self.input.first_chunk::<COMMAND>() {
            let [0xFF, 0xAA, register, low, high] = command else {
                self.input.remove(0);
                continue;
            };
            self.input.drain(..COMMAND);
            self.command(chassis, t, register, u16::from_le_bytes([low, high]));
        }
    }

    fn step(&mut self, chassis: &mut Chassis, t: Timestamp) {
        self.cycle(chassis, t);
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        Some(self.pace.time(self.next_cycle))
    }

    fn fault(&mut self, _chassis: &mut Chassis, _t: Timestamp, fault: &Fault) -> bool {
        match fault {
            Fault::BirdDies { .. } => {}
            Fault::LostPeriods { count, .. } => self.leave_out = *count,
            Fault::WrongOutput { .. } => self.wrong_until = Some(fault.until()),
            _ => return false,
        }
        true
    }
}
