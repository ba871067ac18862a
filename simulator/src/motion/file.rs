//! Real motion from files: poses in CSV, joints in BVH.

use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::spline::{PoseSpline, Row};
use crate::bvh::Bvh;
use crate::motion_file::{Cells, FileError, MotionText};

/// Which axis of a file points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Up {
    /// The y axis, usual in BVH.
    Y,
    /// The z axis, as in the room.
    Z,
}

/// What happens after the last frame of a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Ending {
    /// The last pose is held.
    #[default]
    Hold,
    /// It plays backwards to the beginning, then forwards again.
    ThereAndBack,
}

/// A file of motion, as it stands in a stage file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct File {
    /// `.csv`, `.csv.gz` (columns `t`, `sensor`, `x,y,z` in m, `qw,qx,qy,qz`) or `.bvh`; relative to the stage file.
    pub path: PathBuf,
    /// Metres per unit of length in the file; absent: 1 for CSV, 0.01 for BVH.
    pub unit_m: Option<f64>,
    /// Which axis points up; absent: z for CSV, y for BVH.
    pub up: Option<Up>,
    /// Where the file's origin lies in the room, m.
    #[serde(default)]
    pub origin_m: [f64; 3],
    /// How far the file is turned about room z, degrees.
    #[serde(default)]
    pub heading_deg: f64,
    /// How much faster than real it plays.
    #[serde(default = "one")]
    pub speed: f64,
    /// What happens after the last frame.
    #[serde(default)]
    pub ending: Ending,
}

fn one() -> f64 {
    1.0
}

/// The motion in a file: named tracks in the room, cubic splines through the file's samples with rest at both ends of each track.
#[derive(Clone, Debug)]
pub struct Tracks {
    tracks: Vec<(String, PoseSpline)>,
    speed: f64,
    ending: Ending,
    /// From the file's first sample to its last, s.
    span_s: (f64, f64),
}

impl Tracks {
    /// Reads a file, relative to `folder`, and turns it into the room. Rows of a CSV file without a position are left out;
    /// without all four quaternion columns, orientations are the file's axes.
    ///
    /// # Errors
    /// The file cannot be read, or its name or content is not one of those kinds: see [`FileError`].
    pub fn read(file: &File, folder: &Path) -> Result<Self, FileError> {
        let path = folder.join(&file.path);
        let text = MotionText::read(&path)?;
        let is_bvh = matches!(text, MotionText::Bvh(_));
        let raw = match text {
            MotionText::Bvh(text) => bvh_tracks(
                &Bvh::parse(&text).map_err(|source| FileError::Bvh { path: path.clone(), source })?,
            ),
            MotionText::Table(bytes) => csv_tracks(&bytes, &path)?,
        };
        let unit_m = file.unit_m.unwrap_or(if is_bvh { 0.01 } else { 1.0 });
        let up = file.up.unwrap_or(if is_bvh { Up::Y } else { Up::Z });
        Ok(Self::new(raw, &placement(up, file), unit_m, file))
    }

    fn new(raw: Vec<RawTrack>, placement: &Isometry3<f64>, unit_m: f64, file: &File) -> Self {
        let mut span_s = (f64::INFINITY, f64::NEG_INFINITY);
        let tracks: Vec<_> = raw
            .into_iter()
            .map(|track| {
                let rows = track.rows.into_iter().map(|row| place(row, placement, unit_m)).collect();
                let spline = PoseSpline::new(track.t_s, rows);
                let (first, last) = spline.span_s();
                span_s = (span_s.0.min(first), span_s.1.max(last));
                (track.name, spline)
            })
            .collect();
        Self { tracks, speed: file.speed, ending: file.ending, span_s }
    }

    /// Names of the tracks, in the order of their indices: sensors of a CSV file, joints of a BVH file.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.tracks.iter().map(|(name, _)| name.as_str())
    }

    /// Pose of a track in the room (sensor or joint to room, m) at `t_s` seconds after the beginning, any time; before and after
    /// a track's own samples its first and last pose are held.
    ///
    /// # Panics
    /// If there is no such track.
    pub fn pose(&self, track: usize, t_s: f64) -> Isometry3<f64> {
        let (first, last) = self.span_s;
        let (played, span) = (t_s * self.speed, last - first);
        let t = match self.ending {
            Ending::ThereAndBack if span > 0.0 => {
                let round = played.rem_euclid(2.0 * span);
                if round > span { 2.0 * span - round } else { round }
            }
            _ => played,
        };
        self.tracks[track].1.pose(first + t)
    }
}

/// A track as it stands in the file.
struct RawTrack {
    name: String,
    t_s: Vec<f64>,
    rows: Vec<Row>,
}

/// File axes to room.
fn placement(up: Up, file: &File) -> Isometry3<f64> {
    let stand = match up {
        Up::Z => UnitQuaternion::identity(),
        Up::Y => UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(Matrix3::new(
            1.0, 0.0, 0.0, //
            0.0, 0.0, -1.0, //
            0.0, 1.0, 0.0,
        ))),
    };
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), file.heading_deg.to_radians());
    Isometry3::from_parts(Translation3::from(file.origin_m), rotation * stand)
}

fn place(row: Row, placement: &Isometry3<f64>, unit_m: f64) -> Row {
    let p = placement * nalgebra::Point3::new(row[0] * unit_m, row[1] * unit_m, row[2] * unit_m);
    let q = placement.rotation.quaternion() * nalgebra::Quaternion::new(row[3], row[4], row[5], row[6]);
    [p.x, p.y, p.z, q.w, q.i, q.j, q.k]
}

fn bvh_tracks(bvh: &Bvh) -> Vec<RawTrack> {
    let new = |name: &str| RawTrack { name: name.to_owned(), t_s: Vec::new(), rows: Vec::new() };
    let mut tracks: Vec<RawTrack> = bvh.names().map(new).collect();
    for frame in 0..bvh.frames() {
        for (track, pose) in tracks.iter_mut().zip(bvh.poses(frame)) {
            let (p, q) = (pose.translation.vector, pose.rotation);
            track.t_s.push(frame as f64 * bvh.frame_time_s);
            track.rows.push([p.x, p.y, p.z, q.w, q.i, q.j, q.k]);
        }
    }
    tracks
}

fn csv_tracks(bytes: &[u8], path: &Path) -> Result<Vec<RawTrack>, FileError> {
    let (mut reader, cells) = Cells::open(path, bytes)?;
    let column = |name: &str| cells.header.iter().position(|cell| cell == name);
    let required =
        |name: &str| column(name).ok_or_else(|| cells.wrong(1, name, "the column is missing".to_owned()));
    let t_column = required("t")?;
    let positions = [required("x")?, required("y")?, required("z")?];
    let quaternion = match ["qw", "qx", "qy", "qz"].map(column) {
        [Some(w), Some(x), Some(y), Some(z)] => Some([w, x, y, z]),
        _ => None,
    };
    let sensor = column("sensor");
    let mut tracks: Vec<RawTrack> = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|source| cells.refused(source))?;
        let line = record.position().map_or(0, csv::Position::line);
        let number = |column| cells.number(&record, column);
        if positions.iter().any(|&column| record.get(column).is_none_or(str::is_empty)) {
            continue; // An empty cell is no value: the sensor was not seen.
        }
        let mut row: Row = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
        for (value, column) in
            row.iter_mut().zip(positions.into_iter().chain(quaternion.into_iter().flatten()))
        {
            *value = number(column)?;
        }
        let norm = row[3..].iter().map(|q| q * q).sum::<f64>().sqrt();
        if !(norm > 0.5 && norm < 2.0) {
            return Err(cells.wrong(line, "qw", format!("expected a unit quaternion, found length {norm}")));
        }
        row[3..].iter_mut().for_each(|q| *q /= norm);
        let name = sensor.and_then(|column| record.get(column)).unwrap_or("sensor");
        let index = tracks.iter().position(|track| track.name == name).unwrap_or_else(|| {
            tracks.push(RawTrack { name: name.to_owned(), t_s: Vec::new(), rows: Vec::new() });
            tracks.len() - 1
        });
        let t = number(t_column)?;
        let track = &mut tracks[index];
        if track.t_s.last().is_some_and(|&last| last >= t) {
            return Err(cells.wrong(
                line,
                "t",
                format!("expected a time after the last one of `{name}`, found {t}"),
            ));
        }
        track.t_s.push(t);
        track.rows.push(row);
    }
    if tracks.is_empty() {
        return Err(cells.wrong(2, "t", "expected at least one row with a position".to_owned()));
    }
    Ok(tracks)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(ending: Ending) -> File {
        File {
            path: "unused".into(),
            unit_m: None,
            up: None,
            origin_m: [0.0; 3],
            heading_deg: 0.0,
            speed: 1.0,
            ending,
        }
    }

    fn csv(text: &str, ending: Ending) -> Result<Tracks, FileError> {
        let raw = csv_tracks(text.as_bytes(), Path::new("poses.csv"))?;
        Ok(Tracks::new(raw, &Isometry3::identity(), 1.0, &file(ending)))
    }

    const POSES: &str = "# a comment\nt,sensor,x,y,z,qw,qx,qy,qz\n\
        10.0,left,1,2,3,1,0,0,0\n10.0,right,0,0,0,1,0,0,0\n\
        10.5,left,1.5,2,3,0,0,0,1\n10.5,right,,,,,,,\n11.0,left,2,2,3,0,0,0,-1\n11.0,right,1,0,0,1,0,0,0\n";

    #[test]
    fn poses_of_several_sensors_start_together() {
        let tracks = csv(POSES, Ending::Hold).unwrap();
        assert_eq!(tracks.names().collect::<Vec<_>>(), ["left", "right"]);
        assert_eq!(tracks.pose(0, 0.0).translation.vector, Vector3::new(1.0, 2.0, 3.0));
        assert_eq!(tracks.pose(1, 7.0).translation.vector, Vector3::new(1.0, 0.0, 0.0));
        assert!((tracks.pose(0, 0.5).rotation.angle() - std::f64::consts::PI).abs() < 1e-9);
    }

    #[test]
    fn there_and_back_returns() {
        let tracks = csv(POSES, Ending::ThereAndBack).unwrap();
        let x = |t| tracks.pose(0, t).translation.x;
        assert!((x(0.3) - x(1.7)).abs() < 1e-12);
        assert!((x(0.3) - x(2.3)).abs() < 1e-12);
    }

    #[test]
    fn bad_rows_are_named() {
        let message = |text: &str| csv(text, Ending::Hold).unwrap_err().to_string();
        assert_eq!(message("t,x,y\n0,1,2\n"), "poses.csv: line 1, column z: the column is missing");
        assert_eq!(
            message("t,x,y,z\n0,1,two,3\n"),
            "poses.csv: line 2, column y: expected a number, found `two`"
        );
        assert!(message("t,x,y,z\n0,1,2,3\n0,1,2,3\n").contains("line 3, column t: expected a time after"));
        assert!(message("t,x,y,z,qw,qx,qy,qz\n0,1,2,3,0,0,0,0\n").contains("unit quaternion"));
        assert!(message("t,x,y,z\n").contains("at least one row"));
        assert!(message("t,x,y,z\n0,1,nan,3\n").contains("found `nan`"));
    }

    #[test]
    fn y_up_becomes_z_up() {
        let placement = placement(Up::Y, &file(Ending::Hold));
        let row = place([0.0, 100.0, 0.0, 1.0, 0.0, 0.0, 0.0], &placement, 0.01);
        assert!((row[2] - 1.0).abs() < 1e-12 && row[0].abs() + row[1].abs() < 1e-12);
    }

    #[test]
    fn an_absent_file_is_named() {
        let missing = File { path: "no/such.bvh".into(), ..file(Ending::Hold) };
        let error = Tracks::read(&missing, Path::new("/nowhere")).unwrap_err().to_string();
        assert!(error.contains("/nowhere/no/such.bvh"), "{error}");
        let folder = std::env::temp_dir();
        let odd = folder.join("posed-simulator-odd-name.txt");
        std::fs::write(&odd, "x").unwrap();
        let error = Tracks::read(&File { path: odd.clone(), ..file(Ending::Hold) }, &folder).unwrap_err();
        std::fs::remove_file(odd).unwrap();
        assert!(error.to_string().contains("should end in"), "{error}");
    }
}
