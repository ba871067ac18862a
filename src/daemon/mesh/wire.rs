//! What stage and hub say to each other, and under which keys. MessagePack; stages and hubs of the same [`VERSION`] understand each other.
//!
//! The public messages of `KEY/topics/*` are those of the websocket, in JSON, and not described here.

use rmp_serde::decode;
use serde::{Deserialize, Serialize};

use crate::daemon::server::hub::Item;
use crate::input::serde_bytes_compat as bytes;
use crate::protocol::{Stamp, Topic};
use crate::recording::Header;

/// Version of everything in this file.
pub(in crate::daemon) const VERSION: u32 = 1;
/// Last part of the key of a stage's liveliness token.
pub(in crate::daemon) const TOKEN: &str = "posed-stage";
/// Last part but one of the token of one run of a stage's daemon.
pub(in crate::daemon) const RUN: &str = "posed-run";

/// The keys of one stage.
#[derive(Clone, Debug)]
pub(in crate::daemon) struct Keys {
    stage: String,
}

impl Keys {
    pub(in crate::daemon) fn new(stage: impl Into<String>) -> Self {
        Self { stage: stage.into() }
    }

    /// The key that a token belongs to.
    pub(in crate::daemon) fn of_token(token: &str) -> Option<Self> {
        Some(Self::new(token.strip_suffix(TOKEN)?.strip_suffix('/')?))
    }

    pub(in crate::daemon) fn stage(&self) -> &str {
        &self.stage
    }

    pub(in crate::daemon) fn token(&self) -> String {
        self.below(TOKEN)
    }

    /// The key and the run that a run's token belongs to.
    pub(in crate::daemon) fn of_run(token: &str) -> Option<(Self, &str)> {
        let (below, run) = token.rsplit_once('/')?;
        Some((Self::new(below.strip_suffix(RUN)?.strip_suffix('/')?), run))
    }

    /// Token of one run of the stage's daemon.
    pub(in crate::daemon) fn run(&self, run: &str) -> String {
        self.below(&format!("{RUN}/{run}"))
    }

    /// Token of a hub that sees more than one run at a time.
    pub(in crate::daemon) fn twin(&self, hub: &str) -> String {
        self.below(&format!("posed-twin/{hub}"))
    }

    /// States, of which the newest counts.
    pub(in crate::daemon) fn states(&self) -> String {
        self.below("feed/states")
    }

    /// Events, none of which may be missed.
    pub(in crate::daemon) fn events(&self) -> String {
        self.below("feed/events")
    }

    pub(in crate::daemon) fn feed(&self) -> String {
        self.below("feed/*")
    }

    /// A topic's public messages.
    pub(in crate::daemon) fn topic(&self, topic: Topic) -> String {
        self.below(&format!("topics/{}", topic.name()))
    }

    pub(in crate::daemon) fn log(&self) -> String {
        self.below("log")
    }

    pub(in crate::daemon) fn status(&self) -> String {
        self.below("status")
    }

    pub(in crate::daemon) fn recordings(&self) -> String {
        self.below("recordings")
    }

    pub(in crate::daemon) fn clock(&self) -> String {
        self.below("clock")
    }

    pub(in crate::daemon) fn ask(&self, what: &str) -> String {
        self.below(&format!("ask/{what}"))
    }

    fn below(&self, what: &str) -> String {
        format!("{}/{what}", self.stage)
    }
}

/// In front of every item of the feed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(in crate::daemon) struct Head {
    /// Which run of the daemon says it: UTC of its epoch, ns.
    pub(in crate::daemon) run: i64,
    /// Newest event as this was published: who has not got that far has missed something.
    pub(in crate::daemon) last_event_id: u64,
    /// When and as which event it was published.
    pub(in crate::daemon) stamp: Stamp,
}

/// An item with its head, as bytes.
pub(in crate::daemon) fn write_fed(head: &Head, item: &Item) -> Option<Vec<u8>> {
    let mut out = Vec::new();
    rmp_serde::encode::write(&mut out, head).ok()?;
    match item {
        // All numbers, many times a second: without the names of their fields.
        Item::Estimate(_) | Item::Body(_) | Item::Truth(_) => {
            rmp_serde::encode::write(&mut out, item).ok()?
        }
        // What has optional fields needs their names.
        Item::Outcome(_) | Item::Status(_) | Item::Jobs(_) | Item::Rewind => {
            rmp_serde::encode::write_named(&mut out, item).ok()?;
        }
    }
    Some(out)
}

/// Reads what [`write_fed`] wrote.
pub(in crate::daemon) fn read_fed(mut payload: &[u8]) -> Result<(Head, Item), decode::Error> {
    let head = rmp_serde::from_read(&mut payload)?;
    Ok((head, rmp_serde::from_read(payload)?))
}

/// Bytes as MessagePack's own.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(in crate::daemon) struct Bytes(#[serde(with = "bytes")] pub(in crate::daemon) Vec<u8>);

/// The answer to `KEY/ask/join?after=N`: what a hub needs beside the feed.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(in crate::daemon) struct Joined {
    pub(in crate::daemon) wire: u32,
    /// Of the software.
    pub(in crate::daemon) version: String,
    /// Which run of the daemon.
    pub(in crate::daemon) run: i64,
    /// The stage file, without what is nobody else's business.
    pub(in crate::daemon) stage_toml: String,
    /// What has been published so far, beside what the stage file tells.
    pub(in crate::daemon) topics: Vec<Topic>,
    pub(in crate::daemon) last_event_id: u64,
    /// Whether all events after N are here; else some are older than what is kept.
    pub(in crate::daemon) complete: bool,
    /// Events after N, and with N = 0 those before that still hold, in their order.
    pub(in crate::daemon) events: Vec<Bytes>,
    /// Newest states that come seldom.
    pub(in crate::daemon) states: Vec<Bytes>,
}

/// The answer to `KEY/clock`, ns of stage time.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(in crate::daemon) struct ClockReading {
    pub(in crate::daemon) run: i64,
    pub(in crate::daemon) t_ns: i64,
}

/// Some entries of the input log, on `KEY/log` and as the answer to `KEY/ask/log?from=N`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(in crate::daemon) struct LogChunk {
    pub(in crate::daemon) run: i64,
    /// Number of the first one; the others follow it.
    pub(in crate::daemon) first: u64,
    pub(in crate::daemon) entries: Vec<Bytes>,
}

/// The answer to `KEY/ask/begin`: the pipeline as it stands before an entry, for fusion on another machine.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Begin {
    /// Number of that entry.
    pub(in crate::daemon) next: u64,
    pub(in crate::daemon) header: Header,
}
