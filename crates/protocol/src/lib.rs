//! What clients and the daemon say to each other on the websocket, and how it is written.
//!
//! In: the pipeline's outputs, the daemon's status, bytes that clients sent. Out: messages in JSON or MessagePack,
//! parsed requests, the JSON Schema and TypeScript types of both. Never: a socket, a clock, a thread.
//!
//! Everything is a map with a `type`. A *data message* belongs to a [`Topic`] and starts with `type`, `seq`, `dropped`,
//! which differ from client to client, followed by a *body* which all clients with the same [`View`] share: the body is
//! written once per frame, the head once per client (see [`encode`]).
//!
//! ```
//! use posed_protocol::{Encoding, Feed, Request, parse};
//!
//! let (id, request) = parse(Encoding::Json, br#"{"type": "subscribe", "id": 1, "topics": ["sensors"]}"#)?;
//! assert!(matches!(request, Request::Feed(Feed::Subscribe { .. })), "{id:?}");
//! assert!(parse(Encoding::Json, b"{}").is_err());
//! # Ok::<(), posed_protocol::ParseError>(())
//! ```
//!
//! # Resolution of numbers
//! Positions and their sigma 1e-5 m and 1e-6 m, quaternions 1e-6, times 1e-6 s, velocities 1e-4 m/s and 1e-4 rad/s,
//! angles 1e-3 degrees,
//! covariances four significant digits, rates 1e-3 Hz, ages 1 ms. Both encodings carry the rounded number.

mod body;
pub mod encode;
mod exercise;
pub mod foxglove;
pub mod lsl;
mod message;
pub mod mvn;
mod names;
mod packed;
mod plain;
mod publisher;
mod rate;
mod request;
pub mod ros2;
pub mod round;
pub mod schema;
mod sensors;
#[cfg(test)]
mod testing;
mod topic;
mod typescript;
pub mod vmc;
pub mod vrpn;
mod wish;

pub use encode::{Encoding, Payload};
pub use message::{
    Answer, Begun, Change, Contacts, Data, Demonstration, Deviation, DeviceStatus, Digest, DigestCounts,
    DigestKeyPose, DigestMark, DigestRepetition, Digested, ErrorReply, ExerciseChange, ExerciseEvent,
    Exercises, Fault, FaultChange, FaultSpan, FieldChange, FieldEvent, Figure, FigureSegment, Found,
    FoundPort, FoundSensor, HeadingSource, HealthHistory, Hello, HelloBody, HelloSensor, HostClock,
    Invitation, Job, JobState, Jobs, JointEntry, Judged, KeptExercise, KeptFile, KeyPose, LabelSpan, Labels,
    LearntEntry, LibraryTake, LinkState, ListedSessions, Look, LookBody, LookSensor, MapVersion, Mark,
    Measured, OkReply, People, Phone, Phones, Picture, PicturePath, PlanProgress, Plans, Problem, QrCode,
    Quality, RecordingBegun, RecordingStatus, Recordings, RefusalReason, RelatedClock, Removed, Renamed,
    ReplayStatus, Report, Resumed, RunningSession, ScrewMotion, SegmentBody, SegmentEntry, SegmentSpan,
    SensorEntry, SensorHistory, SensorStatus, Sensors, ServerMessage, SessionBegun, Sessions, Setup,
    SetupBody, SetupDevice, SetupProblem, SetupSensor, Shown, Sole, Spoken, StageEntry, StageLatency,
    StagePresence, Stages, Started, Status, Takes, Timecode, Tracked, TruthEntry, Truths,
};
pub use names::Names;
pub use packed::{unpack, unpacker};
pub use publisher::{Counters, Publisher, PublisherState, STREAMS, Stamp};
pub use rate::Rate;
#[doc(hidden)]
pub use request::REQUEST_EXAMPLES;
pub use request::{
    AnchorSpec, Call, DropPolicy, Feed, ParseError, ReportLanguage, Request, RequestId, RoomPoint, Speed,
    SpeedWord, fuzz_client_message, parse,
};
pub use sensors::{Field, Fields, View};
pub use topic::Topic;
pub use wish::{Selection, Wish};

/// Version of the protocol and name of the websocket sub-protocol with JSON text messages.
pub const SUBPROTOCOL_JSON: &str = "posed.v1";
/// Name of the sub-protocol with the same messages in MessagePack.
pub const SUBPROTOCOL_MSGPACK: &str = "posed.v1.msgpack";
