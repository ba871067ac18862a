//! Writing a recording, to anything that takes bytes.
//!
//! Append-only: a chunk is built in memory and written whole, so that what is cut off at any byte is a readable
//! prefix. [`Writer::flush`] ends the chunk; who owns the file syncs it. No thread, no clock.
//!
//! Where a recording holds no more than its log, entries and what was transmitted go into bundles (see [`super::bundle`]), one for
//! each flush; their channels are declared all the same, so that the index names what the log holds.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, McapError, Schema};
use posed_drivers::Timestamp;

use super::bundle::{Bundle, Piece};
use super::columns::{self, Block};
use super::digest;
use super::header::{Header, METADATA_END, Part};
use super::machine::MachineError;
use super::mcap_file::{CHUNK_BYTES, McapFile};
use super::{MAX_PIECE_BYTES, MAX_RECORD_BYTES};
use posed_protocol::Digest;
use posed_protocol::foxglove::Channel;
use posed_stage::RecordingContent;
use posed_stage::input::{DeviceIndex, Entry, Input};

/// A chunk may go over its size by one message, and is itself one record.
const _: () = assert!(MAX_PIECE_BYTES + 2 * CHUNK_BYTES as usize <= MAX_RECORD_BYTES);

/// Why nothing more can be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// No space or no quota is left.
    #[error("the disk is full; delete old recordings or record to another disk")]
    DiskFull,
    /// The folder or the file may not be written to.
    #[error("no right to write there; choose a folder that this user may write to ({0})")]
    Refused(io::Error),
    /// A file of that name is there already.
    #[error("a file of that name is there already; choose another name")]
    Exists,
    /// The folder is missing.
    #[error("the folder does not exist; make it first")]
    NoFolder,
    /// Anything else that the system said.
    #[error("the recording cannot be written: {0}")]
    Io(io::Error),
    /// An entry of a device that the header does not name.
    #[error("entry of device {device}, but the recording's stage has {devices} devices")]
    UnknownDevice {
        /// The entry's.
        device: DeviceIndex,
        /// How many the header names.
        devices: usize,
    },
    /// An entry, a message or an attachment of more than [`MAX_PIECE_BYTES`].
    #[error("{what} has {bytes} bytes; a recording holds at most {MAX_PIECE_BYTES} in one piece")]
    TooLarge {
        /// What.
        what: String,
        /// Its size.
        bytes: usize,
    },
    /// What follows from its entries cannot be made.
    #[error(transparent)]
    Machine(#[from] MachineError),
    /// Something that the format cannot hold.
    #[error("the recording cannot hold this: {0}")]
    Format(String),
}

impl From<rmp_serde::encode::Error> for WriteError {
    fn from(error: rmp_serde::encode::Error) -> Self {
        Self::Format(error.to_string())
    }
}

impl From<io::Error> for WriteError {
    fn from(error: io::Error) -> Self {
        use io::ErrorKind as Kind;
        match error.kind() {
            Kind::StorageFull | Kind::QuotaExceeded | Kind::FileTooLarge => Self::DiskFull,
            Kind::PermissionDenied | Kind::ReadOnlyFilesystem => Self::Refused(error),
            Kind::AlreadyExists => Self::Exists,
            Kind::NotFound => Self::NoFolder,
            _ => Self::Io(error),
        }
    }
}

impl From<McapError> for WriteError {
    fn from(error: McapError) -> Self {
        match error {
            McapError::Io(error) => error.into(),
            other => Self::Format(other.to_string()),
        }
    }
}

/// Writes one recording.
///
/// After an error of the sink, write nothing more: the file is a readable prefix. What is refused for its device or its size is
/// left out, and the recording goes on without a hole.
pub struct Writer<W: Write> {
    mcap: McapFile<W>,
    header: Header,
    /// Channels already declared, by topic.
    channels: BTreeMap<String, OpenChannel>,
    /// Schemas by topic; those with one name and text are one.
    schemas: BTreeMap<String, Arc<Schema<'static>>>,
    /// Topics of the devices, made once: input bytes, input line, output bytes.
    device_topics: Vec<[String; 3]>,
    /// Counts entries, over all input topics.
    entries: u32,
    /// Pieces that are not yet written, and the number of the first entry among them.
    bundle: Bundle,
    bundle_begins: u32,
    scratch: Vec<u8>,
}

struct OpenChannel {
    id: u16,
    /// Counts messages.
    sequence: u32,
}

/// What a channel holds, as its metadata says it.
pub(super) const KIND: &str = "kind";
/// The device a channel belongs to, as its metadata says it.
pub(super) const DEVICE: &str = "device";
/// Kinds of what the stage as a whole takes in, by their places in a bundle. New ones come last.
pub(super) const STAGE_KINDS: [&str; 6] =
    ["timer", "model", "request", "segmentation_network", "truth", "timecode"];
/// Kinds of what each device has, in the order of their places.
pub(super) const DEVICE_KINDS: [&str; 3] = ["bytes", "line", "transmitted"];
/// First place of the first device; the others follow.
pub(super) const DEVICE_PLACES: u32 = 16;
/// Kind and topic of bundles.
pub(super) const BUNDLE: &str = "bundle";
const BUNDLE_TOPIC: &str = "/input/log";

impl<W: Write> Writer<W> {
    /// Begins a recording and flushes its front part.
    ///
    /// # Errors
    /// The sink refuses, or a part of the header is too large or cannot be packed.
    pub fn new(sink: W, header: Header) -> Result<Self, WriteError> {
        let mut mcap = McapFile::new(sink)?;
        let time = header.log_time(header.begun);
        for Part { name, media_type, data } in header.attachments().map_err(WriteError::Format)? {
            check_size(name, data.len())?;
            let (name, media_type) = (name.to_owned(), media_type.to_owned());
            mcap.attach(&Attachment {
                log_time: time,
                create_time: time,
                name,
                media_type,
                data: data.into(),
            })?;
        }
        mcap.write_metadata(&header.metadata().map_err(WriteError::Format)?)?;
        mcap.flush()?;
        let device_topics = header.devices.iter().map(|device| {
            [
                format!("/input/{device}/bytes"),
                format!("/input/{device}/line"),
                format!("/output/{device}/bytes"),
            ]
        });
        Ok(Self {
            mcap,
            device_topics: device_topics.collect(),
            header,
            channels: BTreeMap::new(),
            schemas: BTreeMap::new(),
            entries: 0,
            bundle: Bundle::default(),
            bundle_begins: 0,
            scratch: Vec::new(),
        })
    }

    /// Lets the index wait in a file of `folder` that has no name, where that can have one; in memory without this, 100 bytes of each
    /// flush. Call it before anything is written.
    pub fn keep_index_in(&mut self, folder: &Path) {
        self.mcap.keep_index_in(folder);
    }

    /// Gives the JSON Schema of a published topic (`sensors`, not `/posed/sensors`); call it before the topic's first message,
    /// for later it has no effect.
    pub fn declare(&mut self, topic: &str, json_schema: &str) {
        self.add_schema(format!("/posed/{topic}"), format!("posed.{topic}"), json_schema);
    }

    fn add_schema(&mut self, topic: String, name: String, text: &str) {
        let is_it = |known: &&Arc<Schema<'static>>| known.name == name && *known.data == *text.as_bytes();
        let schema = self.schemas.values().find(is_it).cloned().unwrap_or_else(|| {
            let last = self.schemas.values().map(|known| known.id).max().unwrap_or_default();
            let data = text.as_bytes().to_vec().into();
            Arc::new(Schema { id: last.saturating_add(1), name, encoding: "jsonschema".to_owned(), data })
        });
        self.schemas.insert(topic, schema);
    }

    /// Appends a message (JSON text, `t` in stage time) of a channel that viewers know: it is for them, and no part of a replay.
    ///
    /// # Errors
    /// The sink refuses, or the message is too large.
    pub fn view(&mut self, channel: &Channel, t: Timestamp, json: &[u8]) -> Result<(), WriteError> {
        if !self.schemas.contains_key(&channel.topic) {
            self.add_schema(channel.topic.clone(), channel.schema_name.clone(), &channel.schema);
        }
        self.write(Destination::View(&channel.topic), t, None, json)
    }

    /// Appends an entry of the input log. Entries keep the order of the calls.
    ///
    /// # Errors
    /// The sink refuses, the device is unknown, or the entry is too large.
    pub fn entry(&mut self, entry: &Entry) -> Result<(), WriteError> {
        let mut scratch = std::mem::take(&mut self.scratch);
        scratch.clear();
        let (place, data): (Destination<'_>, &[u8]) = match &entry.input {
            Input::Bytes { device, bytes } => (Destination::Device(*device, 0, "bytes"), bytes),
            Input::Line { device, event } => {
                rmp_serde::encode::write_named(&mut scratch, event)?;
                (Destination::Device(*device, 1, "line"), &scratch)
            }
            Input::Timer => (Destination::Stage("/input/timer", "timer"), &[]),
            Input::Model(model) => {
                rmp_serde::encode::write_named(&mut scratch, model)?;
                (Destination::Stage("/input/model", "model"), &scratch)
            }
            Input::Request(request) => {
                rmp_serde::encode::write_named(&mut scratch, request)?;
                (Destination::Stage("/input/request", "request"), &scratch)
            }
            Input::SegmentationNetwork(bytes) => {
                (Destination::Stage("/input/segmentation_network", "segmentation_network"), bytes)
            }
            Input::Truth(truth) => {
                rmp_serde::encode::write_named(&mut scratch, truth)?;
                (Destination::Stage("/input/truth", "truth"), &scratch)
            }
            Input::Timecode(reading) => {
                rmp_serde::encode::write_named(&mut scratch, reading)?;
                (Destination::Stage("/input/timecode", "timecode"), &scratch)
            }
        };
        let sequence = self.entries;
        let written = self.write(place, entry.t, Some(sequence), data);
        self.scratch = scratch;
        written?;
        self.entries = self.entries.wrapping_add(1);
        Ok(())
    }

    /// Appends a block of columns: it is for readers without a pipeline, and no part of a replay.
    ///
    /// # Errors
    /// The sink refuses, or a part of it is too large or cannot be packed.
    pub fn columns(&mut self, block: &Block) -> Result<(), WriteError> {
        // One in which nothing was published has a time as well.
        let t = block.t().max(self.header.begun);
        block.each_message(|message| self.write(Destination::View(columns::TOPIC), t, None, message))
    }

    /// Appends a message as it was published: its topic (`sensors`, not `/posed/sensors`), its stage time, its JSON text.
    ///
    /// # Errors
    /// The sink refuses, or the message is too large.
    pub fn message(&mut self, topic: &str, t: Timestamp, json: &[u8]) -> Result<(), WriteError> {
        // What it follows from stands before it.
        self.close_bundle()?;
        self.write(Destination::Published(topic), t, None, json)
    }

    /// Appends what was transmitted to a device at stage time `t`.
    ///
    /// # Errors
    /// The sink refuses, the device is unknown, or it is too much in one piece.
    pub fn transmitted(&mut self, device: DeviceIndex, t: Timestamp, bytes: &[u8]) -> Result<(), WriteError> {
        self.write(Destination::Device(device, 2, "transmitted"), t, None, bytes)
    }

    /// Ends the chunk and hands everything to the sink: once the sink is on the disk, all so far survives.
    ///
    /// # Errors
    /// The sink refuses.
    pub fn flush(&mut self) -> Result<(), WriteError> {
        self.close_bundle()?;
        Ok(self.mcap.flush()?)
    }

    /// Attaches the digest of all that was written; call it once, at the end.
    ///
    /// # Errors
    /// The sink refuses.
    pub fn digest(&mut self, digest: &Digest) -> Result<(), WriteError> {
        let data = serde_json::to_vec(digest).map_err(|error| WriteError::Format(error.to_string()))?;
        self.close_bundle()?;
        let time = self.header.log_time(self.header.begun);
        let (name, media_type) = (digest::NAME.to_owned(), digest::MEDIA_TYPE.to_owned());
        Ok(self.mcap.attach(&Attachment {
            log_time: time,
            create_time: time,
            name,
            media_type,
            data: data.into(),
        })?)
    }

    /// Ends the recording with its index, and gives the sink back, flushed. `reason`, one sentence, states why it ended.
    ///
    /// # Errors
    /// The sink refuses.
    pub fn finish(mut self, reason: &str) -> Result<W, WriteError> {
        self.close_bundle()?;
        let metadata = BTreeMap::from([("reason".to_owned(), reason.to_owned())]);
        self.mcap.write_metadata(&Metadata { name: METADATA_END.to_owned(), metadata })?;
        Ok(self.mcap.finish()?)
    }

    /// Bytes that the sink has taken so far.
    pub fn bytes_written(&self) -> u64 {
        self.mcap.byte_counter().load(Ordering::Relaxed)
    }

    /// The counter behind [`Writer::bytes_written`], for whoever shows it elsewhere.
    pub fn byte_counter(&self) -> Arc<AtomicU64> {
        Arc::clone(self.mcap.byte_counter())
    }

    fn write(
        &mut self,
        place: Destination<'_>,
        t: Timestamp,
        sequence: Option<u32>,
        data: &[u8],
    ) -> Result<(), WriteError> {
        let published;
        let topic = match place {
            Destination::Device(device, which, _) => match self.device_topics.get(usize::from(device)) {
                Some(topics) => topics[which].as_str(),
                None => {
                    return Err(WriteError::UnknownDevice { device, devices: self.device_topics.len() });
                }
            },
            Destination::Stage(topic, _) | Destination::View(topic) => topic,
            Destination::Bundle => BUNDLE_TOPIC,
            Destination::Published(topic) => {
                published = format!("/posed/{topic}");
                published.as_str()
            }
        };
        if !matches!(place, Destination::Bundle) {
            check_size(topic, data.len())?;
        }
        if !self.channels.contains_key(topic) {
            let id = u16::try_from(self.channels.len() + 1).map_err(|_| McapError::TooManyChannels)?;
            let schema = self.schemas.get(topic).cloned();
            self.mcap.declare(&Arc::new(channel(id, topic, &place, &self.header.devices, schema)))?;
            self.channels.insert(topic.to_owned(), OpenChannel { id, sequence: 0 });
        }
        if self.header.content == RecordingContent::Log
            && let Some(place) = place.in_bundle()
        {
            return self.bundle(Piece { place, t, data });
        }
        let Some(channel) = self.channels.get_mut(topic) else {
            return Err(WriteError::Format(format!("channel {topic} is gone")));
        };
        let sequence = sequence.unwrap_or(channel.sequence);
        channel.sequence = channel.sequence.wrapping_add(1);
        let time = self.header.log_time(t);
        let header = MessageHeader { channel_id: channel.id, sequence, log_time: time, publish_time: time };
        Ok(self.mcap.write(&header, data)?)
    }

    /// Appends to the bundle; one that would become too large is written before.
    fn bundle(&mut self, piece: Piece<'_>) -> Result<(), WriteError> {
        if self.bundle.len() + piece.data.len() > CHUNK_BYTES as usize {
            self.close_bundle()?;
        }
        if self.bundle.len() == 0 {
            self.bundle_begins = self.entries;
        }
        self.bundle.push(piece);
        Ok(())
    }

    /// Writes the bundle, if there is anything in it.
    fn close_bundle(&mut self) -> Result<(), WriteError> {
        let bundle = std::mem::take(&mut self.bundle);
        if let Some((bytes, latest)) = bundle.bytes() {
            self.write(Destination::Bundle, latest, Some(self.bundle_begins), bytes)?;
        }
        self.bundle = bundle;
        self.bundle.clear();
        Ok(())
    }
}

/// Where a message goes.
#[derive(Clone, Copy)]
enum Destination<'a> {
    /// A device, which of its topics, and the kind of that topic.
    Device(DeviceIndex, usize, &'static str),
    /// Topic and kind.
    Stage(&'static str, &'static str),
    /// A published topic's name.
    Published(&'a str),
    /// Topic of a channel for viewers; readers of the log see by the lack of a kind that it is nothing to them.
    View(&'a str),
    /// The channel of bundles.
    Bundle,
}

impl Destination<'_> {
    /// The place of a piece of the log in a bundle; the reader counts the same way. `None`: it is no piece of the log.
    fn in_bundle(&self) -> Option<u32> {
        match *self {
            Self::Stage(_, kind) => STAGE_KINDS.iter().position(|known| *known == kind).map(|at| at as u32),
            Self::Device(device, which, _) => {
                Some(DEVICE_PLACES + u32::from(device) * DEVICE_KINDS.len() as u32 + which as u32)
            }
            Self::Published(_) | Self::View(_) | Self::Bundle => None,
        }
    }
}

/// The channel of a topic.
fn channel(
    id: u16,
    topic: &str,
    place: &Destination<'_>,
    devices: &[String],
    schema: Option<Arc<Schema<'static>>>,
) -> mcap::Channel<'static> {
    let (kind, encoding) = match *place {
        Destination::Device(_, _, kind @ ("bytes" | "transmitted")) => {
            (Some(kind), "application/octet-stream")
        }
        Destination::Stage(_, kind @ "timer") => (Some(kind), "application/octet-stream"),
        Destination::Bundle => (Some(BUNDLE), "application/octet-stream"),
        Destination::Device(_, _, kind) | Destination::Stage(_, kind) => (Some(kind), "msgpack"),
        Destination::Published(_) => (Some("message"), "json"),
        Destination::View(columns::TOPIC) => (None, "msgpack"),
        Destination::View(_) => (None, "json"),
    };
    let mut metadata: BTreeMap<_, _> =
        kind.map(|kind| (KIND.to_owned(), kind.to_owned())).into_iter().collect();
    if let Destination::Device(device, ..) = *place
        && let Some(name) = devices.get(usize::from(device))
    {
        metadata.insert(DEVICE.to_owned(), name.clone());
    }
    let (topic, message_encoding) = (topic.to_owned(), encoding.to_owned());
    mcap::Channel { id, topic, schema, message_encoding, metadata }
}

fn check_size(what: &str, bytes: usize) -> Result<(), WriteError> {
    if bytes > MAX_PIECE_BYTES {
        return Err(WriteError::TooLarge { what: what.to_owned(), bytes });
    }
    Ok(())
}
