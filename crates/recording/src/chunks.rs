//! Where a recording can be read from beside its beginning: its chunks, from its index.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::records::{Record, op};
use posed_drivers::Timestamp;

use super::ending::ReadError;
use super::header::Header;
use super::reader::Reader;
use super::records::{Known, Record as Of, Records, parse};
use super::summary::each_record;

/// The chunks of a recording that has an index.
pub struct Chunks {
    path: PathBuf,
    header: Arc<Header>,
    known: Known,
    /// Stage time of the last entry or message.
    end: Timestamp,
    /// In the order of the file.
    places: Vec<Place>,
}

/// Where a chunk is, in the file and in time.
#[derive(Clone, Copy)]
struct Place {
    begins_byte: u64,
    bytes: u64,
    /// Of its first and its last message by time, ns of UTC.
    from_utc_ns: u64,
    to_utc_ns: u64,
}

impl Place {
    fn of(index: &[u8]) -> Option<Self> {
        let number = |at: usize| Some(u64::from_le_bytes(index.get(at..at + 8)?.try_into().ok()?));
        Some(Self {
            from_utc_ns: number(0)?,
            to_utc_ns: number(8)?,
            begins_byte: number(16)?,
            bytes: number(24)?,
        })
    }
}

impl Chunks {
    /// Reads the index; `None` where it has none: a recording that was torn.
    ///
    /// # Errors
    /// It cannot be opened, or is no recording.
    pub fn read(path: &Path) -> Result<Option<Self>, ReadError> {
        let header = Arc::new(Reader::open(path)?.header().clone());
        let (mut known, mut places, mut end_ns) = (Known::default(), Vec::new(), None);
        let found = each_record(path, |opcode, data| {
            match opcode {
                op::SCHEMA | op::CHANNEL => known.learn(opcode, data)?,
                op::CHUNK_INDEX => places.push(Place::of(data)?),
                op::STATISTICS => match parse(opcode, data).ok()? {
                    Record::Statistics(statistics) => end_ns = Some(statistics.message_end_time),
                    _ => return None,
                },
                _ => {}
            }
            Some(())
        })?;
        let Some(end_ns) = end_ns.filter(|_| found) else { return Ok(None) };
        places.sort_unstable_by_key(|place: &Place| place.begins_byte);
        let end = header.stage_time(end_ns).max(header.begun);
        Ok(Some(Self { path: path.to_owned(), header, known, end, places }))
    }

    /// What stands in front.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Stage time of the last entry or message.
    pub fn end(&self) -> Timestamp {
        self.end
    }

    /// All MCAP topics of the recording.
    pub fn topics(&self) -> impl Iterator<Item = &str> {
        self.known.topics()
    }

    /// The channel of an MCAP topic.
    pub(super) fn channel_of(&self, topic: &str) -> Option<u16> {
        self.known.channel_of(topic)
    }

    /// Stage times of the first and the last message of each chunk, by time, in the order of the file.
    pub(super) fn times(&self) -> impl ExactSizeIterator<Item = (Timestamp, Timestamp)> {
        let of = |utc_ns| self.header.stage_time(utc_ns);
        self.places.iter().map(move |place| (of(place.from_utc_ns), of(place.to_utc_ns)))
    }

    /// Gives `each` the messages of one channel in a chunk: stage time and bytes.
    pub(super) fn messages(
        &self,
        chunk: usize,
        channel: u16,
        mut each: impl FnMut(Timestamp, &[u8]),
    ) -> Result<(), ReadError> {
        let Some(Place { begins_byte, bytes, .. }) = self.places.get(chunk).copied() else { return Ok(()) };
        let mut file = File::open(&self.path)?;
        file.seek(SeekFrom::Start(begins_byte))?;
        let mut records = Records::resumed(file.take(bytes), self.known.clone());
        while let Some(record) = records.next()? {
            if let Of::Message(message) = record
                && message.channel.id == channel
            {
                each(self.header.stage_time(message.log_time), &message.data);
            }
        }
        Ok(())
    }

    /// Reads on from entry number `entry`, counted from 0; `None` where there is no such entry. Looks into some ten chunks.
    ///
    /// # Errors
    /// It cannot be read there.
    pub fn reader(&self, entry: u32) -> Result<Option<Reader<BufReader<File>>>, ReadError> {
        // Entries are numbered in the order of the file; their times may be a little out of it.
        let (mut begins, mut behind) = (0, self.places.len());
        while behind - begins > 1 {
            let middle = begins.midpoint(behind);
            match self.at(middle)?.first_entry()? {
                Some(first) if first <= entry => begins = middle,
                _ => behind = middle,
            }
        }
        if self.places.is_empty() {
            return Ok(None);
        }
        let mut reader = self.at(begins)?;
        Ok(reader.pass_to(entry)?.then_some(reader))
    }

    fn at(&self, chunk: usize) -> Result<Reader<BufReader<File>>, ReadError> {
        let mut file = File::open(&self.path)?;
        file.seek(SeekFrom::Start(self.places[chunk].begins_byte))?;
        let source = BufReader::with_capacity(1 << 16, file);
        Ok(Reader::resumed(Records::resumed(source, self.known.clone()), Arc::clone(&self.header)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{chunk, header};
    use crate::{Item, Writer};
    use posed_stage::RecordingContent;
    use posed_stage::input::Entry;

    fn entries(reader: impl Iterator<Item = Result<Item, ReadError>>) -> Vec<Entry> {
        reader
            .filter_map(|item| match item.unwrap() {
                Item::Entry(entry) => Some(entry),
                _ => None,
            })
            .collect()
    }

    #[test]
    fn a_recording_is_read_on_from_any_entry() {
        let folder = tempfile::tempdir().unwrap();
        for content in [RecordingContent::Log, RecordingContent::Full] {
            let path = folder.path().join(format!("{content:?}.mcap"));
            let header = Header { content, ..header() };
            let mut writer = Writer::new(File::create(&path).unwrap(), header).unwrap();
            for n in 0..40 {
                writer.entry(&chunk(n * 1000)).unwrap();
                if n % 7 == 6 {
                    writer.flush().unwrap();
                }
            }
            let torn = folder.path().join("torn.mcap");
            std::fs::copy(&path, &torn).unwrap();
            writer.finish("enough").unwrap();
            assert!(Chunks::read(&torn).unwrap().is_none());

            let all = entries(Reader::open(&path).unwrap());
            assert_eq!(all.len(), 40);
            let chunks = Chunks::read(&path).unwrap().unwrap();
            for number in 0..all.len() {
                let reader = chunks.reader(number as u32).unwrap().unwrap();
                assert_eq!(entries(reader), all[number..], "{content:?} {number}");
            }
            assert!(chunks.reader(40).unwrap().is_none());
        }
    }
}
