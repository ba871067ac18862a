//! One sensor through faults and fusion.

use nalgebra::{Isometry3, Matrix3, Vector3};
use posed_drivers::Timestamp;
use serde::{Deserialize, Serialize};

use super::SensorStatus;
use super::field::{Field, ahead_s};
use crate::faults::{Checked, Detector, Label, MeasuredPose};
use crate::field::PoleReading;
use crate::frame::{Frame, FrameSensor};
use crate::fusion::{Track, Tracker, Tuning, Verdict};
use crate::geometry;
use crate::input::{DeviceIndex, SensorIndex};
use crate::noise::TrackerNoise;
use crate::output::{
    FaultCause, Measured, Outcome, OutcomeKind, Output, PoseEstimate, SensorEstimate, SensorState,
};
use crate::stage;

/// From these speeds on a sensor counts as moving, m/s and rad/s.
const MOVING_M_S: f64 = 0.05;
const MOVING_RAD_S: f64 = 0.2;
/// Variance of an orientation of which nothing is known, rad^2.
const UNKNOWN_RAD2: f64 = std::f64::consts::PI * std::f64::consts::PI / 3.0;

/// A record that was believed; transmitter frame.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Reading {
    t: Timestamp,
    raw: MeasuredPose,
    corrected_m: Option<Vector3<f64>>,
    velocity_m_s: Vector3<f64>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Sensor {
    name: String,
    device: DeviceIndex,
    detector: Detector,
    tracker: Tracker,
    state: SensorState,
    fault: Option<FaultCause>,
    /// The cause that has last been published.
    published: Option<FaultCause>,
    moving: bool,
    /// What the map leaves of the latest position, 3-D rms, m.
    map_sigma_m: f64,
    /// The newest record of this frame that was believed, as the device said it and corrected, and its velocity.
    reading: Option<Reading>,
    samples: u64,
    lost: u64,
    estimated: bool,
}

impl Sensor {
    pub(super) fn new(sensor: &stage::Sensor, device: DeviceIndex) -> Self {
        Self {
            name: sensor.name.clone(),
            device,
            detector: Detector::default(),
            tracker: Tracker::new(TrackerNoise::default(), Tuning::default()),
            state: SensorState::Missing,
            fault: None,
            published: None,
            moving: false,
            map_sigma_m: 0.0,
            reading: None,
            samples: 0,
            lost: 0,
            estimated: false,
        }
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    pub(super) fn device(&self) -> DeviceIndex {
        self.device
    }

    pub(super) fn is_moving(&self) -> bool {
        self.moving
    }

    pub(super) fn set_noise(&mut self, noise: TrackerNoise) {
        self.tracker.set_noise(noise);
    }

    pub(super) fn set_interval_s(&mut self, interval_s: f64) {
        self.tracker.set_interval_s(interval_s);
    }

    pub(super) fn status(&self) -> SensorStatus {
        SensorStatus { samples: self.samples, lost: self.lost, estimated: self.estimated }
    }

    /// Takes the frame's samples, each at its own time, and says where the sensor is at the frame's time.
    pub(super) fn estimate(
        &mut self,
        slot: &FrameSensor,
        frame: &Frame,
        others_move: bool,
        field: &Field,
        room: &Isometry3<f64>,
    ) -> SensorEstimate {
        self.state = SensorState::Missing;
        self.reading = None;
        // Where nothing was due, nothing is wrong that was not wrong before.
        if slot.expected() {
            self.fault = Some(FaultCause::Missing);
        }
        for sample in &slot.samples {
            let (state, fault) = self.measure(&sample.measured, others_move, field);
            self.state = if sample.late && state == SensorState::Ok { SensorState::Late } else { state };
            self.fault = fault;
        }
        self.count(slot, frame);
        let track = self.tracker.at(frame.t_valid);
        self.moving = track.as_ref().is_some_and(is_moving);
        SensorEstimate {
            state: self.state,
            pose: track.and_then(|track| in_room(&track, room, self.map_sigma_m)),
            measured: slot.samples.last().map(|sample| sample.measured),
        }
    }

    /// Position of the newest believed record, corrected, m.
    pub(super) fn corrected_m(&self) -> Option<Vector3<f64>> {
        self.reading?.corrected_m
    }

    /// The newest believed record as the device said it, carried along to `t`: the sensors of a pole are read one after
    /// the other.
    pub(super) fn pole_reading(&self, t: Timestamp) -> Option<PoleReading> {
        let reading = self.reading?;
        let position_m = reading.raw.position_m? + reading.velocity_m_s * ahead_s(reading.t, t);
        Some(PoleReading { position_m, orientation: reading.raw.orientation })
    }

    fn measure(
        &mut self,
        measured: &Measured,
        others_move: bool,
        field: &Field,
    ) -> (SensorState, Option<FaultCause>) {
        let t: Timestamp = measured.t_valid;
        let pose = MeasuredPose {
            position_m: measured.position_m.map(Vector3::from),
            orientation: measured.orientation_wxyz.and_then(geometry::orientation_from_wxyz),
        };
        let finite = pose.position_m.is_none_or(|position| position.iter().all(|value| value.is_finite()));
        if !finite || (pose.orientation.is_none() && measured.orientation_wxyz.is_some()) {
            return (SensorState::Suspect, Some(FaultCause::Gate));
        }
        let expected = self.tracker.expectation(t).map(|expected| field.uncorrected(expected));
        let checked = self.detector.check(&pose, expected.as_ref(), self.tracker.noise(), others_move);
        let corrected = field.correct(&checked.pose);
        let range_m = checked.pose.position_m.map_or(0.0, |position| position.norm());
        let disturbance_m2 = field.doubt_m2(range_m);
        let map_m2 = corrected.sigma_m * corrected.sigma_m + 3.0 * disturbance_m2.unwrap_or(0.0);
        self.tracker.set_doubt(map_m2 / 3.0, disturbance_m2.is_some());
        let verdict = self.tracker.push(t, &Checked { pose: corrected.pose, label: checked.label });
        if verdict == Verdict::Good {
            self.map_sigma_m = map_m2.sqrt();
            self.reading = Some(Reading {
                t,
                raw: checked.pose,
                corrected_m: corrected.pose.position_m,
                velocity_m_s: self.tracker.at(t).map_or(Vector3::zeros(), |track| *track.velocity_m_s()),
            });
        }
        match (verdict, checked.label) {
            (Verdict::Good, Label::Mirrored) => (SensorState::Repaired, Some(FaultCause::Hemisphere)),
            (Verdict::Good, _) if corrected.extrapolated => (SensorState::Extrapolated, None),
            (Verdict::Good, _) => (SensorState::Ok, None),
            (_, Label::Stuck) => (SensorState::Stuck, Some(FaultCause::Stuck)),
            (_, _) => (SensorState::Suspect, Some(FaultCause::Gate)),
        }
    }

    fn count(&mut self, slot: &FrameSensor, frame: &Frame) {
        self.samples += slot.samples.len() as u64;
        if slot.expected() {
            let unpublished = !slot.samples.is_empty() && self.state != SensorState::Ok;
            self.lost += u64::from(slot.missed) + u64::from(unpublished);
            // Ticks without a record are counted by the clock, not by the line.
            let by_time = frame.by_model && slot.samples.is_empty();
            self.lost += frame.ticks_left_out;
            self.estimated |= by_time || frame.ticks_left_out > 0;
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

fn is_moving(track: &Track) -> bool {
    track.velocity_m_s().norm() > MOVING_M_S || track.angular_velocity_rad_s().norm() > MOVING_RAD_S
}

/// A track in the room. Formats without a position have no pose; without an orientation it is the
/// identity, and its covariance says that nothing is known of it. What a map leaves does not average out: it is added to
/// what the filter knows.
fn in_room(track: &Track, room: &Isometry3<f64>, map_sigma_m: f64) -> Option<PoseEstimate> {
    let position_m = room.transform_point(&(*track.position_m()?).into()).coords;
    let turn = room.rotation.to_rotation_matrix();
    let position_m2 = turn.matrix() * track.position_m2() * turn.matrix().transpose()
        + Matrix3::identity() * (map_sigma_m * map_sigma_m / 3.0);
    let (orientation, rotation_rad2, rate) = match track.orientation() {
        Some(orientation) => {
            (room.rotation * orientation, track.rotation_rad2(), *track.angular_velocity_rad_s())
        }
        None => (Default::default(), Matrix3::identity() * UNKNOWN_RAD2, Vector3::zeros()),
    };
    Some(PoseEstimate {
        position_m: position_m.into(),
        orientation_wxyz: geometry::orientation_to_wxyz(&orientation),
        velocity_m_s: (room.rotation * track.velocity_m_s()).into(),
        angular_velocity_rad_s: rate.into(),
        covariance: upper_triangle(&position_m2, &rotation_rad2),
        sigma_m: position_m2.trace().sqrt(),
    })
}

/// Upper triangle of the 6 x 6 covariance, row by row; the two halves are uncoupled.
fn upper_triangle(position_m2: &Matrix3<f64>, rotation_rad2: &Matrix3<f64>) -> [f64; 21] {
    let mut out = [0.0; 21];
    let mut at = 0;
    for row in 0..6 {
        for column in row..6 {
            out[at] = match (row < 3, column < 3) {
                (true, true) => position_m2[(row, column)],
                (false, false) => rotation_rad2[(row - 3, column - 3)],
                _ => 0.0,
            };
            at += 1;
        }
    }
    out
}
