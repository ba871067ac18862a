//! Sessions as they are trained: begun, filled, ended, corrected.

use rusqlite::{OptionalExtension, Transaction, params};

use super::courses::{bytes, hundredths};
use super::{Store, StoreError, check_person, people};
use crate::lesson::TaughtLesson;
use crate::repetition::Repetition;
use crate::session::{EndedBy, SessionId};

/// What a session begins with.
#[derive(Clone, Copy, Debug, Default)]
pub struct NewSession<'a> {
    /// Who trains; taken in where the name is new.
    pub person: &'a str,
    /// The plan that is followed.
    pub plan: Option<&'a str>,
    /// Name of the stage.
    pub stage: &'a str,
    /// The subject of the exercises.
    pub subject: &'a str,
    /// UTC of the stage's epoch, ns since 1970.
    pub epoch_utc_ns: i64,
    /// When it begins, s since that epoch.
    pub t_begin_s: f64,
    /// File name of its recording.
    pub recording: Option<&'a str>,
}

impl Store {
    /// Begins a session.
    ///
    /// # Errors
    /// The name of the person does not serve, or the database does not.
    pub fn begin(&mut self, new: &NewSession<'_>) -> Result<SessionId, StoreError> {
        check_person(new.person)?;
        let transaction = self.connection.transaction()?;
        transaction.execute("INSERT OR IGNORE INTO person (name) VALUES (?1)", [new.person])?;
        let person = people::id_of(&transaction, new.person)?;
        transaction.execute(
            "INSERT INTO session (person, plan, stage, subject, epoch_utc_ns, t_begin_s, recording)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
            params![person, new.plan, new.stage, new.subject, new.epoch_utc_ns, new.t_begin_s, new.recording],
        )?;
        let session = transaction.last_insert_rowid();
        transaction.commit()?;
        Ok(session)
    }

    /// Adds a repetition to a session, in the set that it belongs to.
    ///
    /// # Errors
    /// There is no such session, or the database does not serve: then nothing was added.
    pub fn add(&mut self, session: SessionId, repetition: &Repetition) -> Result<(), StoreError> {
        let transaction = self.connection.transaction()?;
        exists(&transaction, session)?;
        let lesson = lesson_id(&transaction, &repetition.lesson)?;
        let newest =
            "SELECT id FROM training_set WHERE session = ?1 AND lesson = ?2 ORDER BY number DESC LIMIT 1";
        let newest = transaction.query_row(newest, [session, lesson], |row| row.get(0)).optional()?;
        let set: i64 = match newest.filter(|_| !repetition.begins_set) {
            Some(set) => set,
            None => {
                transaction.execute(
                    "INSERT INTO training_set (session, number, lesson, planned)
                     SELECT ?1, 1 + count(*), ?2, ?3 FROM training_set WHERE session = ?1",
                    params![session, lesson, repetition.planned],
                )?;
                transaction.last_insert_rowid()
            }
        };
        let position: i64 = transaction.query_row(
            "SELECT count(*) FROM repetition WHERE training_set = ?1",
            [set],
            |row| row.get(0),
        )?;
        let score = repetition.score;
        transaction.prepare_cached("INSERT INTO repetition VALUES (?,?,?,?,?,?,?,?,?,?,?,?,?,?)")?.execute(
            params![
                set,
                position,
                repetition.number,
                repetition.t_start_s,
                repetition.t_end_s,
                repetition.t_decided_s,
                repetition.reason.map(|reason| reason.as_str()),
                score.map(|score| score.total),
                score.map(|score| score.amplitude),
                score.map(|score| score.tempo),
                score.map(|score| score.smoothness),
                score.and_then(|score| score.symmetry),
                repetition.sentence,
                repetition.sentence_de,
            ],
        )?;
        let mut insert = transaction.prepare_cached("INSERT INTO joint VALUES (?,?,?,?,?,?)")?;
        for joint in &repetition.joints {
            let (least, greatest) = (hundredths(joint.least_deg), hundredths(joint.greatest_deg));
            insert.execute(params![set, position, joint.joint, least, greatest, bytes(&joint.course_deg)])?;
        }
        drop(insert);
        Ok(transaction.commit()?)
    }

    /// Ends a session; one that has ended already stays as it is.
    ///
    /// # Errors
    /// There is no such session, or the database does not serve.
    pub fn end(&mut self, session: SessionId, t_end_s: f64, ended_by: EndedBy) -> Result<(), StoreError> {
        let transaction = self.connection.transaction()?;
        exists(&transaction, session)?;
        transaction.execute(
            "UPDATE session SET t_end_s = ?2, ended_by = ?3 WHERE id = ?1 AND ended_by IS NULL",
            params![session, t_end_s, ended_by.as_str()],
        )?;
        Ok(transaction.commit()?)
    }

    /// Notes the recording of a session, in place of one noted before.
    ///
    /// # Errors
    /// There is no such session, or the database does not serve.
    pub fn link_recording(&mut self, session: SessionId, recording: &str) -> Result<(), StoreError> {
        let link = "UPDATE session SET recording = ?2 WHERE id = ?1";
        match self.connection.execute(link, params![session, recording])? {
            0 => Err(StoreError::NoSession(session)),
            _ => Ok(()),
        }
    }

    /// A recording has another name; how many sessions are in it.
    ///
    /// # Errors
    /// The database does not serve.
    pub fn rename_recording(&mut self, from: &str, to: &str) -> Result<usize, StoreError> {
        let rename = "UPDATE session SET recording = ?2 WHERE recording = ?1";
        Ok(self.connection.execute(rename, params![from, to])?)
    }

    /// Ends the sessions of a stage that a daemon has left open when it broke off, with their last repetitions; how many.
    ///
    /// # Errors
    /// The database does not serve.
    pub fn end_interrupted(&mut self, stage: &str) -> Result<usize, StoreError> {
        Ok(self.connection.execute(
            "UPDATE session SET ended_by = ?2, t_end_s = coalesce(
                 (SELECT max(t_decided_s) FROM repetition JOIN training_set ON training_set.id = training_set
                  WHERE training_set.session = session.id), t_begin_s)
             WHERE stage = ?1 AND ended_by IS NULL",
            params![stage, EndedBy::Interruption.as_str()],
        )?)
    }

    /// Keeps a count that somebody has seen with their own eyes as that of a set; the one that follows from the repetitions stays
    /// beside it, and so do corrections of before.
    ///
    /// # Errors
    /// There is no such set, or the database does not serve.
    pub fn correct(
        &mut self,
        session: SessionId,
        set: u32,
        counted: u32,
        utc_ns: i64,
    ) -> Result<(), StoreError> {
        let transaction = self.connection.transaction()?;
        exists(&transaction, session)?;
        let added = transaction.execute(
            "INSERT INTO correction (training_set, counted, corrected, utc_ns)
             SELECT id, (SELECT count(number) FROM repetition WHERE training_set = training_set.id), ?3, ?4
             FROM training_set WHERE session = ?1 AND number = ?2",
            params![session, set, counted, utc_ns],
        )?;
        if added == 0 {
            return Err(StoreError::NoSet(session, set));
        }
        Ok(transaction.commit()?)
    }
}

fn exists(transaction: &Transaction<'_>, session: SessionId) -> Result<(), StoreError> {
    let known =
        transaction.query_row("SELECT 1 FROM session WHERE id = ?1", [session], |_| Ok(())).optional()?;
    known.ok_or(StoreError::NoSession(session))
}

/// Number of a lesson, which is kept where it is new.
fn lesson_id(transaction: &Transaction<'_>, lesson: &TaughtLesson) -> Result<i64, StoreError> {
    let joints =
        serde_json::to_string(&lesson.joints).map_err(|error| StoreError::Damaged(error.to_string()))?;
    let TaughtLesson { exercise, revision, duration_s, .. } = lesson;
    let values = params![exercise, revision, duration_s, joints];
    let mut known = transaction.prepare_cached(
        "SELECT id FROM lesson WHERE exercise = ?1 AND revision = ?2 AND duration_s = ?3 AND joints = ?4",
    )?;
    if let Some(lesson) = known.query_row(values, |row| row.get(0)).optional()? {
        return Ok(lesson);
    }
    transaction.execute(
        "INSERT INTO lesson (exercise, revision, duration_s, joints) VALUES (?1, ?2, ?3, ?4)",
        values,
    )?;
    Ok(transaction.last_insert_rowid())
}
