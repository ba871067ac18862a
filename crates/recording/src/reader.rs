//! Reading a recording from its beginning to its end, or to where it breaks off.
//!
//! What comes in: a file. What goes out: the header, then everything in the order in which it was written.
//! Memory is that of one chunk and of what is bundled in it. A torn file (`kill -9`, power cut) simply ends; a damaged one says so, once.

use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;
use std::sync::Arc;

use posed_drivers::Timestamp;
use serde::de::DeserializeOwned;

use super::bundle::{Piece, pieces};
use super::ending::{Ending, ReadError};
use super::header::{Header, METADATA, METADATA_END};
use super::records::{Record, Records};
use super::writer::{BUNDLE, DEVICE, DEVICE_KINDS, DEVICE_PLACES, KIND, STAGE_KINDS};
use posed_stage::input::{DeviceIndex, Entry, Input};

/// One thing of a recording.
#[derive(Clone, Debug, PartialEq)]
pub enum Item {
    /// An entry of the input log.
    Entry(Entry),
    /// A message as it was published.
    Message(Message),
    /// Bytes that were sent to a device.
    Transmitted {
        /// To which device.
        device: DeviceIndex,
        /// Stage time at which they were sent.
        t: Timestamp,
        /// The bytes.
        bytes: Vec<u8>,
    },
}

/// A published message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// The topic it was published on, for example `sensors`.
    pub topic: Arc<str>,
    /// Time of the message, stage time.
    pub t: Timestamp,
    /// The message, JSON text.
    pub json: Vec<u8>,
}

/// Iterates the items of a recording in the order in which they were written; channels for viewers are left out. After an error
/// it ends.
pub struct Reader<R> {
    records: Records<R>,
    header: Arc<Header>,
    /// What each channel holds, by its id.
    kinds: BTreeMap<u16, Kind>,
    /// What is left of the newest bundle.
    bundled: VecDeque<Item>,
    /// Number of the next entry; `None` of one that began in the middle, before its first.
    next_entry: Option<u32>,
    sound_messages: u64,
    end_reason: Option<String>,
    failed: bool,
}

/// What a channel holds.
#[derive(Clone)]
enum Kind {
    Log(LogKind),
    /// Many pieces of the log.
    Bundle,
    Message(Arc<str>),
    /// Somebody else's: skipped.
    Foreign,
}

/// What a piece of the log is.
#[derive(Clone, Copy)]
enum LogKind {
    Bytes(DeviceIndex),
    Line(DeviceIndex),
    Timer,
    Model,
    Request,
    SegmentationNetwork,
    Truth,
    Timecode,
    Transmitted(DeviceIndex),
}

impl Reader<BufReader<File>> {
    /// Opens a recording and reads its front part.
    ///
    /// # Errors
    /// The file cannot be opened or read, or is no recording.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let file = File::open(path)?;
        let bytes = file.metadata()?.len();
        Self::new(BufReader::with_capacity(1 << 16, file), bytes)
    }
}

impl<R: Read> Reader<R> {
    /// Reads the front part of a recording of `file_bytes` bytes (0 where unknown).
    ///
    /// # Errors
    /// The source fails, or it is no recording.
    pub fn new(source: R, file_bytes: u64) -> Result<Self, ReadError> {
        let mut records = Records::new(source, file_bytes);
        let mut attachments = BTreeMap::new();
        let header = loop {
            match records.next()? {
                Some(Record::Attachment(attachment)) => {
                    attachments.insert(attachment.name, attachment.data.into_owned());
                }
                Some(Record::Metadata(metadata)) if metadata.name == METADATA => {
                    break Header::assemble(&metadata.metadata, &attachments)
                        .map_err(ReadError::NotARecording)?;
                }
                Some(Record::Metadata(_)) => {}
                Some(Record::Message(_)) => {
                    return Err(ReadError::NotARecording("its metadata `posed` is missing".to_owned()));
                }
                None => return Err(ReadError::NotARecording("it ends before its first chunk".to_owned())),
            }
        };
        Ok(Self { next_entry: Some(0), ..Self::resumed(records, Arc::new(header)) })
    }

    /// Reads on where `records` stand.
    pub(super) fn resumed(records: Records<R>, header: Arc<Header>) -> Self {
        Self {
            records,
            header,
            kinds: BTreeMap::new(),
            bundled: VecDeque::new(),
            next_entry: None,
            sound_messages: 0,
            end_reason: None,
            failed: false,
        }
    }

    /// Number of the next entry, before which nothing is left; `None` at the end.
    pub(super) fn first_entry(&mut self) -> Result<Option<u32>, ReadError> {
        while let Some(item) = self.read()? {
            if matches!(item, Item::Entry(_)) {
                // What is unbundled counts already.
                let waiting =
                    self.bundled.iter().filter(|item| matches!(item, Item::Entry(_))).count() as u32;
                self.bundled.push_front(item);
                return Ok(self.next_entry.map(|next| next.wrapping_sub(waiting + 1)));
            }
        }
        Ok(None)
    }

    /// Reads on until the next entry is that of this number; false where it begins behind that, or ends before.
    pub(super) fn pass_to(&mut self, entry: u32) -> Result<bool, ReadError> {
        while let Some(next) = self.first_entry()? {
            if next >= entry {
                return Ok(next == entry);
            }
            self.bundled.pop_front();
        }
        Ok(false)
    }

    /// What stands in front.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// How it ends; `None` until the iterator has ended without an error.
    pub fn ending(&self) -> Option<Ending> {
        if self.failed { None } else { self.records.ending }
    }

    /// Why the recording was ended, in one sentence; `None` before its end, and of one that was not ended in order.
    pub fn end_reason(&self) -> Option<&str> {
        self.end_reason.as_deref()
    }

    /// Bytes of the file that have been read: how far it is.
    pub fn bytes_read(&self) -> u64 {
        self.records.position()
    }

    /// MCAP messages of all topics, others' and bundles included, before the end or the first error.
    pub(super) fn sound_messages(&self) -> u64 {
        self.sound_messages
    }

    fn read(&mut self) -> Result<Option<Item>, ReadError> {
        loop {
            if let Some(item) = self.bundled.pop_front() {
                return Ok(Some(item));
            }
            match self.records.next()? {
                None => return Ok(None),
                Some(Record::Message(message)) => {
                    let item = self.message(message)?;
                    self.sound_messages += 1;
                    if item.is_some() {
                        return Ok(item);
                    }
                }
                Some(Record::Metadata(mut metadata)) if metadata.name == METADATA_END => {
                    self.end_reason = metadata.metadata.remove("reason");
                }
                Some(Record::Metadata(_) | Record::Attachment(_)) => {}
            }
        }
    }

    /// What a message holds, where that is one item; those of a bundle come later.
    fn message(&mut self, message: mcap::Message<'static>) -> Result<Option<Item>, ReadError> {
        let id = message.channel.id;
        if !self.kinds.contains_key(&id) {
            let kind = self.kind(&message.channel)?;
            self.kinds.insert(id, kind);
        }
        let kind = self.kinds.get(&id).cloned().unwrap_or(Kind::Foreign);
        let t = self.header.stage_time(message.log_time);
        match kind {
            Kind::Foreign => Ok(None),
            Kind::Message(topic) => {
                Ok(Some(Item::Message(Message { topic, t, json: message.data.into_owned() })))
            }
            Kind::Bundle => {
                let items = self.unbundle(&message.data)?;
                self.count(
                    message.sequence,
                    items.iter().filter(|item| matches!(item, Item::Entry(_))).count(),
                )?;
                self.bundled.extend(items);
                Ok(None)
            }
            Kind::Log(kind) => {
                let item = item(kind, t, &message.data)?;
                if let Item::Entry(_) = item {
                    self.count(message.sequence, 1)?;
                }
                Ok(Some(item))
            }
        }
    }

    /// So many entries come next, of which the first has the number `found`.
    fn count(&mut self, found: u32, entries: usize) -> Result<(), ReadError> {
        if let Some(expected) = self.next_entry.filter(|expected| *expected != found) {
            return Err(ReadError::Hole { expected, found });
        }
        self.next_entry = Some(found.wrapping_add(entries as u32));
        Ok(())
    }

    fn unbundle(&self, bytes: &[u8]) -> Result<Vec<Item>, ReadError> {
        let unpacked = pieces(bytes).map(|piece| {
            let Piece { place, t, data } =
                piece.ok_or_else(|| ReadError::Newer("a bundle in another form".to_owned()))?;
            let kind = self.place(place);
            item(kind.ok_or_else(|| ReadError::Newer(format!("a bundle with the place {place}")))?, t, data)
        });
        unpacked.collect()
    }

    /// What stands at a place of a bundle.
    fn place(&self, place: u32) -> Option<LogKind> {
        let Some(place) = place.checked_sub(DEVICE_PLACES) else {
            return log_kind(STAGE_KINDS.get(place as usize)?, || None);
        };
        let each = DEVICE_KINDS.len() as u32;
        let device = DeviceIndex::try_from(place / each).ok()?;
        let device = (usize::from(device) < self.header.devices.len()).then_some(device);
        log_kind(DEVICE_KINDS[(place % each) as usize], || device)
    }

    fn kind(&self, channel: &mcap::Channel<'_>) -> Result<Kind, ReadError> {
        let device = || {
            let name = channel.metadata.get(DEVICE)?;
            DeviceIndex::try_from(self.header.devices.iter().position(|device| device == name)?).ok()
        };
        match channel.metadata.get(KIND).map(String::as_str) {
            None => Ok(Kind::Foreign),
            Some("message") => {
                Ok(Kind::Message(channel.topic.strip_prefix("/posed/").unwrap_or(&channel.topic).into()))
            }
            Some(BUNDLE) => Ok(Kind::Bundle),
            // An input that this version does not know must not be left out of a replay silently.
            Some(kind) => log_kind(kind, device).map(Kind::Log).ok_or_else(|| {
                ReadError::Newer(format!("`{kind}` in the topic {}, or its device", channel.topic))
            }),
        }
    }
}

/// The kind of that name; `None` of a name or a device that is unknown.
fn log_kind(name: &str, device: impl FnOnce() -> Option<DeviceIndex>) -> Option<LogKind> {
    Some(match name {
        "bytes" => LogKind::Bytes(device()?),
        "line" => LogKind::Line(device()?),
        "transmitted" => LogKind::Transmitted(device()?),
        "timer" => LogKind::Timer,
        "model" => LogKind::Model,
        "request" => LogKind::Request,
        "segmentation_network" => LogKind::SegmentationNetwork,
        "truth" => LogKind::Truth,
        "timecode" => LogKind::Timecode,
        _ => return None,
    })
}

/// A piece of the log.
fn item(kind: LogKind, t: Timestamp, data: &[u8]) -> Result<Item, ReadError> {
    let input = match kind {
        LogKind::Transmitted(device) => return Ok(Item::Transmitted { device, t, bytes: data.to_vec() }),
        LogKind::Bytes(device) => Input::Bytes { device, bytes: data.to_vec() },
        LogKind::Line(device) => Input::Line { device, event: unpack(data, "line event")? },
        LogKind::Timer => Input::Timer,
        LogKind::Model => Input::Model(unpack(data, "model")?),
        LogKind::Request => Input::Request(unpack(data, "request")?),
        LogKind::SegmentationNetwork => Input::SegmentationNetwork(data.to_vec()),
        LogKind::Truth => Input::Truth(unpack(data, "truth")?),
        LogKind::Timecode => Input::Timecode(unpack(data, "frame of time code")?),
    };
    Ok(Item::Entry(Entry { t, input }))
}

/// The checksum of its chunk is right: what cannot be unpacked is no damage, but of another version.
fn unpack<T: DeserializeOwned>(data: &[u8], what: &str) -> Result<T, ReadError> {
    posed_protocol::unpack(data).map_err(|error| ReadError::Newer(format!("a {what} ({error})")))
}

impl<R: Read> Iterator for Reader<R> {
    type Item = Result<Item, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let item = self.read();
        self.failed = item.is_err();
        item.transpose()
    }
}
