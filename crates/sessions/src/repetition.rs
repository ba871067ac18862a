//! A repetition as it is kept.

use std::sync::Arc;

use serde::Serialize;

use crate::lesson::TaughtLesson;
use posed_motion::exercise::Reason;

/// Points of the course of a joint over a repetition, from its beginning to its end at equal distances.
pub const POINTS: usize = 32;

/// A repetition that was counted, or was not for a reason.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Repetition {
    /// Who moved: the subject of the exercise.
    #[serde(skip)]
    pub subject: String,
    /// What it was compared with.
    #[serde(skip)]
    pub lesson: Arc<TaughtLesson>,
    /// Whether a set begins with it.
    #[serde(skip)]
    pub begins_set: bool,
    /// Repetitions that its set is planned to have; absent: without end.
    #[serde(skip)]
    pub planned: Option<u32>,
    /// Its number in the set; absent of one that was not counted.
    pub number: Option<u32>,
    /// Its beginning, s since the stage's epoch.
    pub t_start_s: f64,
    /// Its end, the same.
    pub t_end_s: f64,
    /// Capture time of the frame with which it was decided, the same.
    pub t_decided_s: f64,
    /// Why it was not counted; absent of one that was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<Reason>,
    /// In points; absent of one that was not counted, and where nothing could be compared.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub score: Option<Score>,
    /// What was said of it in English; absent where all was as taught.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sentence: Option<String>,
    /// The same in German.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sentence_de: Option<String>,
    /// The joints of its lesson, as far as they were seen all the way.
    pub joints: Vec<JointCourse>,
}

impl Repetition {
    /// Whether it was counted.
    pub fn is_counted(&self) -> bool {
        self.reason.is_none()
    }

    /// Whether all that was measured of it is the same; its place in a set is not looked at, which a recording that begins in the
    /// middle of one cannot know.
    pub fn measures_as(&self, other: &Self) -> bool {
        let Self { number, t_start_s, t_end_s, t_decided_s, reason, score, sentence, sentence_de, .. } =
            other;
        (self.number, self.t_start_s, self.t_end_s, self.t_decided_s)
            == (*number, *t_start_s, *t_end_s, *t_decided_s)
            && (self.reason, self.score) == (*reason, *score)
            && (&self.sentence, &self.sentence_de) == (sentence, sentence_de)
            && self.joints == other.joints
            && self.lesson == other.lesson
    }

    /// How long it took, s.
    pub fn duration_s(&self) -> f64 {
        crate::number::time_s(self.t_end_s - self.t_start_s)
    }
}

/// A repetition beside the lesson, in points from 0 to 100; see [`posed_motion::exercise::Score`]. To a tenth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Score {
    /// Weighted mean of the parts.
    pub total: f64,
    /// How far the joints went.
    pub amplitude: f64,
    /// Whether it took as long.
    pub tempo: f64,
    /// Whether it was as smooth.
    pub smoothness: f64,
    /// Left beside right; absent where the exercise does not move both.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub symmetry: Option<f64>,
}

/// What an angle of a joint did in a repetition, degrees, to a hundredth.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JointCourse {
    /// Index in [`TaughtLesson::joints`].
    #[serde(skip)]
    pub joint: u32,
    /// Name of the channel: `elbow_r_flexion_deg`.
    pub name: String,
    /// Least angle.
    pub least_deg: f64,
    /// Greatest angle.
    pub greatest_deg: f64,
    /// [`POINTS`] angles from its beginning to its end.
    pub course_deg: Vec<f64>,
}

impl JointCourse {
    /// Range of motion.
    pub fn range_deg(&self) -> f64 {
        crate::number::degrees(self.greatest_deg - self.least_deg)
    }
}
