//! The log through a recording on a disk that ends: what is read back is the log's beginning, to the last second that was flushed.

use std::io::{self, Write};

use posed_recording::{Header, Item, Reader, Writer};
use posed_stage::Stage;
use posed_stage::input::{Entry, Input};

use crate::dice::Dice;

/// Takes so many bytes, and then nothing more.
struct Ending {
    bytes: Vec<u8>,
    room: usize,
}

impl Write for Ending {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let taken = bytes.len().min(self.room - self.bytes.len());
        if taken == 0 && !bytes.is_empty() {
            return Err(io::ErrorKind::StorageFull.into());
        }
        self.bytes.extend_from_slice(&bytes[..taken]);
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Entries as they are compared: numbers that are none are equal, too.
fn words(entry: &Entry) -> String {
    format!("{entry:?}")
}

/// # Errors
/// A sentence: which entry is not there, or another one.
pub(crate) fn holds(stage_toml: &str, log: &[Entry], dice: &mut Dice) -> Result<(), String> {
    let stage = Stage::parse(stage_toml).map_err(|error| error.to_string())?;
    let header = Header::new(&stage, stage_toml, 1_700_000_000_000_000_000);
    let known = |entry: &Entry| match entry.input {
        Input::Bytes { device, .. } | Input::Line { device, .. } => usize::from(device) < stage.devices.len(),
        _ => true,
    };
    let size: usize = log
        .iter()
        .map(|entry| 16 + if let Input::Bytes { bytes, .. } = &entry.input { bytes.len() } else { 8 })
        .sum();
    let room = 8_000 + dice.below(size + size / 2);
    let mut sink = Ending { bytes: Vec::new(), room };
    let (mut flushed, mut taken) = (0, 0);
    if let Ok(mut writer) = Writer::new(&mut sink, header) {
        let mut second = 0;
        for entry in log {
            if !known(entry) {
                continue;
            }
            if writer.entry(entry).is_err() {
                break;
            }
            taken += 1;
            if entry.t.as_nanos() / 1_000_000_000 > second {
                second = entry.t.as_nanos() / 1_000_000_000;
                if writer.flush().is_err() {
                    break;
                }
                flushed = taken;
            }
        }
    } else {
        return Ok(());
    }
    let file = sink.bytes;
    let reader =
        Reader::new(file.as_slice(), file.len() as u64).map_err(|error| format!("its recording: {error}"))?;
    let mut read = 0;
    let mut expected = log.iter().filter(|entry| known(entry));
    for item in reader {
        let item = item.map_err(|error| format!("its recording, cut at {room}: {error}"))?;
        let Item::Entry(entry) = item else { continue };
        if expected.next().map(words) != Some(words(&entry)) {
            return Err(format!("entry {read} of its recording is another one"));
        }
        read += 1;
    }
    if read < flushed {
        return Err(format!(
            "its recording, cut at {room}, has {read} of {flushed} entries that were flushed"
        ));
    }
    Ok(())
}
