//! The end of an MCAP file, where its index stands: read without what lies before.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use mcap::records::op;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

/// Bytes of the last record and of the mark behind it; the place of the index stands after its kind and length.
pub(super) const FOOTER: i64 = 1 + 8 + 20 + mcap::MAGIC.len() as i64;
pub(super) const PLACE: std::ops::Range<usize> = 9..17;
/// The place of what says where its parts are.
pub(super) const OFFSETS: std::ops::Range<usize> = 17..25;

/// The last record of a file and the mark behind it; `None` where that is not there.
pub(super) fn footer(file: &mut File) -> io::Result<Option<[u8; FOOTER as usize]>> {
    let mut footer = [0; FOOTER as usize];
    if file.metadata()?.len() < footer.len() as u64 {
        return Ok(None);
    }
    file.seek(SeekFrom::End(-FOOTER))?;
    file.read_exact(&mut footer)?;
    Ok((footer.ends_with(mcap::MAGIC) && footer[0] == op::FOOTER).then_some(footer))
}

/// Hands over each record of the index by its kind and its bytes. False where there is no index that can be read: torn or damaged, what can be read of the file
/// says more; `each` says so by `None`.
pub(super) fn each_record(
    path: &Path,
    mut each: impl FnMut(u8, &[u8]) -> Option<()>,
) -> Result<bool, io::Error> {
    let mut file = File::open(path)?;
    let bytes = file.metadata()?.len();
    let Some(footer) = footer(&mut file)? else { return Ok(false) };
    let place = footer[PLACE].try_into().map_or(0, u64::from_le_bytes);
    if !(1..bytes).contains(&place) {
        return Ok(false);
    }
    file.seek(SeekFrom::Start(place))?;
    // It is asked for a record's few bytes at a time, of some thousands an hour.
    let mut file = BufReader::with_capacity(1 << 16, file);
    let longest = usize::try_from(bytes - place).unwrap_or(usize::MAX);
    let options =
        LinearReaderOptions::default().with_skip_start_magic(true).with_record_length_limit(longest);
    let mut reader = LinearReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(wanted)) => {
                let read = file.read(reader.insert(wanted))?;
                reader.notify_read(read);
            }
            Ok(LinearReadEvent::Record { opcode, data }) => {
                if each(opcode, data).is_none() {
                    return Ok(false);
                }
            }
            Err(_) => return Ok(false),
        }
    }
    Ok(true)
}
