//! A virtual Fastrak: up to four stations that measure in turn.
//!
//! What comes in: commands, single letters or lines. What goes out: records in binary or as text, answers to
//! the status question and to polls. The physics are those of every magnetic tracker here.

mod command;
#[cfg(test)]
mod tests;

use std::time::Duration;

use posed_drivers::Timestamp;

use crate::chassis::{Chassis, Unit};
use crate::device::Pace;
use crate::faults::Fault;
use crate::magnetic::{Scene, Station};

/// Time that the unit takes for one station, s.
const SLOT_S: f64 = 1.0 / 120.0;
/// A line that is so far behind loses records, s.
const MOST_BACKLOG_S: f64 = 0.05;
/// cm and inches per metre.
const CM: f64 = 100.0;
const INCH: f64 = 1.0 / 0.0254;

/// One station that has a sensor plugged in.
#[derive(Debug)]
pub(crate) struct Stylus {
    station: Station,
    on: bool,
    /// Items of the output list.
    items: Vec<u8>,
    /// Letter that its next record carries in place of a space.
    status: u8,
}

impl Stylus {
    pub(crate) fn new(station: Station) -> Self {
        Self { station, on: true, items: vec![2, 4, 1], status: b' ' }
    }

    fn number(&self) -> u8 {
        self.station.address as u8
    }
}

/// A unit; see the module.
#[derive(Debug)]
pub(crate) struct Fastrak {
    stations: Vec<Stylus>,
    scene: Scene,
    input: Vec<u8>,
    continuous: bool,
    text: bool,
    per_metre: f64,
    pace: Pace,
    next_slot: u64,
    /// Index of the station whose turn it is.
    turn: usize,
    leave_out: u32,
    wrong_until: Option<Timestamp>,
}

impl Fastrak {
    pub(crate) fn new(stations: Vec<Stylus>, scene: Scene, chassis: &mut Chassis) -> Self {
        let phase = Duration::from_secs_f64(SLOT_S * chassis.random.uniform());
        Self {
            stations,
            scene,
            input: Vec::new(),
            continuous: false,
            text: true,
            per_metre: INCH,
            pace: Pace::new(Timestamp::ZERO + phase, 0, SLOT_S, chassis.config.drift_ppm),
            next_slot: 0,
            turn: 0,
            leave_out: 0,
            wrong_until: None,
        }
    }

    /// One station's measurement, and its record where they stream.
    fn slot(&mut self, chassis: &mut Chassis, t: Timestamp) {
        let slot = self.next_slot;
        self.next_slot += 1;
        let count = self.stations.len();
        let turns = (0..count).map(|k| (self.turn + k) % count);
        let Some(k) = turns.into_iter().find(|&k| self.stations[k].on) else { return };
        self.turn = (k + 1) % count;
        let Self { stations, scene, .. } = self;
        let row = stations[k].station.measure(scene, &chassis.config.faults, t);
        chassis.truth(t, slot, vec![row]);
        if !self.continuous {
            return;
        }
        let address = self.stations[k].station.address;
        let left_out = self.leave_out > 0;
        self.leave_out = self.leave_out.saturating_sub(1);
        let late = chassis.transmitter.backlog_s(t) > MOST_BACKLOG_S;
        if left_out || late || !chassis.is_on() || chassis.is_gone(address, t) {
            return chassis.lose(slot, Some(address));
        }
        if self.stations[k].status != b' ' {
            chassis.lose(slot, Some(address));
        }
        let record = self.record(k, t);
        self.stations[k].status = b' ';
        chassis.record(t + chassis.config.measurement_delay, &record, slot, Some(address));
    }

    /// The present record of a station.
    fn record(&self, k: usize, t: Timestamp) -> Vec<u8> {
        let stylus = &self.stations[k];
        let Some(latest) = stylus.station.latest() else { return Vec::new() };
        let mut out = vec![b'0', b'0' + stylus.number(), stylus.status];
        let numbers = |values: &[f64], out: &mut Vec<u8>| {
            for &value in values {
                if self.text {
                    out.extend(format!(" {value:8.4}").bytes());
                } else {
                    out.extend((value as f32).to_le_bytes());
                }
            }
        };
        let q = latest.orientation;
        let is_wrong = self.wrong_until.is_some_and(|until| t < until);
        let items = if is_wrong { &[2, 4, 1] } else { stylus.items.as_slice() };
        for item in items {
            match item {
                0 => out.push(b' '),
                1 => out.extend(b"\r\n"),
                2 => numbers((latest.position_m * self.per_metre).as_slice(), &mut out),
                4 => {
                    let angles = posed_drivers::flock::wire::rotation::to_angles([q.w, q.i, q.j, q.k]);
                    numbers(&angles.map(f64::to_degrees), &mut out);
                }
                11 => numbers(&[q.w, q.i, q.j, q.k], &mut out),
                16 => out.extend(b" 0"),
                _ => {}
            }
        }
        out
    }
}

impl Unit for Fastrak {
    fn reset(&mut self, _chassis: &mut Chassis, _t: Timestamp) {
        self.input.clear();
        self.continuous = false;
        self.text = true;
        self.per_metre = INCH;
        self.wrong_until = None;
        for stylus in &mut self.stations {
            stylus.on = true;
            stylus.items = vec![2, 4, 1];
            stylus.station.hemisphere = nalgebra::Vector3::x();
        }
    }

    fn receive(&mut self, chassis: &mut Chassis, t: Timestamp, bytes: &[u8]) {
        self.input.extend(bytes);
        self.work(chassis, t);
    }

    fn step(&mut self, chassis: &mut Chassis, t: Timestamp) {
        self.slot(chassis, t);
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        Some(self.pace.time(self.next_slot))
    }

    fn fault(&mut self, _chassis: &mut Chassis, _t: Timestamp, fault: &Fault) -> bool {
        let named = fault.address().and_then(|of| self.stations.iter().position(|s| s.station.address == of));
        match (fault, named) {
            (Fault::BirdDies { .. } | Fault::OutOfRange { .. } | Fault::HemisphereFlip { .. }, Some(_)) => {}
            (Fault::Error { code, .. }, Some(k)) => self.stations[k].status = b'A' + code % 26,
            (Fault::LostPeriods { count, .. }, _) => self.leave_out = *count,
            (Fault::WrongOutput { .. }, _) => {
                self.wrong_until = Some(fault.until());
            }
            _ => return false,
        }
        true
    }
}
