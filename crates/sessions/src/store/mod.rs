//! The database: one SQLite file, `sessions.db` in the data folder.
//!
//! What comes in: people, plans, sessions, repetitions. What goes out: the same. What it never does: lose what it has taken (each
//! call is a transaction that is on the disk when it returns), or leave bytes of a person who is to be forgotten.
//!
//! ```
//! use posed_sessions::{EndedBy, NewSession, Store};
//!
//! let mut store = Store::in_memory()?;
//! let session = store.begin(&NewSession { person: "P-17", ..NewSession::default() })?;
//! store.end(session, 600.0, EndedBy::Request)?;
//! assert_eq!(store.sessions(Some("P-17"), 10)?.len(), 1);
//! assert_eq!(store.forget("P-17")?.sessions, 1);
//! # Ok::<(), posed_sessions::StoreError>(())
//! ```

mod courses;
mod people;
mod plans;
mod reading;
#[cfg(test)]
mod tests;
mod writing;

use std::path::{Path, PathBuf};
use std::time::Duration;

#[cfg(feature = "testing")]
use rusqlite::Transaction;
use rusqlite::{Connection, TransactionBehavior};

use crate::plan::{NAME, PlanError, is_name};
use crate::session::SessionId;

pub use self::writing::NewSession;

/// Version of the tables.
const VERSION: i64 = 1;
/// How long another program may hold the database.
const PATIENCE: Duration = Duration::from_secs(2);

/// The database.
#[derive(Debug)]
pub struct Store {
    connection: Connection,
}

/// Why the database does not serve.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// It cannot be read or written.
    #[error("the database of sessions: {0}")]
    Database(#[from] rusqlite::Error),
    /// Another version of this program wrote it.
    #[error("the database of sessions has version {0}; this program reads version {VERSION}")]
    Version(i64),
    /// There is no such session.
    #[error("there is no session {0}")]
    NoSession(SessionId),
    /// The session has no such set.
    #[error("session {0} has no set {1}")]
    NoSet(SessionId, u32),
    /// There is nobody of that name.
    #[error("there is nobody called {0:?}")]
    NoPerson(String),
    /// There is no plan of that name.
    #[error("there is no plan called {0:?}")]
    NoPlan(String),
    /// The name of a person does not serve.
    #[error("person: give {NAME}")]
    Name,
    /// A plan does not serve.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// What was kept is not what this program writes.
    #[error("the database of sessions is damaged: {0}")]
    Damaged(String),
}

impl StoreError {
    /// Whether the same may go well later: the disk is full or away, or another program has the database.
    pub fn may_pass(&self) -> bool {
        use rusqlite::ErrorCode::{CannotOpen, DatabaseBusy, DatabaseLocked, DiskFull, SystemIoFailure};
        let code = match self {
            Self::Database(error) => error.sqlite_error_code(),
            _ => None,
        };
        matches!(code, Some(DiskFull | DatabaseBusy | DatabaseLocked | SystemIoFailure | CannotOpen))
    }
}

/// The database of a data folder.
pub fn file_in(data: &Path) -> PathBuf {
    data.join("sessions.db")
}

impl Store {
    /// Opens the database, which is made where it is absent.
    ///
    /// # Errors
    /// It cannot be opened, or another version wrote it.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        Self::new(Connection::open(path)?)
    }

    /// One that ends with the program.
    ///
    /// # Errors
    /// There is no memory for it.
    pub fn in_memory() -> Result<Self, StoreError> {
        Self::new(Connection::open_in_memory()?)
    }

    /// How long it waits for another program that has the database: 2 s where nobody says otherwise.
    ///
    /// # Errors
    /// The database does not serve.
    #[cfg(feature = "testing")]
    pub fn set_patience(&self, patience: Duration) -> Result<(), StoreError> {
        Ok(self.connection.busy_timeout(patience)?)
    }

    /// Keeps everybody else from writing until what it returns is dropped.
    ///
    /// # Errors
    /// Somebody else writes.
    #[cfg(feature = "testing")]
    pub fn hold(&self) -> Result<impl Drop + '_, StoreError> {
        Ok(Transaction::new_unchecked(&self.connection, TransactionBehavior::Immediate)?)
    }

    fn new(mut connection: Connection) -> Result<Self, StoreError> {
        connection.busy_timeout(PATIENCE)?;
        connection.execute_batch(
            "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON; PRAGMA secure_delete = ON;",
        )?;
        let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
        match transaction.query_row("PRAGMA user_version", [], |row| row.get(0))? {
            VERSION => {}
            0 => {
                transaction.execute_batch(include_str!("../schema.sql"))?;
                transaction.pragma_update(None, "user_version", VERSION)?;
            }
            version => return Err(StoreError::Version(version)),
        }
        transaction.commit()?;
        let store = Self { connection };
        // What somebody else's reading has kept in the journal goes with it, if nobody reads now.
        store.erase()?;
        Ok(store)
    }
}

/// Whether somebody can be called so.
fn check_person(name: &str) -> Result<(), StoreError> {
    if is_name(name) { Ok(()) } else { Err(StoreError::Name) }
}
