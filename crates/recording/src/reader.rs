//! Reading a recording from its beginning to its end, or to where it breaks off.
//!
//! What comes in: a file. What goes out: the header, then everything in the order in which it was written.
//! Memory is that of one chunk. A torn file (`kill -9`, power cut) simply ends; a damaged one says so, once.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;
use std::sync::Arc;

use posed_drivers::Timestamp;
use serde::de::DeserializeOwned;

use super::ending::{Ending, ReadError};
use super::header::{Header, METADATA, METADATA_END};
use super::records::{Record, Records};
use super::writer::{DEVICE, KIND};
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
    header: Header,
    /// What each channel holds, by its id.
    kinds: BTreeMap<u16, Kind>,
    next_entry: u32,
    sound_messages: u64,
    end_reason: Option<String>,
    failed: bool,
}

#[derive(Clone)]
enum Kind {
    Bytes(DeviceIndex),
    Line(DeviceIndex),
    Timer,
    Model,
    Request,
    SegmentationNetwork,
    Truth,
    Transmitted(DeviceIndex),
    Message(Arc<str>),
    /// Somebody else's: skipped.
    Foreign,
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
        let kinds = BTreeMap::new();
        Ok(Self { records, header, kinds, next_entry: 0, sound_messages: 0, end_reason: None, failed: false })
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

    /// Messages of all topics, others' included, before the end or the first error.
    pub(super) fn sound_messages(&self) -> u64 {
        self.sound_messages
    }

    fn read(&mut self) -> Result<Option<Item>, ReadError> {
        while let Some(record) = self.records.next()? {
            match record {
                Record::Message(message) => {
                    let item = self.item(message)?;
                    self.sound_messages += 1;
                    if item.is_some() {
                        return Ok(item);
                    }
                }
                Record::Metadata(mut metadata) if metadata.name == METADATA_END => {
                    self.end_reason = metadata.metadata.remove("reason");
                }
                Record::Metadata(_) | Record::Attachment(_) => {}
            }
        }
        Ok(None)
    }

    fn item(&mut self, message: mcap::Message<'static>) -> Result<Option<Item>, ReadError> {
        let id = message.channel.id;
        if !self.kinds.contains_key(&id) {
            let kind = self.kind(&message.channel)?;
            self.kinds.insert(id, kind);
        }
        let kind = self.kinds.get(&id).cloned().unwrap_or(Kind::Foreign);
        let t = self.header.stage_time(message.log_time);
        let data = &message.data;
        let input = match kind {
            Kind::Foreign => return Ok(None),
            Kind::Message(topic) => {
                return Ok(Some(Item::Message(Message { topic, t, json: message.data.into_owned() })));
            }
            Kind::Transmitted(device) => {
                return Ok(Some(Item::Transmitted { device, t, bytes: message.data.into_owned() }));
            }
            Kind::Bytes(device) => Input::Bytes { device, bytes: message.data.into_owned() },
            Kind::Line(device) => Input::Line { device, event: self.unpack(data, "line event")? },
            Kind::Timer => Input::Timer,
            Kind::Model => Input::Model(self.unpack(data, "model")?),
            Kind::Request => Input::Request(self.unpack(data, "request")?),
            Kind::SegmentationNetwork => Input::SegmentationNetwork(message.data.into_owned()),
            Kind::Truth => Input::Truth(self.unpack(data, "truth")?),
        };
        let found = message.sequence;
        if found != self.next_entry {
            return Err(ReadError::Hole { expected: self.next_entry, found });
        }
        self.next_entry = found.wrapping_add(1);
        Ok(Some(Item::Entry(Entry { t, input })))
    }

    fn unpack<T: DeserializeOwned>(&self, data: &[u8], what: &str) -> Result<T, ReadError> {
        rmp_serde::from_slice(data)
            .map_err(|error| self.records.corrupt(format!("unreadable {what}: {error}")))
    }

    fn kind(&self, channel: &mcap::Channel<'_>) -> Result<Kind, ReadError> {
        let device = || {
            let name = channel.metadata.get(DEVICE);
            let index = name.and_then(|name| self.header.devices.iter().position(|device| device == name));
            index.and_then(|index| DeviceIndex::try_from(index).ok()).ok_or_else(|| {
                self.records.corrupt(format!("topic {} names no device of the stage", channel.topic))
            })
        };
        Ok(match channel.metadata.get(KIND).map(String::as_str) {
            Some("bytes") => Kind::Bytes(device()?),
            Some("line") => Kind::Line(device()?),
            Some("timer") => Kind::Timer,
            Some("model") => Kind::Model,
            Some("request") => Kind::Request,
            Some("segmentation_network") => Kind::SegmentationNetwork,
            Some("truth") => Kind::Truth,
            Some("transmitted") => Kind::Transmitted(device()?),
            Some("message") => {
                Kind::Message(channel.topic.strip_prefix("/posed/").unwrap_or(&channel.topic).into())
            }
            // An input that this version does not know must not be left out of a replay silently.
            Some(other) => {
                return Err(self.records.corrupt(format!(
                    "topic {} holds `{other}`, which this version does not know",
                    channel.topic
                )));
            }
            None => Kind::Foreign,
        })
    }
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
