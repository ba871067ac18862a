//! A person out of a CSV table of joint centres: columns `<joint>_x`, `.y`, ` z`, with or without a unit behind.

use std::path::Path;

use nalgebra::Vector3;

use super::names::{JOINTS, Joint, find, words};
use super::recording::{Clip, Frame, Recording, TakeError, spine};
use crate::motion_file::Cells;

/// What may stand behind the axis in the name of a column.
const UNITS: [&str; 5] = ["m", "mm", "cm", "in", "inch"];
/// Columns of times, and seconds in a unit of them.
const TIMES: [(&str, f64); 8] = [
    ("t", 1.0),
    ("ts", 1.0),
    ("time", 1.0),
    ("times", 1.0),
    ("seconds", 1.0),
    ("tms", 1e-3),
    ("timems", 1e-3),
    ("tus", 1e-6),
];

/// The columns of a table.
struct Columns {
    /// x, y, z of the joints, by the place of their words in `names`.
    points: Vec<[usize; 3]>,
    names: Vec<Vec<String>>,
    time: Option<(usize, f64)>,
    clip: Option<usize>,
}

impl Recording {
    /// A person out of a table; `path` names it in errors. Rows follow one another at `rate_hz` where there is no column of times (`t`, `time_s`, `t_ms`, ...). A
    /// new value in a column `clip` begins a span of its own. Rows in which a joint is missing are left out.
    ///
    /// # Errors
    /// Line and column of what is wrong, or the joint that is missing.
    pub fn of_table(path: &Path, bytes: &[u8], rate_hz: Option<f64>) -> Result<Self, TakeError> {
        let (mut reader, cells) = Cells::open(path, bytes)?;
        let columns = Columns::of(&cells.header);
        let found = find(&columns.names, true).map_err(|joint| TakeError::Joint {
            path: path.to_owned(),
            joint,
            names: if columns.names.is_empty() {
                "no columns like `left_knee_x`".to_owned()
            } else {
                columns.names.iter().map(|words| words.join("_")).collect::<Vec<_>>().join(", ")
            },
        })?;
        if columns.time.is_none() && rate_hz.is_none() {
            let problem = "there is no column of times: state `follows_rate_hz`".to_owned();
            return Err(cells.wrong(1, "t", problem).into());
        }
        let mut chosen: [Option<usize>; JOINTS] = std::array::from_fn(|index| found[index].first().copied());
        let mut clips: Vec<Clip> = Vec::new();
        let mut clip_name = None;
        for (row, record) in reader.records().enumerate() {
            let record = record.map_err(|source| cells.refused(source))?;
            let number = |column| cells.number(&record, column);
            let point = |index: usize| -> Result<Vector3<f64>, TakeError> {
                let [x, y, z] = columns.points[index];
                Ok(Vector3::new(number(x)?, number(y)?, number(z)?))
            };
            let empty = |column: &usize| {
                record.get(*column).is_none_or(|cell| cell.is_empty() || cell.eq_ignore_ascii_case("nan"))
            };
            if chosen.iter().flatten().any(|index| columns.points[*index].iter().any(empty)) {
                continue;
            }
            if clips.is_empty() {
                choose_spine(&mut chosen, &found, &point)?;
            }
            let name = columns.clip.map(|column| record.get(column).unwrap_or_default().to_owned());
            if clips.is_empty() || name != clip_name {
                clips.push(Clip::default());
                clip_name = name;
            }
            let t_s = match columns.time {
                Some((column, unit_s)) => number(column)? * unit_s,
                None => row as f64 / rate_hz.unwrap_or(1.0),
            };
            let Some(clip) = clips.last_mut() else { continue };
            if clip.t_s.last().is_some_and(|last_s| *last_s >= t_s) {
                let column = columns.time.map_or("t", |(column, _)| &cells.header[column]);
                let line = record.position().map_or(0, csv::Position::line);
                let problem = "expected a time after that of the row before".to_owned();
                return Err(cells.wrong(line, column, problem).into());
            }
            let mut points = [Vector3::zeros(); JOINTS];
            for (at, index) in points.iter_mut().zip(&chosen) {
                if let Some(index) = index {
                    *at = point(*index)?;
                }
            }
            clip.t_s.push(t_s);
            clip.frames.push(Frame { points, turns: None });
        }
        if clips.is_empty() {
            let problem = "expected at least one row with all joints".to_owned();
            return Err(cells.wrong(2, &cells.header[0], problem).into());
        }
        Ok(Self { path: path.to_owned(), has: chosen.map(|index| index.is_some()), clips })
    }
}

/// Takes that joint of the spine which lies well above the hips in the first row.
fn choose_spine(
    chosen: &mut [Option<usize>; JOINTS],
    found: &[Vec<usize>; JOINTS],
    point: &impl Fn(usize) -> Result<Vector3<f64>, TakeError>,
) -> Result<(), TakeError> {
    let of = |joint: Joint| chosen[joint.index()].map(point).transpose();
    let middle = |a: Option<Vector3<f64>>, b: Option<Vector3<f64>>| a.zip(b).map(|(a, b)| 0.5 * (a + b));
    let hips = middle(of(Joint::Hip(0))?, of(Joint::Hip(1))?).or(of(Joint::Root)?);
    let shoulders = middle(of(Joint::Shoulder(0))?, of(Joint::Shoulder(1))?);
    let Some((hips, shoulders)) = hips.zip(shoulders) else { return Ok(()) };
    let candidates = &found[Joint::Spine.index()];
    let places: Vec<Vector3<f64>> = candidates.iter().map(|at| point(*at)).collect::<Result<_, _>>()?;
    let order: Vec<usize> = (0..places.len()).collect();
    let taken = spine(&order, |at| places[at], hips, (shoulders - hips).norm());
    chosen[Joint::Spine.index()] = taken.map(|at| candidates[at]);
    Ok(())
}

impl Columns {
    fn of(header: &csv::StringRecord) -> Self {
        let mut columns = Self { points: Vec::new(), names: Vec::new(), time: None, clip: None };
        let mut axes: Vec<(Vec<String>, [Option<usize>; 3])> = Vec::new();
        for (column, name) in header.iter().enumerate() {
            let mut words = words(name);
            let joined = words.concat();
            if let Some((_, unit_s)) = TIMES.iter().find(|(name, _)| *name == joined) {
                columns.time = columns.time.or(Some((column, *unit_s)));
                continue;
            }
            if joined == "clip" {
                columns.clip = Some(column);
            }
            if words.last().is_some_and(|word| UNITS.contains(&word.as_str())) {
                words.pop();
            }
            let axis = words.pop().and_then(|word| ["x", "y", "z"].iter().position(|axis| *axis == word));
            let Some(axis) = axis.filter(|_| !words.is_empty()) else { continue };
            match axes.iter_mut().find(|(other, _)| *other == words) {
                Some((_, places)) => places[axis] = Some(column),
                None => {
                    let mut places = [None; 3];
                    places[axis] = Some(column);
                    axes.push((words, places));
                }
            }
        }
        for (name, places) in axes {
            if let [Some(x), Some(y), Some(z)] = places {
                columns.names.push(name);
                columns.points.push([x, y, z]);
            }
        }
        columns
    }
}
