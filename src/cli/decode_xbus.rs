//! `posed decode xbus FILE`: the messages of an Xsens device or chain.

use std::io::{self, Write};
use std::path::Path;

use posed_drivers::xbus::capture::{self, Record};

use super::decode::Table;
use super::{Error, output, print, print_json, tell};

const COLUMNS: [&str; 15] =
    ["t", "sensor", "ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz", "qw", "qx", "qy", "qz"];

/// Decodes `file`, writes what was asked for, and says the summary.
pub(super) fn run(file: &Path, output: Option<&Path>, table: Option<Table>, json: bool) -> Result<(), Error> {
    if table == Some(Table::Recording) {
        return Err(Error::Usage(
            "an Xbus capture carries no times of arrival to record; end the output in .csv, .csv.gz or .jsonl".into(),
        ));
    }
    let bytes = std::fs::read(file).map_err(|error| Error::file("read", file, &error))?;
    if bytes.is_empty() {
        return Err(Error::Failed(format!("cannot decode {}: the file is empty", file.display())));
    }
    let mut records = Vec::new();
    let summary = capture::decode(&bytes, |record| records.push(record));
    if summary.records == 0 {
        return Err(Error::Failed(format!(
            "{} holds no Xbus message: is it a capture of an Xsens device's raw bytes?",
            file.display()
        )));
    }
    match (output, table) {
        (Some(path), Some(table)) => output::replace(path, |file| {
            table.write(file, |file| csv(&records, file), |file| json_lines(&records, file))
        })?,
        _ if !json => {
            let mut text = Vec::new();
            csv(&records, &mut text).map_err(Error::failed)?;
            print(&String::from_utf8_lossy(&text))?;
        }
        _ => {}
    }
    if json {
        return print_json(&summary);
    }
    tell(&format!(
        "{} records, {} bytes skipped, {} bad checksums, {} packets lost",
        summary.records, summary.bytes_skipped, summary.bad_checksums, summary.packets_lost
    ));
    Ok(())
}

/// One row per tracker and data message.
fn csv(records: &[Record], file: &mut dyn Write) -> io::Result<()> {
    let mut table = csv::Writer::from_writer(file);
    table.write_record(COLUMNS)?;
    for record in records {
        let Some(tracker) = record.tracker() else { continue };
        let items = &record.items;
        table.write_field(record.t_s.map(|t| t.to_string()).unwrap_or_default())?;
        table.write_field(format!("tracker-{tracker}"))?;
        for vector in [items.acceleration, items.rate_of_turn, items.magnetic_field] {
            fields(&mut table, vector)?;
        }
        fields(&mut table, items.quaternion)?;
        table.write_record(None::<&[u8]>)?;
    }
    table.flush()
}

/// Numbers, or empty cells.
fn fields<const N: usize>(
    table: &mut csv::Writer<&mut dyn Write>,
    values: Option<[f64; N]>,
) -> io::Result<()> {
    for at in 0..N {
        table.write_field(values.map(|values| values[at].to_string()).unwrap_or_default())?;
    }
    Ok(())
}

/// Every record in full.
fn json_lines(records: &[Record], file: &mut dyn Write) -> io::Result<()> {
    for record in records {
        serde_json::to_writer(&mut *file, record)?;
        file.write_all(b"\n")?;
    }
    Ok(())
}
