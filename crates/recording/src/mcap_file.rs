//! An MCAP file of any length, written in little memory.
//!
//! The library's writer keeps a quarter of a kilobyte of each chunk for the index: 49 MB for a day of two chunks a second, and as much
//! again while the index is written. Therefore the file is written in **stretches**: each is what one writer of the library makes,
//! without its front and its end, and begins with the channels known by then, as the format allows. What a stretch adds to the
//! index goes to [`Index`], and from there to the end of the file.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Channel, Compression, McapError, WriteOptions};

use super::index::Index;
use super::sink::{Gate, Sink};

/// Uncompressed bytes after which a chunk is closed by itself.
pub(super) const CHUNK_BYTES: u64 = 1 << 20;
/// Chunks of a stretch: two minutes, two a second.
const STRETCH_CHUNKS: u32 = 256;

type Stretch<W> = mcap::Writer<Sink<W>>;

/// Writes an MCAP file; after an error, nothing more.
pub(super) struct McapFile<W: Write> {
    /// What is being written; gone after an error between two stretches.
    stretch: Option<Stretch<W>>,
    stretch_chunks: u32,
    /// Chunks in this stretch that are closed, and bytes of the messages in the one that is not.
    chunks: u32,
    open_bytes: u64,
    channels: BTreeMap<u16, Arc<Channel<'static>>>,
    index: Index,
    gate: Gate,
}

impl<W: Write> McapFile<W> {
    /// Begins a file.
    pub(super) fn new(sink: W) -> Result<Self, McapError> {
        Self::with_stretches_of(STRETCH_CHUNKS, sink)
    }

    fn with_stretches_of(stretch_chunks: u32, sink: W) -> Result<Self, McapError> {
        let gate = Gate::default();
        let stretch = Some(options().create(Sink::new(sink, gate.clone()))?);
        let (channels, index) = (BTreeMap::new(), Index::default());
        Ok(Self { stretch, stretch_chunks, chunks: 0, open_bytes: 0, channels, index, gate })
    }

    /// Lets the index wait in a file of `folder` that has no name, where it would take memory.
    pub(super) fn keep_index_in(&mut self, folder: &Path) {
        self.index.keep_in(folder);
    }

    pub(super) fn attach(&mut self, attachment: &Attachment<'_>) -> Result<(), McapError> {
        self.stretch()?.attach(attachment)
    }

    pub(super) fn write_metadata(&mut self, metadata: &Metadata) -> Result<(), McapError> {
        self.stretch()?.write_metadata(metadata)
    }

    /// Makes a channel known, with its schema; one that is known already is passed over.
    pub(super) fn declare(&mut self, channel: &Arc<Channel<'static>>) -> Result<(), McapError> {
        if !self.channels.contains_key(&channel.id) {
            declare(self.stretch()?, channel)?;
            self.channels.insert(channel.id, Arc::clone(channel));
        }
        Ok(())
    }

    /// Appends a message of a declared channel.
    pub(super) fn write(&mut self, header: &MessageHeader, data: &[u8]) -> Result<(), McapError> {
        if self.open_bytes > CHUNK_BYTES {
            self.close_chunk();
        }
        if self.chunks >= self.stretch_chunks {
            self.begin_stretch()?;
        }
        self.open_bytes += data.len() as u64 + 1;
        self.stretch()?.write_to_known_channel(header, data)
    }

    /// Ends the chunk and hands everything to the sink.
    pub(super) fn flush(&mut self) -> Result<(), McapError> {
        self.close_chunk();
        self.stretch()?.flush()
    }

    /// Ends the file with its index, and gives the sink back, flushed.
    pub(super) fn finish(mut self) -> Result<W, McapError> {
        let mut sink = self.end_stretch()?;
        self.index.write(&mut sink, &self.channels)?;
        sink.flush()?;
        Ok(sink.into_inner())
    }

    /// Counts the bytes that the sink has taken.
    pub(super) fn byte_counter(&self) -> &Arc<AtomicU64> {
        &self.gate.bytes
    }

    fn stretch(&mut self) -> Result<&mut Stretch<W>, McapError> {
        self.stretch.as_mut().ok_or(McapError::AttemptedWriteAfterFailure)
    }

    fn close_chunk(&mut self) {
        self.chunks += u32::from(self.open_bytes > 0);
        self.open_bytes = 0;
    }

    fn begin_stretch(&mut self) -> Result<(), McapError> {
        let sink = self.end_stretch()?;
        self.gate.close(true);
        let stretch = self.stretch.insert(options().create(sink)?);
        self.gate.close(false);
        (self.chunks, self.open_bytes) = (0, 0);
        self.channels.values().try_for_each(|channel| declare(stretch, channel))
    }

    fn end_stretch(&mut self) -> Result<Sink<W>, McapError> {
        self.stretch()?.flush()?;
        self.gate.close(true);
        let mut stretch = self.stretch.take().ok_or(McapError::AttemptedWriteAfterFailure)?;
        let summary = stretch.finish()?;
        let sink = stretch.into_inner();
        self.gate.close(false);
        self.index.append(summary)?;
        Ok(sink)
    }
}

impl<W: Write> Drop for McapFile<W> {
    /// A file that nobody has finished stays a readable prefix: the library would write an index of the last stretch.
    fn drop(&mut self) {
        if let Some(stretch) = &mut self.stretch {
            let _ = stretch.flush();
        }
        self.gate.close(true);
    }
}

fn declare<W: Write>(stretch: &mut Stretch<W>, channel: &Channel<'static>) -> Result<(), McapError> {
    if let Some(schema) = &channel.schema {
        stretch.add_schema_with_id(schema.id, &schema.name, &schema.encoding, &schema.data)?;
    }
    let schema = channel.schema.as_ref().map_or(0, |schema| schema.id);
    let Channel { id, topic, message_encoding, metadata, .. } = channel;
    stretch.add_channel_with_id(*id, schema, topic, message_encoding, metadata).map(drop)
}

/// How every file of ours is written.
fn options() -> WriteOptions {
    WriteOptions::new()
        .profile("posed")
        .library(concat!("posed ", env!("CARGO_PKG_VERSION")))
        .compression(Some(Compression::Zstd))
        // In the caller's thread: the others have work of their own.
        .compression_threads(0)
        .chunk_size(Some(CHUNK_BYTES))
        // Nothing behind the end of the file is ever patched: see the module's doc.
        .disable_seeking(true)
        // Of the whole file, and so not of a stretch.
        .calculate_data_section_crc(false)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering;

    use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
    use mcap::{MessageStream, Schema, Summary};

    use super::*;

    fn channel(id: u16, schema: Option<Arc<Schema<'static>>>) -> Arc<Channel<'static>> {
        let (topic, message_encoding) = (format!("/{id}"), "json".to_owned());
        Arc::new(Channel { id, topic, schema, message_encoding, metadata: BTreeMap::new() })
    }

    /// Twenty chunks of two messages each, from 1000 ns down to 962 ns; the second channel comes late.
    fn written(stretch_chunks: u32) -> Vec<u8> {
        let data = vec![b' '; 3].into();
        let schema =
            Arc::new(Schema { id: 7, name: "s".to_owned(), encoding: "jsonschema".to_owned(), data });
        let (first, second) = (channel(3, Some(schema)), channel(9, None));
        let mut file = McapFile::with_stretches_of(stretch_chunks, Vec::new()).unwrap();
        let metadata = |name: &str| Metadata { name: name.to_owned(), metadata: BTreeMap::new() };
        file.write_metadata(&metadata("begin")).unwrap();
        for n in 0..20_u16 {
            for (at, of) in [&first, if n < 10 { &first } else { &second }].into_iter().enumerate() {
                file.declare(of).unwrap();
                let time = 1000 - 2 * u64::from(n);
                let sequence = u32::from(n) * 2 + at as u32;
                let header =
                    MessageHeader { channel_id: of.id, sequence, log_time: time, publish_time: time };
                file.write(&header, &n.to_le_bytes()).unwrap();
            }
            file.flush().unwrap();
        }
        file.write_metadata(&metadata("end")).unwrap();
        let counter = Arc::clone(file.byte_counter());
        let bytes = file.finish().unwrap();
        assert_eq!(counter.load(Ordering::Relaxed), bytes.len() as u64);
        bytes
    }

    fn is_whole(bytes: &[u8]) -> bool {
        let options = LinearReaderOptions::default()
            .with_prevalidate_chunk_crcs(true)
            .with_validate_data_section_crc(true)
            .with_validate_summary_section_crc(true);
        let mut reader = LinearReader::new_with_options(options);
        let mut rest = bytes;
        while let Some(event) = reader.next_event() {
            match event {
                Ok(LinearReadEvent::ReadRequest(wanted)) => {
                    let (now, later) = rest.split_at(wanted.min(rest.len()));
                    reader.insert(now.len()).copy_from_slice(now);
                    reader.notify_read(now.len());
                    rest = later;
                }
                Ok(LinearReadEvent::Record { .. }) => {}
                Err(_) => return false,
            }
        }
        true
    }

    #[test]
    fn a_file_of_many_stretches_has_what_one_of_a_single_stretch_has_and_its_index_finds_all_of_it() {
        let (one, many) = (written(1000), written(3));
        assert!(many.len() > one.len(), "stretches repeat their channels");
        let messages = |bytes: &[u8]| {
            let messages = MessageStream::new(bytes).unwrap().map(Result::unwrap);
            messages.map(|m| (m.channel.clone(), m.sequence, m.log_time, m.data.to_vec())).collect::<Vec<_>>()
        };
        assert_eq!(messages(&one).len(), 40);
        assert_eq!(messages(&one), messages(&many));
        let read = |bytes: &[u8]| Summary::read(bytes).unwrap().unwrap();
        let (expected, summary) = (read(&one), read(&many));
        assert_eq!(expected.stats, summary.stats);
        assert_eq!(expected.channels, summary.channels);
        assert_eq!(expected.schemas, summary.schemas);
        assert_eq!(summary.metadata_indexes.len(), 2);
        let statistics = summary.stats.as_ref().unwrap();
        assert_eq!((statistics.message_count, statistics.chunk_count, statistics.channel_count), (40, 20, 2));
        assert_eq!((statistics.message_start_time, statistics.message_end_time), (962, 1000));
        let found = summary.chunk_indexes.iter().flat_map(|chunk| {
            let by_channel = summary.read_message_indexes(&many, chunk).unwrap();
            assert_eq!(by_channel.values().map(Vec::len).sum::<usize>(), 2);
            summary
                .stream_chunk(&many, chunk)
                .unwrap()
                .map(|message| message.unwrap().sequence)
                .collect::<Vec<_>>()
        });
        assert!(found.eq(0..40));
        for index in &summary.metadata_indexes {
            assert_eq!(mcap::read::metadata(&many, index).unwrap().name, index.name);
        }
    }

    #[test]
    fn a_long_index_waits_in_a_file_without_a_name() {
        let folder = tempfile::tempdir().unwrap();
        let mut file = McapFile::new(Vec::new()).unwrap();
        file.keep_index_in(folder.path());
        let of = channel(3, None);
        file.declare(&of).unwrap();
        for sequence in 0..2000 {
            let time = u64::from(sequence);
            let header = MessageHeader { channel_id: 3, sequence, log_time: time, publish_time: time };
            file.write(&header, b"1").unwrap();
            file.flush().unwrap();
        }
        assert!(!file.index.is_in_memory());
        let bytes = file.finish().unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        assert!(is_whole(&bytes));
        let summary = Summary::read(&bytes).unwrap().unwrap();
        let times = summary.chunk_indexes.iter().map(|chunk| chunk.message_start_time);
        assert!(times.eq(0..2000));
    }

    #[test]
    fn checksums_of_data_and_index_hold() {
        let mut bytes = written(3);
        assert!(is_whole(&bytes));
        for at in [bytes.len() / 4, bytes.len() - 200] {
            bytes[at] ^= 1;
            assert!(!is_whole(&bytes), "{at}");
            bytes[at] ^= 1;
        }
    }

    #[test]
    fn a_file_that_nobody_finishes_is_a_prefix() {
        let whole = written(3);
        let mut bytes = Vec::new();
        let mut file = McapFile::with_stretches_of(3, &mut bytes).unwrap();
        let of = channel(3, None);
        file.declare(&of).unwrap();
        for sequence in 0..10 {
            let header = MessageHeader { channel_id: 3, sequence, log_time: 1, publish_time: 1 };
            file.write(&header, b"1").unwrap();
            if sequence < 9 {
                file.flush().unwrap();
            }
        }
        drop(file);
        assert!(!bytes.ends_with(mcap::MAGIC) && whole.ends_with(mcap::MAGIC));
        let mut records = crate::records::Records::new(&bytes[..], 0);
        let mut messages = 0;
        while records.next().unwrap().is_some() {
            messages += 1;
        }
        assert_eq!((messages, records.ending), (10, Some(crate::Ending::Torn)));
    }
}
