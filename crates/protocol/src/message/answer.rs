//! What `ok` carries as `result`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Digested, HealthHistory, Invitation, Labels, Look, Phones, Removed, Renamed, Setup, Takes};
use posed_sessions::{Forgotten, Person, Plan, SessionId, SessionSummary};

/// What a request was answered with; which one gets which: [`Answers`]. All others are answered with `ok` alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Answer {
    /// To `resume`.
    Resumed(Resumed),
    /// To `record.start`; before [`Started`], which is a part of it.
    RecordingBegun(RecordingBegun),
    /// To all that is a job.
    Started(Started),
    /// To `session.forget`; before [`Recordings`], which is a part of it.
    Forgotten(Forgotten),
    /// To `replay.list`.
    Recordings(Recordings),
    /// To `replay.track`.
    Tracked(Tracked),
    /// To `library.list`.
    Takes(Takes),
    /// To `library.digest`; one that is being made is as [`Started`].
    Digested(Digested),
    /// To `library.empty_bin`.
    Removed(Removed),
    /// To `replay.look`.
    Look(Look),
    /// To `replay.labels` and `replay.label`.
    Labels(Labels),
    /// To `health.history`.
    History(HealthHistory),
    /// To `exercise.list`.
    Exercises(Exercises),
    /// To `exercise.demonstration`.
    Demonstration(Demonstration),
    /// To `field.accept` and `field.rollback`.
    MapVersion(MapVersion),
    /// To `setup.read`.
    Setup(Box<Setup>),
    /// To `phone.invite`.
    Invitation(Invitation),
    /// To `phone.list`.
    Phones(Phones),
    /// To `faults.name_cell`.
    KeptFile(KeptFile),
    /// To `session.begin`.
    SessionBegun(SessionBegun),
    /// To `session.list`.
    Sessions(ListedSessions),
    /// To `session.show`.
    Shown(Shown),
    /// To `session.report`.
    Report(Report),
    /// To `session.people`.
    People(People),
    /// To `session.plans`.
    Plans(Plans),
    /// To `library.rename`, `library.remove` and `library.restore`.
    Renamed(Renamed),
}

/// Which events follow.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Resumed {
    /// Whether none of those that were missed is too old to be known.
    pub complete: bool,
    /// The newest of the stage.
    pub last_event_id: u64,
}

/// A recording that has begun.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RecordingBegun {
    /// Name of the file in the folder of recordings.
    pub name: String,
    /// Its job.
    pub job: u64,
}

/// A job that has begun; the topic `jobs` reports its progress.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Started {
    /// Its number.
    pub job: u64,
}

/// The recordings of the folder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Recordings {
    /// Their names, in order.
    pub recordings: Vec<String>,
}

/// Channels of a whole recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Tracked {
    /// Where no channel was asked for.
    Channels {
        /// The names of all.
        columns: Vec<String>,
    },
    /// Those that were asked for, thinned out.
    Rows {
        /// Time of each row, s.
        t_s: Vec<f64>,
        /// Each row, in the order that was asked for; null where nothing was measured.
        values: Vec<Vec<Option<f64>>>,
    },
}

/// The exercises of the stage's folder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Exercises {
    /// By name.
    pub exercises: Vec<KeptExercise>,
}

/// An exercise that can be selected.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct KeptExercise {
    /// Its name.
    pub name: String,
    /// The newest revision: how often it was taught.
    pub revision: u32,
}

/// How an exercise was taught, as a figure that moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Demonstration {
    /// Name of the exercise.
    pub exercise: String,
    /// How often it was taught.
    pub revision: u32,
    /// How long a repetition takes, s: the median of the lesson.
    pub duration_s: f64,
    /// The angles that are shown, by their channels; all other joints hang straight.
    pub angles: Vec<String>,
    /// The figure at equal distances in time, from the beginning of a repetition to its end.
    pub frames: Vec<Vec<FigureSegment>>,
}

/// A segment of a figure that stands above the room's origin and looks along the room's x.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FigureSegment {
    /// Its name, as in `body`.
    pub name: String,
    /// Its origin, room, m.
    pub position_m: [f64; 3],
    /// Segment to room, unit, scalar first.
    pub orientation_wxyz: [f64; 4],
}

/// The map of the field that is in use now.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct MapVersion {
    /// Its version.
    pub version: u32,
}

/// A file that was written.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct KeptFile {
    /// The revision of what it holds.
    pub revision: u32,
    /// Its name.
    pub file: String,
}

/// A session that has begun.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SessionBegun {
    /// Its number.
    pub session: SessionId,
}

/// Sessions in one line each.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ListedSessions {
    /// The newest first.
    pub sessions: Vec<SessionSummary>,
}

/// A session in full.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Shown {
    /// Its sets, repetitions, scores and courses, as `posed session show --json` prints them.
    pub shown: serde_json::Value,
}

/// A report.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Report {
    /// One self-contained HTML page.
    pub html: String,
}

/// Everybody who trains.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct People {
    /// By name.
    pub people: Vec<Person>,
}

/// All plans.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Plans {
    /// By name.
    pub plans: Vec<Plan>,
}

/// The `result` of each request that has one, by the request's `type`.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "a table for the published schema")]
pub(crate) struct Answers {
    resume: Resumed,
    #[serde(rename = "record.start")]
    record_start: RecordingBegun,
    #[serde(rename = "replay.list")]
    replay_list: Recordings,
    #[serde(rename = "replay.track")]
    replay_track: Tracked,
    #[serde(rename = "replay.seek")]
    replay_seek: Started,
    #[serde(rename = "replay.look")]
    replay_look: Look,
    #[serde(rename = "replay.labels")]
    replay_labels: Labels,
    #[serde(rename = "replay.label")]
    replay_label: Labels,
    #[serde(rename = "library.list")]
    library_list: Takes,
    #[serde(rename = "library.digest")]
    library_digest: Digested,
    #[serde(rename = "library.rename")]
    library_rename: Renamed,
    #[serde(rename = "library.remove")]
    library_remove: Renamed,
    #[serde(rename = "library.restore")]
    library_restore: Renamed,
    #[serde(rename = "library.empty_bin")]
    library_empty_bin: Removed,
    #[serde(rename = "library.export")]
    library_export: Started,
    #[serde(rename = "health.history")]
    health_history: HealthHistory,
    #[serde(rename = "field.finish")]
    field_finish: Started,
    #[serde(rename = "field.accept")]
    field_accept: MapVersion,
    #[serde(rename = "field.rollback")]
    field_rollback: MapVersion,
    #[serde(rename = "exercise.list")]
    exercise_list: Exercises,
    #[serde(rename = "exercise.demonstration")]
    exercise_demonstration: Demonstration,
    #[serde(rename = "exercise.teach")]
    exercise_teach: Started,
    #[serde(rename = "faults.train")]
    faults_train: Started,
    #[serde(rename = "faults.name_cell")]
    faults_name_cell: KeptFile,
    #[serde(rename = "segments.train")]
    segments_train: Started,
    #[serde(rename = "body.calibrate")]
    body_calibrate: Started,
    #[serde(rename = "stage.align")]
    stage_align: Started,
    #[serde(rename = "imu.calibrate")]
    imu_calibrate: Started,
    #[serde(rename = "setup.read")]
    setup_read: Setup,
    #[serde(rename = "setup.find")]
    setup_find: Started,
    #[serde(rename = "phone.invite")]
    phone_invite: Invitation,
    #[serde(rename = "phone.list")]
    phone_list: Phones,
    #[serde(rename = "session.begin")]
    session_begin: SessionBegun,
    #[serde(rename = "session.list")]
    session_list: ListedSessions,
    #[serde(rename = "session.show")]
    session_show: Shown,
    #[serde(rename = "session.report")]
    session_report: Report,
    #[serde(rename = "session.people")]
    session_people: People,
    #[serde(rename = "session.forget")]
    session_forget: Forgotten,
    #[serde(rename = "session.plans")]
    session_plans: Plans,
}
