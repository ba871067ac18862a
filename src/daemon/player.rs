//! Plays a recording to the server's clients: the same log through the same pipeline, at a chosen speed.
//!
//! In: a recording, and what clients ask of it. Out: messages through the [`Hub`], and a status that says where it is. The
//! thread stands in the place of the fusion thread, so a client cannot tell the two apart but by `status.replay`.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use posed_drivers::Timestamp;

use super::calls;
use super::clock::StageClock;
use super::health::Health;
use super::server::{Hub, PendingCall};
use crate::input::Entry;
use crate::pipeline::Pipeline;
use crate::protocol::{Call, ReplayStatus};
use crate::recording::{Header, Info, Item, ReadError, Reader, machine};
use crate::stage::Stage;

/// Distance of two `status` messages, and the longest time without looking at the clients.
const STATUS_INTERVAL: Duration = Duration::from_secs(1);
/// Entries between two looks at the clients while seeking.
const SEEK_BATCH: usize = 4096;

/// What the player is told.
pub(super) enum Command {
    /// A client's call.
    Call(PendingCall),
    /// Ends the thread.
    Shutdown,
}

/// The thread's state.
pub(super) struct Player {
    clock: StageClock,
    commands: Receiver<Command>,
    hub: Hub,
    folder: PathBuf,
    stage: Stage,
    health: Health,
    playing: Playing,
}

/// An open recording.
struct Playing {
    path: PathBuf,
    reader: Reader<std::io::BufReader<std::fs::File>>,
    pipeline: Pipeline,
    begun: Timestamp,
    end: Timestamp,
    /// The next entry, read and not yet played.
    next: Option<Entry>,
    /// Where the recording stands.
    at: Timestamp,
    /// Multiple of real time; 0 is a pause, infinity as fast as it goes.
    speed: f64,
    /// Host time and stream time at which `speed` was set.
    since: (Timestamp, Timestamp),
    ended: Option<String>,
}
