//! A session as the store gives it.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::lesson::TaughtLesson;
use crate::repetition::Repetition;

/// Number of a session.
pub type SessionId = i64;

/// A session in one line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct SessionSummary {
    /// Its number.
    pub session: SessionId,
    /// Who trained.
    pub person: String,
    /// The plan that was followed; absent: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plan: Option<String>,
    /// When it began, RFC 3339 in UTC.
    pub begun: String,
    /// How long it took, s; absent while it goes on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub duration_s: Option<f64>,
    /// How it ended; absent while it goes on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ended_by: Option<EndedBy>,
    /// Sets begun.
    pub sets: u32,
    /// Repetitions counted.
    pub counted: u32,
    /// Repetitions that were seen and not counted.
    pub rejected: u32,
    /// Mean score of those counted, points; absent where none has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub score: Option<f64>,
    /// The recording of it, if one was kept.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recording: Option<String>,
}

/// How a session ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EndedBy {
    /// It was asked to.
    Request,
    /// Its plan was complete.
    Plan,
    /// The daemon ended.
    Daemon,
    /// The daemon broke off: the end is that of the last repetition.
    Interruption,
    /// It was counted from a recording.
    Recording,
}

impl EndedBy {
    /// As messages and the store spell it.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Request => "request",
            Self::Plan => "plan",
            Self::Daemon => "daemon",
            Self::Interruption => "interruption",
            Self::Recording => "recording",
        }
    }
}

/// All that is known of a session.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Session {
    /// In one line.
    #[serde(flatten)]
    pub summary: SessionSummary,
    /// Name of the stage.
    pub stage: String,
    /// The subject of the exercises.
    pub subject: String,
    /// UTC of the stage's epoch, ns since 1970.
    pub epoch_utc_ns: i64,
    /// When it began, s since the stage's epoch.
    pub t_begin_s: f64,
    /// Its sets in order.
    pub training: Vec<TrainingSet>,
}

/// A set of a session.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrainingSet {
    /// Its number among all sets of the session, from 1.
    pub set: u32,
    /// What it was compared with.
    #[serde(serialize_with = "crate::lesson::shared")]
    pub lesson: Arc<TaughtLesson>,
    /// Repetitions that were planned; absent: without end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub planned: Option<u32>,
    /// The count that a therapist gave in place of the one that follows from the repetitions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub corrected: Option<u32>,
    /// Its repetitions in order of time, those that were not counted among them.
    pub repetitions: Vec<Repetition>,
}

impl TrainingSet {
    /// Repetitions counted.
    pub fn counted(&self) -> impl Iterator<Item = &Repetition> {
        self.repetitions.iter().filter(|repetition| repetition.is_counted())
    }
}

impl Session {
    /// All its repetitions in order of time.
    pub fn repetitions(&self) -> impl Iterator<Item = &Repetition> {
        self.training.iter().flat_map(|set| &set.repetitions)
    }

    /// Its end; infinite of one that goes on.
    pub(crate) fn t_end_s(&self) -> f64 {
        self.summary.duration_s.map_or(f64::INFINITY, |duration_s| self.t_begin_s + duration_s)
    }

    /// In what it differs from what was counted again in its recording, a sentence each; empty where every number is the same.
    /// `counted` are all repetitions of the recording; those of another subject or time are left aside, and so is what began before
    /// the recording did, at `begun_s`.
    pub fn differences(&self, counted: &[Repetition], begun_s: f64) -> Vec<String> {
        let t_end_s = self.t_end_s();
        let is_of_it = |repetition: &&Repetition| {
            repetition.subject == self.subject
                && repetition.t_decided_s > self.t_begin_s
                && repetition.t_decided_s <= t_end_s
        };
        let is_in_recording = |repetition: &&Repetition| repetition.t_start_s >= begun_s;
        let mut own: Vec<&Repetition> = self.repetitions().filter(is_in_recording).collect();
        let mut again: Vec<&Repetition> = counted.iter().filter(is_of_it).filter(is_in_recording).collect();
        let order = |a: &&Repetition, b: &&Repetition| a.t_decided_s.total_cmp(&b.t_decided_s);
        own.sort_by(order);
        again.sort_by(order);
        let place = |repetition: &Repetition| {
            format!("{} at {:.3} s", repetition.lesson.exercise, repetition.t_start_s)
        };
        let mut differences = Vec::new();
        for kept in &own {
            match again.iter().position(|other| is_the_same(kept, other)) {
                Some(found) if again[found].measures_as(kept) => _ = again.remove(found),
                Some(found) => {
                    again.remove(found);
                    differences.push(format!("{}: kept with other figures than counted again", place(kept)));
                }
                None => differences.push(format!("{}: kept, but not counted again", place(kept))),
            }
        }
        differences
            .extend(again.iter().map(|other| format!("{}: counted again, but not kept", place(other))));
        differences
    }
}

fn is_the_same(left: &Repetition, right: &Repetition) -> bool {
    left.lesson.exercise == right.lesson.exercise
        && (left.t_start_s, left.t_decided_s) == (right.t_start_s, right.t_decided_s)
}
