//! `posed decode xbus FILE`: the messages of an Xsens device or chain.

use std::io::{self, Write};
use std::path::Path;

use posed_drivers::xbus::capture::{self, Record};

use super::super::Error;
use super::target::{ImuRow, Target, imu_csv, lines_of};

/// Decodes `file`, writes what was asked for, and reports the summary.
pub(super) fn run(file: &Path, target: Target<'_>) -> Result<(), Error> {
    target.check_no_recording("an Xbus capture")?;
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
    target.write(|file| csv(&records, file), |file| lines_of(&records, file))?;
    let sentence = format!(
        "{} records, {} bytes skipped, {} bad checksums, {} packets lost",
        summary.records, summary.bytes_skipped, summary.bad_checksums, summary.packets_lost
    );
    target.notify(&summary, &sentence)
}

/// One row per tracker and data message that holds something of an IMU: one with satellites alone has a time of its own, which
/// is that of its fix and lies behind.
fn csv(records: &[Record], file: &mut dyn Write) -> io::Result<()> {
    let rows = records.iter().filter_map(|record| {
        let row = ImuRow {
            t_s: record.t_s,
            sensor: format!("tracker-{}", record.tracker()?),
            specific_force_m_s2: record.items.acceleration,
            angular_velocity_rad_s: record.items.rate_of_turn,
            magnetic_field: record.items.magnetic_field,
            orientation_wxyz: record.items.quaternion,
        };
        row.measures().then_some(row)
    });
    imu_csv(rows, file)
}
