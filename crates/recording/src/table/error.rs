//! What can be wrong with a table.

use std::io;

use crate::ReadError;

/// Why a table cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// The system said no.
    #[error("cannot {tried} {file}: {source}")]
    Io {
        /// `read` or `write`.
        tried: &'static str,
        /// The file.
        file: String,
        /// What the system said.
        source: io::Error,
    },
    /// A line does not hold what it should.
    #[error("{file}, line {line}: expected {expected}, found {found}")]
    Line {
        /// The file.
        file: String,
        /// From 1, comments and empty lines counted.
        line: u64,
        /// What should be there.
        expected: String,
        /// What is there.
        found: String,
    },
    /// A cell does not hold what it should.
    #[error("{file}, line {line}, column {column}: expected {expected}, found {found}")]
    Cell {
        /// The file.
        file: String,
        /// From 1, comments and empty lines counted.
        line: u64,
        /// The column's name.
        column: String,
        /// What should be there.
        expected: String,
        /// What is there.
        found: String,
    },
    /// A recording in a table's place cannot be read.
    #[error("{file}: {source}")]
    Recording {
        /// The file.
        file: String,
        /// Why.
        source: ReadError,
    },
    /// Labels beside a sequence cannot be its labels, or a sequence has none.
    #[error("{file}: {what}")]
    Labels {
        /// The file.
        file: String,
        /// Why.
        what: String,
    },
}
