//! Messages from a client to the daemon.

mod parse;

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

#[doc(hidden)]
pub use self::parse::REQUEST_EXAMPLES;
pub use self::parse::{ParseError, fuzz_client_message, parse};
use super::{Field, Topic};
use posed_fusion::body::Thoroughness;
use posed_fusion::faults::Class;
use posed_sessions::{Plan, SessionId};
use posed_stage::edit::Change;
use posed_stage::input::Model;

/// What a client calls its request; replies carry it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum RequestId {
    /// A whole number.
    Number(i64),
    /// A text of up to 64 bytes.
    Text(String),
}

/// A request that was read.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// About what this client receives.
    Feed(Feed),
    /// Something for the daemon to do.
    Call(Call),
}

/// Requests about what this client receives.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum Feed {
    /// Subscribes to topics; again for the same topic: with the new options. The reply is followed by the last state.
    Subscribe {
        /// Which ones.
        topics: Vec<Topic>,
        /// At most so many messages per second and topic, events excepted; absent: every frame.
        #[serde(default)]
        max_rate_hz: Option<f64>,
        /// Only these sensors, by name; absent: all.
        #[serde(default)]
        sensors: Option<Vec<String>>,
        /// What `sensors` and `truth` say of each sensor, beside its name and state; absent: `device`, `position_m`,
        /// `orientation_wxyz`, `sigma_m`.
        #[serde(default)]
        fields: Option<Vec<Field>>,
        /// What to do when this client is too slow; absent: `latest`.
        #[serde(default)]
        drop: Option<DropPolicy>,
    },
    /// Ends subscriptions.
    Unsubscribe {
        /// Which ones.
        topics: Vec<Topic>,
    },
    /// Sends the events of the subscribed topics that came after one, of the last ten minutes.
    Resume {
        /// The last `event_id` that the client has; 0: all.
        after: u64,
    },
}

/// Requests for the daemon. All but those that only tell something need the role `operate`: `replay.list`, `replay.track`,
/// `replay.look`, `replay.labels`, `library.list`, `library.digest` without `make`, `health.history`, `exercise.list` and `exercise.demonstration`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "type", deny_unknown_fields)]
pub enum Call {
    /// Begins a recording.
    #[serde(rename = "record.start")]
    RecordStart {
        /// File name within the recordings' folder, without a path; absent: stage and time.
        #[serde(default)]
        name: Option<String>,
    },
    /// Ends the recording.
    #[serde(rename = "record.stop")]
    RecordStop {},
    /// Notes this moment: an event of the topic `marks`, and in the recording that is in progress.
    #[serde(rename = "mark")]
    Mark {
        /// What happens now, 200 bytes at most; absent: nothing is said of it.
        #[serde(default)]
        label: Option<String>,
    },
    /// Names the recordings.
    #[serde(rename = "replay.list")]
    ReplayList {},
    /// Opens a recording.
    #[serde(rename = "replay.open")]
    ReplayOpen {
        /// A name that `replay.list` gave.
        name: String,
    },
    /// Reads a few channels of a whole recording, to compare runs; answered when it is read.
    #[serde(rename = "replay.track")]
    ReplayTrack {
        /// A name that `replay.list` gave.
        name: String,
        /// Up to six channels; absent: only their names are answered.
        #[serde(default)]
        columns: Vec<String>,
    },
    /// Goes to a time in the open recording.
    #[serde(rename = "replay.seek")]
    ReplaySeek {
        /// Seconds since the recording's epoch.
        t_s: f64,
    },
    /// Sets the speed of the replay.
    #[serde(rename = "replay.speed")]
    ReplaySpeed {
        /// Multiple of real time; 0 pauses.
        speed: Speed,
    },
    /// Tells where everything was at a time of the open recording, from what it shows to viewers: at once, and without moving the replay.
    #[serde(rename = "replay.look")]
    ReplayLook {
        /// Seconds since the recording's epoch.
        t_s: f64,
    },
    /// Tells what somebody has said that a recording shows: the labels beside it, which `segments.train` learns from.
    #[serde(rename = "replay.labels")]
    ReplayLabels {
        /// A name that `library.list` gave.
        name: String,
    },
    /// Says what a recording shows for a while, in the place of what was said of that time before; kept beside it, where
    /// `segments.train` reads it. The recording needs a digest.
    #[serde(rename = "replay.label")]
    ReplayLabel {
        /// A name that `library.list` gave.
        name: String,
        /// Since when, stage time, s.
        from_s: f64,
        /// Until when, s.
        to_s: f64,
        /// What it shows, 200 bytes at most; empty: nothing is said of that time any more.
        label: String,
    },
    /// Tells which recordings there are, with what can be known of each without reading it.
    #[serde(rename = "library.list")]
    LibraryList {
        /// Those in the bin instead; absent: those in the folder.
        #[serde(default)]
        bin: bool,
    },
    /// Tells what happens in a recording.
    #[serde(rename = "library.digest")]
    LibraryDigest {
        /// A name that `library.list` gave.
        name: String,
        /// Whether a job makes one where there is none: by a replay, as long as that takes; needs the role `operate`. Absent: no.
        #[serde(default)]
        make: bool,
    },
    /// Gives a recording another name; what is kept beside it goes along.
    #[serde(rename = "library.rename")]
    LibraryRename {
        /// A name that `library.list` gave.
        name: String,
        /// File name of letters, digits, `-`, `_`, `.` and spaces, without a path; one that is free.
        to: String,
    },
    /// Puts a recording into the bin.
    #[serde(rename = "library.remove")]
    LibraryRemove {
        /// A name that `library.list` gave.
        name: String,
    },
    /// Takes a recording out of the bin.
    #[serde(rename = "library.restore")]
    LibraryRestore {
        /// A name that `library.list` of the bin gave.
        name: String,
    },
    /// Removes for good what is in the bin.
    #[serde(rename = "library.empty_bin")]
    LibraryEmptyBin {},
    /// Writes a recording as a file for another program into the folder `exports`, from where `/exports/FILE` serves it; a job, whose result is `{file, rows, bytes}`.
    #[serde(rename = "library.export")]
    LibraryExport {
        /// A name that `library.list` gave.
        name: String,
        /// As `--to` of `posed export`: `csv`, `jsonl`, `bvh`, `trc`, `glb`, `vrm`, `vrma`, `usda`, `c3d`, `sto`, `mot`, `mcap`.
        format: String,
        /// As `--bones`, for `bvh`; absent: `posed`.
        #[serde(default)]
        bones: Option<String>,
        /// As `--model`, for `mot`; absent: `rajagopal`.
        #[serde(default)]
        model: Option<String>,
        /// As `--body`: which of several bodies is shown, by name.
        #[serde(default)]
        body: Option<String>,
        /// As `--frame`, for `csv`: `room` or `transmitter`; absent: `room`.
        #[serde(default)]
        frame: Option<String>,
    },
    /// Tells how the sensors were in the last hour.
    #[serde(rename = "health.history")]
    HealthHistory {},
    /// Begins a guided calibration of the field: move the pole, and follow what the topic `field` says.
    #[serde(rename = "field.start")]
    FieldStart {
        /// The pole's sensors by name, in their order along it.
        sensors: Vec<String>,
        /// Measured distance between neighbours, m.
        spacing_m: f64,
    },
    /// Ends the guided calibration and solves it, as a job.
    #[serde(rename = "field.finish")]
    FieldFinish {
        /// Surveyed points that a sensor of the pole stood on meanwhile; three or more make positions absolute.
        #[serde(default)]
        anchors: Vec<AnchorSpec>,
    },
    /// Uses the map of the last calibration from the next frame on, and keeps it as the stage's newest version.
    #[serde(rename = "field.accept")]
    FieldAccept {},
    /// Goes back to the version before; to no map before the first.
    #[serde(rename = "field.rollback")]
    FieldRollback {},
    /// Names the exercises that can be selected: those in the stage's folder.
    #[serde(rename = "exercise.list")]
    ExerciseList {},
    /// Shows how an exercise was taught, as a figure that moves.
    #[serde(rename = "exercise.demonstration")]
    ExerciseDemonstration {
        /// Its name, as `exercise.list` gave it.
        exercise: String,
    },
    /// Teaches an exercise from what is tracked; a job. The exercise is kept as a file, loaded, and counted for the
    /// subject from then on.
    #[serde(rename = "exercise.teach")]
    ExerciseTeach {
        /// Name of the exercise: 1 to 64 letters, digits, spaces, `-` and `_`.
        name: String,
        /// How many repetitions it is taught from; 3 to 10 are good.
        repetitions: u32,
        /// The repetitions lie in the last so many seconds; absent: they are about to be done, and the job ends once
        /// they were done and the subject rests.
        #[serde(default)]
        last_s: Option<f64>,
        /// Only these sensors, by name; absent: all.
        #[serde(default)]
        sensors: Option<Vec<String>>,
        /// Only these channels; absent: those that do the same in every repetition.
        #[serde(default)]
        channels: Option<Vec<String>>,
        /// Who moves; absent: the name of the body, or `default`.
        #[serde(default)]
        subject: Option<String>,
        /// The body whose joints are looked at, by name; absent: the one that is called as the subject, or else the first one.
        #[serde(default)]
        body: Option<String>,
    },
    /// Counts exercises from 0 for a subject, and no others.
    #[serde(rename = "exercise.select")]
    ExerciseSelect {
        /// Their names; none ends the counting.
        exercises: Vec<String>,
        /// Repetitions of a set; absent: one set without end.
        #[serde(default)]
        repetitions: Option<u32>,
        /// Sets of each exercise; absent: no end.
        #[serde(default)]
        sets: Option<u32>,
        /// Rest after a set, s; absent: none.
        #[serde(default)]
        rest_s: Option<f64>,
        /// Who moves; absent: the name of the body, or `default`.
        #[serde(default)]
        subject: Option<String>,
        /// The body whose joints are counted, by name; absent: the one that is called as the subject, or else the first one.
        #[serde(default)]
        body: Option<String>,
        /// For each sensor that the exercises were taught with the one that this subject wears; absent: the same.
        #[serde(default)]
        sensors: Option<BTreeMap<String, String>>,
    },
    /// Counts a subject's exercises from 0 again.
    #[serde(rename = "exercise.reset")]
    ExerciseReset {
        /// Who moves; absent: `default`.
        #[serde(default)]
        subject: Option<String>,
    },
    /// Learns a fault map; a job. It is kept as a file, and takes the place of the one in use.
    #[serde(rename = "faults.train")]
    FaultsTrain {
        /// From the last so many seconds; absent: from all that is remembered, five minutes at most.
        #[serde(default)]
        last_s: Option<f64>,
        /// From a recording instead: a name that `replay.list` gave.
        #[serde(default)]
        recording: Option<String>,
    },
    /// Gives a cell of the fault map another class; kept as a file.
    #[serde(rename = "faults.name_cell")]
    FaultsNameCell {
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
        /// What frames of this cell are.
        class: Class,
    },
    /// Learns to name segments of the motion from the recordings that have labels beside them (`TAKE.labels.csv` or `TAKE.eaf`); a
    /// job. The model is kept as a file, and takes the place of the one in use.
    #[serde(rename = "segments.train")]
    SegmentsTrain {
        /// Most epochs; absent: 30.
        #[serde(default)]
        epochs: Option<u32>,
        /// Frames of 1/24 s that the network may look ahead: the fewer, the sooner labels are sure. More than 40, half
        /// of what it sees, is 40; absent: 40.
        #[serde(default)]
        look_ahead: Option<usize>,
    },
    /// Finds how the body's sensors sit, and with `assign` on which segment each does, from poses and movements that the job's message
    /// asks for one after the other; a job. It notices by itself when each was done, and swaps in what it found if it is good to
    /// five degrees. Its result has `quality_deg` and `sensors` by segment.
    #[serde(rename = "body.calibrate")]
    BodyCalibrate {
        /// How much is asked for; absent: `full`.
        #[serde(default)]
        how: Option<Thoroughness>,
        /// The person, by the name of the body; absent: the only one.
        #[serde(default)]
        body: Option<String>,
    },
    /// The person looks this way now, upright: the headings of IMUs on the body that no field identifies begin anew from it. Gyros drift; this takes it away.
    #[serde(rename = "heading.reset")]
    HeadingReset {
        /// The person, by the name of the body; absent: the one who wears the IMU, or the only one.
        #[serde(default)]
        body: Option<String>,
        /// The IMU, by name; absent: all on the body.
        #[serde(default)]
        sensor: Option<String>,
        /// How far to the left of the room's x the person looks, degrees, -360 to 360; absent: 0.
        #[serde(default)]
        heading_deg: Option<f64>,
    },
    /// Finds how the transmitter stands in the room, and how the IMU sits on a magnetic sensor that has one; a job, whose message
    /// states what to do next. Both are swapped in if they are good.
    #[serde(rename = "stage.align")]
    StageAlign {
        /// The magnetic sensor, by name; absent: the first that has an IMU, else the first.
        #[serde(default)]
        sensor: Option<String>,
        /// Surveyed points of the room that the sensor is held at, in this order; three or more where no IMU is attached to it.
        #[serde(default)]
        anchors: Vec<RoomPoint>,
    },
    /// Finds the intrinsics of an IMU that is placed in one direction after the other and turned between; a job, whose message
    /// states what to do next and whose result states which directions were held. They are kept as a file of the unit and used from
    /// then on, if they are good.
    #[serde(rename = "imu.calibrate")]
    ImuCalibrate {
        /// The sensor, by name; absent: the only IMU of the stage.
        #[serde(default)]
        sensor: Option<String>,
    },
    /// Begins a session: what a subject does from now on is kept for this person. With a plan its steps are selected one after the
    /// other, with their rests, and the session ends after the last.
    #[serde(rename = "session.begin")]
    SessionBegin {
        /// Who trains: a name or a number of 1 to 64 bytes; taken in where it is new.
        person: String,
        /// A plan that `session.plans` gave; absent: what is selected by hand.
        #[serde(default)]
        plan: Option<String>,
        /// The subject of the exercises; absent: `default`.
        #[serde(default)]
        subject: Option<String>,
    },
    /// Ends a session.
    #[serde(rename = "session.end")]
    SessionEnd {
        /// Of this subject; absent: `default`.
        #[serde(default)]
        subject: Option<String>,
    },
    /// Names sessions, the newest first.
    #[serde(rename = "session.list")]
    SessionList {
        /// Only those of this person.
        #[serde(default)]
        person: Option<String>,
        /// At most so many, 1 to 1000; absent: 100.
        #[serde(default)]
        limit: Option<u32>,
    },
    /// Gives a session in full.
    #[serde(rename = "session.show")]
    SessionShow {
        /// Its number.
        session: SessionId,
    },
    /// Writes a report of one session, or of all sessions of a person.
    #[serde(rename = "session.report")]
    SessionReport {
        /// Number of the session; or
        #[serde(default)]
        session: Option<SessionId>,
        /// the person.
        #[serde(default)]
        person: Option<String>,
        /// In which language; absent: `english`.
        #[serde(default)]
        language: Option<ReportLanguage>,
        /// Time zone of its dates by its IANA name, `Europe/Berlin`; absent: that of the daemon.
        #[serde(default)]
        time_zone: Option<String>,
    },
    /// Keeps the count of a set that somebody has seen, beside the one that was counted.
    #[serde(rename = "session.correct")]
    SessionCorrect {
        /// Number of the session.
        session: SessionId,
        /// Number of the set in it.
        set: u32,
        /// Repetitions that were really done.
        counted: u32,
    },
    /// Names everybody who trains.
    #[serde(rename = "session.people")]
    SessionPeople {},
    /// Removes a person with everything of them.
    #[serde(rename = "session.forget")]
    SessionForget {
        /// Who.
        person: String,
        /// Whether the recordings of their sessions go too, whoever else is in them.
        recordings: bool,
    },
    /// Gives all plans.
    #[serde(rename = "session.plans")]
    SessionPlans {},
    /// Keeps a plan, in the place of one of its name.
    #[serde(rename = "session.save_plan")]
    SessionSavePlan {
        /// The plan.
        plan: Plan,
    },
    /// Removes a plan.
    #[serde(rename = "session.delete_plan")]
    SessionDeletePlan {
        /// Its name.
        name: String,
    },
    /// Reads the stage file, as it would be with these changes, and says all that is wrong with it; nothing is written.
    #[serde(rename = "setup.read")]
    SetupRead {
        /// Made one after the other; none: the file as it is.
        #[serde(default)]
        changes: Vec<Change>,
    },
    /// Writes changes into the stage file, keeps the file of before beside it (its name and `~`), and begins the changed stage: all
    /// connections are closed with code 1012 and served again at once. Refused as `busy` while a recording or another job runs, as
    /// `changed` where the file is not what was read, as `failed` where the stage could not run like this.
    #[serde(rename = "setup.save")]
    SetupSave {
        /// Made one after the other.
        changes: Vec<Change>,
        /// The `revision` that `setup.read` gave.
        revision: String,
    },
    /// Asks the ports that no device of the stage has what is there; a job, whose `result` (`Found`) grows as they answer. A unit that
    /// streams is stopped by the question; nothing else is changed.
    #[serde(rename = "setup.find")]
    SetupFind {
        /// Only this one: path of a serial port, tcp://HOST:PORT or udp://HOST:PORT; absent: all serial ports, and the units
        /// that announce themselves on the network.
        #[serde(default)]
        port: Option<String>,
    },
    /// Lets phones come as sensors, and says how: an address with a token that allows only this, as a text and as a QR code. The daemon
    /// listens there from then on.
    #[serde(rename = "phone.invite")]
    PhoneInvite {},
    /// The phones and other devices that are connected to the websocket `/imu` just now.
    #[serde(rename = "phone.list")]
    PhoneList {},
    /// Has one of them show itself: a phone's page flashes. Refused as `not_connected` where it is not there.
    #[serde(rename = "phone.blink")]
    PhoneBlink {
        /// Its id.
        phone_id: String,
    },
    /// Cancels a job.
    #[serde(rename = "job.cancel")]
    JobCancel {
        /// Its number.
        job: u64,
    },
    /// Swaps a model in between two frames.
    #[serde(rename = "model.load")]
    ModelLoad {
        /// The model, in full.
        model: Model,
    },
}

impl Call {
    /// Whether it needs the role `operate`: all do that do more than tell something.
    pub fn changes_something(&self) -> bool {
        let only_tells = matches!(
            self,
            Self::ReplayList {}
                | Self::ReplayTrack { .. }
                | Self::ReplayLook { .. }
                | Self::ReplayLabels { .. }
                | Self::LibraryList { .. }
                | Self::LibraryDigest { make: false, .. }
                | Self::HealthHistory {}
                | Self::ExerciseList {}
                | Self::ExerciseDemonstration { .. }
        );
        !only_tells
    }

    /// Whether it is about the folder of recordings, and so answered in the same way by a live stage and beside a replay.
    pub fn is_of_library(&self) -> bool {
        matches!(
            self,
            Self::ReplayLabels { .. }
                | Self::ReplayLabel { .. }
                | Self::LibraryList { .. }
                | Self::LibraryDigest { .. }
                | Self::LibraryRename { .. }
                | Self::LibraryRemove { .. }
                | Self::LibraryRestore { .. }
                | Self::LibraryEmptyBin {}
                | Self::LibraryExport { .. }
        )
    }
}

/// Languages of a report.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ReportLanguage {
    /// English.
    #[default]
    English,
    /// German.
    German,
}

/// A surveyed point that a sensor of the pole stood on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AnchorSpec {
    /// For messages.
    pub name: String,
    /// The sensor, by name.
    pub sensor: String,
    /// From when, stream time, s.
    pub t_start: f64,
    /// Until when, stream time, s.
    pub t_end: f64,
    /// The point in the transmitter frame, m.
    pub position_m: [f64; 3],
}

/// A surveyed point of the room.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RoomPoint {
    /// For messages.
    pub name: String,
    /// Where it is, room, m.
    pub position_m: [f64; 3],
}

/// What to do with messages for which a client is too slow. Either way the oldest goes first and is counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DropPolicy {
    /// Keep a few of the newest: for who shows them.
    #[default]
    Latest,
    /// Keep a long queue: for who stores them.
    Queue,
}

/// Speed of a replay.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Speed {
    /// Multiple of real time; 0 pauses.
    Times(f64),
    /// A word.
    Word(SpeedWord),
}

impl Speed {
    /// Multiple of real time; infinity is as fast as it goes.
    pub fn times(self) -> f64 {
        match self {
            Self::Times(times) => times,
            Self::Word(SpeedWord::Max) => f64::INFINITY,
        }
    }
}

/// A speed in words.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SpeedWord {
    /// As fast as it goes.
    Max,
}
