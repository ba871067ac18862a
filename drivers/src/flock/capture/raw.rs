//! Captures of the unit's bytes alone: the records themselves must say what they are.
//!
//! Pieces are cut at bytes with bit 7 set. Of all ways to read them (group mode or not, button bytes or
//! not, a format for each address) the one that makes sense of most bytes wins; a tie is reported.

use std::collections::BTreeMap;

use super::{BUTTONS, CaptureError, CapturedRecord, Decoded, Options, Summary};
use crate::flock::wire::record::{self, PHASE_BIT};
use crate::flock::wire::{Format, Record, Scale, Shape, Tolerance};

/// One way to read a capture.
#[derive(Clone, Debug)]
struct Reading {
    shapes: BTreeMap<u8, Shape>,
    records: u64,
    /// Addresses whose format is one of several that fit equally well.
    ambiguous: Vec<(u8, Format, Format)>,
}

/// Decodes raw bytes: records in order, without times, and counts. What could be read in more than one way is in the warnings.
///
/// # Errors
/// [`CaptureError::NoRecords`]: no way of reading gives a single record; so for an empty file.
pub fn decode(file: &[u8], options: Options) -> Result<Decoded, CaptureError> {
    let pieces: Vec<&[u8]> = cut(file);
    let scale =
        Scale { range: options.range.unwrap_or_default(), quaternion_sense: options.quaternion_sense };
    let mut best: Option<Reading> = None;
    let mut rivals = 0;
    for (group, button) in [(false, false), (true, false), (false, true), (true, true)] {
        let reading = read(&pieces, group, button, options.format, scale);
        match &best {
            Some(best) if reading.records < best.records => {}
            Some(best) if reading.records == best.records => rivals += 1,
            _ => {
                best = Some(reading);
                rivals = 0;
            }
        }
    }
    let Some(reading) = best.filter(|reading| reading.records > 0) else {
        return Err(CaptureError::NoRecords);
    };
    let mut decoded = Decoded { range: scale.range, ..Decoded::default() };
    let mut summary = Summary { bytes_skipped: file.len() as u64, ..Summary::default() };
    for piece in &pieces {
        match interpret(piece, &reading.shapes, scale) {
            Some((shape, record)) => {
                summary.records += 1;
                summary.bytes_skipped -= piece.len() as u64;
                let address = record.address.unwrap_or(0);
                decoded.records.push(CapturedRecord { t: None, address, format: shape.format, record });
            }
            None => summary.rejected += 1,
        }
    }
    decoded.summary = summary;
    if rivals > 0 {
        decoded.warnings.push(
            "the records can be read with or without button and address bytes; without is shown".into(),
        );
    }
    for (address, shown, other) in reading.ambiguous {
        decoded.warnings.push(format!(
            "bird {address}: the records fit both {shown} and {other}; {shown} is shown, name the format to decide"
        ));
    }
    Ok(decoded)
}

/// Pieces that begin at a byte with bit 7; what comes before the first belongs to none.
fn cut(file: &[u8]) -> Vec<&[u8]> {
    let starts: Vec<usize> = (0..file.len()).filter(|&i| file[i] & PHASE_BIT != 0).collect();
    let ends = starts.iter().skip(1).copied().chain([file.len()]);
    starts.iter().zip(ends).map(|(&start, end)| &file[start..end]).collect()
}

/// Reads with this choice of tail bytes; each address gets the format that fits most of its pieces.
fn read(pieces: &[&[u8]], group: bool, button: bool, format: Option<Format>, scale: Scale) -> Reading {
    let mut by_address: BTreeMap<u8, Vec<&[u8]>> = BTreeMap::new();
    for piece in pieces {
        match (group, piece.last()) {
            (true, Some(&address)) if (1..=126).contains(&address) && piece.len() > 1 => {
                by_address.entry(address).or_default().push(piece);
            }
            (false, _) => by_address.entry(0).or_default().push(piece),
            _ => {}
        }
    }
    let mut reading = Reading { shapes: BTreeMap::new(), records: 0, ambiguous: Vec::new() };
    for (address, pieces) in by_address {
        let fits = |format: Format| {
            let shape = Shape { format, button, group };
            pieces.iter().filter(|piece| decode_one(piece, shape, scale).is_some()).count() as u64
        };
        let candidates: Vec<Format> = format.map_or_else(|| by_evidence().to_vec(), |format| vec![format]);
        let counted: Vec<(Format, u64)> =
            candidates.into_iter().map(|format| (format, fits(format))).collect();
        let most = counted.iter().map(|&(_, count)| count).max().unwrap_or(0);
        // A lone piece that happens to fit is no bird, where others make a stream.
        if most == 0 || (group && most * 50 < pieces.len() as u64) {
            continue;
        }
        let mut winners = counted.into_iter().filter(|&(_, count)| count == most).map(|(format, _)| format);
        let Some(winner) = winners.next() else { continue };
        // A norm of one in every record is no accident; words that may be anything can be anything.
        let proven = winner.has_orientation() && !matches!(winner, Format::Angles | Format::PositionAngles);
        if let (Some(other), false) = (winners.next(), proven) {
            reading.ambiguous.push((address, winner, other));
        }
        reading.records += most;
        reading.shapes.insert(address, Shape { format: winner, button, group });
    }
    reading
}

/// Formats, those that prove themselves first.
const fn by_evidence() -> [Format; 7] {
    [
        Format::PositionMatrix,
        Format::Matrix,
        Format::PositionQuaternion,
        Format::Quaternion,
        Format::PositionAngles,
        Format::Position,
        Format::Angles,
    ]
}

fn interpret(piece: &[u8], shapes: &BTreeMap<u8, Shape>, scale: Scale) -> Option<(Shape, Record)> {
    let group = shapes.values().next()?.group;
    let shape = *shapes.get(if group { piece.last()? } else { &0 })?;
    Some((shape, decode_one(piece, shape, scale)?))
}

fn decode_one(piece: &[u8], shape: Shape, scale: Scale) -> Option<Record> {
    let record = record::decode(piece, shape, scale, Tolerance::CAPTURE).ok()?;
    record.button.is_none_or(|button| BUTTONS.contains(&button)).then_some(record)
}
