//! A virtual SlimeVR receiver on USB, and the trackers whose radio packets it gives on.
//!
//! What goes out: reports of four packets. A measurement goes out at once; what is left of the report names trackers, in turn, also those that are
//! switched off. Nothing comes in.

use std::time::Duration;

use posed_drivers::Timestamp;
use posed_drivers::slimevr::hid::{self, PACKET, RECEIVER, REPORT};

use crate::chassis::{Chassis, Unit};
use crate::device::{DeviceOutput, Pace};
use crate::faults::Fault;
use crate::inertial::{Imu, Inertial};
use crate::line::RecordByte;

/// Time between two measurements, s.
const MOTION_S: f64 = 0.01;
/// Measurements of which one goes in a reduced packet, with battery and signal beside it.
const REDUCED: u64 = 10;
/// Between two reports without a measurement, and two words of a tracker about itself.
const KEEP_ALIVE: Duration = Duration::from_millis(100);
const STATUS: Duration = Duration::from_secs(1);
/// Strength of the radio signals, -dBm.
const SIGNAL: u8 = 55;
/// What a tracker says of its button's sleep: none is planned.
const NO_SLEEP: u16 = 65_535;

/// A tracker with one sensor.
#[derive(Debug)]
pub(crate) struct RadioTracker {
    number: u16,
    mac: [u8; 6],
    imu: Imu,
    level: f64,
    pace: Pace,
    cycle: u64,
    leave_out: u32,
    last: Option<Inertial>,
    status: u8,
    presses: u8,
    next_status: Timestamp,
}

impl RadioTracker {
    pub(crate) fn new(number: u16, mac: [u8; 6], imu: Imu, chassis: &mut Chassis) -> Self {
        let start = Timestamp::from_secs_f64(MOTION_S * chassis.random.uniform());
        Self {
            number,
            mac,
            imu,
            level: 0.9,
            pace: Pace::new(start, 0, MOTION_S, chassis.config.drift_ppm),
            cycle: 0,
            leave_out: 0,
            last: None,
            status: 1,
            presses: 0,
            next_status: start,
        }
    }

    fn battery(&self) -> [u8; 2] {
        [0x80 | (100.0 * self.level) as u8, (100.0 * (3.2 + self.level) - 245.0) as u8]
    }

    fn poll_timeout(&self) -> Timestamp {
        self.pace.time(self.cycle).min(self.next_status)
    }
}

/// See the module.
#[derive(Debug)]
pub(crate) struct Receiver {
    trackers: Vec<RadioTracker>,
    next_keep_alive: Timestamp,
    /// Whose registration is next.
    turn: usize,
}

impl Receiver {
    pub(crate) fn new(trackers: Vec<RadioTracker>) -> Self {
        Self { trackers, next_keep_alive: Timestamp::ZERO, turn: 0 }
    }

    /// A report with these packets, the first of which is perhaps a record: its cycle and sensor.
    fn report(
        &mut self,
        chassis: &mut Chassis,
        t: Timestamp,
        packets: &[[u8; PACKET]],
        record: Option<(u64, u16)>,
    ) {
        self.next_keep_alive = t + KEEP_ALIVE;
        let mut bytes = packets.concat();
        while bytes.len() < REPORT {
            bytes.extend(hid::registration(self.turn as u8, self.trackers[self.turn].mac));
            self.turn = (self.turn + 1) % self.trackers.len();
        }
        let tagged = bytes.into_iter().zip(0_u16..).map(|(byte, index)| {
            let of = |(cycle, address)| RecordByte {
                cycle,
                address: Some(address),
                index,
                frame_index: index,
                frame_len: PACKET as u16,
            };
            (byte, record.filter(|_| usize::from(index) < PACKET).map(of))
        });
        let wire = chassis.transmitter.wire(t + chassis.config.measurement_delay, tagged);
        chassis.emit(DeviceOutput::SendFrom(RECEIVER, wire));
    }

    fn motion(&mut self, chassis: &mut Chassis, k: usize, t: Timestamp) {
        let is_quiet = !chassis.is_on() || chassis.is_gone(self.trackers[k].number, t);
        let is_wrong =
            chassis.config.faults.iter().any(|f| matches!(f, Fault::WrongOutput { .. }) && f.is_active(t));
        let tracker = &mut self.trackers[k];
        let (cycle, number) = (tracker.cycle, tracker.number);
        tracker.cycle += 1;
        let row = tracker.imu.truth(t);
        let measured = tracker.imu.measure(t, MOTION_S);
        chassis.truth(t, cycle, vec![row]);
        // At rest nothing is sent that has not changed.
        if tracker.last == Some(measured) {
            return;
        }
        let is_left_out = tracker.leave_out > 0;
        tracker.leave_out = tracker.leave_out.saturating_sub(1);
        if is_quiet || is_left_out {
            return chassis.lose(cycle, Some(number));
        }
        tracker.last = Some(measured);
        let q = measured.orientation;
        let q = if is_wrong { [0.0; 4] } else { [q.w, q.i, q.j, q.k] };
        let acceleration = measured.linear_acceleration_m_s2.into();
        let packet = if cycle.is_multiple_of(REDUCED) && !is_wrong {
            hid::reduced(k as u8, q, acceleration, tracker.battery(), SIGNAL)
        } else {
            hid::full(k as u8, q, acceleration)
        };
        if is_wrong {
            chassis.lose(cycle, Some(number));
        }
        self.report(chassis, t, &[packet], Some((cycle, number)));
    }

    /// A tracker's word about itself.
    fn status(&mut self, chassis: &mut Chassis, k: usize, t: Timestamp) {
        let is_quiet = !chassis.is_on() || chassis.is_gone(self.trackers[k].number, t);
        let tracker = &mut self.trackers[k];
        tracker.next_status = t + STATUS;
        let id = k as u8;
        let words = [
            hid::info(id, tracker.battery(), [0, 7, 3], SIGNAL),
            hid::status(id, std::mem::replace(&mut tracker.status, 1), SIGNAL),
            hid::button(id, std::mem::take(&mut tracker.presses), NO_SLEEP),
        ];
        if !is_quiet {
            self.report(chassis, t, &words, None);
        }
    }
}

impl Unit for Receiver {
    fn reset(&mut self, _chassis: &mut Chassis, t: Timestamp) {
        self.turn = 0;
        self.next_keep_alive = t;
    }

    fn receive(&mut self, _chassis: &mut Chassis, _t: Timestamp, _bytes: &[u8]) {}

    fn step(&mut self, chassis: &mut Chassis, t: Timestamp) {
        let first = (0..self.trackers.len()).min_by_key(|&k| self.trackers[k].poll_timeout());
        let Some(k) = first.filter(|&k| self.trackers[k].poll_timeout() <= t) else {
            self.next_keep_alive = t + KEEP_ALIVE;
            if chassis.is_on() && !self.trackers.is_empty() {
                self.report(chassis, t, &[], None);
            }
            return;
        };
        if self.trackers[k].pace.time(self.trackers[k].cycle) <= t {
            self.motion(chassis, k, t);
        } else {
            self.status(chassis, k, t);
        }
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        let first = self.trackers.iter().map(RadioTracker::poll_timeout).min();
        Some(first.map_or(self.next_keep_alive, |t| t.min(self.next_keep_alive)))
    }

    fn fault(&mut self, _chassis: &mut Chassis, t: Timestamp, fault: &Fault) -> bool {
        let named = self.trackers.iter().position(|tracker| Some(tracker.number) == fault.address());
        match (fault, named) {
            (Fault::BirdDies { .. }, Some(_)) | (Fault::WrongOutput { .. }, _) => {}
            (Fault::LostPeriods { count, .. }, _) => {
                self.trackers.iter_mut().for_each(|tracker| tracker.leave_out = *count);
            }
            (Fault::Error { .. }, Some(k)) => {
                (self.trackers[k].status, self.trackers[k].next_status) = (3, t)
            }
            (Fault::Button { .. }, Some(k)) => {
                (self.trackers[k].presses, self.trackers[k].next_status) = (1, t)
            }
            (Fault::LowBattery { .. }, Some(k)) => {
                (self.trackers[k].level, self.trackers[k].next_status) = (0.05, t);
            }
            _ => return false,
        }
        true
    }
}
