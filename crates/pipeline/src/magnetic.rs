//! One sensor of a magnetic tracker, or of another that measures poses, through faults and fusion.
//!
//! What comes in: raw records in the transmitter's frame, and the field that corrects them. What goes out: how far each can be trusted, and the
//! filtered pose in the room.

use nalgebra::{Isometry3, Matrix3, Vector3};
use posed_drivers::Timestamp;
use posed_state::Plain;

use super::field::{Field, ahead_s};
use posed_field::PoleReading;
use posed_fusion::faults::{Cause, Checked, Class, Detector, Finding, Label, MeasuredPose, Verdict};
use posed_fusion::noise::TrackerNoise;
use posed_fusion::{Track, Tracker, Tuning};
use posed_stage::output::{Measured, PoseEstimate};

/// Uncertainty that a pose may gain on the way from its record to its frame, m and rad (3-D, one sigma), before it is no longer good.
const LOST_M: f64 = 0.1;
const LOST_RAD: f64 = 0.35;
/// From these speeds on a sensor counts as moving, m/s and rad/s.
const MOVING_M_S: f64 = 0.05;
pub(super) const MOVING_RAD_S: f64 = 0.2;

/// Variance of an orientation of which nothing is known, rad^2.
const UNKNOWN_RAD2: f64 = std::f64::consts::PI * std::f64::consts::PI / 3.0;

/// A record that was believed; transmitter frame.
#[derive(Clone, Copy, Debug, Plain)]
struct Reading {
    t: Timestamp,
    raw: MeasuredPose,
    corrected: MeasuredPose,
    velocity_m_s: Vector3<f64>,
    /// Of the corrected position, m^2, and of the rotation about an axis, rad^2: the device's noise as the filter has learnt
    /// it, and what the field leaves.
    position_m2: Matrix3<f64>,
    rotation_rad2: f64,
}

/// The newest record of a frame that was believed, corrected; transmitter frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct EstimatedPose {
    pub(super) t: Timestamp,
    pub(super) pose: Isometry3<f64>,
    /// Covariance of the position, m^2, and of the rotation about an axis, rad^2.
    pub(super) position_m2: Matrix3<f64>,
    pub(super) rotation_rad2: f64,
}

#[derive(Clone, Debug, Plain)]
pub(super) struct Magnetic {
    detector: Detector,
    tracker: Tracker,
    /// What the field leaves of the latest believed position, 3-D rms, m.
    map_sigma_m: f64,
    /// The newest record of this frame that was believed.
    reading: Option<Reading>,
}

impl Magnetic {
    /// With the noise that is believed until it is measured.
    pub(super) fn new(noise: TrackerNoise) -> Self {
        Self {
            detector: Detector::default(),
            tracker: Tracker::new(noise, Tuning::default()),
            map_sigma_m: 0.0,
            reading: None,
        }
    }

    /// Goes on where another one was, with all but its track.
    pub(super) fn follow(&mut self, before: &Self) {
        self.detector = before.detector.after_break();
    }

    pub(super) fn set_noise(&mut self, noise: TrackerNoise) {
        self.tracker.set_noise(noise);
    }

    pub(super) fn set_interval_s(&mut self, interval_s: f64) {
        self.tracker.set_interval_s(interval_s);
    }

    /// Forgets the frame before.
    pub(super) fn begin_frame(&mut self) {
        self.reading = None;
    }

    /// Something else knows where the sensor is at a time, device axes, m. Heard where nothing is tracked.
    pub(super) fn known_at(&mut self, t: Timestamp, position_m: Vector3<f64>) {
        if self.tracker.expectation(t).is_none() {
            self.detector.known_at(position_m);
        }
    }

    /// Position of the newest believed record of this frame, corrected, m.
    pub(super) fn corrected_m(&self) -> Option<Vector3<f64>> {
        self.reading?.corrected.position_m
    }

    /// The newest believed record of this frame, where it is a whole pose.
    pub(super) fn estimated_pose(&self) -> Option<EstimatedPose> {
        let Reading { t, corrected, position_m2, rotation_rad2, .. } = self.reading?;
        let pose = Isometry3::from_parts(corrected.position_m?.into(), corrected.orientation?);
        Some(EstimatedPose { t, pose, position_m2, rotation_rad2 })
    }

    /// The newest believed record of this frame as the device said it, carried along to `t`: the sensors of a pole are
    /// read one after the other.
    pub(super) fn pole_reading(&self, t: Timestamp) -> Option<PoleReading> {
        let reading = self.reading?;
        let position_m = reading.raw.position_m? + reading.velocity_m_s * ahead_s(reading.t, t);
        Some(PoleReading { position_m, orientation: reading.raw.orientation })
    }

    /// Takes a record, and returns what was found out about it. Faults see what
    /// the device reports, the filter what the field makes of it.
    pub(super) fn measure(
        &mut self,
        measured: &Measured,
        others_move: bool,
        by_map: Option<Label>,
        field: &Field,
    ) -> Finding {
        let t: Timestamp = measured.t_valid;
        let pose = MeasuredPose {
            position_m: measured.position_m.map(Vector3::from),
            orientation: measured.orientation_wxyz.and_then(posed_geometry::orientation_from_wxyz),
        };
        let finite = pose.position_m.is_none_or(|position| position.iter().all(|value| value.is_finite()));
        if !finite || (pose.orientation.is_none() && measured.orientation_wxyz.is_some()) {
            return Finding::new(Verdict::Suspect, Label::anomalous(Cause::Gate));
        }
        if measured.clipped {
            return Finding::new(Verdict::Dropped, Label::anomalous(Cause::Saturated));
        }
        let expected = self.tracker.expectation(t).map(|expected| field.uncorrected(expected));
        let noise = self.tracker.noise();
        let checked = self.detector.check(&pose, expected.as_ref(), noise, others_move, by_map);
        let corrected = field.correct(&checked.pose);
        let range_m = checked.pose.position_m.map_or(0.0, |position| position.norm());
        let disturbance_m2 = field.doubt_m2(range_m);
        let map_m2 = corrected.sigma_m * corrected.sigma_m + 3.0 * disturbance_m2.unwrap_or(0.0);
        self.tracker.set_doubt(map_m2 / 3.0, disturbance_m2.is_some());
        let verdict = self.tracker.push(t, &Checked { pose: corrected.pose, ..checked });
        let doubted = by_map.is_some_and(|label| label.class == Class::Anomalous)
            || checked.label.class == Class::Unknown;
        if verdict == Verdict::Used && !doubted {
            self.map_sigma_m = map_m2.sqrt();
            let (noise, position_m) = (self.tracker.noise(), checked.pose.position_m.unwrap_or_default());
            let learnt = self.tracker.expectation(t);
            let [position, rotation] =
                learnt.map_or([1.0; 2], |e| [e.position_noise_scale, e.rotation_noise_scale]);
            self.reading = Some(Reading {
                t,
                raw: checked.pose,
                corrected: corrected.pose,
                velocity_m_s: self.tracker.at(t).map_or(Vector3::zeros(), |track| *track.velocity_m_s()),
                position_m2: noise.position_m2(&position_m) * position + Matrix3::identity() * (map_m2 / 3.0),
                rotation_rad2: noise.rotation_rad2(Some(&position_m))[(0, 0)] * rotation,
            });
        }
        let label = match (verdict, checked.label) {
            // Enough records agree: the sensor was taken elsewhere.
            (Verdict::Used, Label { cause: Some(Cause::Gate), .. }) => Label::CLEAN,
            // Nothing is tracked that it could contradict.
            (Verdict::Suspect, Label::CLEAN) if expected.is_none() => Label::CLEAN,
            (Verdict::Suspect, Label { class, .. }) if class != Class::Unknown => {
                Label::anomalous(Cause::Gate)
            }
            (_, label) => label,
        };
        let extrapolated = corrected.extrapolated;
        Finding { repair: checked.repair, extrapolated, ..Finding::new(verdict, label) }
    }

    /// The pose in the room at `t`, and whether the sensor moves.
    pub(super) fn at(&self, t: Timestamp, room: &Isometry3<f64>) -> (Option<PoseEstimate>, bool) {
        let track = self.tracker.at(t);
        let moving = track.as_ref().is_some_and(is_moving);
        (track.and_then(|track| in_room(&track, room, self.map_sigma_m)), moving)
    }

    /// Whether the way from the newest believed record of this frame to `t` has left nobody knows what: of a filter that has just
    /// begun, the velocity is unknown.
    pub(super) fn is_lost(&self, t: Timestamp) -> bool {
        let (Some(track), Some(reading)) = (self.tracker.at(t), &self.reading) else { return false };
        let position = track.position_m().is_some()
            && track.position_m2().trace() > reading.position_m2.trace() + LOST_M.powi(2);
        let rotation = track.orientation().is_some()
            && track.rotation_rad2().trace() > 3.0 * reading.rotation_rad2 + LOST_RAD.powi(2);
        position || rotation
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
    let rotation = room.rotation.to_rotation_matrix();
    let position_m2 = rotation.matrix() * track.position_m2() * rotation.matrix().transpose()
        + Matrix3::identity() * (map_sigma_m * map_sigma_m / 3.0);
    let (orientation, rotation_rad2, angular_velocity_rad_s) = match track.orientation() {
        Some(orientation) => {
            (room.rotation * orientation, track.rotation_rad2(), *track.angular_velocity_rad_s())
        }
        None => (Default::default(), Matrix3::identity() * UNKNOWN_RAD2, Vector3::zeros()),
    };
    Some(PoseEstimate {
        position_m: Some(position_m.into()),
        orientation_wxyz: posed_geometry::orientation_to_wxyz(&orientation),
        velocity_m_s: Some((room.rotation * track.velocity_m_s()).into()),
        angular_velocity_rad_s: angular_velocity_rad_s.into(),
        covariance: upper_triangle(&position_m2, &rotation_rad2),
        sigma_m: Some(position_m2.trace().sqrt()),
    })
}

/// Upper triangle of the 6 x 6 covariance, row by row; the two halves are uncoupled.
pub(super) fn upper_triangle(position_m2: &Matrix3<f64>, rotation_rad2: &Matrix3<f64>) -> [f64; 21] {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_first_record_carried_far_is_lost_and_one_carried_a_little_is_not() {
        let at = |s: f64| Timestamp::from_nanos((s * 1e9) as i64);
        let record = Measured {
            t_valid: at(1.0),
            position_m: Some([0.4, 0.1, 0.2]),
            clipped: false,
            orientation_wxyz: Some([1.0, 0.0, 0.0, 0.0]),
            button: None,
            inertial: None,
        };
        let field = Field::new(&posed_stage::Stage::parse("name = \"test\"").unwrap());
        let mut magnetic = Magnetic::new(TrackerNoise::default());
        let measure = |magnetic: &mut Magnetic, s: f64| {
            magnetic.begin_frame();
            let position_m = Some([0.4 + 0.01 * s, 0.1, 0.2 - 0.01 * s]);
            magnetic.measure(&Measured { t_valid: at(s), position_m, ..record }, false, None, &field);
            magnetic.reading.is_some()
        };
        let first_s = (0..9).map(|k| 1.0 + 0.25 * f64::from(k)).find(|s| measure(&mut magnetic, *s)).unwrap();
        assert!(!magnetic.is_lost(at(first_s)) && !magnetic.is_lost(at(first_s + 0.005)));
        assert!(magnetic.is_lost(at(first_s + 0.1)), "nobody knows its velocity");
        // Once that is known, the same way is no matter.
        assert!((1..50).all(|k| measure(&mut magnetic, first_s + 0.01 * f64::from(k))));
        assert!(!magnetic.is_lost(at(first_s + 0.49 + 0.1)));
    }
}
