//! What the pipeline reports: estimates and outcomes, before anyone turns them into messages.

mod body;
mod exercise;

use posed_drivers::{State, Timestamp};
use posed_state::Plain;
use serde::{Deserialize, Serialize};

pub use self::body::{Body, PositionSource, SegmentEstimate, SegmentState};
pub use self::exercise::{
    ExerciseOutcome, ExerciseProgress, ExerciseState, ExerciseWhat, LiveHint, Repetition,
};
use crate::BodyIndex;
use crate::input::{DeviceIndex, Model, SensorIndex, Truth};
use posed_field::{PoleRun, Progress, Warning};
use posed_fusion::ahrs::ImuSample;
use posed_fusion::faults::{Cause, Class, Finding, ImuWords, Label, Repair, Verdict};
use posed_motion::keyframes::Screw;
use posed_timecode::Relation;

/// One output of `Pipeline::push`; borrowed, valid during the call. The order of outputs is part of the answer: the same entries
/// give the same outputs in the same order.
#[derive(Debug)]
pub enum Output<'a> {
    /// Write these bytes to a device's line.
    Transmit {
        /// Whose line.
        device: DeviceIndex,
        /// What to write.
        bytes: &'a [u8],
    },
    /// Set a device's RTS line.
    SetRts {
        /// Whose line.
        device: DeviceIndex,
        /// `true` = asserted.
        asserted: bool,
    },
    /// There is news of a body; comes before the estimate of its frame, once per frame and body at most.
    Body(&'a Body),
    /// A frame has closed: poses of all sensors at one time. Frames come in order of time.
    Estimate(&'a Estimate),
    /// Something happened that no client may miss. What a frame has shown comes behind its estimate.
    Outcome(&'a Outcome),
    /// A device's state changed.
    Device {
        /// Which device.
        device: DeviceIndex,
        /// Its new state.
        state: &'a State,
    },
    /// One sentence for the operator about a device, as its session gives it.
    Warning {
        /// Which device.
        device: DeviceIndex,
        /// The sentence.
        text: &'a str,
    },
    /// A guided calibration has ended: what its pole was seen to do, empty if none was under way.
    PoleRun(&'a PoleRun),
    /// The network of segments has seen the frame of the last [`Output::Estimate`]: what happened since then was its work.
    Named,
    /// Ground truth of a simulator, passed through as it came in.
    Truth(&'a Truth),
    /// Where time code lies, as of now: with each frame of it that was read, and once a second while none is.
    Timecode(&'a Timecode),
}

/// Where time code lies on the host's clock.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct Timecode {
    /// When this is so.
    pub t: Timestamp,
    /// The code at any moment.
    pub relation: Relation,
    /// How often the code has gone on somewhere else.
    pub jumps: u64,
}

/// Poses of all sensors at one tick of the stage clock. Causal: of what arrived until the frame closed, each sensor predicted to
/// the tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Plain)]
pub struct Estimate {
    /// Number of the frame, from 0; ticks that were left out during a silence have none.
    pub frame: u64,
    /// The tick: capture time that the values belong to, on the host's clock since the stage's epoch. It rises strictly.
    pub t_valid: Timestamp,
    /// Host time at which the frame closed (time of the entry that closed it).
    pub t_closed: Timestamp,
    /// Standard deviation of `t_valid` itself, s: that of the latest cycle of the device whose cycles are the ticks; with
    /// `frame_rate_hz` in the stage file, of any device.
    pub sigma_t_s: f64,
    /// What the fault map reports about the frame; absent where the stage has none.
    pub fault: Option<FrameLabel>,
    /// One per sensor of the stage file, in its order.
    pub sensors: Vec<SensorEstimate>,
}

/// How far a sensor's pose can be trusted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema, Plain)]
#[serde(rename_all = "snake_case")]
pub enum SensorState {
    /// Measured in this frame and inside its predicted gate.
    Ok,
    /// Measured, but outside the gate, or not yet confirmed: never to be used as good.
    Suspect,
    /// Nothing arrived for this frame.
    #[default]
    Missing,
    /// Measured for an earlier frame, arrived after it had closed.
    Late,
    /// The device repeats its last words.
    Stuck,
    /// Mirrored, through the transmitter or in the vertical axis, and mirrored back.
    Repaired,
    /// Corrected outside the calibrated hull.
    Extrapolated,
}

impl SensorState {
    /// The state of a sensor of whose newest record in the frame this was found; `None` where there is no record, which gives
    /// [`Self::Missing`]. The one place where findings become states.
    pub fn of(finding: Option<&Finding>) -> Self {
        let Some(Finding { verdict, label, extrapolated, late, .. }) = finding else { return Self::Missing };
        match (verdict, *label) {
            (Verdict::Used, Label::CLEAN) if *extrapolated => Self::Extrapolated,
            (Verdict::Used, Label::CLEAN) if *late => Self::Late,
            (Verdict::Used, Label::CLEAN) => Self::Ok,
            (Verdict::Used, Label { class: Class::Inverted, .. }) => Self::Repaired,
            (Verdict::Dropped, Label { cause: Some(Cause::Stuck), .. }) => Self::Stuck,
            _ => Self::Suspect,
        }
    }

    /// Whether a pose in this state may be used as good: `Ok`, `Repaired` and `Extrapolated` only.
    pub fn is_usable(self) -> bool {
        matches!(self, Self::Ok | Self::Repaired | Self::Extrapolated)
    }
}

/// One sensor in one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Plain)]
pub struct SensorEstimate {
    /// How far to trust it. Of a sensor with an attached IMU it speaks of the tracker's own record.
    pub state: SensorState,
    /// Filtered pose in the room, predicted to the frame's time. Absent before its filter has begun (a magnetic sensor needs
    /// three agreeing records), after coasting for 0.5 s, in magnetic formats without a position, and, where no IMU is attached,
    /// for a repaired record while `faults.repair` of the stage file is false. Read `state` before using it: a coasted pose is
    /// here too.
    pub pose: Option<PoseEstimate>,
    /// The newest raw record of the frame, in device axes; absent where none arrived.
    pub measured: Option<Measured>,
    /// What the fault map reports about it; absent where the stage has none, or not for this sensor.
    pub fault: Option<SensorLabel>,
    /// No record of this frame is in the pose: the IMU that is attached to the sensor carries it on.
    pub coasted: bool,
    /// The statistic of key poses; absent where the sensor is not watched for them (`[keyframes]` of the stage file), or not yet.
    pub change: Option<Change>,
}

impl SensorEstimate {
    /// Its pose in the room, if there is one and its state allows to use it as good ([`SensorState::is_usable`]).
    pub fn usable_pose(&self) -> Option<&PoseEstimate> {
        self.pose.as_ref().filter(|_| self.state.is_usable())
    }

    /// Takes a pose away that holds a number which is not finite: whatever came before, it is no pose and not to be trusted.
    pub fn withhold_non_finite(&mut self) {
        if self.pose.as_ref().is_some_and(|pose| !pose.is_finite()) {
            self.pose = None;
            self.state = SensorState::Suspect;
        }
    }
}

/// The statistic of key poses of a sensor at an earlier frame: it needs the frames around it, `keyframes.window_frames` to either
/// side.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct Change {
    /// Capture time of the frame that it speaks of.
    pub t_valid: Timestamp,
    /// How clear a change of motion there would be, at least 0: without unit, comparable between sensors; by the paper's method, m a frame.
    pub score: f64,
    /// What the score of a peak must exceed to be a key pose; it follows from `[keyframes]` of the stage file, and by the paper's method from the
    /// motion before.
    pub threshold: f64,
}

/// What the fault map reports about a frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema, Plain)]
pub struct FrameLabel {
    /// Rules and map together: inverted if most sensors are, anomalous if any is not clean.
    pub label: Class,
    /// Why; null where it is clean.
    pub cause: Option<Cause>,
    /// Distance of the frame from its cell, in shares of a chain; null where no sensor is there.
    pub distance: Option<f64>,
    /// The cell that wins: row times columns plus column; null where no sensor is there.
    pub cell: Option<u32>,
}

/// What the fault map reports about a sensor in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema, Plain)]
pub struct SensorLabel {
    /// Rules and map together.
    pub label: Class,
    /// Why; null where it is clean.
    pub cause: Option<Cause>,
    /// Distance from the nearest place where it was in training, m; null where it is missing.
    pub distance_m: Option<f64>,
    /// How the published pose differs from the record; null where it does not.
    pub repair: Option<Repair>,
}

/// A filtered pose with its uncertainty: an estimate, causal. Room frame: z up, or the tracker's own axes where nothing places
/// the transmitter (`transmitter.pose_in_room`, `Model::Transmitter`).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct PoseEstimate {
    /// Position in the room, m; absent where the sensor measures none (an IMU alone).
    pub position_m: Option<[f64; 3]>,
    /// Sensor to room, unit, scalar first and not negative. The identity where the sensor measures no orientation: its
    /// covariance then is that of an unknown one.
    pub orientation_wxyz: [f64; 4],
    /// Velocity in the room, m/s; absent with the position.
    pub velocity_m_s: Option<[f64; 3]>,
    /// Angular velocity in sensor axes, rad/s; zero where the sensor measures no orientation.
    pub angular_velocity_rad_s: [f64; 3],
    /// Covariance of (position in room, m; rotation error in sensor axes, rad): upper triangle of the
    /// 6 x 6 matrix, row by row; the position's part is zero where there is none. The two are taken as uncorrelated.
    pub covariance: [f64; 21],
    /// Root mean square of the expected 3-D position error, m, the root of the trace of the position's covariance; absent with
    /// the position.
    pub sigma_m: Option<f64>,
}

impl PoseEstimate {
    /// Whether every number of it is finite.
    pub fn is_finite(&self) -> bool {
        let vectors = [self.position_m, self.velocity_m_s, Some(self.angular_velocity_rad_s)];
        let mut numbers = vectors.iter().flatten().flatten().chain(&self.orientation_wxyz);
        numbers.all(|x| x.is_finite()) && self.covariance.iter().chain(&self.sigma_m).all(|x| x.is_finite())
    }
}

/// A raw record in device axes: of a magnetic tracker those of the transmitter, of an IMU the frame z up that the unit chose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct Measured {
    /// Capture time of this record, as the device's clock model gives it; at or before the frame's.
    pub t_valid: Timestamp,
    /// Position in device axes, m; absent in formats without one, and of IMUs.
    pub position_m: Option<[f64; 3]>,
    /// Whether a coordinate of it is at the end of what the device can say, beyond which it stands still.
    pub clipped: bool,
    /// Sensor to device axes, scalar first; absent where the record holds none. Of an IMU it is what the unit computes itself.
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Button byte as sent; absent where the device sends none.
    pub button: Option<u8>,
    /// What a body-worn sensor measured, in its own axes; absent of magnetic trackers.
    pub inertial: Option<Inertial>,
}

/// What a body-worn sensor measured, in sensor axes; absent is what the record does not hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Plain)]
pub struct Inertial {
    /// Angular velocity as the unit sends it, rad/s.
    pub angular_velocity_rad_s: Option<[f64; 3]>,
    /// Specific force (+g upwards at rest), m/s².
    pub specific_force_m_s2: Option<[f64; 3]>,
    /// Acceleration with gravity taken out by the device, m/s².
    pub linear_acceleration_m_s2: Option<[f64; 3]>,
    /// Magnetic field, in units of the field at the place of the device's own calibration: about 1.
    pub magnetic_field: Option<[f64; 3]>,
    /// [`Self::uncorrected`] with the unit's intrinsics applied (`Model::Imu`); absent where they are not known, or the record
    /// holds no whole sample.
    pub corrected: Option<ImuSample>,
}

impl Inertial {
    /// What orientation filters take, sensor axes: corrected, where the unit's intrinsics are known; `None` where the record
    /// lacks angular velocity or specific force, as of a unit that sends its orientation only.
    pub fn sample(&self) -> Option<ImuSample> {
        self.corrected.or_else(|| self.uncorrected())
    }

    /// What shows whether the unit repeats itself, uncorrected: angular velocity, and specific force or else linear acceleration.
    /// `None` of one that sends no angular velocity.
    pub fn words(&self) -> Option<ImuWords> {
        let acceleration = self.specific_force_m_s2.or(self.linear_acceleration_m_s2);
        Some(ImuWords {
            angular_velocity_rad_s: self.angular_velocity_rad_s?.into(),
            acceleration_m_s2: acceleration.map(Into::into),
        })
    }

    /// The sample as the unit measured it, sensor axes; `None` where the record lacks angular velocity or specific force.
    pub fn uncorrected(&self) -> Option<ImuSample> {
        Some(ImuSample {
            gyro_rad_s: self.angular_velocity_rad_s?.into(),
            accel_m_s2: self.specific_force_m_s2?.into(),
            mag: self.magnetic_field.map(Into::into),
        })
    }
}

/// Something that happened; clients get every one of these.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// Capture time it speaks of; of what no measurement shows, such as a swap of models, that of the latest frame.
    pub t_valid: Timestamp,
    /// Capture time of the frame with which it was decided: the delay of the decision is this less `t_valid`.
    pub t_decided: Timestamp,
    /// What happened.
    pub what: OutcomeKind,
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum OutcomeKind {
    /// A sensor's fault label began (`true`) or ended (`false`). A sensor has one cause at a time: another one ends it first.
    Fault {
        /// Which sensor.
        sensor: SensorIndex,
        /// Which fault.
        cause: Cause,
        /// `true` where it began with this frame, `false` where it ended.
        active: bool,
    },
    /// A model was swapped in: frames after `t_valid` use it. A segmentation network has no such outcome.
    ModelSwapped(Model),
    /// Something happened with an exercise.
    Exercise(ExerciseOutcome),
    /// A sensor's motion changed, or an earlier report of it is withdrawn.
    KeyPose(KeyPoseEvent),
    /// A segment of the motion begins, or an earlier report of it is withdrawn; `t_valid` is when it begins.
    MotionSegment(MotionSegment),
    /// Somebody noted the moment; `t_valid` is that of the frame before it.
    Mark {
        /// What happened, in their words; may be empty.
        label: String,
    },
    /// The field is disturbed, or has drifted, or a guided calibration goes on.
    Field(FieldNews),
}

/// What there is to say of the field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum FieldNews {
    /// A disturbance began or ended, or the field has drifted.
    Warning(Warning),
    /// How far a guided calibration is: when it begins, once a second, and when it ends.
    Progress(Progress),
}

/// A frame at which a sensor's motion changes; the outcome's `t_valid` is that of the frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct KeyPoseEvent {
    /// Which sensor.
    pub sensor: SensorIndex,
    /// Whether it is for good.
    pub phase: Phase,
    /// The statistic there ([`Change::score`]).
    pub score: f64,
    /// Whether the velocity changes at once, within a frame or two.
    pub corner: bool,
    /// Of a confirmed one, the segment that it ends; `None` where nothing moved or nobody knows where the sensor is.
    pub segment: Option<ScrewSegment>,
}

/// What a sensor did between two key poses, as one screw motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct ScrewSegment {
    /// Capture time of the key pose before, or of the beginning of the motion.
    pub since: Timestamp,
    /// Where the sensor was then, room frame, m.
    pub from_m: [f64; 3],
    /// From the pose there to that of the key pose, room frame.
    pub screw: Screw,
}

/// How final an event is that can be taken back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema, Plain)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// Probably so; will be confirmed or withdrawn.
    Provisional,
    /// So, for good.
    Confirmed,
    /// Said too early.
    Withdrawn,
}

/// What is reported of a segment of the motion. A confirmation is final; a provisional one is confirmed or withdrawn.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionSegment {
    /// What is reported.
    pub event: SegmentEvent,
    /// Whose motion it is, by the index of the body in the stage; absent on a stage without bodies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body: Option<BodyIndex>,
    /// Number of the segment, from 1; the same in all reports of one segment, and it goes on over a change of models.
    pub segment: u64,
    /// What it shows: one of the model's labels.
    pub label: String,
    /// Probability of the label at the segment's first frame, 0 to 1; 0 where it is withdrawn.
    pub confidence: f64,
    /// How long after its beginning a segment is confirmed at the latest, s: a property of the model.
    pub delay_s: f64,
}

/// What is said of a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SegmentEvent {
    /// It seems to begin.
    Provisional,
    /// It did.
    Confirmed,
    /// It did not.
    Withdrawn,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_that_is_no_number_is_withheld() {
        let whole = PoseEstimate {
            position_m: Some([0.1, 0.2, 0.3]),
            orientation_wxyz: [1.0, 0.0, 0.0, 0.0],
            velocity_m_s: Some([0.0; 3]),
            angular_velocity_rad_s: [0.0; 3],
            covariance: [0.0; 21],
            sigma_m: Some(1e-3),
        };
        let settled = |pose: PoseEstimate| {
            let mut sensor =
                SensorEstimate { state: SensorState::Ok, pose: Some(pose), ..Default::default() };
            sensor.withhold_non_finite();
            (sensor.state, sensor.pose)
        };
        assert_eq!(settled(whole), (SensorState::Ok, Some(whole)));
        let mut covariance = whole.covariance;
        covariance[20] = f64::INFINITY;
        for broken in [
            PoseEstimate { velocity_m_s: Some([0.0, f64::NAN, 0.0]), ..whole },
            PoseEstimate { angular_velocity_rad_s: [f64::NAN; 3], ..whole },
            PoseEstimate { covariance, ..whole },
        ] {
            assert_eq!(settled(broken), (SensorState::Suspect, None));
        }
    }
}
