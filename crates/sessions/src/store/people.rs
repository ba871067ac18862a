//! People: a name or a number each, and no trace of those who are to be forgotten.

use rusqlite::{Connection, OptionalExtension, params};

use super::{Store, StoreError, check_person};
use crate::people::{Erasure, Forgotten, Person};

impl Store {
    /// Takes somebody in; does nothing where the name is known.
    ///
    /// # Errors
    /// The name does not serve, or the database does not.
    pub fn add_person(&mut self, name: &str) -> Result<(), StoreError> {
        check_person(name)?;
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
        let person = id_of(&transaction, name)?;
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
///
/// # Errors
/// There is no such person, or the database cannot be read.
pub(super) fn id_of(connection: &Connection, name: &str) -> Result<i64, StoreError> {
    let person = "SELECT id FROM person WHERE name = ?1";
    let id = connection.query_row(person, [name], |row| row.get(0)).optional()?;
    id.ok_or_else(|| StoreError::NoPerson(name.to_owned()))
}
