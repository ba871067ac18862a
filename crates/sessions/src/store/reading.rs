//! Sessions as they are read.

use std::collections::BTreeMap;
use std::sync::Arc;

use rusqlite::{OptionalExtension, Row, params};
use serde::de::{DeserializeOwned, IntoDeserializer};

use super::courses::{course, degrees};
use super::{Store, StoreError, people};
use crate::lesson::{LessonJoint, TaughtLesson};
use crate::repetition::{JointCourse, Repetition, Score};
use crate::session::{Session, SessionId, SessionSummary, TrainingSet};

/// What a summary is made of.
const SUMMARY: &str =
    "SELECT session.id, person.name, plan, epoch_utc_ns, t_begin_s, session.t_end_s, ended_by, recording,
    count(DISTINCT training_set.id), count(repetition.number), count(reason), avg(score_total), stage, subject
    FROM session JOIN person ON person.id = session.person
    LEFT JOIN training_set ON training_set.session = session.id
    LEFT JOIN repetition ON repetition.training_set = training_set.id";

impl Store {
    /// Sessions, the newest first, at most so many; of one person only where one is given.
    ///
    /// # Errors
    /// There is no such person, or the database cannot be read.
    pub fn sessions(&self, person: Option<&str>, at_most: u32) -> Result<Vec<SessionSummary>, StoreError> {
        person.map(|name| people::id_of(&self.connection, name)).transpose()?;
        let sql = format!(
            "{SUMMARY} WHERE ?1 IS NULL OR person.name = ?1 GROUP BY session.id
             ORDER BY epoch_utc_ns + CAST(t_begin_s * 1e9 AS INTEGER) DESC, session.id DESC LIMIT ?2"
        );
        let mut statement = self.connection.prepare_cached(&sql)?;
        let sessions = statement.query_map(params![person, at_most], summary)?;
        Ok(sessions.collect::<Result<_, _>>()?)
    }

    /// One session with all its sets.
    ///
    /// # Errors
    /// There is no such session, or the database cannot be read.
    pub fn session(&self, session: SessionId) -> Result<Session, StoreError> {
        let sql = format!("{SUMMARY} WHERE session.id = ?1 GROUP BY session.id");
        let mut statement = self.connection.prepare_cached(&sql)?;
        let read = |row: &Row<'_>| Ok((summary(row)?, row.get(12)?, row.get(13)?, row.get(3)?, row.get(4)?));
        let (summary, stage, subject, epoch_utc_ns, t_begin_s): (_, _, String, _, _) =
            statement.query_row([session], read).optional()?.ok_or(StoreError::NoSession(session))?;
        let training = self.sets(session, &subject)?;
        Ok(Session { summary, stage, subject, epoch_utc_ns, t_begin_s, training })
    }

    /// The sessions of a person with all their sets, the oldest first.
    ///
    /// # Errors
    /// There is no such person, or the database cannot be read.
    pub fn course(&self, person: &str) -> Result<Vec<Session>, StoreError> {
        let sessions = self.sessions(Some(person), u32::MAX)?;
        sessions.iter().rev().map(|summary| self.session(summary.session)).collect()
    }

    fn sets(&self, session: SessionId, subject: &str) -> Result<Vec<TrainingSet>, StoreError> {
        let mut statement = self.connection.prepare_cached(
            "SELECT id, number, lesson, planned,
             (SELECT corrected FROM correction WHERE training_set = training_set.id ORDER BY id DESC LIMIT 1)
             FROM training_set WHERE session = ?1 ORDER BY number",
        )?;
        let mut rows = statement.query([session])?;
        let (mut sets, mut lessons) = (Vec::new(), BTreeMap::new());
        while let Some(row) = rows.next()? {
            let (id, lesson): (i64, i64) = (row.get(0)?, row.get(2)?);
            let lesson = match lessons.get(&lesson) {
                Some(known) => Arc::clone(known),
                None => {
                    let read = Arc::new(self.lesson(lesson)?);
                    lessons.insert(lesson, Arc::clone(&read));
                    read
                }
            };
            let planned = row.get(3)?;
            let repetitions = self.repetitions(id, subject, &lesson, planned)?;
            sets.push(TrainingSet { set: row.get(1)?, lesson, planned, corrected: row.get(4)?, repetitions });
        }
        Ok(sets)
    }

    fn lesson(&self, lesson: i64) -> Result<TaughtLesson, StoreError> {
        let sql = "SELECT exercise, revision, duration_s, joints FROM lesson WHERE id = ?1";
        let mut statement = self.connection.prepare_cached(sql)?;
        let (exercise, revision, duration_s, joints): (_, _, _, String) =
            statement.query_row([lesson], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?)))?;
        let joints: Vec<LessonJoint> =
            serde_json::from_str(&joints).map_err(|error| StoreError::Damaged(error.to_string()))?;
        Ok(TaughtLesson { exercise, revision, duration_s, joints })
    }

    fn repetitions(
        &self,
        set: i64,
        subject: &str,
        lesson: &Arc<TaughtLesson>,
        planned: Option<u32>,
    ) -> Result<Vec<Repetition>, StoreError> {
        let mut joints = self.joints(set, lesson)?;
        let mut statement = self.connection.prepare_cached(
            "SELECT position, number, t_start_s, t_end_s, t_decided_s, reason, score_total, score_amplitude, score_tempo,
             score_smoothness, score_symmetry, sentence, sentence_de FROM repetition WHERE training_set = ?1 ORDER BY position",
        )?;
        let mut rows = statement.query([set])?;
        let mut repetitions = Vec::new();
        while let Some(row) = rows.next()? {
            let (position, reason): (i64, Option<String>) = (row.get(0)?, row.get(5)?);
            repetitions.push(Repetition {
                subject: subject.to_owned(),
                lesson: Arc::clone(lesson),
                begins_set: position == 0,
                planned,
                number: row.get(1)?,
                t_start_s: row.get(2)?,
                t_end_s: row.get(3)?,
                t_decided_s: row.get(4)?,
                reason: reason.map(|word| named(&word)).transpose()?,
                score: score(row)?,
                sentence: row.get(11)?,
                sentence_de: row.get(12)?,
                joints: joints.remove(&position).unwrap_or_default(),
            });
        }
        Ok(repetitions)
    }

    /// Courses of a set by the position of the repetition.
    fn joints(&self, set: i64, lesson: &TaughtLesson) -> Result<BTreeMap<i64, Vec<JointCourse>>, StoreError> {
        let sql = "SELECT repetition, joint, least, greatest, course FROM joint WHERE training_set = ?1 ORDER BY 1, 2";
        let mut statement = self.connection.prepare_cached(sql)?;
        let mut rows = statement.query([set])?;
        let mut joints = BTreeMap::<i64, Vec<JointCourse>>::new();
        while let Some(row) = rows.next()? {
            let joint: u32 = row.get(1)?;
            let name = lesson.joints.get(joint as usize).map(|joint| joint.name.clone());
            let name = name.ok_or_else(|| StoreError::Damaged(format!("a lesson has no joint {joint}")))?;
            let bytes: Vec<u8> = row.get(4)?;
            joints.entry(row.get(0)?).or_default().push(JointCourse {
                joint,
                name,
                least_deg: degrees(row.get(2)?),
                greatest_deg: degrees(row.get(3)?),
                course_deg: course(&bytes)?,
            });
        }
        Ok(joints)
    }
}

fn summary(row: &Row<'_>) -> rusqlite::Result<SessionSummary> {
    let (epoch_utc_ns, t_begin_s, t_end_s): (i64, f64, Option<f64>) = (row.get(3)?, row.get(4)?, row.get(5)?);
    let ended_by: Option<String> = row.get(6)?;
    let score: Option<f64> = row.get(11)?;
    Ok(SessionSummary {
        session: row.get(0)?,
        person: row.get(1)?,
        plan: row.get(2)?,
        begun: rfc3339(epoch_utc_ns.saturating_add((t_begin_s * 1e9) as i64)),
        duration_s: t_end_s.map(|t_end_s| crate::number::time_s(t_end_s - t_begin_s)),
        ended_by: ended_by.and_then(|word| named(&word).ok()),
        recording: row.get(7)?,
        sets: row.get(8)?,
        counted: row.get(9)?,
        rejected: row.get(10)?,
        score: score.map(crate::number::points),
    })
}

fn score(row: &Row<'_>) -> rusqlite::Result<Option<Score>> {
    let Some(total) = row.get(6)? else { return Ok(None) };
    let (amplitude, tempo, smoothness, symmetry) = (row.get(7)?, row.get(8)?, row.get(9)?, row.get(10)?);
    Ok(Some(Score { total, amplitude, tempo, smoothness, symmetry }))
}

/// What messages spell so.
fn named<T: DeserializeOwned>(word: &str) -> Result<T, StoreError> {
    T::deserialize(word.into_deserializer())
        .map_err(|error: serde::de::value::Error| StoreError::Damaged(error.to_string()))
}

/// A time in UTC, to the second.
pub(super) fn rfc3339(utc_ns: i64) -> String {
    let second = jiff::Timestamp::from_second(utc_ns.div_euclid(1_000_000_000)).unwrap_or_default();
    second.to_string()
}
