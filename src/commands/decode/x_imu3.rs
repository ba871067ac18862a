//! `posed decode x-imu3 FILE`: the bytes of an x-IMU3 unit or chain, such as its log files, as a table of its IMUs.

use std::io::{self, Write};
use std::path::Path;

use posed_drivers::Measurement;
use posed_drivers::x_imu3::data;
use posed_drivers::x_imu3::wire::{self, Lines};
use serde::Serialize;

use super::super::Error;
use super::target::{ImuRow, Target, imu_csv, lines_of};

/// One inertial message, with what came since the one before.
#[derive(Clone, Debug, Serialize)]
struct Record {
    t_s: f64,
    /// Channel bytes of a chain; 0 for a unit alone.
    address: u16,
    angular_velocity_rad_s: [f64; 3],
    specific_force_m_s2: [f64; 3],
    magnetic_field: Option<[f64; 3]>,
    orientation_wxyz: Option<[f64; 4]>,
}

/// The answer.
#[derive(Default, Serialize)]
struct Summary {
    records: u64,
    rejected: u64,
    bytes_skipped: u64,
}

/// Decodes `file`, writes what was asked for, and reports the summary.
pub(super) fn run(file: &Path, target: Target<'_>) -> Result<(), Error> {
    target.check_no_recording("an x-IMU3 capture")?;
    let bytes = std::fs::read(file).map_err(|error| Error::file("read", file, &error))?;
    let (records, summary) = decode(&bytes);
    if records.is_empty() {
        return Err(Error::Failed(format!(
            "{} holds no inertial message: is it a log or capture of an x-IMU3?",
            file.display()
        )));
    }
    target.write(|file| csv(&records, file), |file| lines_of(&records, file))?;
    let Summary { records, rejected, bytes_skipped } = summary;
    target.notify(&summary, &format!("{records} records, {rejected} rejected, {bytes_skipped} bytes skipped"))
}

fn decode(bytes: &[u8]) -> (Vec<Record>, Summary) {
    let (mut lines, mut scratch) = (Lines::default(), Vec::new());
    let (mut records, mut summary) = (Vec::new(), Summary::default());
    // By address: field and orientation for the unit's next inertial message.
    type Waiting = (u16, Option<[f64; 3]>, Option<[f64; 4]>);
    let mut waiting: Vec<Waiting> = Vec::new();
    lines.push(bytes);
    while let Some(line) = lines.find() {
        let line = lines.line(line);
        let Some(message) = wire::parse(line, &mut scratch) else {
            summary.rejected += 1;
            summary.bytes_skipped += line.len() as u64 + 1;
            continue;
        };
        if matches!(message.body, wire::Body::Command(_)) {
            continue;
        }
        let measured = data::decode(&message.body).map(|it| (it.time_us, it.data.measurement()));
        let Some((time_us, Ok(measurement))) = measured else {
            summary.rejected += 1;
            summary.bytes_skipped += line.len() as u64 + 1;
            continue;
        };
        let Some(Measurement::Imu {
            angular_velocity_rad_s,
            specific_force_m_s2,
            magnetic_field,
            orientation_wxyz,
            ..
        }) = measurement
        else {
            continue;
        };
        let at = waiting.iter().position(|(address, ..)| *address == message.address).unwrap_or_else(|| {
            waiting.push((message.address, None, None));
            waiting.len() - 1
        });
        let (address, field, orientation) = &mut waiting[at];
        *field = magnetic_field.or(*field);
        *orientation = orientation_wxyz.or(*orientation);
        if let (Some(angular_velocity_rad_s), Some(specific_force_m_s2)) =
            (angular_velocity_rad_s, specific_force_m_s2)
        {
            summary.records += 1;
            records.push(Record {
                t_s: time_us as f64 * 1e-6,
                address: *address,
                angular_velocity_rad_s,
                specific_force_m_s2,
                magnetic_field: field.take(),
                orientation_wxyz: orientation.take(),
            });
        }
    }
    summary.bytes_skipped += lines.bytes_skipped();
    (records, summary)
}

/// One row per inertial message.
fn csv(records: &[Record], file: &mut dyn Write) -> io::Result<()> {
    let row = |record: &Record| ImuRow {
        t_s: Some(record.t_s),
        sensor: format!("unit-{}", record.address),
        specific_force_m_s2: Some(record.specific_force_m_s2),
        angular_velocity_rad_s: Some(record.angular_velocity_rad_s),
        magnetic_field: record.magnetic_field,
        orientation_wxyz: record.orientation_wxyz,
    };
    imu_csv(records.iter().map(row), file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slower_magnetometer_joins_the_next_inertial_message() {
        let mut bytes = Vec::new();
        let mut add = |address, letter, time_us, values: &[f64]| {
            wire::binary(address, letter, &data::encode(time_us, values), &mut bytes);
        };
        add(2, b'I', 10_000, &[0.0, 0.0, 180.0, 0.0, 0.0, 1.0]);
        add(3, b'I', 12_000, &[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        add(2, b'M', 15_000, &[1.0, 0.0, 0.0]);
        add(2, b'I', 20_000, &[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        bytes.extend(b"\xC9broken\n");
        let (records, summary) = decode(&bytes);
        assert_eq!((summary.records, summary.rejected), (3, 1));
        assert_eq!(records[0].angular_velocity_rad_s[2], std::f64::consts::PI);
        assert!((records[0].t_s, records[1].address) == (0.01, 3) && records[1].magnetic_field.is_none());
        assert_eq!(records[2].magnetic_field, Some([1.0, 0.0, 0.0]));
        let mut text = Vec::new();
        csv(&records, &mut text).unwrap();
        let text = String::from_utf8(text).unwrap();
        assert!(text.lines().nth(1).unwrap().starts_with("0.01,unit-2,0,0,9.80665,0,0,3.14159"), "{text}");
    }
}
