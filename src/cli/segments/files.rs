//! Sequences as the commands find them: a folder of CSV files, with labels in a column, beside them, or none.
//!
//! `walk.csv` (or `.csv.gz`) is a sequence. If `walk.labels.csv` or `walk.eaf` stands beside it, its labels count
//! instead of the column's: what `posed segments label` wrote and an annotator corrected.

use std::path::{Path, PathBuf};

use posed::motion::segments::Model;
use posed::table::{SegmentLabels, SequenceOptions, Sequences, Unit, Up};

use super::super::{Error, tell};
use super::elan;

/// How to read sequences.
#[derive(clap::Args)]
pub(super) struct Reading {
    /// Rows per second of files without a column `t`.
    #[arg(long, value_name = "HZ")]
    rate_hz: Option<f64>,
    /// Unit of the positions.
    #[arg(long, value_enum, default_value_t)]
    unit: Unit,
    /// The upward axis of the positions.
    #[arg(long, value_enum, default_value_t)]
    up: Up,
}

impl Reading {
    /// Reads a sequence, or a recording (`.mcap`): its sensors and the segments of its body are the joints.
    pub(super) fn read(&self, path: &Path) -> Result<Sequences, Error> {
        if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap")) {
            return Sequences::read_recording(path).map_err(Error::failed);
        }
        let options = SequenceOptions { rate_hz: self.rate_hz, unit: self.unit, up: self.up };
        let mut sequences = Sequences::read(path, &options).map_err(Error::failed)?;
        let stem = stem(path);
        for (name, elan) in [(format!("{stem}.labels.csv"), false), (format!("{stem}.eaf"), true)] {
            let beside = path.with_file_name(name);
            if beside.is_file() {
                if elan {
                    elan::read(&beside, &mut sequences)?
                } else {
                    correct(&beside, &mut sequences)?
                }
                sequences.labelled = true;
                break;
            }
        }
        let rising = sequences.frames.windows(2).all(|pair| pair[0].t_s < pair[1].t_s);
        if rising {
            Ok(sequences)
        } else {
            Err(Error::Failed(format!("{}: the times do not rise from row to row", path.display())))
        }
    }

    /// Reads all sequences of a folder, in the order of their names.
    pub(super) fn read_folder(&self, folder: &Path) -> Result<Vec<(String, Sequences)>, Error> {
        let mut paths: Vec<PathBuf> = Vec::new();
        if folder.is_dir() {
            for entry in std::fs::read_dir(folder).map_err(|error| Error::file("read", folder, &error))? {
                let path = entry.map_err(|error| Error::file("read", folder, &error))?.path();
                let name = name(&path);
                let sequence = name.ends_with(".csv") || name.ends_with(".csv.gz");
                if sequence && !stem(&path).ends_with(".labels") && path.is_file() {
                    paths.push(path);
                }
            }
            paths.sort();
        } else {
            paths.push(folder.to_owned());
        }
        let read = |path: &PathBuf| Ok((name(path), self.read(path)?));
        let files = paths.iter().map(read).collect::<Result<Vec<_>, Error>>()?;
        let labelled = |file: &(String, Sequences)| file.1.frames.iter().any(|frame| frame.label.is_some());
        match files.iter().find(|file| !labelled(file)) {
            _ if files.is_empty() => {
                Err(Error::Failed(format!("{}: there are no .csv or .csv.gz files", folder.display())))
            }
            Some((name, _)) => Err(Error::Failed(format!(
                "{name}: no frame has a label; give a column `label`, or labels beside it in {}.labels.csv",
                stem(Path::new(name))
            ))),
            None => Ok(files),
        }
    }
}

fn name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Name of a file without `.csv` or `.csv.gz`.
pub(super) fn stem(path: &Path) -> String {
    let name = name(path);
    let stem = name.strip_suffix(".gz").unwrap_or(&name);
    stem.strip_suffix(".csv").unwrap_or(stem).to_owned()
}

/// Takes the labels of a file of segment labels, one row per frame.
fn correct(path: &Path, sequences: &mut Sequences) -> Result<(), Error> {
    let labels = SegmentLabels::read(path).map_err(Error::failed)?;
    if labels.rows.len() != sequences.frames.len() {
        return Err(Error::Failed(format!(
            "{}: expected a row for each of the sequence's {} frames, found {}",
            path.display(),
            sequences.frames.len(),
            labels.rows.len()
        )));
    }
    for (frame, row) in sequences.frames.iter_mut().zip(labels.rows) {
        frame.label = row.label;
    }
    Ok(())
}

/// Refuses a file that lacks most of the model's joints or is in another unit; tells of joints that are missing.
pub(super) fn fits(name: &str, file: &Sequences, model: &Model) -> Result<(), Error> {
    let preparation = &model.card.preparation;
    let joints = file.joints.iter().map(String::as_str);
    model.columns(joints).map_err(|what| Error::Failed(format!("{name}: {what}")))?;
    let missing: Vec<&str> =
        preparation.joints.iter().filter(|joint| !file.joints.contains(joint)).map(String::as_str).collect();
    if !missing.is_empty() {
        tell(&format!("{name}: goes without {}, which the model knows", missing.join(", ")));
    }
    let columns: Vec<usize> =
        (0..file.joints.len()).filter(|index| preparation.joints.contains(&file.joints[*index])).collect();
    let (mut sum, mut count) = (0.0, 0.0_f64);
    for frame in 0..file.frames.len() {
        let positions = file.positions_m(frame);
        let known: Vec<[f64; 3]> = columns.iter().filter_map(|column| positions[*column]).collect();
        let mean: [f64; 3] = std::array::from_fn(|axis| {
            known.iter().map(|p| p[axis]).sum::<f64>() / known.len().max(1) as f64
        });
        sum += known.iter().map(|p| (0..3).map(|i| (p[i] - mean[i]).powi(2)).sum::<f64>()).sum::<f64>();
        count += known.len() as f64;
    }
    let size_m = (sum / count.max(1.0)).sqrt();
    let ratio = size_m / preparation.size_m;
    if count > 0.0 && !(0.2..5.0).contains(&ratio) {
        return Err(Error::Failed(format!(
            "{name}: joints lie {size_m:.3} m from their centre, where the model knows {:.3} m; is `--unit` right?",
            preparation.size_m
        )));
    }
    Ok(())
}
