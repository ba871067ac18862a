//! Guides somebody through the alignment of a stage, and notices by itself when each step was done.
//!
//! In: records of the magnetic sensor and of its IMU as they come. Out: what to do next, in words; in the end a recording and
//! the anchors as the tracker has them. It has no clock: time is that of the records.

use nalgebra::{Isometry3, Matrix3, Vector3};

use super::super::ahrs::ImuSample;
use super::{AnchorPoint, Recording};
use posed_geometry::so3::log;

/// For so long a sensor is held at an anchor, s.
const HOLD_S: f64 = 1.5;
/// So little it may wander meanwhile, m.
const STILL_M: f64 = 0.005;
/// Two anchors are at least so far apart, m.
const APART_M: f64 = 0.05;
/// For so long it must have been turned, s, faster than this, rad/s.
const MOVED_S: f64 = 25.0;
const ROTATES_RAD_S: f64 = 0.5;
/// And so far to and fro about a second axis (standard deviation), rad.
const SPREAD_RAD: f64 = 0.3;

/// What somebody is asked to do with the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ask<'a> {
    /// Hold it still at an anchor.
    Anchor {
        /// The anchor's name.
        name: &'a str,
        /// Its place in the room, m.
        position_m: [f64; 3],
    },
    /// Turn it to and fro about all axes.
    Wave,
    /// Turn it about an axis that it was hardly turned about.
    OtherAxis,
}

/// An alignment on its way.
#[derive(Clone, Debug)]
pub struct Guide {
    /// Names and places in the room, m.
    anchors: Vec<(String, Vector3<f64>)>,
    points: Vec<AnchorPoint>,
    /// What was read since the sensor came to rest.
    held: Vec<(f64, Vector3<f64>)>,
    imu: bool,
    recording: Recording,
    moved_s: f64,
    /// Sum of the squared rotation vectors from the first orientation, rad², and how many.
    spread: (Matrix3<f64>, f64),
}

impl Guide {
    /// Longest alignment, s; it is for the caller to stop then.
    pub const LONGEST_S: f64 = 300.0;

    /// An alignment that begins with these anchors (names, and places in the room, m), in this order; then, with an `imu`,
    /// the movement.
    pub fn new(anchors: Vec<(String, Vector3<f64>)>, imu: bool) -> Self {
        Self {
            anchors,
            points: Vec::new(),
            held: Vec::new(),
            imu,
            recording: Recording::default(),
            moved_s: 0.0,
            spread: (Matrix3::zeros(), 0.0),
        }
    }

    /// A record of the magnetic sensor at its capture time, s: sensor to transmitter, m. An anchor counts once the sensor has
    /// stayed within 5 mm for 1.5 s, at least 5 cm from the one before. After the anchors, times that do not rise change
    /// nothing.
    pub fn magnetic(&mut self, t_s: f64, pose: &Isometry3<f64>) {
        if self.points.len() < self.anchors.len() {
            self.hold(t_s, pose.translation.vector);
        } else if self.recording.magnetic.last().is_none_or(|(last_s, _)| t_s > *last_s) {
            let first = self.recording.magnetic.first().map_or(pose.rotation, |(_, first)| first.rotation);
            let rotation_vector_rad = log(&(first.inverse() * pose.rotation));
            self.spread.0 += rotation_vector_rad * rotation_vector_rad.transpose();
            self.spread.1 += 1.0;
            self.recording.magnetic.push((t_s, *pose));
        }
    }

    /// A sample of the IMU at its capture time on its own clock, s. Before the anchors are done, and where numbers are not
    /// finite or times do not rise, it changes nothing.
    pub fn imu(&mut self, t_s: f64, sample: &ImuSample) {
        let finite = sample.gyro_rad_s.iter().chain(sample.accel_m_s2.iter()).all(|value| value.is_finite());
        if self.points.len() < self.anchors.len() || !finite {
            return;
        }
        let since_s = self.recording.imu.last().map_or(0.0, |(last_s, _)| t_s - last_s);
        if since_s < 0.0 || (since_s == 0.0 && !self.recording.imu.is_empty()) {
            return;
        }
        if sample.gyro_rad_s.norm() > ROTATES_RAD_S {
            self.moved_s += since_s.min(0.1);
        }
        self.recording.imu.push((t_s, *sample));
    }

    fn hold(&mut self, t_s: f64, position_m: Vector3<f64>) {
        let far = |other: &Vector3<f64>, least_m: f64| (other - position_m).norm() > least_m;
        let left = self.points.last().is_none_or(|last| far(&last.transmitter_m, APART_M));
        if !left || self.held.first().is_some_and(|(_, first)| far(first, STILL_M)) {
            self.held.clear();
        }
        if !left {
            return;
        }
        self.held.push((t_s, position_m));
        if t_s - self.held[0].0 >= HOLD_S {
            let mean = self.held.iter().map(|(_, position_m)| position_m).sum::<Vector3<f64>>()
                / self.held.len() as f64;
            let room_m = self.anchors[self.points.len()].1;
            self.points.push(AnchorPoint { transmitter_m: mean, room_m });
            self.held.clear();
        }
    }

    /// How far it is, 0 to 1; at 1 a rotation about a second axis may still be missing, see [`Self::prompt`].
    pub fn progress(&self) -> f64 {
        let steps = self.anchors.len() as f64 + if self.imu { 2.0 } else { 0.0 };
        let moved = if self.imu { 2.0 * (self.moved_s / MOVED_S).min(1.0) } else { 0.0 };
        (self.points.len() as f64 + moved) / steps.max(1.0)
    }

    /// What to do now; `None` once all is done.
    pub fn asks(&self) -> Option<Ask<'_>> {
        if let Some((name, position_m)) = self.anchors.get(self.points.len()) {
            return Some(Ask::Anchor { name, position_m: (*position_m).into() });
        }
        if !self.imu || self.is_moved() {
            return None;
        }
        Some(if self.moved_s < MOVED_S { Ask::Wave } else { Ask::OtherAxis })
    }

    /// The same as a sentence without a full stop.
    pub fn prompt(&self) -> Option<String> {
        self.asks().map(|asks| match asks {
            Ask::Anchor { name, position_m: [x, y, z] } => {
                format!("hold the sensor still at {name:?} ({x:.3}, {y:.3}, {z:.3} m in the room)")
            }
            Ask::Wave => {
                "turn the sensor quickly to and fro about all its axes, by 45 degrees and more, and go on"
                    .into()
            }
            Ask::OtherAxis => {
                "turn the sensor about another axis than up to now, by 45 degrees and more".into()
            }
        })
    }

    fn is_moved(&self) -> bool {
        let mut spread: Vec<f64> =
            (self.spread.0 / self.spread.1.max(1.0)).symmetric_eigenvalues().iter().copied().collect();
        spread.sort_by(f64::total_cmp);
        self.moved_s >= MOVED_S && spread[1] > SPREAD_RAD * SPREAD_RAD
    }

    /// What was recorded so far, for [`super::align_recording`], and the anchors that were held, in their order.
    pub fn recorded(&self) -> (&Recording, &[AnchorPoint]) {
        (&self.recording, &self.points)
    }
}
