//! `posed field correct`.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use posed_baselines::cascade::DistortionNetwork;
use posed_field::Corrector;
use posed_geometry::{orientation_from_wxyz, orientation_to_wxyz};
use posed_recording::is_recording;
use posed_recording::table::{Poses, TableError, TableWriter};

use super::{Error, cascade, collect, notify, print_json, read_map};

/// A map, and the poses to correct.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  posed field correct field.json poses.csv -o corrected.csv\n\n\
    The poses are in the transmitter frame; of a recording it takes what the devices said. Columns added: sigma_m (expected rms 3-D error) and extrapolated (0/1), \
    both empty with the file of a cascade, which states neither and corrects no orientation.")]
pub(crate) struct Args {
    /// The map, or what `posed field solve --method cascade` wrote.
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

/// What corrects poses.
pub(super) enum Correction {
    Map(Box<Corrector>),
    Cascade(DistortionNetwork),
}

impl Correction {
    fn read(path: &Path) -> Result<Self, Error> {
        let text = std::fs::read(path).ok();
        let file = text.and_then(|text| serde_json::from_slice::<cascade::File>(&text).ok());
        match file {
            Some(file) => Ok(Self::Cascade(file.cascade)),
            // Says what is wrong with a file that is neither.
            None => Ok(Self::Map(read_map(path)?.corrector().into())),
        }
    }
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let correction = Correction::read(&args.field)?;
    let summary = write_corrected(&correction, &args.poses, &args.output)?;
    if args.json {
        return print_json(&summary);
    }
    notify(&format!("{} rows, {} outside of what was calibrated", summary.rows, summary.extrapolated));
    Ok(())
}

/// Corrects a file of poses into another.
pub(super) fn write_corrected(correction: &Correction, from: &Path, to: &Path) -> Result<Summary, Error> {
    let poses = if is_recording(from) {
        collect::measured(from)?
    } else {
        Poses::read(from).map_err(Error::failed)?
    };
    write(correction, &poses, to).map_err(Error::failed)
}

fn write(correction: &Correction, poses: &Poses, path: &Path) -> Result<Summary, TableError> {
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
        let corrected = measured.map(|z| match correction {
            Correction::Map(corrector) => {
                let corrected = corrector.correct(&z);
                (corrected.position_m, Some((corrected.sigma_m, corrected.extrapolated)))
            }
            Correction::Cascade(network) => (network.correct(&z), None),
        });
        table.number(row.t_s)?;
        if named {
            table.text(poses.name(row))?;
        }
        table.vector::<3>(corrected.map(|(position_m, _)| position_m.into()))?;
        if turned {
            let orientation = row.orientation_wxyz.and_then(orientation_from_wxyz);
            let orientation = match (correction, &measured, orientation) {
                (Correction::Map(corrector), Some(z), Some(q)) => {
                    Some(orientation_to_wxyz(&corrector.orientation(z, &q)))
                }
                // Without a place nobody knows what the field does to it.
                _ => row.orientation_wxyz,
            };
            table.vector(orientation)?;
        }
        match corrected.and_then(|(_, trust)| trust) {
            Some((sigma_m, extrapolated)) => {
                table.number(sigma_m)?;
                table.text(if extrapolated { "1" } else { "0" })?;
                summary.extrapolated += usize::from(extrapolated);
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
