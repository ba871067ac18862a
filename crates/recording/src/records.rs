//! MCAP records in file order, from a whole file, a torn one or a damaged one.
//!
//! What comes in: bytes. What goes out: attachments, metadata, messages with their channels; each chunk only once
//! it is complete and its checksum right. Nothing of ours is decoded here; [`super::reader`] does.

use std::collections::BTreeMap;
use std::io::{self, Read};
use std::sync::Arc;

use mcap::records::{Metadata, Record as Raw, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{Attachment, Channel, McapError, Message, Schema};

use super::MAX_RECORD_BYTES;
use super::ending::{Ending, ReadError};

/// What a file is made of, as far as a recording cares.
pub(super) enum Record {
    Attachment(Attachment<'static>),
    Metadata(Metadata),
    Message(Message<'static>),
}

/// Schemas and channels that were seen.
#[derive(Clone, Default)]
pub(super) struct Known {
    schemas: BTreeMap<u16, Arc<Schema<'static>>>,
    channels: BTreeMap<u16, Arc<Channel<'static>>>,
}

impl Known {
    /// Takes a schema or a channel from the index; `None` where it cannot be read.
    pub(super) fn learn(&mut self, opcode: u8, data: &[u8]) -> Option<()> {
        self.take(parse(opcode, data).ok()?.into_owned()).ok()
    }

    /// The channel of that topic.
    pub(super) fn channel_of(&self, topic: &str) -> Option<u16> {
        self.channels.values().find(|channel| channel.topic == topic).map(|channel| channel.id)
    }

    /// All topics.
    pub(super) fn topics(&self) -> impl Iterator<Item = &str> {
        self.channels.values().map(|channel| channel.topic.as_str())
    }

    /// Takes a schema or a channel, or says what is wrong with it.
    fn take(&mut self, record: Raw<'static>) -> Result<(), String> {
        match record {
            Raw::Schema { header, data } => {
                let schema = Schema { id: header.id, name: header.name, encoding: header.encoding, data };
                let (id, schema) = (schema.id, Arc::new(schema));
                if self.schemas.insert(id, Arc::clone(&schema)).is_some_and(|old| old != schema) {
                    return Err(format!("schema {} changes midway", schema.name));
                }
            }
            Raw::Channel(channel) => {
                let mcap::records::Channel { id, topic, message_encoding, metadata, schema_id } = channel;
                let schema = match schema_id {
                    0 => None,
                    id => match self.schemas.get(&id) {
                        Some(schema) => Some(Arc::clone(schema)),
                        None => return Err(format!("channel {topic} names an unknown schema")),
                    },
                };
                let channel = Arc::new(Channel { id, topic, schema, message_encoding, metadata });
                if self.channels.insert(id, Arc::clone(&channel)).is_some_and(|old| old != channel) {
                    return Err(format!("channel {} changes midway", channel.topic));
                }
            }
            _ => {}
        }
        Ok(())
    }
}

/// Iterates the records of a file.
pub(super) struct Records<R> {
    source: R,
    reader: LinearReader,
    known: Known,
    /// Bytes taken from the source.
    position: u64,
    /// The data section is over: what follows is the index, which repeats schemas and channels.
    summary: bool,
    /// Set once there is nothing more to say.
    pub(super) ending: Option<Ending>,
}

impl<R: Read> Records<R> {
    /// `file_bytes` is the size of the file, where known: no record is longer.
    pub(super) fn new(source: R, file_bytes: u64) -> Self {
        let longest = usize::try_from(file_bytes).unwrap_or(usize::MAX).max(MAX_RECORD_BYTES);
        let options = LinearReaderOptions::default()
            .with_prevalidate_chunk_crcs(true)
            .with_validate_data_section_crc(true)
            .with_record_length_limit(longest);
        Self::of(source, options, Known::default())
    }

    /// From a source that stands at the beginning of a chunk.
    pub(super) fn resumed(source: R, known: Known) -> Self {
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(MAX_RECORD_BYTES);
        Self::of(source, options, known)
    }

    fn of(source: R, options: LinearReaderOptions, known: Known) -> Self {
        let reader = LinearReader::new_with_options(options);
        Self { source, reader, known, position: 0, summary: false, ending: None }
    }

    /// The channels seen so far, those without a message too.
    pub(super) fn channels(&self) -> impl Iterator<Item = &Arc<Channel<'static>>> {
        self.known.channels.values()
    }

    /// Bytes taken from the source.
    pub(super) fn position(&self) -> u64 {
        self.position
    }

    /// The next record; `None` at the end, see [`Records::ending`].
    pub(super) fn next(&mut self) -> Result<Option<Record>, ReadError> {
        while self.ending.is_none() {
            let step = match self.reader.next_event() {
                None => Ok(Step::End),
                Some(Err(error)) => Err(error),
                Some(Ok(LinearReadEvent::ReadRequest(bytes))) => Ok(Step::Read(bytes)),
                // No record has this number: the file ends in zeros, as after a power cut.
                Some(Ok(LinearReadEvent::Record { opcode: 0, .. })) => Ok(Step::Torn),
                Some(Ok(LinearReadEvent::Record { opcode, data })) => match opcode {
                    op::SCHEMA | op::CHANNEL | op::MESSAGE | op::ATTACHMENT | op::METADATA => {
                        parse(opcode, data).map(|record| Step::Record(record.into_owned()))
                    }
                    op::DATA_END => {
                        self.summary = true;
                        Ok(Step::Skip)
                    }
                    _ => Ok(Step::Skip),
                },
            };
            match step {
                Ok(Step::Skip) => {}
                Ok(Step::End) => self.ending = Some(Ending::Complete),
                Ok(Step::Torn) | Err(McapError::UnexpectedEof) => self.ending = Some(Ending::Torn),
                Ok(Step::Read(bytes)) => self.fill(bytes)?,
                Ok(Step::Record(record)) => {
                    if let Some(record) =
                        self.take(record).inspect_err(|_| self.ending = Some(Ending::Torn))?
                    {
                        return Ok(Some(record));
                    }
                }
                Err(error) => {
                    self.ending = Some(Ending::Torn);
                    return Err(self.error(error));
                }
            }
        }
        Ok(None)
    }

    fn fill(&mut self, bytes: usize) -> Result<(), ReadError> {
        let read = loop {
            match self.source.read(self.reader.insert(bytes)) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => {
                    self.ending = Some(Ending::Torn);
                    return Err(ReadError::Io(error));
                }
                Ok(read) => break read,
            }
        };
        self.reader.notify_read(read);
        self.position += read as u64;
        Ok(())
    }

    fn take(&mut self, record: Raw<'static>) -> Result<Option<Record>, ReadError> {
        if self.summary {
            return Ok(None);
        }
        match record {
            record @ (Raw::Schema { .. } | Raw::Channel(_)) => {
                self.known.take(record).map_err(|reason| self.corrupt(reason))?;
            }
            Raw::Message { header, data } => {
                let channel = self.known.channels.get(&header.channel_id).cloned().ok_or_else(|| {
                    self.corrupt(format!("message of unknown channel {}", header.channel_id))
                })?;
                return Ok(Some(Record::Message(Message {
                    channel,
                    sequence: header.sequence,
                    log_time: header.log_time,
                    publish_time: header.publish_time,
                    data,
                })));
            }
            Raw::Attachment { header, data, .. } => {
                return Ok(Some(Record::Attachment(Attachment {
                    log_time: header.log_time,
                    create_time: header.create_time,
                    name: header.name,
                    media_type: header.media_type,
                    data,
                })));
            }
            Raw::Metadata(metadata) => return Ok(Some(Record::Metadata(metadata))),
            _ => {}
        }
        Ok(None)
    }

    fn error(&self, error: McapError) -> ReadError {
        match error {
            McapError::BadMagic if self.position <= mcap::MAGIC.len() as u64 => {
                ReadError::NotARecording("it does not begin as an MCAP file".to_owned())
            }
            McapError::UnsupportedCompression(name) => ReadError::Newer(format!("chunks packed by {name}")),
            other => self.corrupt(other.to_string()),
        }
    }

    /// Damage before the last byte taken.
    pub(super) fn corrupt(&self, reason: String) -> ReadError {
        ReadError::Corrupt { before_byte: self.position, reason }
    }
}

/// The record of these bytes: a schema, channel, message, attachment, metadata, statistics, or where an attachment or metadata is.
///
/// # Errors
/// They are none, or of another kind.
pub(super) fn parse(opcode: u8, data: &[u8]) -> Result<Raw<'_>, McapError> {
    if !lies_within(opcode, data) {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "a part is longer than its record").into());
    }
    mcap::parse_record(opcode, data)
}

/// Whether the parts of a record end before it does: the library takes memory for a text that is as long as it claims to be, and
/// takes for granted that an attachment is there.
fn lies_within(opcode: u8, mut data: &[u8]) -> bool {
    let (begins, texts, has_map, ends) = match opcode {
        op::SCHEMA => (2, 2, false, 4),
        op::CHANNEL => (4, 2, true, 0),
        op::ATTACHMENT => (16, 2, false, 12),
        op::METADATA => (0, 1, true, 0),
        op::ATTACHMENT_INDEX => (40, 2, false, 0),
        op::METADATA_INDEX => (16, 1, false, 0),
        op::MESSAGE | op::STATISTICS => return true,
        // Nobody asks for another kind: who does must say where its texts are.
        _ => return false,
    };
    let rest = &mut data;
    let begins = take(rest, begins).is_some() && (0..texts).all(|_| text(rest).is_some());
    begins && (!has_map || map(rest).is_some()) && rest.len() >= ends
}

fn take<'a>(rest: &mut &'a [u8], length: usize) -> Option<&'a [u8]> {
    let (taken, later) = rest.split_at_checked(length)?;
    *rest = later;
    Some(taken)
}

fn length(rest: &mut &[u8]) -> Option<usize> {
    let bytes = take(rest, 4)?.try_into().ok()?;
    usize::try_from(u32::from_le_bytes(bytes)).ok()
}

fn text(rest: &mut &[u8]) -> Option<()> {
    let length = length(rest)?;
    take(rest, length).map(drop)
}

/// Names and values, after how many bytes they have.
fn map(rest: &mut &[u8]) -> Option<()> {
    let length = length(rest)?;
    let before = rest.len();
    while before - rest.len() < length {
        text(rest)?;
        text(rest)?;
    }
    Some(())
}

enum Step {
    Skip,
    Read(usize),
    Record(Raw<'static>),
    Torn,
    End,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_that_claims_to_be_longer_than_its_record_takes_no_memory() {
        let long = u32::MAX.to_le_bytes();
        let texts = [&1_u32.to_le_bytes()[..], b"a"].concat();
        for (opcode, begins) in [
            (op::SCHEMA, vec![0; 2]),
            (op::SCHEMA, [&[0; 2], &texts[..]].concat()),
            (op::CHANNEL, vec![0; 4]),
            (op::CHANNEL, [&[0; 4], &texts[..], &texts[..], &100_u32.to_le_bytes()].concat()),
            (op::METADATA, vec![]),
            (op::METADATA, [&texts[..], &100_u32.to_le_bytes()].concat()),
            (op::ATTACHMENT, vec![0; 16]),
            (op::ATTACHMENT_INDEX, vec![0; 40]),
            (op::METADATA_INDEX, vec![0; 16]),
            (op::CHUNK_INDEX, vec![0; 32]),
        ] {
            let claims = [&begins[..], &long].concat();
            assert!(!lies_within(opcode, &claims), "{opcode} {begins:?}");
            assert!(parse(opcode, &claims).is_err());
        }
        // An attachment without a sum, which the library reads beyond its beginning.
        assert!(parse(op::ATTACHMENT, &[&[0; 16], &texts[..], &texts[..], &[0; 8][..]].concat()).is_err());
        // What is whole is read.
        let metadata = [&texts[..], &10_u32.to_le_bytes(), &texts[..], &texts[..]].concat();
        assert!(
            matches!(parse(op::METADATA, &metadata), Ok(Raw::Metadata(read)) if read.metadata["a"] == "a")
        );
    }
}
