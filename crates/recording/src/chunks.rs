//! Where a recording can be read from beside its beginning: its chunks, from its index.

use std::fs::File;
use std::io::{BufReader, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::records::op;

use super::ending::ReadError;
use super::header::Header;
use super::reader::Reader;
use super::records::{Known, Records};
use super::summary::each_record;

/// The chunks of a recording that has an index.
pub struct Chunks {
    path: PathBuf,
    header: Arc<Header>,
    known: Known,
    /// Where each begins in the file, bytes.
    places: Vec<u64>,
}

impl Chunks {
    /// Reads the index; `None` where it has none: a recording that was torn.
    ///
    /// # Errors
    /// It cannot be opened, or is no recording.
    pub fn read(path: &Path) -> Result<Option<Self>, ReadError> {
        let header = Arc::new(Reader::open(path)?.header().clone());
        let (mut known, mut places) = (Known::default(), Vec::new());
        let found = each_record(path, |opcode, data| {
            match opcode {
                op::SCHEMA | op::CHANNEL => known.learn(opcode, data)?,
                // Behind the times of its first and its last message.
                op::CHUNK_INDEX => places.push(u64::from_le_bytes(data.get(16..24)?.try_into().ok()?)),
                _ => {}
            }
            Some(())
        })?;
        if !found {
            return Ok(None);
        }
        places.sort_unstable();
        Ok(Some(Self { path: path.to_owned(), header, known, places }))
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
        file.seek(SeekFrom::Start(self.places[chunk]))?;
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
