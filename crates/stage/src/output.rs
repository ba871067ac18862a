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
use crate::input::{DeviceIndex, Model, SensorIndex, Truth};
use posed_field::{PoleRun, Progress, Warning};
use posed_fusion::ahrs::ImuSample;
use posed_fusion::faults::{Cause, Class, Finding, ImuWords, Label, Repair, Verdict};

/// One output of `Pipeline::push`; borrowed, valid during the call.
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
    /// There is news of the body; comes before the estimate of its frame.
    Body(&'a Body),
    /// A frame has closed: poses of all sensors at one time.
    Estimate(&'a Estimate),
    /// Something happened that no client may miss.
    Outcome(&'a Outcome),
    /// A device's state changed.
    Device {
        /// Which device.
        device: DeviceIndex,
        /// Its new state.
        state: &'a State,
    },
    /// One sentence for the operator about a device.
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
    /// Ground truth, passed through.
    Truth(&'a Truth),
}

/// Poses of all sensors at one tick of the stage clock.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Plain)]
pub struct Estimate {
    /// Number of the frame, from 0.
    pub frame: u64,
    /// The tick: capture time that the values belong to.
    pub t_valid: Timestamp,
    /// Host time at which the frame closed (time of the entry that closed it).
    pub t_closed: Timestamp,
    /// Standard deviation of `t_valid` itself, s.
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
    /// Mirrored through the transmitter and mirrored back.
    Repaired,
    /// Corrected outside the calibrated hull.
    Extrapolated,
}

impl SensorState {
    /// The state of a sensor of whose newest record in the frame this was found; `None` where there is no record. The one
    /// place where findings become states.
    pub fn of(finding: Option<&Finding>) -> Self {
        let Some(Finding { verdict, label, extrapolated, late, .. }) = finding else { return Self::Missing };
        match (verdict, *label) {
            (Verdict::Used, Label::CLEAN) if *extrapolated => Self::Extrapolated,
            (Verdict::Used, Label::CLEAN) if *late => Self::Late,
            (Verdict::Used, Label::CLEAN) => Self::Ok,
            (Verdict::Used, Label::INVERTED) => Self::Repaired,
            (Verdict::Dropped, Label { cause: Some(Cause::Stuck), .. }) => Self::Stuck,
            _ => Self::Suspect,
        }
    }

    /// Whether a pose in this state may be used as good.
    pub fn is_usable(self) -> bool {
        matches!(self, Self::Ok | Self::Repaired | Self::Extrapolated)
    }
}

/// One sensor in one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Plain)]
pub struct SensorEstimate {
    /// How far to trust it.
    pub state: SensorState,
    /// Filtered pose in the room at the frame's time; absent before the first good measurement and
    /// after coasting too long.
    pub pose: Option<PoseEstimate>,
    /// The raw record, in device axes, where one arrived.
    pub measured: Option<Measured>,
    /// What the fault map reports about it; absent where the stage has none, or not for this sensor.
    pub fault: Option<SensorLabel>,
    /// No record of this frame is in the pose: the IMU that is attached to the sensor carries it on.
    pub coasted: bool,
    /// The statistic of key poses; absent where they are not looked for, or not yet.
    pub change: Option<Change>,
}

impl SensorEstimate {
    /// Its pose, if it may be used as good.
    pub fn usable_pose(&self) -> Option<&PoseEstimate> {
        self.pose.as_ref().filter(|_| self.state.is_usable())
    }
}

/// The statistic of key poses of a sensor at an earlier frame: it needs the frames around it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct Change {
    /// Capture time of the frame that it speaks of.
    pub t_valid: Timestamp,
    /// How clear a change of motion there would be: without unit, comparable between sensors.
    pub score: f64,
    /// What a peak must exceed to be a key pose.
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

/// A filtered pose with its uncertainty; room frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct PoseEstimate {
    /// Position, m; absent where the sensor measures none.
    pub position_m: Option<[f64; 3]>,
    /// Sensor to room, unit.
    pub orientation_wxyz: [f64; 4],
    /// Velocity, m/s; absent with the position.
    pub velocity_m_s: Option<[f64; 3]>,
    /// Angular velocity in sensor axes, rad/s.
    pub angular_velocity_rad_s: [f64; 3],
    /// Covariance of (position in room, m; rotation error in sensor axes, rad): upper triangle of the
    /// 6 x 6 matrix, row by row; the position's part is zero where there is none.
    pub covariance: [f64; 21],
    /// Root mean square of the expected 3-D position error, m; absent with the position.
    pub sigma_m: Option<f64>,
}

/// A raw record in device axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct Measured {
    /// Capture time of this record.
    pub t_valid: Timestamp,
    /// Position in device axes, m.
    pub position_m: Option<[f64; 3]>,
    /// Sensor to device axes.
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Button byte.
    pub button: Option<u8>,
    /// What a body-worn sensor measured, in its own axes.
    pub inertial: Option<Inertial>,
}

/// What a body-worn sensor measured, in sensor axes; absent is what the record does not hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Plain)]
pub struct Inertial {
    /// Angular rate, rad/s.
    pub angular_velocity_rad_s: Option<[f64; 3]>,
    /// Specific force (+g upwards at rest), m/s².
    pub specific_force_m_s2: Option<[f64; 3]>,
    /// Acceleration with gravity taken out by the device, m/s².
    pub linear_acceleration_m_s2: Option<[f64; 3]>,
    /// Magnetic field, about 1 at the place of calibration.
    pub magnetic_field: Option<[f64; 3]>,
    /// The same by the unit's intrinsics, where they are known.
    pub corrected: Option<ImuSample>,
}

impl Inertial {
    /// What orientation filters take: corrected, where the unit's intrinsics are known; `None` of a unit that tells its
    /// orientation only.
    pub fn sample(&self) -> Option<ImuSample> {
        self.corrected.or_else(|| self.uncorrected())
    }

    /// What tells whether the unit repeats itself; `None` of one that sends no angular velocity.
    pub fn words(&self) -> Option<ImuWords> {
        let acceleration = self.specific_force_m_s2.or(self.linear_acceleration_m_s2);
        Some(ImuWords {
            angular_velocity_rad_s: self.angular_velocity_rad_s?.into(),
            acceleration_m_s2: acceleration.map(Into::into),
        })
    }

    /// The same as the unit measured it.
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
    /// Time it speaks of.
    pub t_valid: Timestamp,
    /// Stream time at which it was decided.
    pub t_decided: Timestamp,
    /// What.
    pub what: OutcomeKind,
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum OutcomeKind {
    /// A sensor's fault label began (`true`) or ended (`false`).
    Fault {
        /// Which sensor.
        sensor: SensorIndex,
        /// Which fault.
        cause: Cause,
        /// Began or ended.
        active: bool,
    },
    /// A model was swapped in.
    ModelSwapped(Model),
    /// Something happened with an exercise.
    Exercise(ExerciseOutcome),
    /// A sensor's motion changed.
    KeyPose(KeyPoseEvent),
    /// A segment of the motion begins; `t_valid` is when.
    MotionSegment(MotionSegment),
    /// The field is disturbed, or has drifted, or a guided calibration goes on.
    Field(FieldNews),
}

/// What there is to say of the field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum FieldNews {
    /// A disturbance began or ended, or the field has drifted.
    Warning(Warning),
    /// How far a guided calibration is.
    Progress(Progress),
}

/// A frame at which a sensor's motion changes; the outcome's `t_valid` is that of the frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct KeyPoseEvent {
    /// Which sensor.
    pub sensor: SensorIndex,
    /// Whether it is for good.
    pub phase: Phase,
    /// The statistic there.
    pub score: f64,
    /// Whether the velocity changes at once, within a frame or two.
    pub corner: bool,
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

/// What is said of a segment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionSegment {
    /// What is said.
    pub event: SegmentEvent,
    /// Number of the segment, from 1.
    pub segment: u64,
    /// What it shows.
    pub label: String,
    /// Probability of the label at the segment's first frame, 0 to 1.
    pub confidence: f64,
    /// How long after its beginning a segment is confirmed at the latest, s.
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
