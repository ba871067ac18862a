//! Sessions: who trained what, when and how well.
//!
//! What comes in: outputs of the pipeline, live or from the replay of a recording, and who trains. What goes out: repetitions with
//! the course of their joints ([`Follower`]), an embedded database of people, plans, sessions, sets and repetitions ([`Store`]),
//! reports ([`report`]) and files for other programs ([`export`]). What it never does: own a thread or a clock, count a repetition
//! itself, or keep more of a person than a name or a number.
//!
//! ```text
//! Output -> Follower -> Repetition -> Store -> Session -> report (HTML), export (JSON, CSV, FHIR)
//! ```
//! A replay says the same outputs as the live stage did, and so the follower finds the same repetitions in it, number by number:
//! every figure of a report can be counted again ([`Session::differences`]).
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

pub mod export;
mod follower;
mod lesson;
mod number;
mod plan;
mod repetition;
pub mod report;
mod session;
mod store;
mod summary;
#[cfg(test)]
mod testing;

pub use follower::Follower;
pub use lesson::{LessonJoint, TaughtLesson};
pub use plan::{Plan, PlanStep};
pub use repetition::{JointCourse, POINTS, Repetition, Score};
pub use session::{EndedBy, Session, SessionSummary, TrainingSet};
pub use store::{Erasure, Forgotten, NewSession, Person, SessionId, Store, StoreError, file_in};
pub use summary::{ExerciseSummary, JointSummary};
