//! One sensor: what its samples are worth, where it is, what was lost, which fault began or ended.

use nalgebra::{Isometry3, Vector3};
use posed_drivers::{Condition, Loss, Measurement, Timestamp};
use posed_state::State;

use super::SensorStatus;
use super::fault_map::Advice;
use super::field::Field;
use super::inertial::Inertial;
use super::magnetic::{EstimatedPose, Magnetic};
use crate::frame::{Frame, FrameSensor};
use posed_field::PoleReading;
use posed_fusion::faults::{Cause, Class, Debounce, Finding, Label, Verdict};
use posed_fusion::noise::TrackerNoise;
use posed_stage::input::{DeviceIndex, SensorIndex};
use posed_stage::output::{
    Measured, Outcome, OutcomeKind, Output, PoseEstimate, SensorEstimate, SensorLabel, SensorState,
};

/// A sensor of which nothing came for so long is missing, s.
const MISSING_S: f64 = 0.1;

/// By what a sensor is estimated.
#[derive(Clone, Debug, State)]
enum Kind {
    /// A magnetic tracker, or what stands behind a VRPN server: poses in the device's frame.
    Magnetic(Box<Magnetic>),
    /// A body-worn IMU: an orientation in the room, no position.
    Inertial(Box<Inertial>),
}

#[derive(Clone, Debug, State)]
pub(super) struct Sensor {
    #[state(same)]
    name: String,
    /// Serial number that the stage file asks for.
    #[state(keep)]
    serial: Option<String>,
    #[state(keep)]
    device: DeviceIndex,
    kind: Kind,
    state: SensorState,
    fault: Option<Cause>,
    /// A record was outside the gate.
    gated: Debounce,
    /// A record was due and did not come; the time over which none did, less that in which they did, s; and the last frame with one due.
    awaited: Debounce,
    missing_s: f64,
    frame_at: Option<Timestamp>,
    /// The cause that has last been published.
    published: Option<Cause>,
    moving: bool,
    /// Whether what was changed may be published.
    #[state(keep)]
    repairs: bool,
    samples: u64,
    /// Capture time of the newest one.
    newest: Option<Timestamp>,
    /// Records that came in and were not published as `ok`, and those that the frames miss.
    unpublished: u64,
    missed: u64,
    missed_by_time: bool,
    /// Whether any was published as `ok`.
    was_ok: bool,
}

impl Sensor {
    pub(super) fn new(
        sensor: &posed_stage::Sensor,
        device: DeviceIndex,
        driver: &posed_stage::Driver,
        repairs: bool,
    ) -> Self {
        let kind = if driver.is_inertial() {
            Kind::Inertial(Box::new(Inertial::new(sensor.magnetometer, sensor.gyro_delay_ms * 1e-3)))
        } else {
            Kind::Magnetic(Box::new(Magnetic::new(driver.pose_noise())))
        };
        Self {
            name: sensor.name.clone(),
            serial: sensor.serial.clone(),
            device,
            kind,
            state: SensorState::Missing,
            fault: None,
            gated: Debounce::default(),
            awaited: Debounce::default(),
            missing_s: 0.0,
            frame_at: None,
            published: None,
            moving: false,
            repairs,
            samples: 0,
            newest: None,
            unpublished: 0,
            was_ok: false,
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

    /// Goes on where another pipeline's sensor was, as after a break: with its counts, and what nobody could know from a beginning.
    pub(super) fn follow(&mut self, before: &Self) {
        if let (Kind::Magnetic(this), Kind::Magnetic(before)) = (&mut self.kind, &before.kind) {
            this.follow(before);
        }
        self.published = before.published;
        self.samples = before.samples;
        (self.newest, self.unpublished) = (before.newest, before.unpublished);
        (self.missed, self.missed_by_time) = (before.missed, before.missed_by_time);
        self.was_ok = before.was_ok;
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
    pub(super) fn status(
        &self,
        counted: Option<&Loss>,
        condition: Condition,
        corrected: bool,
    ) -> SensorStatus {
        let (missed, estimated) =
            counted.map_or((self.missed, self.missed_by_time), |loss| (loss.lost, loss.estimated));
        let lost = missed + self.unpublished;
        let newest = self.newest;
        SensorStatus { samples: self.samples, newest, lost, missed, estimated, condition, corrected }
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
            (Kind::Magnetic(_), Measurement::Pose { position_m, clipped, orientation_wxyz, button }) => {
                Some(Measured { t_valid, position_m, clipped, orientation_wxyz, button, inertial: None })
            }
            (Kind::Inertial(inertial), measurement) => inertial.record(t_valid, &measurement),
            // No driver of magnetic trackers has such samples.
            (Kind::Magnetic(_), Measurement::Imu { .. }) => None,
        }
    }

    /// Something else knows where a magnetic sensor is, device axes, m.
    pub(super) fn known_at(&mut self, t: Timestamp, position_m: Vector3<f64>) {
        if let Kind::Magnetic(magnetic) = &mut self.kind {
            magnetic.known_at(t, position_m);
        }
    }

    /// Takes the frame's samples, each at its own time, and returns where the sensor is at the frame's time; `advice` is
    /// what the fault map reports about it.
    pub(super) fn estimate(
        &mut self,
        slot: &FrameSensor,
        frame: &Frame,
        others_move: bool,
        field: &Field,
        room: &Isometry3<f64>,
        advice: Option<&Advice>,
    ) -> SensorEstimate {
        if let Kind::Magnetic(magnetic) = &mut self.kind {
            magnetic.begin_frame();
        }
        // Where nothing was due, nothing is wrong that was not wrong before. Records that a line lost or a busy host read late are counted, and no fault.
        if slot.expected() {
            let is_missing = slot.samples.is_empty();
            let since_s = self.frame_at.map_or(0.0, |at| frame.t_valid.seconds_since(at));
            self.frame_at = Some(frame.t_valid);
            self.missing_s = if is_missing {
                (self.missing_s + since_s).min(2.0 * MISSING_S)
            } else {
                (self.missing_s - since_s).max(0.0)
            };
            self.awaited.push(is_missing);
            if self.missing_s >= MISSING_S && self.awaited.lasts() {
                self.fault = Some(Cause::Missing);
            }
        }
        let mut finding: Option<Finding> = None;
        for sample in &slot.samples {
            let found = match &mut self.kind {
                Kind::Magnetic(magnetic) => {
                    let by_map = advice.map(|advice| advice.label);
                    magnetic.measure(&sample.measured, others_move, by_map, field)
                }
                Kind::Inertial(inertial) => inertial.measure(&sample.measured, sample.late),
            };
            if let (Some(_), false, Kind::Magnetic(magnetic)) = (found.repair, self.repairs, &mut self.kind) {
                // What may not be published must not come in by an attached IMU or a pole either.
                magnetic.begin_frame();
            }
            let is_gated = found.label.cause == Some(Cause::Gate);
            self.gated.push(is_gated);
            // One record in a thousand of a good sensor is outside: that is what the gate was made for, and no fault.
            let lasts = !is_gated || self.gated.lasts();
            self.fault = found.label.cause.filter(|_| lasts);
            finding = Some(Finding { late: sample.late, ..found });
        }
        let repair = finding.and_then(|found| found.repair);
        if let Some(found) = &mut finding {
            if let Some(advice) = advice {
                // What is followed for want of a prediction is still not good.
                if advice.label.class == Class::Anomalous && found.label == Label::CLEAN {
                    found.label.class = Class::Anomalous;
                }
                self.fault = advice.lasting.or(self.fault);
            }
            if repair.is_some() && !self.repairs {
                found.verdict = Verdict::Suspect;
            }
        }
        self.state = SensorState::of(finding.as_ref());
        let lost = |magnetic: &Magnetic| magnetic.is_lost(frame.t_valid);
        if self.state.is_usable() && self.magnetic().is_some_and(lost) {
            self.state = SensorState::Suspect;
        }
        self.was_ok |= self.state == SensorState::Ok;
        // Whose filter settles for the first time has lost nothing.
        let settles = finding.is_some_and(|found| found == Finding { late: found.late, ..Finding::SETTLING });
        self.count(slot, frame, settles && !self.was_ok);
        let pose: Option<PoseEstimate>;
        (pose, self.moving) = match &self.kind {
            Kind::Magnetic(magnetic) => magnetic.at(frame.t_valid, room),
            Kind::Inertial(inertial) => inertial.at(frame.t_valid),
        };
        // What is changed and may not be published is absent; the raw record is there all the same.
        let pose = pose.filter(|_| repair.is_none() || self.repairs);
        let repair = repair.filter(|_| pose.is_some());
        let fault = advice.map(|advice| SensorLabel {
            label: advice.label.class,
            cause: advice.label.cause,
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
    pub(super) fn estimated_pose(&self) -> Option<EstimatedPose> {
        self.magnetic()?.estimated_pose()
    }

    /// The newest believed record of this frame as the device said it, carried along to `t`.
    pub(super) fn pole_reading(&self, t: Timestamp) -> Option<PoleReading> {
        self.magnetic()?.pole_reading(t)
    }

    fn count(&mut self, slot: &FrameSensor, frame: &Frame, settles: bool) {
        self.samples += slot.samples.len() as u64;
        self.newest = self.newest.max(slot.samples.iter().map(|sample| sample.measured.t_valid).max());
        if slot.expected() {
            let unpublished = !slot.samples.is_empty() && !settles && self.state != SensorState::Ok;
            self.unpublished += u64::from(unpublished);
            self.missed += u64::from(slot.missed);
            // Ticks without a record are counted by the clock, not by the line.
            let by_time = frame.by_model && slot.samples.is_empty();
            // More than one at once is identified by how long its device was away.
            self.missed_by_time |= by_time || slot.missed > 1;
        }
    }

    /// Reports which fault began or ended with this frame.
    pub(super) fn outcomes(&mut self, sensor: SensorIndex, frame: &Frame, emit: &mut dyn FnMut(Output<'_>)) {
        if self.fault == self.published {
            return;
        }
        let t = frame.t_valid;
        for (cause, active) in [(self.published, false), (self.fault, true)] {
            if let Some(cause) = cause {
                let what = OutcomeKind::Fault { sensor, cause, active };
                emit(Output::Outcome(&Outcome { t_valid: t, t_decided: t, what }));
            }
        }
        self.published = self.fault;
    }
}
