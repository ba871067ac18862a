//! The index of an MCAP file: its summary section, gathered while the file is written.
//!
//! What is known of each chunk waits as the bytes that it will be; in a file without a name once they are many, where a folder for
//! it is named.

use std::collections::BTreeMap;
use std::io::{self, Cursor, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::Arc;

use binrw::BinWrite;
use mcap::records::{AttachmentIndex, DataEnd, MetadataIndex, SchemaHeader, Statistics, SummaryOffset, op};
use mcap::{Channel, McapError, Schema, Summary};
use tempfile::{SpooledTempFile, spooled_tempfile, spooled_tempfile_in, tempfile_in};

use super::sink::Sink;

/// Bytes of the chunks' part that stay in memory where it has a folder.
const IN_MEMORY: usize = 64 << 10;

/// What the end of a file will say of it.
pub(super) struct Index {
    statistics: Statistics,
    attachments: Vec<AttachmentIndex>,
    metadata: Vec<MetadataIndex>,
    /// Records of the chunks.
    chunks: SpooledTempFile,
}

impl Default for Index {
    fn default() -> Self {
        Self {
            statistics: Statistics::default(),
            attachments: Vec::new(),
            metadata: Vec::new(),
            chunks: spooled_tempfile(usize::MAX),
        }
    }
}

impl Index {
    /// Lets what waits be in `folder` where it is much, if that can have such a file; before anything waits.
    pub(super) fn keep_in(&mut self, folder: &Path) {
        // A name without a folder has an empty one.
        let folder = Path::new(".").join(folder);
        if tempfile_in(&folder).is_ok() {
            self.chunks = spooled_tempfile_in(IN_MEMORY, folder);
        }
    }

    #[cfg(test)]
    pub(super) fn is_in_memory(&self) -> bool {
        !self.chunks.is_rolled()
    }

    /// Adds what a stretch has.
    pub(super) fn append(&mut self, stretch: Summary) -> io::Result<()> {
        let mut bytes = Vec::new();
        for chunk in &stretch.chunk_indexes {
            record(&mut bytes, op::CHUNK_INDEX, chunk, &[])?;
        }
        self.chunks.write_all(&bytes)?;
        self.attachments.extend(stretch.attachment_indexes);
        self.metadata.extend(stretch.metadata_indexes);
        let Some(added) = stretch.stats else { return Ok(()) };
        let all = &mut self.statistics;
        if added.message_count > 0 {
            let is_first = all.message_count == 0;
            let start = if is_first { u64::MAX } else { all.message_start_time };
            all.message_start_time = start.min(added.message_start_time);
            all.message_end_time = all.message_end_time.max(added.message_end_time);
        }
        all.message_count += added.message_count;
        all.chunk_count += added.chunk_count;
        all.attachment_count += added.attachment_count;
        all.metadata_count += added.metadata_count;
        for (channel, messages) in added.channel_message_counts {
            *all.channel_message_counts.entry(channel).or_default() += messages;
        }
        Ok(())
    }

    /// Writes the end of the file, behind the data.
    pub(super) fn write<W: Write>(
        &mut self,
        sink: &mut Sink<W>,
        channels: &BTreeMap<u16, Arc<Channel<'static>>>,
    ) -> Result<(), McapError> {
        let schemas: BTreeMap<u16, &Schema<'static>> = channels
            .values()
            .filter_map(|channel| channel.schema.as_deref())
            .map(|schema| (schema.id, schema))
            .collect();
        self.statistics.schema_count = schemas.len() as u16;
        self.statistics.channel_count = channels.len() as u32;
        let mut bytes = Vec::new();
        let data_section_crc = sink.take_checksum();
        record(&mut bytes, op::DATA_END, &DataEnd { data_section_crc }, &[])?;
        sink.write_all(&bytes)?;
        sink.take_checksum();
        let mut end = End { begins: sink.position(), sink, groups: Vec::new() };
        end.group(op::SCHEMA, |bytes| {
            schemas.values().try_for_each(|schema| {
                let Schema { id, name, encoding, data } = schema;
                let header = SchemaHeader { id: *id, name: name.clone(), encoding: encoding.clone() };
                let data = [&(data.len() as u32).to_le_bytes(), &data[..]].concat();
                record(bytes, op::SCHEMA, &header, &data)
            })
        })?;
        end.group(op::CHANNEL, |bytes| {
            channels.values().try_for_each(|channel| {
                let channel = mcap::records::Channel {
                    id: channel.id,
                    schema_id: channel.schema.as_ref().map_or(0, |schema| schema.id),
                    topic: channel.topic.clone(),
                    message_encoding: channel.message_encoding.clone(),
                    metadata: channel.metadata.clone(),
                };
                record(bytes, op::CHANNEL, &channel, &[])
            })
        })?;
        end.group(op::STATISTICS, |bytes| record(bytes, op::STATISTICS, &self.statistics, &[]))?;
        end.chunks(&mut self.chunks)?;
        end.group(op::ATTACHMENT_INDEX, |bytes| {
            self.attachments.iter().try_for_each(|index| record(bytes, op::ATTACHMENT_INDEX, index, &[]))
        })?;
        end.group(op::METADATA_INDEX, |bytes| {
            self.metadata.iter().try_for_each(|index| record(bytes, op::METADATA_INDEX, index, &[]))
        })?;
        end.finish()
    }
}

/// The summary section as it is written.
struct End<'a, W> {
    begins: u64,
    sink: &'a mut Sink<W>,
    groups: Vec<SummaryOffset>,
}

impl<W: Write> End<'_, W> {
    /// Appends records of one kind.
    fn group(&mut self, kind: u8, records: impl FnOnce(&mut Vec<u8>) -> io::Result<()>) -> io::Result<()> {
        let mut bytes = Vec::new();
        records(&mut bytes)?;
        let begins = self.sink.position();
        self.sink.write_all(&bytes)?;
        self.end_group(kind, begins);
        Ok(())
    }

    /// Appends the records of the chunks.
    fn chunks(&mut self, waiting: &mut SpooledTempFile) -> io::Result<()> {
        let begins = self.sink.position();
        waiting.seek(SeekFrom::Start(0))?;
        io::copy(waiting, self.sink)?;
        self.end_group(op::CHUNK_INDEX, begins);
        Ok(())
    }

    fn end_group(&mut self, group_opcode: u8, group_start: u64) {
        let group_length = self.sink.position() - group_start;
        if group_length > 0 {
            self.groups.push(SummaryOffset { group_opcode, group_start, group_length });
        }
    }

    /// Appends where the groups are, and the end of the file.
    fn finish(self) -> Result<(), McapError> {
        let offsets_begin = self.sink.position();
        let mut bytes = Vec::new();
        for group in &self.groups {
            record(&mut bytes, op::SUMMARY_OFFSET, group, &[])?;
        }
        bytes.push(op::FOOTER);
        bytes.extend(20_u64.to_le_bytes());
        bytes.extend(self.begins.to_le_bytes());
        bytes.extend(offsets_begin.to_le_bytes());
        self.sink.write_all(&bytes)?;
        let checksum = self.sink.take_checksum();
        self.sink.write_all(&checksum.to_le_bytes())?;
        self.sink.write_all(mcap::MAGIC)?;
        Ok(())
    }
}

/// Appends a record; `data` follows what `head` is written as.
fn record<H>(bytes: &mut Vec<u8>, kind: u8, head: &H, data: &[u8]) -> io::Result<()>
where
    H: for<'a> BinWrite<Args<'a> = ()>,
{
    let mut body = Cursor::new(Vec::new());
    head.write_le(&mut body).map_err(io::Error::other)?;
    let body = body.into_inner();
    bytes.push(kind);
    bytes.extend(((body.len() + data.len()) as u64).to_le_bytes());
    bytes.extend(body);
    bytes.extend(data);
    Ok(())
}
