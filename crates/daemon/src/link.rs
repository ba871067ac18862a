//! Where other machines are connected: what a link takes from a stage, so that the daemon need not know what it is made of.
//!
//! In: a [`Connect`] in the daemon's options, for a stage whose file asks for one. Out: to its [`Feed`] all that is published, to
//! its log every entry. Never: a wait for the link, but at the very end, when it is dropped.

use std::any::Any;
use std::path::PathBuf;

use super::clock::StageClock;
use super::fusion::FusionInbox;
use super::observers::Observer;
use super::server::Item;
use posed_protocol::{Names, Problem, Stamp};
use posed_stage::Stage;

/// What is reported of a stage whose file has this table, in a program that has no link for it.
pub(super) fn absent(table: &str) -> String {
    format!(
        "[{table}]: this posed was built without zenoh; install the packaged one, or build it with `--features zenoh`"
    )
}

/// Begins a link. The error is a sentence for the operator: the stage runs without it too.
pub type Connect = fn(Context<'_>) -> Result<Link, Box<dyn std::error::Error + Send + Sync>>;

/// What a link is begun with.
#[derive(Debug)]
pub struct Context<'a> {
    /// The stage.
    pub stage: &'a Stage,
    /// The stage's clock.
    pub clock: StageClock,
    /// The queue into the fusion thread, which answers how the pipeline stands (`FusionInbox::begin`).
    pub inbox: FusionInbox,
    /// The folder that recordings are in.
    pub recordings: PathBuf,
}

/// A link at work: the ends that the daemon keeps.
pub struct Link {
    /// Takes what is published.
    pub feed: Box<dyn Feed>,
    /// Takes the input log, on the fusion thread: every entry, in order; absent where it only publishes.
    pub log: Option<Box<dyn Observer + Send>>,
    /// Dropped when the stage has ended, where it may block.
    pub session: Box<dyn Any + Send>,
}

/// Takes what is published, on the server's task: it must not wait.
pub trait Feed: Send {
    /// Takes an item with the stamp that clients of this stage get; `names` are those of the stage's sensors.
    fn publish(&self, item: &Item, stamp: &Stamp, names: &Names);

    /// What is wrong with the link now, for the status; `None`: nothing.
    fn problem(&self) -> Option<Problem>;
}
