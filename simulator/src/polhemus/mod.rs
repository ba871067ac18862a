//! A virtual Liberty or Patriot: stations that are all measured in each frame.
//!
//! What comes in: commands, `P` at once and the others with their CR. What goes out: records in binary or as text, answers to the
//! questions about stations and who it is, errors of commands that are none. The physics are those of every magnetic tracker here.

mod command;
#[cfg(test)]
mod tests;

use std::time::Duration;

use posed_drivers::Timestamp;
use posed_drivers::polhemus::wire::{Header, Model, STREAM};

use crate::chassis::{Chassis, Unit};
use crate::device::{Pace, shown_s};
use crate::faults::Fault;
use crate::magnetic::{Scene, Station};

/// A line that is so far behind loses frames, s.
const MOST_BACKLOG_S: f64 = 0.02;
/// cm and inches per metre.
const CM: f64 = 100.0;
const INCH: f64 = 1.0 / 0.0254;
/// The output list of a unit that nobody has set.
const DEFAULT_ITEMS: [u8; 3] = [2, 4, 1];

/// One station that has a sensor plugged in.
#[derive(Debug)]
pub(crate) struct Port {
    station: Station,
    items: Vec<u8>,
    /// What its next record carries in the place of a space.
    error: u8,
}

impl Port {
    pub(crate) fn new(station: Station) -> Self {
        Self { station, items: DEFAULT_ITEMS.to_vec(), error: b' ' }
    }

    fn number(&self) -> u8 {
        self.station.address as u8
    }
}

/// A unit; see the module.
#[derive(Debug)]
pub(crate) struct Polhemus {
    model: Model,
    ports: Vec<Port>,
    scene: Scene,
    input: Vec<u8>,
    is_continuous: bool,
    text: bool,
    per_metre: f64,
    pace: Pace,
    next_frame: u64,
    /// When the unit's time and frames were 0.
    counted_from: (Timestamp, u64),
    leave_out: u32,
    wrong_until: Option<Timestamp>,
}

impl Polhemus {
    pub(crate) fn new(model: Model, ports: Vec<Port>, scene: Scene, chassis: &mut Chassis) -> Self {
        let period_s = 1.0 / model.rate_hz();
        let phase = Duration::from_secs_f64(period_s * chassis.random.uniform());
        Self {
            model,
            ports,
            scene,
            input: Vec::new(),
            is_continuous: false,
            text: true,
            per_metre: INCH,
            pace: Pace::new(Timestamp::ZERO + phase, 0, period_s, chassis.config.drift_ppm),
            next_frame: 0,
            counted_from: (Timestamp::ZERO, 0),
            leave_out: 0,
            wrong_until: None,
        }
    }

    /// All stations' measurement, and their records where they stream.
    fn frame(&mut self, chassis: &mut Chassis, t: Timestamp) {
        let frame = self.next_frame;
        self.next_frame += 1;
        let Self { ports, scene, .. } = self;
        let faults = &chassis.config.faults;
        let rows = ports.iter_mut().map(|port| port.station.measure(scene, faults, t)).collect();
        chassis.truth(t, frame, rows);
        if !self.is_continuous {
            return;
        }
        let is_left_out = self.leave_out > 0;
        self.leave_out = self.leave_out.saturating_sub(1);
        let late = chassis.transmitter.backlog_s(t) > MOST_BACKLOG_S;
        for k in 0..self.ports.len() {
            let address = self.ports[k].station.address;
            if is_left_out || late || !chassis.is_on() || chassis.is_gone(address, t) {
                chassis.lose(frame, Some(address));
                continue;
            }
            let record = self.record(chassis, k, STREAM, t, frame);
            self.ports[k].error = b' ';
            chassis.record(t + chassis.config.measurement_delay, &record, frame, Some(address));
        }
    }

    /// The present record of a station.
    fn record(&self, chassis: &Chassis, k: usize, command: u8, t: Timestamp, frame: u64) -> Vec<u8> {
        let port = &self.ports[k];
        let Some(latest) = port.station.latest() else { return Vec::new() };
        let mut body = Vec::new();
        let numbers = |values: &[f64], decimals: usize, body: &mut Vec<u8>| {
            for &value in values {
                if self.text {
                    body.extend(format!(" {value:8.decimals$}").bytes());
                } else {
                    body.extend((value as f32).to_le_bytes());
                }
            }
        };
        let count = |value: u32, body: &mut Vec<u8>| {
            if self.text {
                body.extend(format!(" {value:10}").bytes());
            } else {
                body.extend(value.to_le_bytes());
            }
        };
        let (start, first) = self.counted_from;
        let time_ms = shown_s(start, t, chassis.config.drift_ppm).max(0.0) * 1e3;
        let q = latest.orientation;
        let is_wrong = self.wrong_until.is_some_and(|until| t < until);
        let items = if is_wrong { &DEFAULT_ITEMS[..] } else { port.items.as_slice() };
        for item in items {
            match item {
                0 => body.push(b' '),
                1 => body.extend(b"\r\n"),
                2 => numbers((latest.position_m * self.per_metre).as_slice(), 3, &mut body),
                4 => {
                    let angles = posed_drivers::flock::wire::rotation::to_angles([q.w, q.i, q.j, q.k]);
                    numbers(&angles.map(f64::to_degrees), 3, &mut body);
                }
                7 => numbers(&[q.w, q.i, q.j, q.k], 5, &mut body),
                8 => count(time_ms as u64 as u32, &mut body),
                9 => count((frame - first) as u32, &mut body),
                10 if self.text => body.extend(b" 0"),
                10 => count(0, &mut body),
                _ => {}
            }
        }
        if self.text {
            let mut line = format!("{:02}{}", port.number(), char::from(port.error)).into_bytes();
            line.extend(body);
            return line;
        }
        let mut out = self.header(port.number(), command, port.error, body.len());
        out.extend(body);
        out
    }

    fn header(&self, station: u8, command: u8, error: u8, size: usize) -> Vec<u8> {
        let mut out = Vec::new();
        Header { model: self.model, station, command, error, size: size as u16 }.encode(&mut out);
        out
    }
}

impl Unit for Polhemus {
    fn reset(&mut self, _chassis: &mut Chassis, t: Timestamp) {
        self.input.clear();
        self.is_continuous = false;
        self.text = true;
        self.per_metre = INCH;
        self.counted_from = (t, self.next_frame);
        self.wrong_until = None;
        for port in &mut self.ports {
            port.items = DEFAULT_ITEMS.to_vec();
            port.station.hemisphere = nalgebra::Vector3::x();
        }
    }

    fn receive(&mut self, chassis: &mut Chassis, t: Timestamp, bytes: &[u8]) {
        self.input.extend(bytes);
        self.work(chassis, t);
    }

    fn step(&mut self, chassis: &mut Chassis, t: Timestamp) {
        self.frame(chassis, t);
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        Some(self.pace.time(self.next_frame))
    }

    fn fault(&mut self, _chassis: &mut Chassis, t: Timestamp, fault: &Fault) -> bool {
        let named = fault.address().and_then(|of| self.ports.iter().position(|p| p.station.address == of));
        match (fault, named) {
            (Fault::BirdDies { .. } | Fault::OutOfRange { .. } | Fault::HemisphereFlip { .. }, Some(_)) => {}
            (Fault::Error { code, .. }, Some(k)) => self.ports[k].error = b'A' + code % 7,
            (Fault::LostPeriods { count, .. }, _) => self.leave_out = *count,
            (Fault::CounterRestart { .. }, _) => self.counted_from = (t, self.next_frame),
            (Fault::WrongOutput { .. }, _) => self.wrong_until = Some(fault.until()),
            _ => return false,
        }
        true
    }
}
