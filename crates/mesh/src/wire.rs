//! What stage and hub say to each other, and under which keys. MessagePack; stages and hubs of the same [`VERSION`] understand each other.
//!
//! The public messages of `KEY/topics/*` are those of the websocket, in JSON, and not described here.

use rmp_serde::decode;
use serde::{Deserialize, Serialize};

use super::frame::Frame;
use posed_daemon::server::Item;
use posed_geometry::bytes;
use posed_protocol::{Selection, Stamp, Topic, Wish, unpacker};
use posed_recording::Header;

/// Version of everything in this file.
pub(crate) const VERSION: u32 = 2;
/// Last part of the key of a stage's liveliness token.
pub(crate) const TOKEN: &str = "posed-stage";
/// Last part but one of the token of one run of a stage's daemon.
pub(crate) const RUN: &str = "posed-run";
/// What the tokens of wishes are below.
const WISH: &str = "posed-wish";

/// The keys of one stage.
#[derive(Clone, Debug)]
pub(crate) struct Keys {
    stage: String,
}

impl Keys {
    pub(crate) fn new(stage: impl Into<String>) -> Self {
        Self { stage: stage.into() }
    }

    /// The key that a token belongs to.
    pub(crate) fn of_token(token: &str) -> Option<Self> {
        Some(Self::new(token.strip_suffix(TOKEN)?.strip_suffix('/')?))
    }

    pub(crate) fn stage(&self) -> &str {
        &self.stage
    }

    pub(crate) fn token(&self) -> String {
        self.below(TOKEN)
    }

    /// The key and the run that a run's token belongs to.
    pub(crate) fn of_run(token: &str) -> Option<(Self, &str)> {
        let (below, run) = token.rsplit_once('/')?;
        Some((Self::new(below.strip_suffix(RUN)?.strip_suffix('/')?), run))
    }

    /// Token of one run of the stage's daemon.
    pub(crate) fn run(&self, run: &str) -> String {
        self.below(&format!("{RUN}/{run}"))
    }

    /// Token of a hub that sees more than one run at a time.
    pub(crate) fn twin(&self, hub: &str) -> String {
        self.below(&format!("posed-twin/{hub}"))
    }

    /// Token of what a hub wants of the stage's states.
    pub(crate) fn wish(&self, hub: &str, wish: &Wish) -> String {
        self.below(&format!("{WISH}/{hub}/{}", wish.to_json()))
    }

    /// Tokens of all hubs that want something.
    pub(crate) fn wishes(&self) -> String {
        self.below(&format!("{WISH}/**"))
    }

    /// What a token of [`Self::wishes`] asks for; `None` where it cannot be read.
    pub(crate) fn wish_of(token: &str) -> Option<Wish> {
        Wish::from_json(token.rsplit_once('/')?.1)
    }

    /// Poses, bodies and ground truth, as far as somebody wants them.
    pub(crate) fn frames(&self) -> String {
        self.below("feed/frames")
    }

    /// States that come seldom, of which the newest counts.
    pub(crate) fn states(&self) -> String {
        self.below("feed/states")
    }

    /// Events, none of which may be missed.
    pub(crate) fn events(&self) -> String {
        self.below("feed/events")
    }

    /// A topic's public messages.
    pub(crate) fn topic(&self, topic: Topic) -> String {
        self.below(&format!("topics/{}", topic.name()))
    }

    pub(crate) fn log(&self) -> String {
        self.below("log")
    }

    pub(crate) fn status(&self) -> String {
        self.below("status")
    }

    pub(crate) fn recordings(&self) -> String {
        self.below("recordings")
    }

    pub(crate) fn clock(&self) -> String {
        self.below("clock")
    }

    pub(crate) fn ask(&self, what: &str) -> String {
        self.below(&format!("ask/{what}"))
    }

    fn below(&self, what: &str) -> String {
        format!("{}/{what}", self.stage)
    }
}

/// In front of every item of the feed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Head {
    /// Which run of the daemon reports it: UTC of its epoch, ns.
    pub(crate) run: i64,
    /// Newest event as this was published: who has not got that far has missed something.
    pub(crate) last_event_id: u64,
    /// When and as which event it was published.
    pub(crate) stamp: Stamp,
}

/// An item as it travels.
#[derive(Serialize)]
enum Carrying<'a> {
    Frame(&'a Frame),
    Item(&'a Item),
}

#[derive(Deserialize)]
enum Carried {
    Frame(Frame),
    Item(Item),
}

/// An item with its head, as bytes; of a frame's poses what is selected.
pub(crate) fn write_fed(head: &Head, item: &Item, selection: &Selection) -> Option<Vec<u8>> {
    let mut out = Vec::new();
    rmp_serde::encode::write(&mut out, head).ok()?;
    match item {
        // All numbers, many times a second: without the names of their fields.
        Item::Estimate(estimate) => {
            let frame = Frame::of(estimate, selection);
            rmp_serde::encode::write(&mut out, &Carrying::Frame(&frame)).ok()?;
        }
        Item::Body(_) | Item::Truth(_) | Item::Timecode(_) => {
            rmp_serde::encode::write(&mut out, &Carrying::Item(item)).ok()?;
        }
        // What has optional fields needs their names.
        Item::Outcome(_) | Item::Status(_) | Item::Jobs(_) | Item::Sessions(_) | Item::Rewind => {
            rmp_serde::encode::write_named(&mut out, &Carrying::Item(item)).ok()?;
        }
    }
    Some(out)
}

/// Reads what [`write_fed`] wrote, with what there is of it.
pub(crate) fn read_fed(payload: &[u8]) -> Result<(Head, Item, Selection), decode::Error> {
    let mut unpacker = unpacker(payload);
    let head = Head::deserialize(&mut unpacker)?;
    Ok(match Carried::deserialize(&mut unpacker)? {
        Carried::Frame(frame) => {
            let (estimate, selection) = frame.into_estimate();
            (head, Item::Estimate(estimate), selection)
        }
        Carried::Item(item) => (head, item, Selection::whole()),
    })
}

/// Bytes as MessagePack's own.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Bytes(#[serde(with = "bytes")] pub(crate) Vec<u8>);

/// The answer to `KEY/ask/join?after=N`: what a hub needs beside the feed.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Joined {
    pub(crate) wire: u32,
    /// Of the software.
    pub(crate) version: String,
    /// Which run of the daemon.
    pub(crate) run: i64,
    /// The stage file, without what is nobody else's business.
    pub(crate) stage_toml: String,
    /// What has been published so far, beside what the stage file tells.
    pub(crate) topics: Vec<Topic>,
    pub(crate) last_event_id: u64,
    /// Whether all events after N are here; else some are older than what is kept.
    pub(crate) complete: bool,
    /// Events after N, and with N = 0 those before that still hold, in their order.
    pub(crate) events: Vec<Bytes>,
    /// Newest states that come seldom.
    pub(crate) states: Vec<Bytes>,
}

/// The answer to `KEY/clock`, ns of stage time.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct ClockReading {
    pub(crate) run: i64,
    pub(crate) t_ns: i64,
    /// Frames so far: who asks again has their rate.
    pub(crate) frames: u64,
    /// Newest event.
    pub(crate) last_event_id: u64,
}

/// Some entries of the input log, on `KEY/log` and as the answer to `KEY/ask/log?from=N`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct LogChunk {
    pub(crate) run: i64,
    /// Number of the first one; the others follow it.
    pub(crate) first: u64,
    pub(crate) entries: Vec<Bytes>,
}

/// The answer to `KEY/ask/begin`: the pipeline as it stands before an entry, for fusion on another machine.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Begin {
    /// Number of that entry.
    pub(crate) next: u64,
    pub(crate) header: Header,
}
