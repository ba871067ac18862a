//! What a player must know before it plays: where a recording ends and which topics it has.
//!
//! From the index, which takes no time, where the recording has one; by reading all of it where it was torn.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{Read, Seek};
use std::path::Path;
use std::time::Duration;

use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use posed_drivers::Timestamp;

use super::ending::ReadError;
use super::info::Info;
use super::reader::Reader;

/// End and topics of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outline {
    /// Stage time of its last entry or message.
    pub end: Timestamp,
    /// Its MCAP topics; those for viewers only where they come from the index.
    pub topics: BTreeSet<String>,
}

impl Outline {
    /// Reads the index, or the whole recording where it has none.
    ///
    /// # Errors
    /// It cannot be opened, or is no recording.
    pub fn read(path: &Path) -> Result<Self, ReadError> {
        let header = Reader::open(path)?.header().clone();
        if let Some(summary) = index(path)?
            && let Some(statistics) = &summary.stats
        {
            let topics = summary.channels.values().map(|channel| channel.topic.clone()).collect();
            let end = header.stage_time(statistics.message_end_time).max(header.begun);
            return Ok(Self { end, topics });
        }
        let info = Info::read(path, |_| ())?;
        let duration = Duration::try_from_secs_f64(info.duration_s).unwrap_or_default();
        Ok(Self { end: header.begun + duration, topics: info.topics.into_keys().collect() })
    }
}

/// The index at the end of the file; `None` where there is none that can be read.
fn index(path: &Path) -> Result<Option<mcap::Summary>, ReadError> {
    let mut file = File::open(path)?;
    let options = SummaryReaderOptions::default().with_file_size(file.metadata()?.len());
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event {
            Ok(SummaryReadEvent::ReadRequest(bytes)) => {
                let read = file.read(reader.insert(bytes))?;
                reader.notify_read(read);
            }
            Ok(SummaryReadEvent::SeekRequest(to)) => reader.notify_seeked(file.seek(to)?),
            // Torn or damaged: what can be read of it says more.
            Err(_) => return Ok(None),
        }
    }
    Ok(reader.finish())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Writer;
    use crate::testing::{chunk, header};

    #[test]
    fn index_and_reading_through_agree_and_a_torn_recording_has_an_outline_too() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let mut writer = Writer::new(File::create(&path).unwrap(), header()).unwrap();
        for n in 0..50 {
            writer.entry(&chunk(n)).unwrap();
            writer.message("sensors", Timestamp::from_nanos(n + 5), b"{}").unwrap();
        }
        writer.flush().unwrap();
        let torn = folder.path().join("torn.mcap");
        std::fs::copy(&path, &torn).unwrap();
        writer.finish("enough").unwrap();
        assert!(index(&path).unwrap().is_some() && index(&torn).unwrap().is_none());
        let outline = Outline::read(&path).unwrap();
        assert!(outline.topics.contains("/posed/sensors"), "{outline:?}");
        let through = Outline::read(&torn).unwrap();
        assert_eq!(outline.end, through.end);
        assert!(through.topics.is_subset(&outline.topics));
        std::fs::write(&torn, "nothing").unwrap();
        assert!(Outline::read(&torn).is_err());
    }
}
