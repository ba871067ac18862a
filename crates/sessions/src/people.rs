//! People: a name or a number each.

use serde::{Deserialize, Serialize};

/// Somebody who trains.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
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
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Forgotten {
    /// Sessions with all that was in them.
    pub sessions: u32,
    /// The recordings that these sessions name; whoever has the files removes them.
    pub recordings: Vec<String>,
    /// Whether the bytes are gone too.
    pub erasure: Erasure,
}

/// Whether the bytes of somebody who was forgotten are gone from the disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Erasure {
    /// They are overwritten.
    Done,
    /// Nobody finds them in the database, but another program reads it and keeps its
    /// journal: they go when the database is opened next after that has ended.
    Pending,
}
