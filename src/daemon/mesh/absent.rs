//! What stands in the place of zenoh in a program without it: nothing that could ever be made.

use std::path::PathBuf;

use super::super::clock::StageClock;
use super::super::fusion::FusionInbox;
use super::super::server::hub::Item;
use crate::input::Entry;
use crate::protocol::{Names, Problem, Stamp};
use crate::stage::{Stage, Zenoh};

/// See `feed.rs`.
#[derive(Clone, Debug)]
pub(in crate::daemon) enum Feed {}

impl Feed {
    pub(in crate::daemon) fn publish(&self, _: &Item, _: &Stamp, _: &Names) {
        match *self {}
    }

    pub(in crate::daemon) fn problem(&self) -> Option<Problem> {
        match *self {}
    }
}

/// See `log.rs`.
#[derive(Clone, Debug)]
pub(in crate::daemon) enum Log {}

impl Log {
    pub(in crate::daemon) fn entry(&self, _: &Entry) {
        match *self {}
    }

    pub(in crate::daemon) fn next(&self) -> u64 {
        match *self {}
    }
}

/// See `wire.rs`.
#[derive(Debug)]
#[expect(dead_code, reason = "nobody reads what is never made")]
pub struct Begin {
    pub(in crate::daemon) next: u64,
    pub(in crate::daemon) header: crate::recording::Header,
}

/// See `stage.rs`.
#[derive(Debug)]
pub(in crate::daemon) enum Mesh {}

impl Mesh {
    /// The sentence that says that there is no zenoh.
    pub(in crate::daemon) fn start(
        _: &Stage,
        _: &Zenoh,
        _: StageClock,
        _: FusionInbox,
        _: PathBuf,
    ) -> Result<Self, String> {
        Err(super::ABSENT.to_owned())
    }

    pub(in crate::daemon) fn feed(&self) -> Feed {
        match *self {}
    }

    pub(in crate::daemon) fn log(&self) -> Log {
        match *self {}
    }
}
