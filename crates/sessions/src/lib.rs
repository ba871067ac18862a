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

mod accuracy;
pub mod export;
mod follower;
mod lesson;
mod number;
mod people;
mod plan;
mod repetition;
pub mod report;
mod session;
#[cfg(feature = "store")]
mod store;
mod summary;
#[cfg(test)]
mod testing;

pub use accuracy::CountAccuracy;
pub use follower::Follower;
pub use lesson::{LessonJoint, TaughtLesson, course_at};
pub use people::{Erasure, Forgotten, Person};
pub use plan::{Plan, PlanError, PlanStep};
pub use repetition::{JointCourse, POINTS, Repetition, Score};
pub use session::{EndedBy, Session, SessionId, SessionSummary, TrainingSet};
#[cfg(feature = "store")]
pub use store::{NewSession, Store, StoreError, file_in};
pub use summary::{ExerciseSummary, JointSummary};
