//! What is known of recordings without playing them: which there are, what happened in one, where everything was at a time.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use posed_fusion::faults::Cause;

/// The takes of the folder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Takes {
    /// The newest first; those that cannot be read last.
    pub takes: Vec<LibraryTake>,
    /// The file that is being recorded into; null without one.
    pub recording: Option<String>,
}

/// A recording in one line.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LibraryTake {
    /// Its file name.
    pub name: String,
    /// Size of the file, bytes.
    pub bytes: u64,
    /// When it begins: UTC in RFC 3339; null where it cannot be read.
    pub utc: Option<String>,
    /// How long it is, s; null where that is not known without reading all of it.
    pub length_s: Option<f64>,
    /// Name of its stage; empty where it cannot be read.
    pub stage: String,
    /// Whether it has an index: it was ended in order, or repaired.
    pub complete: bool,
    /// How much happens in it; null where it has no digest.
    pub counts: Option<DigestCounts>,
    /// A small picture; null where it has no digest.
    pub picture: Option<Picture>,
    /// Why it cannot be read; null where it can.
    pub unreadable: Option<String>,
}

/// How many of each kind there are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DigestCounts {
    /// Moments that somebody noted.
    pub marks: u64,
    /// Faults of sensors that began or went on.
    pub faults: u64,
    /// Segments of motion.
    pub segments: u64,
    /// Repetitions of exercises that were judged.
    pub repetitions: u64,
    /// Confirmed key poses.
    pub key_poses: u64,
}

/// Where sensors went, thinned out: enough for a thumbnail.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Picture {
    /// A path for each sensor that measures positions; where none does, for hips, hands and feet of each body.
    pub paths: Vec<PicturePath>,
}

/// A path of a picture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PicturePath {
    /// The sensor, or `BODY/SEGMENT`.
    pub name: String,
    /// Places in order of time, room, m.
    pub position_m: Vec<[f64; 3]>,
}

/// What happens in a recording. Times are stage time, s, as in `status.replay`. Of more than 2000 of a kind an even choice is listed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Digest {
    /// Stage time at which the recording begins, s.
    pub begun_s: f64,
    /// From there to its last entry, s.
    pub length_s: f64,
    /// Capture time of its first frame, s: labels that are kept beside it count from there. Null where there is none.
    #[serde(default)]
    pub first_frame_s: Option<f64>,
    /// How many of each kind happened.
    pub counts: DigestCounts,
    /// How many of each kind are not listed.
    pub dropped: DigestCounts,
    /// Moments that somebody noted.
    pub marks: Vec<DigestMark>,
    /// Faults of sensors. One that has gone on since before the recording is in it from its end on.
    pub faults: Vec<FaultSpan>,
    /// Segments of motion.
    pub segments: Vec<SegmentSpan>,
    /// Repetitions that were judged.
    pub repetitions: Vec<DigestRepetition>,
    /// Confirmed key poses.
    pub key_poses: Vec<DigestKeyPose>,
    /// Where sensors went.
    pub picture: Picture,
}

/// A moment that somebody noted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DigestMark {
    /// When, s.
    pub t_s: f64,
    /// What happened, in their words; may be empty.
    pub label: String,
}

/// How long a sensor had a fault.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FaultSpan {
    /// Which sensor.
    pub sensor: String,
    /// What was wrong with it.
    pub fault: Cause,
    /// Since when, s: the recording's beginning where it had begun before.
    pub from_s: f64,
    /// Until when, s: the recording's end where it went on.
    pub to_s: f64,
}

/// What a motion showed for a while.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SegmentSpan {
    /// Whose motion, by the name of the body; null on a stage without one.
    pub body: Option<String>,
    /// What it showed.
    pub label: String,
    /// Since when, s.
    pub from_s: f64,
    /// Until when, s: the beginning of the next one, or the end of the recording.
    pub to_s: f64,
}

/// A repetition that was judged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DigestRepetition {
    /// Who moved.
    pub subject: String,
    /// The exercise.
    pub exercise: String,
    /// Its beginning, s.
    pub from_s: f64,
    /// Its end, s.
    pub t_s: f64,
    /// Whether it counts.
    pub counted: bool,
}

/// A frame at which a sensor's motion changes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DigestKeyPose {
    /// Which sensor.
    pub sensor: String,
    /// When, s.
    pub t_s: f64,
}

/// What `library.digest` is answered with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Digested {
    /// The recording has one.
    Known {
        /// It.
        digest: Box<Digest>,
    },
    /// It has none, and none was to be made.
    Unknown {
        /// Always true.
        unknown: bool,
    },
    /// A job makes it; ask again when that has ended.
    Making {
        /// Its number.
        job: u64,
    },
}

/// What a recording is called now.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Renamed {
    /// Its file name.
    pub name: String,
}

/// What was removed for good.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Removed {
    /// How many recordings.
    pub removed: u64,
}

/// Where everything was, as a recording shows it to viewers: five times a second, in a full one at every frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Look {
    /// Stage time of what is shown, s: of several the latest.
    pub t_s: f64,
    /// Sensors that were good then, in the stage file's order.
    pub sensors: Vec<LookSensor>,
    /// Bodies of which something was shown, in the stage file's order.
    pub bodies: Vec<LookBody>,
}

/// A sensor at a time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LookSensor {
    /// Its name.
    pub name: String,
    /// Its position in the room, m; null for one that measures none.
    pub position_m: Option<[f64; 3]>,
    /// Sensor to room, unit quaternion, scalar first.
    pub orientation_wxyz: [f64; 4],
}

/// A body at a time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LookBody {
    /// Its name.
    pub name: String,
    /// Its segments, as in `body`.
    pub segments: Vec<super::FigureSegment>,
}

/// What somebody says that a recording shows.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Labels {
    /// In order of time.
    pub labels: Vec<LabelSpan>,
}

/// What somebody says that a motion shows for a while.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LabelSpan {
    /// What it shows.
    pub label: String,
    /// Since when, stage time, s.
    pub from_s: f64,
    /// Until when, s.
    pub to_s: f64,
}
