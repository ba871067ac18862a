//! Messages from the daemon to a client, as types: the source of the schema. One file per topic.
//!
//! `sensors` and `truth` are written from borrowed frames by [`super::encode`]; the types here describe the result, and a
//! test reads every written message back through them. Times are seconds since the stage's epoch.

mod answer;
mod body;
mod exercise;
mod faults;
mod field;
mod hello;
mod history;
mod jobs;
mod keyframes;
mod library;
mod marks;
mod phones;
mod reply;
mod segments;
mod sensors;
mod session;
mod setup;
mod stages;
mod status;
mod timecode;
mod truth;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) use self::answer::Answers;
pub use self::answer::{
    Answer, Demonstration, Exercises, FigureSegment, KeptExercise, KeptFile, ListedSessions, MapVersion,
    People, Plans, RecordingBegun, Recordings, Report, Resumed, SessionBegun, Shown, Started, Tracked,
};
pub use self::body::{Contacts, Figure, HeadingSource, JointEntry, LearntEntry, SegmentEntry, Sole};
pub use self::exercise::{Begun, Deviation, ExerciseChange, ExerciseEvent, Judged, Spoken};
pub use self::faults::{Fault, FaultChange};
pub use self::field::{FieldChange, FieldEvent};
pub use self::hello::{Hello, HelloBody, HelloSensor};
pub use self::history::{HealthHistory, SensorHistory};
pub use self::jobs::{Job, JobState, Jobs};
pub use self::keyframes::{KeyPose, ScrewMotion};
pub use self::library::{
    Digest, DigestCounts, DigestKeyPose, DigestMark, DigestRepetition, Digested, FaultSpan, LabelSpan,
    Labels, LibraryTake, Look, LookBody, LookSensor, Picture, PicturePath, Removed, Renamed, SegmentSpan,
    Takes,
};
pub use self::marks::Mark;
pub use self::phones::{Invitation, Phone, Phones, QrCode};
pub use self::reply::{ErrorReply, OkReply, RefusalReason};
pub use self::segments::SegmentBody;
pub use self::sensors::{Change, Measured, Quality, SensorEntry, Sensors};
pub use self::session::{PlanProgress, RunningSession, Sessions};
pub use self::setup::{
    Found, FoundPort, FoundSensor, Setup, SetupBody, SetupDevice, SetupProblem, SetupSensor,
};
pub use self::stages::{RelatedClock, StageEntry, StagePresence, Stages};
pub use self::status::{
    DeviceStatus, HostClock, LinkState, Problem, RecordingStatus, ReplayStatus, SensorStatus, StageLatency,
    Status,
};
pub use self::timecode::Timecode;
pub use self::truth::{TruthEntry, Truths};

/// Everything a client can receive.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum ServerMessage {
    /// First message on every connection.
    Hello(Hello),
    /// A request was carried out.
    Ok(OkReply),
    /// A request was refused, or could not be read.
    Error(ErrorReply),
    /// Health.
    Status(Data<Status>),
    /// Poses of one frame.
    Sensors(Data<Sensors>),
    /// Segments and joints at one time.
    Body(Data<Figure>),
    /// Ground truth of one instant.
    Truth(Data<Truths>),
    /// All jobs, running and lately ended.
    Jobs(Data<Jobs>),
    /// All sessions that go on.
    Session(Data<Sessions>),
    /// A fault began or ended, or the fault map changed.
    Faults(Data<Fault>),
    /// A sensor's motion changed.
    Keyframes(Data<KeyPose>),
    /// A model of the field changed.
    Field(Data<FieldEvent>),
    /// A repetition, or what belongs to it.
    Exercise(Data<ExerciseEvent>),
    /// A segment of the motion begins.
    Segments(Data<SegmentBody>),
    /// Somebody noted a moment.
    Marks(Data<Mark>),
    /// Where time code lies.
    Timecode(Data<Timecode>),
    /// All stages of a hub; only on a hub's own websocket.
    Stages(Stages),
}

/// What every data message starts with, and its body.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "{B}Message")]
pub struct Data<B> {
    /// Counts this topic's messages to this client from 0; a gap is a message that was dropped.
    pub seq: u64,
    /// Data messages of all topics that were dropped for this client so far.
    pub dropped: u64,
    /// The rest.
    #[serde(flatten)]
    pub body: B,
    /// Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where counting is
    /// drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub timecode: Option<String>,
}
