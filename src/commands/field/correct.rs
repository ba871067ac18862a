//! `posed field correct`.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use posed_field::Corrector;
use posed_geometry::{orientation_from_wxyz, orientation_to_wxyz};
use posed_recording::is_recording;
use posed_recording::table::{Poses, TableError, TableWriter};

use super::{Error, collect, notify, print_json, read_map};

/// A map, and the poses to correct.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  posed field correct field.json poses.csv -o corrected.csv\n\n\
    The poses are in the transmitter frame; of a recording it takes what the devices said. Columns added: sigma_m (expected rms 3-D error) and extrapolated (0/1).")]
pub(crate) struct Args {
    /// The map.
    field: PathBuf,
    /// The poses, `.csv`, `.csv.gz` or a recording.
    poses: PathBuf,
    /// Where to write them, one row for each row.
    #[arg(short, long, value_name = "CSV")]
    output: PathBuf,
    /// Print a summary as one JSON object: rows, extrapolated.
    #[arg(long)]
    json: bool,
}

#[derive(Default, serde::Serialize)]
pub(super) struct Summary {
    rows: usize,
    extrapolated: usize,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let corrector = read_map(&args.field)?.corrector();
    let summary = write_corrected(&corrector, &args.poses, &args.output)?;
    if args.json {
        return print_json(&summary);
    }
    notify(&format!("{} rows, {} outside of what was calibrated", summary.rows, summary.extrapolated));
    Ok(())
}

/// Corrects a file of poses into another.
pub(super) fn write_corrected(corrector: &Corrector, from: &Path, to: &Path) -> Result<Summary, Error> {
    let poses = if is_recording(from) {
        collect::measured(from)?
    } else {
        Poses::read(from).map_err(Error::failed)?
    };
    write(corrector, &poses, to).map_err(Error::failed)
}

fn write(corrector: &Corrector, poses: &Poses, path: &Path) -> Result<Summary, TableError> {
    let named = poses.sensors.iter().any(|name| !name.is_empty());
    let turned = poses.rows.iter().any(|row| row.orientation_wxyz.is_some());
    let mut columns = vec!["t"];
    columns.extend(named.then_some("sensor"));
    columns.extend(["x", "y", "z"]);
    columns.extend(["qw", "qx", "qy", "qz"].iter().filter(|_| turned));
    columns.extend(["sigma_m", "extrapolated"]);
    let mut table = TableWriter::create(path, &columns)?;
    let mut summary = Summary::default();
    for row in &poses.rows {
        summary.rows += 1;
        let measured = row.position_m.map(Vector3::from);
        let corrected = measured.map(|z| corrector.correct(&z));
        table.number(row.t_s)?;
        if named {
            table.text(poses.name(row))?;
        }
        table.vector::<3>(corrected.map(|corrected| corrected.position_m.into()))?;
        if turned {
            let orientation = row.orientation_wxyz.and_then(orientation_from_wxyz);
            let orientation = match (&measured, orientation) {
                (Some(z), Some(q)) => Some(orientation_to_wxyz(&corrector.orientation(z, &q))),
                // Without a place nobody knows what the field does to it.
                _ => row.orientation_wxyz,
            };
            table.vector(orientation)?;
        }
        match corrected {
            Some(corrected) => {
                table.number(corrected.sigma_m)?;
                table.text(if corrected.extrapolated { "1" } else { "0" })?;
                summary.extrapolated += usize::from(corrected.extrapolated);
            }
            None => {
                table.text("")?;
                table.text("")?;
            }
        }
        table.end_row()?;
    }
    table.finish()?;
    Ok(summary)
}
