//! One sensor: what its samples are worth, where it is, what was lost, which fault began or ended.

use nalgebra::{Isometry3, Vector3};
use posed_drivers::{Loss, Measurement, Timestamp};
use serde::{Deserialize, Serialize};

use super::SensorStatus;
use super::faults_map::Advice;
use super::field::Field;
use super::inertial::Inertial;
use super::magnetic::{Believed, Magnetic};
use crate::faults::som::rules::Class;
use crate::field::PoleReading;
use crate::frame::{Frame, FrameSensor};
use crate::input::{DeviceIndex, SensorIndex};
use crate::noise::TrackerNoise;
use crate::output::{
    FaultCause, Measured, Outcome, OutcomeKind, Output, PoseEstimate, SensorEstimate, SensorLabel,
    SensorState,
};
use crate::stage;

/// From these speeds on a sensor counts as moving, m/s and rad/s.
pub(super) const MOVING_M_S: f64 = 0.05;
pub(super) const MOVING_RAD_S: f64 = 0.2;

/// By what a sensor is estimated.
#[derive(Clone, Debug, Serialize, Deserialize)]
enum Kind {
    /// A magnetic tracker: poses in the transmitter's frame.
    Magnetic(Box<Magnetic>),
    /// A body-worn IMU: an orientation in the room, no position.
    Inertial(Box<Inertial>),
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Sensor {
    name: String,
    /// Serial number that the stage file asks for.
    serial: Option<String>,
    device: DeviceIndex,
    kind: Kind,
    state: SensorState,
    fault: Option<FaultCause>,
    /// The cause that has last been published.
    published: Option<FaultCause>,
    moving: bool,
    /// Whether what was changed may be published.
    repairs: bool,
    samples: u64,
    /// Capture time of the newest one.
    newest: Option<Timestamp>,
    /// Records that came in and were not published as `ok`, and those that the frames miss.
    unpublished: u64,
    missed: u64,
    missed_by_time: bool,
}

impl Sensor {
    pub(super) fn new(
        sensor: &stage::Sensor,
        device: DeviceIndex,
        driver: &stage::Driver,
        repairs: bool,
    ) -> Self {
        let kind = if driver.is_inertial() {
            Kind::Inertial(Box::new(Inertial::new(sensor.magnetometer, sensor.gyro_delay_ms * 1e-3)))
        } else {
            Kind::Magnetic(Box::new(Magnetic::new()))
        };
        Self {
            name: sensor.name.clone(),
            serial: sensor.serial.clone(),
            device,
            kind,
            state: SensorState::Missing,
            fault: None,
            published: None,
            moving: false,
            repairs,
            samples: 0,
            newest: None,
            unpublished: 0,
            missed: 0,
            missed_by_time: false,
        }
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    pub(super) fn serial(&self) -> Option<&str> {
        self.serial.as_deref()
    }

    pub(super) fn device(&self) -> DeviceIndex {
        self.device
    }

    pub(super) fn is_moving(&self) -> bool {
        self.moving
    }

    /// Whether it is one of a magnetic tracker.
    pub(super) fn is_magnetic(&self) -> bool {
        matches!(self.kind, Kind::Magnetic(_))
    }

    pub(super) fn set_noise(&mut self, noise: TrackerNoise) {
        if let Kind::Magnetic(magnetic) = &mut self.kind {
            magnetic.set_noise(noise);
        }
    }

    /// Its samples are corrected otherwise from now on.
    pub(super) fn restart(&mut self) {
        if let Kind::Inertial(inertial) = &mut self.kind {
            inertial.restart();
        }
    }

    pub(super) fn set_interval_s(&mut self, interval_s: f64) {
        if let Kind::Magnetic(magnetic) = &mut self.kind {
            magnetic.set_interval_s(interval_s);
        }
    }

    /// `counted` is what the device itself knows to be lost; without it the frames count.
    pub(super) fn status(&self, counted: Option<&Loss>) -> SensorStatus {
        let (lost, estimated) =
            counted.map_or((self.missed, self.missed_by_time), |loss| (loss.lost, loss.estimated));
        SensorStatus { samples: self.samples, newest: self.newest, lost: lost + self.unpublished, estimated }
    }

    /// Whether a measurement is one of the cycle that times its device, rather than one beside it.
    pub(super) fn times(&self, measurement: &Measurement) -> bool {
        match &self.kind {
            Kind::Magnetic(_) => true,
            Kind::Inertial(inertial) => inertial.times(measurement),
        }
    }

    /// The record that a measurement makes; none where it only adds to the next one.
    pub(super) fn record(&mut self, t_valid: Timestamp, measurement: &Measurement) -> Option<Measured> {
        match (&mut self.kind, *measurement) {
            (Kind::Magnetic(_), Measurement::Pose { position_m, orientation_wxyz, button }) => {
                Some(Measured { t_valid, position_m, orientation_wxyz, button, inertial: None })
            }
            (Kind::Inertial(inertial), measurement) => inertial.record(t_valid, &measurement),
            // No driver of magnetic trackers has such samples.
            (Kind::Magnetic(_), Measurement::Imu { .. }) => None,
        }
    }

    /// Takes the frame's samples, each at its own time, and says where the sensor is at the frame's time; `advice` is
    /// what the map of faults says of it.
    pub(super) fn estimate(
        &mut self,
        slot: &FrameSensor,
        frame: &Frame,
        others_move: bool,
        field: &Field,
        room: &Isometry3<f64>,
        advice: Option<&Advice>,
    ) -> SensorEstimate {
        self.state = SensorState::Missing;
        let mut repair = None;
        if let Kind::Magnetic(magnetic) = &mut self.kind {
            magnetic.begin_frame();
        }
        // Where nothing was due, nothing is wrong that was not wrong before.
        if slot.expected() {
            self.fault = Some(FaultCause::Missing);
        }
        for sample in &slot.samples {
            let (state, fault) = match &mut self.kind {
                Kind::Magnetic(magnetic) => {
                    let by_map = advice.map(|advice| advice.class);
                    let (state, fault, done) = magnetic.measure(&sample.measured, others_move, by_map, field);
                    repair = done;
                    (state, fault)
                }
                Kind::Inertial(inertial) => inertial.measure(&sample.measured),
            };
            self.state = if sample.late && state == SensorState::Ok { SensorState::Late } else { state };
            self.fault = fault;
        }
        if let Some(advice) = advice.filter(|_| !slot.samples.is_empty()) {
            // What is followed for want of a prediction is still not good.
            let good = matches!(self.state, SensorState::Ok | SensorState::Late | SensorState::Extrapolated);
            if advice.class == Class::Anomalous && good {
                self.state = SensorState::Suspect;
            }
            self.fault = advice.lasting.or(self.fault);
        }
        if repair.is_some() && !self.repairs {
            self.state = SensorState::Suspect;
        }
        self.count(slot, frame);
        let pose: Option<PoseEstimate>;
        (pose, self.moving) = match &self.kind {
            Kind::Magnetic(magnetic) => magnetic.at(frame.t_valid, room),
            Kind::Inertial(inertial) => inertial.at(frame.t_valid),
        };
        // What is changed and may not be published is absent; the raw record is there all the same.
        let pose = pose.filter(|_| repair.is_none() || self.repairs);
        let repair = repair.filter(|_| pose.is_some());
        let fault = advice.map(|advice| SensorLabel {
            label: advice.class,
            cause: advice.cause,
            distance_m: advice.distance_m,
            repair,
        });
        SensorEstimate {
            state: self.state,
            pose,
            measured: slot.samples.last().map(|sample| sample.measured),
            fault,
            ..SensorEstimate::default()
        }
    }

    fn magnetic(&self) -> Option<&Magnetic> {
        match &self.kind {
            Kind::Magnetic(magnetic) => Some(magnetic),
            Kind::Inertial(_) => None,
        }
    }

    /// Position of the newest believed record of this frame in the transmitter frame, corrected, m.
    pub(super) fn corrected_m(&self) -> Option<Vector3<f64>> {
        self.magnetic()?.corrected_m()
    }

    /// The newest believed record of this frame, corrected.
    pub(super) fn believed(&self) -> Option<Believed> {
        self.magnetic()?.believed()
    }

    /// The newest believed record of this frame as the device said it, carried along to `t`.
    pub(super) fn pole_reading(&self, t: Timestamp) -> Option<PoleReading> {
        self.magnetic()?.pole_reading(t)
    }

    fn count(&mut self, slot: &FrameSensor, frame: &Frame) {
        self.samples += slot.samples.len() as u64;
        self.newest = self.newest.max(slot.samples.iter().map(|sample| sample.measured.t_valid).max());
        if slot.expected() {
            let unpublished = !slot.samples.is_empty() && self.state != SensorState::Ok;
            self.unpublished += u64::from(unpublished);
            self.missed += u64::from(slot.missed);
            // Ticks without a record are counted by the clock, not by the line.
            let by_time = frame.by_model && slot.samples.is_empty();
            self.missed += frame.ticks_left_out;
            // More than one at once is told by how long its device was away.
            self.missed_by_time |= by_time || frame.ticks_left_out > 0 || slot.missed > 1;
        }
    }

    /// Says which fault began or ended with this frame.
    pub(super) fn outcomes(&mut self, sensor: SensorIndex, frame: &Frame, say: &mut impl FnMut(Output<'_>)) {
        if self.fault == self.published {
            return;
        }
        let t = frame.t_valid;
        for (cause, active) in [(self.published, false), (self.fault, true)] {
            if let Some(cause) = cause {
                let what = OutcomeKind::Fault { sensor, cause, active };
                say(Output::Outcome(&Outcome { t_valid: t, t_decided: t, what }));
            }
        }
        self.published = self.fault;
    }
}
