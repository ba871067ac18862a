//! What a player must know before it plays: where a recording ends and which topics it has.
//!
//! From the index, which takes no time, where the recording has one; by reading all of it where it was torn.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

use mcap::records::{Record, op};
use posed_drivers::Timestamp;

use super::ending::ReadError;
use super::info::Info;
use super::reader::Reader;
use super::records::parse;
use super::summary::each_record;

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
        if let Some(Index { end_ns, topics }) = index(path)? {
            let end = header.stage_time(end_ns).max(header.begun);
            return Ok(Self { end, topics });
        }
        let info = Info::read(path, |_| ())?;
        let duration = Duration::try_from_secs_f64(info.duration_s).unwrap_or_default();
        Ok(Self { end: header.begun + duration, topics: info.topics.into_keys().collect() })
    }
}

/// What the index says.
struct Index {
    /// Time of the last message, ns of UTC.
    end_ns: u64,
    topics: BTreeSet<String>,
}

/// The index at the end of the file; `None` where there is none that can be read.
fn index(path: &Path) -> Result<Option<Index>, ReadError> {
    let (mut topics, mut end_ns) = (BTreeSet::new(), None);
    let found = each_record(path, |opcode, data| {
        if matches!(opcode, op::CHANNEL | op::STATISTICS) {
            match parse(opcode, data).ok()? {
                Record::Channel(channel) => _ = topics.insert(channel.topic),
                Record::Statistics(statistics) => end_ns = Some(statistics.message_end_time),
                _ => return None,
            }
        }
        Some(())
    })?;
    Ok(end_ns.filter(|_| found).map(|end_ns| Index { end_ns, topics }))
}

#[cfg(test)]
mod tests {
    use std::fs::File;

    use super::*;
    use crate::Writer;
    use crate::summary::{FOOTER, PLACE};
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
        // An index that claims to be nowhere.
        let mut bytes = std::fs::read(&path).unwrap();
        let place = bytes.len() - FOOTER as usize + PLACE.start;
        for claimed in [0, 1, u64::MAX, i64::MAX as u64, bytes.len() as u64] {
            bytes[place..place + 8].copy_from_slice(&claimed.to_le_bytes());
            std::fs::write(&torn, &bytes).unwrap();
            assert_eq!(Outline::read(&torn).unwrap().end, through.end, "{claimed}");
        }
        std::fs::write(&torn, "nothing").unwrap();
        assert!(Outline::read(&torn).is_err());
    }
}
