//! The measurement cycle: truth, physics, faults of the device, the class of each measurement.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use posed_drivers::Timestamp;
use posed_drivers::flock::Family;

use super::unit::Measured;
use super::{Ready, VirtualFlock};
use crate::device::DeviceOutput;
use crate::faults::{Fault, FaultHit};
use crate::magnetic::Signal;
use crate::truth::{Class, TruthCycle, TruthRow};

/// How long measurements are bad after a start, and how fast they get better.
const SETTLING_S: f64 = 0.5;
const SETTLING_TIME_CONSTANT_S: f64 = 0.05;

impl VirtualFlock {
    /// When a cycle begins; its measurement is taken then.
    pub(super) fn cycle_time(&self, cycle: u64) -> Timestamp {
        let (start, origin) = self.origin;
        let period_ns = 1e9 / self.rate_hz * (1.0 + self.config.drift_ppm * 1e-6);
        Timestamp::from_nanos(start.as_nanos() + ((cycle - origin) as f64 * period_ns).round() as i64)
    }

    /// From the next cycle on the unit measures at another rate.
    pub(super) fn set_rate(&mut self, t: Timestamp, rate_hz: f64) {
        let next = self.cycle_time(self.next_cycle).max(t);
        self.origin = (next, self.next_cycle);
        self.rate_hz = rate_hz;
    }

    /// Measures all sensors.
    pub(super) fn measure_cycle(&mut self, t: Timestamp) {
        let cycle = self.next_cycle;
        self.next_cycle += 1;
        let powered = !self.held && self.booting.is_none();
        let mut rows = Vec::with_capacity(self.units.len());
        let mut units = Vec::with_capacity(self.units.len());
        for index in 0..self.units.len() {
            let Some(sensor) = self.config.units[index].sensor.clone() else {
                units.push(None);
                continue;
            };
            let pose = sensor.pose_in_room(t);
            let (class, distortion_m) = self.measure_unit(t, index, &pose);
            rows.push(TruthRow {
                sensor: sensor.index,
                pose,
                class,
                distortion_m: self.config.transmitter_in_room.rotation * distortion_m,
            });
            units.push(self.units[index].latest);
        }
        self.output.push_back(DeviceOutput::Truth(TruthCycle {
            t,
            device: self.config.device,
            cycle,
            sensors: rows,
        }));
        if powered {
            self.ready.push_back(Ready { at: t + self.config.measurement_delay, cycle, units });
        }
    }

    /// One sensor: keeps the new measurement, states what became of it and how far it is bent (transmitter axes).
    fn measure_unit(&mut self, t: Timestamp, index: usize, pose: &Isometry3<f64>) -> (Class, Vector3<f64>) {
        let in_transmitter = self.config.transmitter_in_room.inverse() * pose;
        let hemisphere = Vector3::from(self.units[index].hemisphere.direction());
        let reading = self.config.tracker.measure(
            t.as_secs_f64(),
            &in_transmitter,
            &hemisphere,
            &mut self.noise[index],
        );
        let mut mirrored = reading.mirrored;
        let mut distortion_m = reading.distortion_m;
        let address = u16::from(self.units[index].address);
        let script = |wanted: fn(&Fault) -> bool| {
            self.config
                .faults
                .iter()
                .any(|fault| wanted(fault) && fault.address() == Some(address) && fault.is_active(t))
        };
        // An input whose sensor was pulled repeats what it had.
        let pulled = self.config.family == Family::Guidance && self.is_dead(index, t);
        let frozen = pulled || script(|fault| matches!(fault, Fault::OutOfRange { .. }));
        let flipped = script(|fault| matches!(fault, Fault::HemisphereFlip { .. }));
        let bad_matrix = script(|fault| matches!(fault, Fault::BadMatrix { .. }));

        let saturated = reading.signal == Signal::Saturated;
        if saturated && !self.units[index].saturated {
            self.set_error(index, 32, 0);
        }
        let accessible = self.is_accessible(index, t);
        let unit = &mut self.units[index];
        unit.saturated = saturated;
        if accessible && !std::mem::replace(&mut unit.accessible, accessible) {
            unit.started = Some(t);
        }
        unit.accessible = accessible;
        let solution = reading.solution.filter(|_| !frozen);
        let Some(solution) = solution else {
            let begins = !std::mem::replace(&mut unit.stuck, true);
            if begins && frozen {
                self.report(t, "out-of-range", address);
            }
            return (Class::Stuck, distortion_m);
        };
        let mut measured =
            Measured { position_m: solution.position_m, orientation: solution.orientation, gain: 1.0 };
        if flipped {
            measured.position_m = -measured.position_m;
            mirrored = !mirrored;
        }
        let settling = unit.started.map(|started| t.seconds_since(started)).filter(|&s| s < SETTLING_S);
        if let Some(since_s) = settling {
            let error = libm::exp(-since_s.max(0.0) / SETTLING_TIME_CONSTANT_S);
            measured.position_m += error * unit.start_error_m;
            measured.orientation =
                UnitQuaternion::from_scaled_axis(error * 2.0 * unit.start_error_m) * measured.orientation;
            measured.gain = 1.0 - 0.01 * error;
            distortion_m += error * unit.start_error_m;
        }
        if bad_matrix {
            measured.gain = 0.8;
        }
        let jumps = std::mem::replace(&mut unit.stuck, false) && unit.latest.is_some();
        unit.latest = Some(measured);
        let bent = distortion_m.norm() > self.config.disturbed_above_m;
        let class = match () {
            () if jumps => Class::Jump,
            () if mirrored => Class::Inverted,
            () if bent || saturated || bad_matrix || settling.is_some() => Class::Disturbed,
            () => Class::Clean,
        };
        if flipped {
            self.report(t, "hemisphere-flip", address);
        }
        if bad_matrix {
            self.report(t, "bad-matrix", address);
        }
        (class, distortion_m)
    }

    /// Notes what a fault of the device hit: the cycle being measured.
    fn report(&mut self, t: Timestamp, fault: &'static str, address: u16) {
        let cycle = Some(self.next_cycle - 1);
        self.output.push_back(DeviceOutput::Fault(FaultHit {
            t,
            fault,
            address: Some(address),
            cycle,
            byte: None,
        }));
    }

    /// A frame is ready: it becomes the present one, and is streamed if it is due.
    pub(super) fn publish(&mut self, ready: Ready) {
        self.present_cycle = ready.cycle;
        for (index, measured) in ready.units.into_iter().enumerate() {
            self.units[index].present = measured;
        }
        let due = self.last_frame.is_none_or(|last| ready.cycle >= last + u64::from(self.report_every));
        if self.streaming && due && !self.is_stalled(ready.at) {
            self.last_frame = Some(ready.cycle);
            self.send_frame(ready.at);
        }
    }

    fn is_stalled(&self, t: Timestamp) -> bool {
        self.config.faults.iter().any(|fault| matches!(fault, Fault::Stall { .. }) && fault.is_active(t))
    }
}
