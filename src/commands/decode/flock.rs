//! `posed decode flock-of-birds FILE`: a log or capture of a Flock of Birds.

use std::io::{self, Write};
use std::path::Path;

use posed_drivers::flock::capture::{self, CapturedRecord, Decoded, Options};
use posed_drivers::flock::wire::Format;
use serde::Serialize;

use super::super::Error;
use super::recording;
use super::target::{Table, Target};

/// Decodes `file`, writes what was asked for, and reports the summary.
pub(super) fn run(file: &Path, options: Options, target: Target<'_>) -> Result<(), Error> {
    let bytes = std::fs::read(file).map_err(|error| Error::file("read", file, &error))?;
    let decoded = capture::decode(&bytes, options)
        .map_err(|error| Error::Failed(format!("cannot decode {}: {error}", file.display())))?;
    for warning in &decoded.warnings {
        tracing::warn!("{warning}");
    }
    if let Some((path, Table::Recording)) = target.file {
        recording::write(path, &bytes, &decoded, options.quaternion_sense)?;
    } else {
        let records = &decoded.records;
        target.write(|file| csv(records, file), |file| json_lines(records, file))?;
    }
    let summary = Summary::of(&decoded);
    target.notify(&summary, &summary.sentence())
}

fn csv(records: &[CapturedRecord], file: &mut dyn Write) -> io::Result<()> {
    let mut table = csv::Writer::from_writer(file);
    table.write_record(["t", "sensor", "x", "y", "z", "qw", "qx", "qy", "qz", "format", "button"])?;
    for CapturedRecord { t, address, format, record } in records {
        table.write_field(t.as_deref().unwrap_or_default())?;
        table.write_field(format!("bird-{address}"))?;
        let position = record.position_m.map(|values| values.map(|value| value.to_string()));
        for field in position.unwrap_or_default() {
            table.write_field(field)?;
        }
        let orientation = record.orientation_wxyz.map(|values| values.map(|value| value.to_string()));
        for field in orientation.unwrap_or_default() {
            table.write_field(field)?;
        }
        table.write_field(format.to_string())?;
        table.write_field(record.button.map(|button| button.to_string()).unwrap_or_default())?;
        table.write_record(None::<&[u8]>)?;
    }
    table.flush()
}

/// One record in full, but for its time.
#[derive(Serialize)]
struct Line {
    sensor: String,
    format: Format,
    button: Option<u8>,
    position_m: Option<[f64; 3]>,
    orientation_wxyz: Option<[f64; 4]>,
}

fn json_lines(records: &[CapturedRecord], file: &mut dyn Write) -> io::Result<()> {
    for CapturedRecord { t, address, format, record } in records {
        let line = Line {
            sensor: format!("bird-{address}"),
            format: *format,
            button: record.button,
            position_m: record.position_m,
            orientation_wxyz: record.orientation_wxyz,
        };
        let line = serde_json::to_string(&line)?;
        // The time goes in as text: its digits may be more than a 64-bit number gives back.
        let t = match t {
            Some(t) if serde_json::from_str::<serde_json::Number>(t).is_ok() => t.clone(),
            Some(t) => serde_json::to_string(t)?,
            None => "null".to_owned(),
        };
        writeln!(file, "{{\"t\":{t},{}", line.trim_start_matches('{'))?;
    }
    Ok(())
}

/// What was in the capture.
#[derive(Serialize)]
struct Summary<'a> {
    records: u64,
    rejected: u64,
    bytes_skipped: u64,
    answers: u64,
    warnings: &'a [String],
}

impl<'a> Summary<'a> {
    fn of(decoded: &'a Decoded) -> Self {
        let capture::Summary { records, rejected, bytes_skipped, answers } = decoded.summary;
        Self { records, rejected, bytes_skipped, answers, warnings: &decoded.warnings }
    }

    fn sentence(&self) -> String {
        let Self { records, rejected, bytes_skipped, answers, .. } = self;
        format!(
            "{records} records, {rejected} rejected pieces, {bytes_skipped} bytes skipped, {answers} answers"
        )
    }
}
