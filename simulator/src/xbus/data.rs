//! Measurement cycles and data messages.

use nalgebra::UnitQuaternion;
use posed_drivers::Timestamp;
use posed_drivers::xbus::message::{self, MASTER};
use posed_drivers::xbus::mtdata::{Block, Layout, Orientation};
use posed_drivers::xbus::mtdata2::{self, Axes, id};

use super::{ALWAYS, State, Xbus};
use crate::chassis::Chassis;
use crate::faults::Fault;
use crate::inertial::Inertial;
use crate::scenario::Personality;

/// A line that is so far behind loses data messages, s.
const MOST_BACKLOG_S: f64 = 0.05;

impl Xbus {
    /// A measurement cycle: truth always, a data message where one is due.
    pub(super) fn cycle(&mut self, chassis: &mut Chassis, t: Timestamp) {
        let cycle = self.next_cycle;
        self.next_cycle += 1;
        let rows = self.trackers.iter().filter_map(|tracker| Some(tracker.imu.as_ref()?.truth(t))).collect();
        chassis.truth(t, cycle, rows);
        if self.state != State::Measuring {
            return;
        }
        let period_s = 1.0 / self.rate_hz();
        let measured: Vec<Option<Inertial>> = (self.trackers.iter_mut())
            .map(|tracker| tracker.imu.as_mut().map(|imu| imu.measure(t, period_s)))
            .collect();
        if !chassis.is_on() || !self.may_send {
            return chassis.lose(cycle, None);
        }
        if self.leave_out > 0 {
            self.leave_out -= 1;
            chassis.hit(t, &Fault::LostPeriods { at_s: 0.0, count: 1 }, Some(cycle));
            return chassis.lose(cycle, None);
        }
        if chassis.transmitter.backlog_s(t) > MOST_BACKLOG_S {
            if !std::mem::replace(&mut self.overflow_reported, true) {
                chassis.answer(t, &message::request(MASTER, message::ERROR, &[0x29]));
            }
            return chassis.lose(cycle, None);
        }
        let at = t + chassis.config.measurement_delay;
        if self.wrong_until.is_some_and(|until| until <= t) {
            self.wrong_until = None;
        }
        let data = match self.personality {
            Personality::Mti if self.wrong_until.is_none() => {
                let data = self.items(chassis, t, cycle, measured.first().copied().flatten());
                chassis.record(at, &message::request(MASTER, message::MTDATA2, &data), cycle, None);
                return;
            }
            Personality::Mti => vec![0; 36],
            Personality::Mtx | Personality::Chain => match self.blocks(chassis, t, cycle, &measured) {
                Some(data) => data,
                None => return chassis.lose(cycle, None),
            },
        };
        chassis.record(at, &message::request(MASTER, message::MTDATA, &data), cycle, None);
    }

    /// Counter of a cycle since the measurement began.
    fn counter(&self, cycle: u64) -> u16 {
        (cycle - self.counter_start) as u16
    }

    /// Bytes of a tracker's block, its own counter included.
    pub(super) fn block_len(&self, k: usize) -> usize {
        let layout = self.trackers[k].layout;
        layout.block_len() + if layout.has_counter() { 2 } else { 0 }
    }

    /// Bytes of data of a message with everything in it.
    pub(super) fn message_len(&self) -> usize {
        match self.personality {
            Personality::Chain => 2 + self.bus.iter().map(|&k| self.block_len(k)).sum::<usize>(),
            Personality::Mtx => self.block_len(0),
            Personality::Mti => {
                let mut data = Vec::new();
                self.outputs.iter().for_each(|&(id, _)| item(id, 0, 0, &STILL, &mut data));
                data.len()
            }
        }
    }

    /// MTData: the blocks of all trackers. `None` when a tracker has failed and the period with it.
    fn blocks(
        &mut self,
        chassis: &mut Chassis,
        t: Timestamp,
        cycle: u64,
        measured: &[Option<Inertial>],
    ) -> Option<Vec<u8>> {
        let counter = self.counter(cycle).to_be_bytes();
        let on_bus: Vec<usize> = if self.is_chain() { self.bus.clone() } else { vec![0] };
        let mut data = Vec::new();
        if self.is_chain() {
            data.extend(counter);
        }
        for (bid, k) in (1..).zip(on_bus) {
            let tracker = &mut self.trackers[k];
            if chassis.is_gone(tracker.address, t) {
                if self.error_mode > 0 {
                    if self.error_mode >= 2 {
                        chassis.answer(t, &message::request(MASTER, message::ERROR, &[0x1D, bid]));
                    }
                    if self.error_mode == 3 {
                        self.state = State::Config;
                    }
                    return None;
                }
                // It repeats, as if nothing had happened.
            } else {
                let mut layout = tracker.layout;
                if self.wrong_until.is_some() {
                    layout.mode ^= Layout::TEMPERATURE;
                }
                tracker.block.clear();
                layout.encode(&block(layout, &measured[k].unwrap_or(STILL)), &mut tracker.block);
                if layout.has_counter() {
                    tracker.block.extend(counter);
                }
            }
            data.extend(&tracker.block);
        }
        Some(data)
    }

    /// MTData2: the items that are due in this cycle.
    fn items(&self, chassis: &Chassis, t: Timestamp, cycle: u64, measured: Option<Inertial>) -> Vec<u8> {
        let measured = measured.unwrap_or(STILL);
        let (counter, time) = (self.counter(cycle), self.fine_time(chassis, t));
        let base_hz = u64::from(self.base_hz());
        let mut data = Vec::new();
        for &(id, hz) in &self.outputs {
            let every = if hz == ALWAYS { 1 } else { (base_hz / u64::from(hz.max(1))).max(1) };
            if (cycle - self.counter_start).is_multiple_of(every) {
                item(id, counter, time, &measured, &mut data);
            }
        }
        data
    }
}

/// What a tracker without a sensor of the stage measures.
const STILL: Inertial = Inertial {
    angular_velocity_rad_s: nalgebra::Vector3::new(0.0, 0.0, 0.0),
    specific_force_m_s2: nalgebra::Vector3::new(0.0, 0.0, crate::inertial::GRAVITY_M_S2),
    magnetic_field: nalgebra::Vector3::new(0.0, 0.5, -0.866),
    orientation: UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(1.0, 0.0, 0.0, 0.0)),
    linear_acceleration_m_s2: nalgebra::Vector3::new(0.0, 0.0, 0.0),
};

/// Roll, pitch and yaw in degrees: R = Rz(yaw) Ry(pitch) Rx(roll).
fn euler_deg(q: &UnitQuaternion<f64>) -> [f64; 3] {
    let (roll, pitch, yaw) = q.euler_angles();
    [roll, pitch, yaw].map(f64::to_degrees)
}

/// Sensor to the axes that the settings ask for.
fn in_axes(q: &UnitQuaternion<f64>, axes: Axes) -> UnitQuaternion<f64> {
    use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2};
    match axes {
        Axes::Enu => *q,
        // x north, y west: a quarter turn about z.
        Axes::Nwu => UnitQuaternion::from_euler_angles(0.0, 0.0, -FRAC_PI_2) * q,
        // x north, y east, z down: half a turn about the bisector of x and y.
        Axes::Ned => {
            let half_turn = nalgebra::Quaternion::new(0.0, FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0);
            UnitQuaternion::new_unchecked(half_turn) * q
        }
    }
}

fn wxyz(q: &UnitQuaternion<f64>) -> [f64; 4] {
    [q.w, q.i, q.j, q.k]
}

fn block(layout: Layout, measured: &Inertial) -> Block {
    let axes = if layout.settings & Layout::NED != 0 { Axes::Ned } else { Axes::Enu };
    let q = in_axes(&measured.orientation, axes);
    let orientation = match layout.settings & 0x0C {
        0 => Orientation::Quaternion(wxyz(&q)),
        4 => Orientation::EulerDeg(euler_deg(&q)),
        _ => {
            let m = q.to_rotation_matrix();
            Orientation::Matrix(std::array::from_fn(|row| std::array::from_fn(|column| m[(row, column)])))
        }
    };
    Block {
        temperature_c: Some(31.5),
        acceleration: Some(measured.specific_force_m_s2.into()),
        rate_of_turn: Some(measured.angular_velocity_rad_s.into()),
        magnetic_field: Some(measured.magnetic_field.into()),
        orientation: Some(orientation),
        ..Block::default()
    }
}

fn item(id: u16, counter: u16, time: u32, measured: &Inertial, out: &mut Vec<u8>) {
    let q = in_axes(&measured.orientation, mtdata2::axes(id));
    match id & 0xFFF0 {
        id::PACKET_COUNTER => mtdata2::encode_bytes(id, &counter.to_be_bytes(), out),
        id::SAMPLE_TIME_FINE => mtdata2::encode_bytes(id, &time.to_be_bytes(), out),
        id::SAMPLE_TIME_COARSE => mtdata2::encode_bytes(id, &(time / 10_000).to_be_bytes(), out),
        // Self-test passed, filter valid.
        id::STATUS_WORD => mtdata2::encode_bytes(id, &3u32.to_be_bytes(), out),
        id::STATUS_BYTE => mtdata2::encode_bytes(id, &[3], out),
        id::QUATERNION => mtdata2::encode_numbers(id, &wxyz(&q), out),
        id::EULER => mtdata2::encode_numbers(id, &euler_deg(&q), out),
        id::ACCELERATION => mtdata2::encode_numbers(id, measured.specific_force_m_s2.as_slice(), out),
        id::RATE_OF_TURN => mtdata2::encode_numbers(id, measured.angular_velocity_rad_s.as_slice(), out),
        id::MAGNETIC_FIELD => mtdata2::encode_numbers(id, measured.magnetic_field.as_slice(), out),
        id::FREE_ACCELERATION => {
            let free = q * measured.linear_acceleration_m_s2;
            mtdata2::encode_numbers(id, free.as_slice(), out);
        }
        id::TEMPERATURE => mtdata2::encode_numbers(id, &[31.5], out),
        _ => {}
    }
}
