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

#[cfg(test)]
mod tests {
    use posed_drivers::slimevr::{Settings, SlimeVrSession};
    use posed_drivers::{Measurement, Session, State};

    use crate::faults::{Bytes, Fault};
    use crate::inertial::ImuClass;
    use crate::scenario::DeviceScenario;
    use crate::testing::{Pair, scenario_of, stage_of};

    fn pair(faults: Vec<Fault>) -> Pair<SlimeVrSession> {
        let session = SlimeVrSession::new(Settings::default(), &[1, 2, 3]).unwrap();
        let device = DeviceScenario { imu: ImuClass::Mtx, faults, ..DeviceScenario::default() };
        Pair::new(&stage_of("slimevr", "/dev/hidraw0", 115_200, &[1, 2, 3]), &scenario_of(device), session)
    }

    /// Samples that are not what was true about when they were read: the tracker's own filter wanders by a few degrees.
    fn wrong(pair: &Pair<SlimeVrSession>) -> usize {
        let is_true = |sample: &&posed_drivers::Sample| {
            let Measurement::Imu { orientation_wxyz: Some(q), .. } = sample.measurement else { return false };
            let (t, _) = pair.truth_of(sample);
            let rows = pair.truth.iter().filter(|cycle| t.seconds_since(cycle.t).abs() < 0.6);
            let mut rows = rows
                .flat_map(|cycle| &cycle.sensors)
                .filter(|row| row.sensor == usize::from(sample.address) - 1);
            rows.any(|row| tilt_between(q, &row.pose.rotation) < 0.12)
        };
        pair.samples.iter().filter(|sample| !is_true(sample)).count()
    }

    /// Angle between the directions of up: a tracker's heading is its own.
    fn tilt_between([w, x, y, z]: [f64; 4], truth: &nalgebra::UnitQuaternion<f64>) -> f64 {
        let q = nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, x, y, z));
        let up = nalgebra::Vector3::z();
        (q.inverse() * up).angle(&(truth.inverse() * up))
    }

    #[test]
    fn trackers_are_registered_and_stream_what_is_true() {
        let mut pair = pair(vec![]);
        pair.run_until(2.0);
        assert_eq!(*pair.session.state(), State::Streaming, "{:?}", pair.warnings);
        pair.forget();
        pair.run_until(4.0);
        for address in 1..=3 {
            assert!(pair.samples_of(address).len().abs_diff(200) <= 2, "{}", pair.samples_of(address).len());
        }
        assert_eq!(wrong(&pair), 0);
        let conditions = pair.session.conditions();
        assert!(
            conditions.iter().all(|of| of.signal_dbm == Some(-55.0) && of.battery == Some(0.9)),
            "{conditions:?}"
        );
    }

    #[test]
    fn radio_loss_a_pulled_receiver_and_dead_batteries_make_no_wrong_pose() {
        let bytes = Bytes { count: 100, start_s: 3.0, end_s: 8.0 };
        for fault in [
            Fault::LostDatagrams(bytes),
            Fault::DuplicatedDatagrams(bytes),
            Fault::DelayedDatagrams { at_s: 4.0, duration_s: 0.5 },
            Fault::LostPeriods { at_s: 4.0, count: 30 },
            Fault::WrongOutput { at_s: 4.0, duration_s: Some(1.0) },
            Fault::BirdDies { address: 2, at_s: 3.0, duration_s: Some(5.0) },
            Fault::Unplug { at_s: 4.0, duration_s: Some(1.0), power: true },
            Fault::Stall { at_s: 4.0, duration_s: 1.0 },
            Fault::LowBattery { address: 1, at_s: 4.0 },
            Fault::Error { address: 1, at_s: 4.0, code: 0, detail: 0 },
            Fault::Button { address: 1, at_s: 4.0 },
        ] {
            let mut pair = pair(vec![fault.clone()]);
            pair.run_until(10.0);
            assert_eq!(*pair.session.state(), State::Streaming, "{fault:?}");
            for address in 1..=3 {
                let last = *pair.samples_of(address).last().unwrap();
                assert!(pair.now.seconds_since(last.arrival.t_read) < 0.05, "{fault:?}");
            }
            assert_eq!(wrong(&pair), 0, "{fault:?}");
        }
    }
}
