//! What can be said of a recording at once, whatever its length: from its end, which says where its few records outside of chunks are.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use mcap::records::{Metadata, Record, op};
use posed_drivers::Timestamp;
use serde::Deserialize;

use super::digest;
use super::ending::ReadError;
use super::header::METADATA;
use super::info::rfc3339;
use super::reader::Reader;
use super::records::parse;
use super::summary::{FOOTER, OFFSETS, footer};
use posed_protocol::{DigestCounts, Picture};

/// Longest part of the index that is looked at, bytes: those of many attachments and channels.
const MOST_BYTES: u64 = 1 << 20;

/// A recording in a few words.
#[derive(Clone, Debug, PartialEq)]
pub struct Brief {
    /// The stage's name.
    pub stage: String,
    /// UTC of its beginning, ns since 1970.
    pub begun_utc_ns: i64,
    /// Stage time of its beginning.
    pub begun: Timestamp,
    /// From there to its last message, s; `None` without an index.
    pub length_s: Option<f64>,
    /// What its digest counts, where it has one.
    pub counts: Option<DigestCounts>,
    /// The digest's picture.
    pub picture: Option<Picture>,
}

/// What is wanted of a digest here; the rest is passed over.
#[derive(Deserialize)]
struct Glance {
    counts: DigestCounts,
    picture: Picture,
}

impl Brief {
    /// Reads the end of a recording, or the beginning of one that was torn.
    ///
    /// # Errors
    /// It cannot be opened, or is no recording.
    pub fn read(path: &Path) -> Result<Self, ReadError> {
        let mut file = File::open(path)?;
        let ends = Ends::read(&mut file)?;
        let front = match &ends {
            Some(ends) => ends.front(&mut file)?,
            None => None,
        };
        let Front { stage, epoch_utc_ns, begun } = match front {
            Some(front) => front,
            None => Front::of_torn(path)?,
        };
        let begun_utc_ns = epoch_utc_ns.saturating_add(begun.as_nanos());
        let length_s = ends.and_then(|ends| ends.end_utc_ns).map(|end_utc_ns| {
            let end = (end_utc_ns as i64).wrapping_sub(epoch_utc_ns);
            Timestamp::from_nanos(end).seconds_since(begun).max(0.0)
        });
        let glance: Option<Glance> = digest::read(path)?;
        let (counts, picture) = glance.map(|glance| (glance.counts, glance.picture)).unzip();
        Ok(Self { stage, begun_utc_ns, begun, length_s, counts, picture })
    }

    /// Whether it has an index.
    pub fn is_complete(&self) -> bool {
        self.length_s.is_some()
    }

    /// UTC of its beginning as RFC 3339.
    pub fn utc(&self) -> String {
        rfc3339(self.begun_utc_ns)
    }
}

/// What the front part says, shortly.
struct Front {
    stage: String,
    epoch_utc_ns: i64,
    begun: Timestamp,
}

impl Front {
    fn of_torn(path: &Path) -> Result<Self, ReadError> {
        let reader = Reader::open(path)?;
        let header = reader.header();
        Ok(Self { stage: header.stage.clone(), epoch_utc_ns: header.epoch_utc_ns, begun: header.begun })
    }

    /// `None` of another version's metadata.
    fn of(metadata: &Metadata) -> Option<Self> {
        let text = |key: &str| metadata.metadata.get(key);
        let number = |key: &str| text(key)?.parse().ok();
        let begun = Timestamp::from_nanos(number("begun_ns")?);
        Some(Self { stage: text("stage")?.clone(), epoch_utc_ns: number("epoch_utc_ns")?, begun })
    }
}

/// What the end of a file says, without the records of its chunks.
pub(super) struct Ends {
    /// Of the last message, ns of UTC.
    end_utc_ns: Option<u64>,
    /// Name, place and length of each record outside of chunks.
    attachments: Vec<(String, u64, u64)>,
    metadata: Vec<(String, u64, u64)>,
}

impl Ends {
    /// `None` of a file without an index, or with one of another form.
    pub(super) fn read(file: &mut File) -> io::Result<Option<Self>> {
        let Some(footer) = footer(file)? else { return Ok(None) };
        let place = footer[OFFSETS].try_into().map_or(0, u64::from_le_bytes);
        let end = file.metadata()?.len() - FOOTER as u64;
        if !(1..end).contains(&place) {
            return Ok(None);
        }
        let mut ends = Self { end_utc_ns: None, attachments: Vec::new(), metadata: Vec::new() };
        let Some(offsets) = part(file, place, end - place)? else { return Ok(None) };
        for (opcode, offset) in records(&offsets) {
            let (op::SUMMARY_OFFSET, [kind, place @ ..]) = (opcode, offset) else { continue };
            let (Some(at), Some(length)) = (number(place, 0), number(place, 8)) else { return Ok(None) };
            if !matches!(*kind, op::STATISTICS | op::ATTACHMENT_INDEX | op::METADATA_INDEX) {
                continue;
            }
            let Some(group) = part(file, at, length)? else { return Ok(None) };
            if records(&group).any(|(opcode, data)| ends.take(opcode, data).is_none()) {
                return Ok(None);
            }
        }
        Ok(Some(ends))
    }

    fn take(&mut self, opcode: u8, data: &[u8]) -> Option<()> {
        match parse(opcode, data).ok()? {
            Record::Statistics(statistics) => self.end_utc_ns = Some(statistics.message_end_time),
            Record::AttachmentIndex(index) => {
                self.attachments.push((index.name, index.offset, index.length));
            }
            Record::MetadataIndex(index) => self.metadata.push((index.name, index.offset, index.length)),
            _ => {}
        }
        Some(())
    }

    fn front(&self, file: &mut File) -> io::Result<Option<Front>> {
        let Some((_, at, length)) = self.metadata.iter().find(|(name, ..)| name == METADATA) else {
            return Ok(None);
        };
        let record = part(file, *at, *length)?;
        Ok(record.as_deref().and_then(|record| match records(record).next()? {
            (opcode @ op::METADATA, data) => match parse(opcode, data).ok()? {
                Record::Metadata(metadata) => Front::of(&metadata),
                _ => None,
            },
            _ => None,
        }))
    }

    /// The attachment of that name, which has so many bytes at most.
    pub(super) fn attachment(&self, file: &mut File, name: &str, most: u64) -> io::Result<Option<Vec<u8>>> {
        let Some((_, at, length)) = self.attachments.iter().find(|(known, ..)| known == name) else {
            return Ok(None);
        };
        let Some(record) = part_of(file, *at, *length, most)? else { return Ok(None) };
        Ok(records(&record).next().and_then(|(opcode, data)| match parse(opcode, data).ok()? {
            Record::Attachment { data, .. } => Some(data.into_owned()),
            _ => None,
        }))
    }
}

fn part(file: &mut File, at: u64, length: u64) -> io::Result<Option<Vec<u8>>> {
    part_of(file, at, length, MOST_BYTES)
}

/// So many bytes of a file; `None` where they are not there, or more than `most`.
fn part_of(file: &mut File, at: u64, length: u64, most: u64) -> io::Result<Option<Vec<u8>>> {
    let ends = at.checked_add(length);
    if length > most || ends.is_none_or(|ends| file.metadata().map_or(true, |known| ends > known.len())) {
        return Ok(None);
    }
    file.seek(SeekFrom::Start(at))?;
    let mut bytes = vec![0; length as usize];
    file.read_exact(&mut bytes)?;
    Ok(Some(bytes))
}

/// Kind and bytes of each record; ends where one is not whole.
fn records(mut bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    std::iter::from_fn(move || {
        let (kind, rest) = bytes.split_first()?;
        let length = usize::try_from(number(rest, 0)?).ok()?;
        let (data, rest) = rest.get(8..)?.split_at_checked(length)?;
        bytes = rest;
        Some((*kind, data))
    })
}

fn number(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_le_bytes(bytes.get(at..at + 8)?.try_into().ok()?))
}
