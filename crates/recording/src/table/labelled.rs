//! Labelled sequences as folders hold them: labels in a column, or in a file beside the sequence.
//!
//! What comes in: `walk.csv` (or `.csv.gz`), a sequence, or `walk.mcap`, a recording. If `walk.labels.csv` or `walk.eaf` stands
//! beside it, its labels count instead of the column's: what `posed segments label` wrote and somebody corrected. What goes out:
//! sequences, in the order of their names.

use std::path::{Path, PathBuf};

use super::elan::read_elan;
use super::{SegmentLabels, SequenceOptions, Sequences, TableError};
use crate::is_recording;

/// A sequence, and the name of its file.
pub type Named = (String, Sequences);

/// Reads a sequence, or a recording (`.mcap`), whose sensors and segments of the body are the joints; with the labels beside it,
/// which take the place of its column `label`; its column `transition` stays. `options` are for tables.
///
/// # Errors
/// A file cannot be read, the labels beside it are not its labels, its times do not rise.
pub fn read_labelled(path: &Path, options: &SequenceOptions) -> Result<Sequences, TableError> {
    let mut sequences =
        if is_recording(path) { Sequences::read_recording(path)? } else { Sequences::read(path, options)? };
    match beside(path) {
        Some(Beside::Elan(path)) => read_elan(&path, &mut sequences)?,
        Some(Beside::Rows(path)) => correct(&path, &mut sequences)?,
        None => {}
    }
    sequences.labelled |= beside(path).is_some();
    let rising = sequences.frames.windows(2).all(|pair| pair[0].t_s < pair[1].t_s);
    if rising { Ok(sequences) } else { Err(wrong(path, "the times do not rise from row to row")) }
}

/// Reads a sequence, or all of a folder in the order of their names; of recordings in it those that have labels beside them.
///
/// # Errors
/// As for [`read_labelled`]; there are none, or one has no label at all.
pub fn read_labelled_folder(folder: &Path, options: &SequenceOptions) -> Result<Vec<Named>, TableError> {
    if !folder.is_dir() {
        return labelled(&[folder.to_owned()], options);
    }
    let paths: Vec<PathBuf> = files(folder)?
        .into_iter()
        .filter(|path| if is_recording(path) { beside(path).is_some() } else { is_sequence(path) })
        .collect();
    if paths.is_empty() {
        let what = "there are no .csv or .csv.gz files, and no recordings with labels beside them";
        return Err(wrong(folder, what));
    }
    labelled(&paths, options)
}

/// Reads the recordings of a folder that have labels beside them, in the order of their names; none is no error, nor is no
/// folder.
///
/// # Errors
/// As for [`read_labelled`]; one has no label at all.
pub fn read_labelled_recordings(folder: &Path) -> Result<Vec<Named>, TableError> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let mut paths = files(folder)?;
    paths.retain(|path| is_recording(path) && beside(path).is_some());
    labelled(&paths, &SequenceOptions::default())
}

/// The file's name without `.csv`, `.csv.gz` or `.mcap`, in letters of either case; another end stays.
pub fn stem(path: &Path) -> String {
    let name = name(path);
    let ends = [".csv.gz", ".csv", ".mcap"];
    ends.iter().find_map(|end| without(&name, end)).unwrap_or(&name).to_owned()
}

/// The name without this end, in letters of either case.
fn without<'a>(name: &'a str, end: &str) -> Option<&'a str> {
    let (stem, found) = name.split_at_checked(name.len().checked_sub(end.len())?)?;
    found.eq_ignore_ascii_case(end).then_some(stem)
}

fn labelled(paths: &[PathBuf], options: &SequenceOptions) -> Result<Vec<Named>, TableError> {
    let read = |path: &PathBuf| {
        let sequences = read_labelled(path, options)?;
        if sequences.frames.iter().all(|frame| frame.label.is_none()) {
            let stem = stem(path);
            let what = format!(
                "no frame has a label; give a column `label`, or labels beside it in {stem}.labels.csv or {stem}.eaf"
            );
            return Err(wrong(path, &what));
        }
        Ok((name(path), sequences))
    };
    paths.iter().map(read).collect()
}

fn files(folder: &Path) -> Result<Vec<PathBuf>, TableError> {
    let failed = |source| TableError::Io { tried: "read", file: folder.display().to_string(), source };
    let entries = std::fs::read_dir(folder).map_err(failed)?;
    let mut paths = entries
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<Result<Vec<_>, _>>()
        .map_err(failed)?;
    paths.retain(|path| path.is_file());
    paths.sort();
    Ok(paths)
}

fn is_sequence(path: &Path) -> bool {
    let name = name(path);
    let table = [".csv", ".csv.gz"].iter().any(|end| without(&name, end).is_some());
    table && without(&stem(path), ".labels").is_none()
}

fn name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Labels in a file of their own.
enum Beside {
    Rows(PathBuf),
    Elan(PathBuf),
}

/// Where the labels of a recording or a table are looked for beside it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LabelFiles {
    /// With a row for each frame, as `posed segments label` writes it: counts where it is there.
    pub rows: PathBuf,
    /// ELAN's.
    pub elan: PathBuf,
}

impl LabelFiles {
    /// Of this recording or table.
    pub fn beside(path: &Path) -> Self {
        let stem = stem(path);
        let with = |end: &str| path.with_file_name(format!("{stem}{end}"));
        Self { rows: with(".labels.csv"), elan: with(".eaf") }
    }
}

fn beside(path: &Path) -> Option<Beside> {
    let LabelFiles { rows, elan } = LabelFiles::beside(path);
    let there = |path: PathBuf| Some(path).filter(|path| path.is_file());
    there(rows).map(Beside::Rows).or_else(|| there(elan).map(Beside::Elan))
}

/// Takes the labels of a file of segment labels, one row per frame.
fn correct(path: &Path, sequences: &mut Sequences) -> Result<(), TableError> {
    let labels = SegmentLabels::read(path)?;
    let (frames, found) = (sequences.frames.len(), labels.rows.len());
    if found != frames {
        let what = format!("expected a row for each of the sequence's {frames} frames, found {found}");
        return Err(wrong(path, &what));
    }
    for (frame, row) in sequences.frames.iter_mut().zip(labels.rows) {
        frame.label = row.label;
    }
    Ok(())
}

fn wrong(path: &Path, what: &str) -> TableError {
    TableError::Labels { file: path.display().to_string(), what: what.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_of_names_are_known_in_letters_of_either_case() {
        for (name, expected) in [
            ("walk.csv", "walk"),
            ("Walk.CSV", "Walk"),
            ("walk.Csv.GZ", "walk"),
            ("TAKE.MCAP", "TAKE"),
            ("walk.txt", "walk.txt"),
            ("ü.mcap", "ü"),
            ("csv", "csv"),
        ] {
            assert_eq!(stem(Path::new(name)), expected);
        }
        assert!(is_sequence(Path::new("a.CSV")) && !is_sequence(Path::new("a.Labels.CSV")));
        // Labels beside a recording are found whatever its name's end looks like.
        let folder = tempfile::tempdir().unwrap();
        let [take, labels] = ["TAKE.MCAP", "TAKE.labels.csv"].map(|name| folder.path().join(name));
        std::fs::write(&labels, "label\n").unwrap();
        assert!(matches!(beside(&take), Some(Beside::Rows(path)) if path == labels));
    }
}
