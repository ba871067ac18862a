//! What a player must know before it plays: where a recording ends and which topics it has.
//!
//! From the index, which takes no time, where the recording has one; by reading all of it where it was torn.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

use posed_drivers::Timestamp;

use super::chunks::Chunks;
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
        if let Some(chunks) = Chunks::read(path)? {
            let topics = chunks.topics().map(str::to_owned).collect();
            return Ok(Self { end: chunks.end(), topics });
        }
        let info = Info::read(path, |_| ())?;
        let duration = Duration::try_from_secs_f64(info.duration_s).unwrap_or_default();
        let begun = Reader::open(path)?.header().begun;
        Ok(Self { end: begun + duration, topics: info.topics.into_keys().collect() })
    }
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
        assert!(Chunks::read(&path).unwrap().is_some() && Chunks::read(&torn).unwrap().is_none());
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
