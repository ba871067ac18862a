//! People: a name or a number each, and no trace of those who are to be forgotten.

use rusqlite::{OptionalExtension, Transaction, params};
use serde::Serialize;

use super::{Store, StoreError, named};

/// Somebody who trains.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, schemars::JsonSchema)]
pub struct Person {
    /// A name or a number.
    pub name: String,
    /// Sessions so far.
    pub sessions: u32,
    /// When the newest began, RFC 3339 in UTC; absent: none yet.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub last: Option<String>,
}

/// What went with a person.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, schemars::JsonSchema)]
pub struct Forgotten {
    /// Sessions with all that was in them.
    pub sessions: u32,
    /// The recordings that these sessions name; whoever has the files removes them.
    pub recordings: Vec<String>,
    /// Whether the bytes are gone too.
    pub erasure: Erasure,
}

/// Whether the bytes of somebody who was forgotten are gone from the disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Erasure {
    /// They are overwritten.
    Done,
    /// Nobody finds them in the database, but another program reads it and keeps its
    /// journal: they go when the database is opened next after that has ended.
    Pending,
}

impl Store {
    /// Takes somebody in; does nothing where the name is known.
    ///
    /// # Errors
    /// The name does not serve, or the database does not.
    pub fn add_person(&mut self, name: &str) -> Result<(), StoreError> {
        named("person", name)?;
        self.connection.execute("INSERT OR IGNORE INTO person (name) VALUES (?1)", [name])?;
        Ok(())
    }

    /// Everybody, by name.
    ///
    /// # Errors
    /// The database cannot be read.
    pub fn people(&self) -> Result<Vec<Person>, StoreError> {
        let mut statement = self.connection.prepare_cached(
            "SELECT name, count(session.id), max(epoch_utc_ns + CAST(t_begin_s * 1e9 AS INTEGER))
             FROM person LEFT JOIN session ON session.person = person.id GROUP BY person.id ORDER BY name",
        )?;
        let people = statement.query_map([], |row| {
            let last: Option<i64> = row.get(2)?;
            Ok(Person { name: row.get(0)?, sessions: row.get(1)?, last: last.map(super::reading::rfc3339) })
        })?;
        Ok(people.collect::<Result<_, _>>()?)
    }

    /// Removes somebody with every session, set, repetition and correction, and the lessons that nobody else was compared with. The
    /// bytes are overwritten, also those in the journal.
    ///
    /// # Errors
    /// There is no such person, or the database does not serve: then nothing is removed.
    pub fn forget(&mut self, name: &str) -> Result<Forgotten, StoreError> {
        let transaction = self.connection.transaction()?;
        let person = id_of(&transaction, name)?.ok_or_else(|| StoreError::NoPerson(name.to_owned()))?;
        let recordings = {
            let mut statement = transaction.prepare(
                "SELECT DISTINCT recording FROM session WHERE person = ?1 AND recording IS NOT NULL ORDER BY 1",
            )?;
            let recordings = statement.query_map([person], |row| row.get(0))?;
            recordings.collect::<Result<Vec<String>, _>>()?
        };
        let count = "SELECT count(*) FROM session WHERE person = ?1";
        let sessions = transaction.query_row(count, [person], |row| row.get(0))?;
        transaction.execute("DELETE FROM person WHERE id = ?1", params![person])?;
        transaction.execute("DELETE FROM lesson WHERE id NOT IN (SELECT lesson FROM training_set)", [])?;
        transaction.commit()?;
        Ok(Forgotten { sessions, recordings, erasure: self.erase()? })
    }

    /// Brings what is in the journal into the database and empties it: overwritten bytes are in neither then.
    pub(super) fn erase(&self) -> Result<Erasure, StoreError> {
        let busy: i64 = self.connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |row| row.get(0))?;
        Ok(if busy == 0 { Erasure::Done } else { Erasure::Pending })
    }
}

/// Number of a person.
pub(super) fn id_of(transaction: &Transaction<'_>, name: &str) -> Result<Option<i64>, StoreError> {
    let person = "SELECT id FROM person WHERE name = ?1";
    Ok(transaction.query_row(person, [name], |row| row.get(0)).optional()?)
}
