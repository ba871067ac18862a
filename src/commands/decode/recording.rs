//! `posed decode ... -o REC.mcap`: a capture as a recording that info, export and replay take.
//!
//! What comes in: a capture and what was decoded of it. What goes out: its bytes as the input log of a stage that only
//! listens (`mode = "listen"`). What it never does: invent a time without saying so.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::Path;

use posed_drivers::flock::capture::{CapturedRecord, Decoded, log};
use posed_drivers::flock::wire::{QuaternionSense, Range};
use posed_drivers::{LineEvent, Timestamp};
use posed_recording::{Header, Scribe, WriteError};
use posed_stage::Stage;
use posed_stage::input::{Entry, Input};

use super::super::{Error, notify, output};

/// A unit's own rate at power-up, Hz; for captures without times.
const RATE_HZ: f64 = 103.3;
/// Time after the last byte in which the last frame still closes, ns.
const TAIL_NS: i64 = 100_000_000;
/// A byte with this bit begins a record.
const PHASE_BIT: u8 = 0x80;

/// One read or write of the capture.
struct Chunk {
    t: Timestamp,
    to_unit: bool,
    bytes: Vec<u8>,
}

/// Writes the recording.
pub(super) fn write(
    path: &Path,
    file: &[u8],
    decoded: &Decoded,
    sense: QuaternionSense,
) -> Result<(), Error> {
    let (chunks, origin) = chunks(file, decoded)?;
    let text = stage(decoded, sense, &origin)?;
    let stage = Stage::parse(&text).map_err(Error::failed)?;
    let header = Header::new(&stage, &text, 0);
    let mut written = Ok(0);
    output::replace(path, |file| {
        written = log_of(header, &chunks, file);
        match &written {
            Err(error) => Err(std::io::Error::other(error.to_string())),
            Ok(_) => Ok(()),
        }
    })?;
    if written.map_err(Error::failed)? == 0 {
        tracing::warn!(
            "no pose follows from this capture: it is too short for the clock, which needs a second or two of \
             stream; the recording holds its bytes, and -o FILE.csv all records"
        );
    }
    notify(&format!("time 0 of the recording is {origin}"));
    Ok(())
}

/// The capture in pieces with their times, and in words what time 0 is.
fn chunks(file: &[u8], decoded: &Decoded) -> Result<(Vec<Chunk>, String), Error> {
    if log::is_log(file) {
        let lines = log::parse(file).map_err(Error::failed)?;
        let first = lines.first().map(|line| line.t.clone()).unwrap_or_default();
        let origin = nanos(&first);
        let chunk = |line: log::Line| {
            let t = origin.zip(nanos(&line.t)).and_then(|(origin, t)| i64::try_from(t - origin).ok());
            let t =
                Timestamp::from_nanos(t.ok_or_else(|| {
                    Error::Failed(format!("cannot place the time {} after {first}", line.t))
                })?);
            Ok(Chunk { t, to_unit: line.side == log::Side::Host, bytes: line.bytes })
        };
        let chunks = lines.into_iter().map(chunk).collect::<Result<_, Error>>()?;
        return Ok((chunks, format!("{first} of the capture")));
    }
    let group = decoded.records.iter().any(|record| record.record.address.is_some());
    let starts: Vec<usize> = (0..file.len()).filter(|&at| file[at] & PHASE_BIT != 0).collect();
    let ends = starts.iter().skip(1).copied().chain([file.len()]);
    let mut cycle = 0_u32;
    let mut last_address = None;
    let mut chunks = Vec::new();
    for (&start, end) in starts.iter().zip(ends) {
        let bytes = file[start..end].to_vec();
        let address = if group { bytes.last().copied() } else { None };
        // A cycle goes through the birds by rising address.
        if last_address.is_some_and(|last| address <= last) {
            cycle += 1;
        }
        last_address = Some(address);
        let t = Timestamp::from_secs_f64(f64::from(cycle) / RATE_HZ);
        chunks.push(Chunk { t, to_unit: false, bytes });
    }
    let words = "the first record; the capture holds no times, so its cycles follow each other at 103.3 Hz";
    Ok((chunks, words.to_owned()))
}

/// Decimal seconds as nanoseconds, exactly; digits beyond are dropped.
fn nanos(seconds: &str) -> Option<i128> {
    let (whole, fraction) = seconds.split_once('.').unwrap_or((seconds, ""));
    let digits: String = fraction.chars().chain(std::iter::repeat('0')).take(9).collect();
    let fraction: i128 = digits.parse().ok()?;
    let whole: i128 = whole.parse().ok()?;
    let sign = if seconds.starts_with('-') { -1 } else { 1 };
    whole.checked_mul(1_000_000_000)?.checked_add(sign * fraction)
}

/// The stage that the capture was made on, as far as it says.
fn stage(decoded: &Decoded, sense: QuaternionSense, origin: &str) -> Result<String, Error> {
    let addresses: BTreeSet<u8> = decoded.records.iter().map(|record| record.address).collect();
    let mut kinds = BTreeMap::new();
    for CapturedRecord { format, record, .. } in &decoded.records {
        *kinds.entry((format.to_string(), record.button.is_some())).or_insert(0_u64) += 1;
    }
    let Some((format, button)) = kinds.iter().max_by_key(|(_, count)| **count).map(|(kind, _)| kind) else {
        return Err(Error::Failed("the capture holds no record, so there is nothing to replay".to_owned()));
    };
    if kinds.len() > 1 {
        tracing::warn!(
            "the capture holds records of {} kinds; a replay decodes those in the format {format}, -o FILE.csv all",
            kinds.len()
        );
    }
    let range_in = match decoded.range {
        Range::In36 => 36,
        Range::In72 => 72,
        Range::In144 => 144,
    };
    let sense = match sense {
        QuaternionSense::Vendor => "vendor",
        QuaternionSense::Direct => "direct",
    };
    let mut text = format!(
        "# Written by `posed decode`. Time 0 is {origin}.\n\nname = \"Capture\"\n\n[[device]]\nname = \"flock\"\n\
         driver = \"flock-of-birds\"\nport = \"auto\"\nmode = \"listen\"\nformat = \"{format}\"\nbutton = {button}\n\
         range_in = {range_in}\nquaternion_sense = \"{sense}\"\n"
    );
    for address in addresses {
        text.push_str(&format!(
            "\n[[sensor]]\nname = \"bird-{address}\"\ndevice = \"flock\"\naddress = {address}\n"
        ));
    }
    Ok(text)
}

/// Runs the capture through the pipeline as it would have run live, and writes what a live stage would; the number of messages.
fn log_of(header: Header, chunks: &[Chunk], file: &mut dyn Write) -> Result<u64, WriteError> {
    let mut scribe = Scribe::new(file, header)?;
    let opened = Input::Line { device: 0, event: LineEvent::Opened { modem_lines: false } };
    let mut messages = scribe.entry(&Entry { t: Timestamp::ZERO, input: opened })?;
    let mut last = Timestamp::ZERO;
    for Chunk { t, to_unit, bytes } in chunks {
        messages += timers(&mut scribe, *t)?;
        last = last.max(*t);
        if *to_unit {
            scribe.transmitted(0, *t, bytes)?;
        } else {
            let input = Input::Bytes { device: 0, bytes: bytes.clone() };
            messages += scribe.entry(&Entry { t: *t, input })?;
        }
    }
    messages += timers(&mut scribe, Timestamp::from_nanos(last.as_nanos() + TAIL_NS))?;
    scribe.finish("the capture ends here")?;
    Ok(messages)
}

/// All deadlines up to `t`; the number of messages.
fn timers<W: Write>(scribe: &mut Scribe<W>, t: Timestamp) -> Result<u64, WriteError> {
    let mut messages = 0;
    while let Some(at) = scribe.pipeline().poll_timeout().filter(|&at| at <= t) {
        messages += scribe.entry(&Entry { t: at, input: Input::Timer })?;
        if scribe.pipeline().poll_timeout() == Some(at) {
            // Due as soon as time goes on.
            return Ok(messages + scribe.entry(&Entry { t, input: Input::Timer })?);
        }
    }
    Ok(messages)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_keep_their_digits() {
        assert_eq!(nanos("24431916642.05558"), Some(24_431_916_642_055_580_000));
        assert_eq!(nanos("-1.5"), Some(-1_500_000_000));
        assert_eq!(nanos("3"), Some(3_000_000_000));
        assert_eq!(nanos("1e3"), None);
    }
}
