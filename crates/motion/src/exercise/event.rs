//! What counting tells: that a repetition began, is provisional, was counted, rejected or withdrawn.

use serde::{Deserialize, Serialize};

use super::exercise::Exercise;
use super::feedback::Feedback;
use super::judge::{Measures, Reason};
use super::remark::Remark;
use super::words::{Language, sentence};

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EventKind {
    /// A repetition has begun.
    Started,
    /// It seems to be complete; `Counted`, `Rejected` or `Withdrawn` follows.
    Provisional,
    /// It is complete and counts.
    Counted,
    /// It is complete and does not count.
    Rejected,
    /// What was provisional was none.
    Withdrawn,
}

impl EventKind {
    /// The word in files and messages.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Started => "started",
            Self::Provisional => "provisional",
            Self::Counted => "counted",
            Self::Rejected => "rejected",
            Self::Withdrawn => "withdrawn",
        }
    }
}

/// Something happened with an exercise. Times are those of the stream.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// End of the repetition, s; its beginning where it has only begun.
    pub t_s: f64,
    /// Beginning of the repetition, s.
    pub t_start_s: f64,
    /// Time of the sample with which it was decided, s: the delay is this less `t_s`.
    pub t_decided_s: f64,
    /// Index of the exercise, as given to `Counter::new`.
    pub exercise: usize,
    /// What happened.
    pub kind: EventKind,
    /// Repetitions of this exercise counted so far, with this one; it only rises.
    pub count: u64,
    /// Why it was rejected; `None` for every other kind.
    pub reason: Option<Reason>,
    /// Measures of a counted or rejected repetition.
    pub measures: Option<Measures>,
    /// What deviated most in a counted or rejected repetition.
    pub feedback: Option<Feedback>,
    /// Whether it was meant: false of a rejected movement that is another one, outside of a set; true of every other kind.
    pub is_attempt: bool,
    /// What to say of a counted repetition; none where all was as taught.
    pub remark: Option<Remark>,
}

impl Event {
    /// [`sentence`] of this one, `None` where it was no attempt.
    pub fn sentence(&self, exercise: &Exercise, language: Language) -> Option<String> {
        let channel = self.feedback.and_then(|feedback| exercise.channel(feedback.channel)).unwrap_or("");
        sentence(self.remark, self.reason.filter(|_| self.is_attempt), channel, language)
    }
}
