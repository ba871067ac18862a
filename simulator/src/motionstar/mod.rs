//! A virtual MotionStar: a server of magnetic sensors on a network.
//!
//! What comes in: BirdNet packets of the host. What goes out: answers, and data packets while it runs. The
//! physics are those of every magnetic tracker here.

mod answer;
#[cfg(test)]
mod tests;

use std::time::Duration;

use posed_drivers::Timestamp;
use posed_drivers::flock::wire::{Format, QuaternionSense};
use posed_drivers::motionstar::wire::{self, Header, Packets, Pose, kind};

use crate::chassis::{Chassis, Unit};
use crate::device::{Pace, shown_s};
use crate::faults::Fault;
use crate::magnetic::{Scene, Station};

/// Seconds of 1970 at which its clock starts.
const CLOCK_START_S: u32 = 1_000_000_000;
/// Full scale of positions, inches, and m per inch.
const SCALE_IN: u16 = 144;
const INCH_M: f64 = 0.0254;

/// One bird: a sensor and how its records look.
#[derive(Debug)]
pub(crate) struct Bird {
    station: Station,
    format: Format,
    report_every: u8,
    hemisphere: u8,
    /// Setup byte; bit 3: button bytes.
    setup: u8,
}

impl Bird {
    pub(crate) fn new(station: Station) -> Self {
        Self { station, format: Format::PositionAngles, report_every: 1, hemisphere: 0, setup: 0x07 }
    }

    fn address(&self) -> u8 {
        self.station.address as u8
    }
}

/// A server; see the module.
#[derive(Debug)]
pub(crate) struct MotionStar {
    birds: Vec<Bird>,
    scene: Scene,
    power_up_rate_hz: f64,
    rate_hz: f64,
    packets: Packets,
    awake: bool,
    running: bool,
    /// Cycle in which it began to run.
    run_start: u64,
    /// Number of the next data packet.
    sequence: u16,
    pace: Pace,
    next_cycle: u64,
    clock_start: Timestamp,
    leave_out: u32,
    wrong_until: Option<Timestamp>,
    /// An error that the next data packet tells.
    error: u8,
}

impl MotionStar {
    pub(crate) fn new(birds: Vec<Bird>, scene: Scene, rate_hz: f64, chassis: &mut Chassis) -> Self {
        let phase = Duration::from_secs_f64(chassis.random.uniform() / rate_hz);
        Self {
            birds,
            scene,
            power_up_rate_hz: rate_hz,
            rate_hz,
            packets: Packets::default(),
            awake: false,
            running: false,
            run_start: 0,
            sequence: 0,
            pace: Pace::new(Timestamp::ZERO + phase, 0, 1.0 / rate_hz, chassis.config.drift_ppm),
            next_cycle: 0,
            clock_start: Timestamp::ZERO,
            leave_out: 0,
            wrong_until: None,
            error: 0,
        }
    }

    /// The measurement rate changes; the next cycle keeps its time.
    fn set_rate(&mut self, chassis: &Chassis, rate_hz: f64) {
        let next = self.pace.time(self.next_cycle);
        self.rate_hz = rate_hz;
        self.pace = Pace::new(next, self.next_cycle, 1.0 / rate_hz, chassis.config.drift_ppm);
    }

    /// The header's time: seconds since 1970 and milliseconds.
    fn stamp(&self, chassis: &Chassis, t: Timestamp) -> (u32, u16) {
        let millis = (shown_s(self.clock_start, t, chassis.config.drift_ppm).max(0.0) * 1e3).round() as u64;
        (CLOCK_START_S + (millis / 1000) as u32, (millis % 1000) as u16)
    }

    fn cycle(&mut self, chassis: &mut Chassis, t: Timestamp) {
        let cycle = self.next_cycle;
        self.next_cycle += 1;
        let Self { birds, scene, .. } = self;
        let rows =
            birds.iter_mut().map(|bird| bird.station.measure(scene, &chassis.config.faults, t)).collect();
        chassis.truth(t, cycle, rows);
        if !self.running {
            return;
        }
        let number = cycle - self.run_start;
        let due = |bird: &&Bird| number.is_multiple_of(u64::from(bird.report_every.max(1)));
        if !self.birds.iter().any(|bird| due(&bird)) {
            return;
        }
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        if self.leave_out > 0 || !chassis.is_on() {
            self.leave_out = self.leave_out.saturating_sub(1);
            return chassis.lose(cycle, None);
        }
        let is_wrong = self.wrong_until.is_some_and(|until| t < until);
        let mut body = Vec::new();
        for bird in self.birds.iter().filter(due) {
            let address = bird.station.address;
            let Some(latest) = bird.station.latest().filter(|_| !chassis.is_gone(address, t)) else {
                chassis.lose(cycle, Some(address));
                continue;
            };
            let before = body.len();
            let q = latest.orientation;
            let pose = Pose {
                position_m: Some(latest.position_m.into()),
                orientation_wxyz: Some([q.w, q.i, q.j, q.k]),
            };
            let range_m = f64::from(SCALE_IN) * INCH_M;
            let buttons = (bird.setup & 0x08 != 0).then_some([0, 0]);
            wire::encode_record(
                bird.address(),
                bird.format,
                pose,
                range_m,
                QuaternionSense::Vendor,
                buttons,
                &mut body,
            );
            if is_wrong {
                // Bad data, as many words as ever.
                body[before + 1] |= 0xF0;
                chassis.lose(cycle, Some(address));
            }
        }
        let (seconds, millis) = self.stamp(chassis, t);
        let error = std::mem::take(&mut self.error);
        let header =
            Header { sequence, millis, seconds, kind: kind::DATA_PACKET, error, ..Header::default() };
        let mut packet = Vec::new();
        header.encode(&body, &mut packet);
        chassis.record(t + chassis.config.measurement_delay, &packet, cycle, None);
    }
}

impl Unit for MotionStar {
    fn reset(&mut self, chassis: &mut Chassis, t: Timestamp) {
        self.packets = Packets::default();
        self.awake = false;
        self.running = false;
        self.clock_start = t;
        self.error = 0;
        for bird in &mut self.birds {
            (bird.format, bird.report_every, bird.setup) = (Format::PositionAngles, 1, 0x07);
            bird.hemisphere = 0;
            bird.station.hemisphere = answer::hemisphere(0);
        }
        self.set_rate(chassis, self.power_up_rate_hz);
    }

    fn receive(&mut self, chassis: &mut Chassis, t: Timestamp, bytes: &[u8]) {
        self.packets.push(bytes);
        let mut packets = std::mem::take(&mut self.packets);
        while let Some(found) = packets.find() {
            self.request(chassis, t, found.header, packets.body(found));
        }
        self.packets = packets;
    }

    fn step(&mut self, chassis: &mut Chassis, t: Timestamp) {
        self.cycle(chassis, t);
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        Some(self.pace.time(self.next_cycle))
    }

    fn fault(&mut self, _chassis: &mut Chassis, t: Timestamp, fault: &Fault) -> bool {
        match *fault {
            Fault::BirdDies { .. } | Fault::OutOfRange { .. } | Fault::HemisphereFlip { .. } => {}
            Fault::Error { code, .. } => self.error = code,
            Fault::CounterRestart { .. } => {
                self.sequence = 0;
                self.clock_start = t;
            }
            Fault::LostPeriods { count, .. } => self.leave_out = count,
            Fault::WrongOutput { .. } => {
                self.wrong_until = Some(fault.until());
            }
            _ => return false,
        }
        true
    }
}
