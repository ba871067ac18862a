//! `posed keyframes POSES.csv -o KEYS.csv`: changes of each sensor's motion, and a smooth path between.

use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Vector3};
use serde::Serialize;

use super::{Error, notify, output, positive, print_json};
use posed_motion::keyframes::{BRIDGED_FRAMES, bridge};
use posed_motion::keyframes::{Detector, KeyPose, Method, Trace};
use posed_motion::keyframes::{Deviation, ScrewPath, Spline};
use posed_recording::animation::{Item, Line, write_items};
use posed_recording::table::{PoseRow, Poses, TableWriter};
use posed_stage::{Keyframes, KeyframesMethod};

/// How far a screw's axis is drawn beyond what its segment goes along it, m.
const AXIS_END_M: f64 = 0.05;
/// Colours of an animation: as it was recorded, smooth, in screws.
const RECORDED: [f32; 3] = [0.6, 0.6, 0.6];
const SMOOTH: [f32; 3] = [0.12, 0.47, 0.71];
const SCREW: [f32; 3] = [0.84, 0.15, 0.16];

/// Where to look, and how.
#[derive(clap::Args)]
pub(super) struct Find {
    /// Poses, one per frame and sensor: CSV or a recording.
    poses: PathBuf,
    /// Where to write the changes.
    #[arg(short, long, value_name = "KEYS.csv")]
    output: PathBuf,
    /// `hinge`: a hinge fitted beside a parabola; `paper`: Merckel and Nishida (2010).
    #[arg(long, value_enum, default_value = "hinge")]
    method: MethodName,
    /// Frames on either side of a change that are looked at; a change is known twice as many later.
    #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u16).range(5..=500))]
    window: u16,
    /// False alarms per minute and sensor that noise may cause (hinge).
    #[arg(long, default_value_t = 1.0, value_parser = positive)]
    false_alarms_per_min: f64,
    /// On either side a change exceeds all others within so many frames: the paper's n (paper) [default: the window].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=500))]
    neighbourhood: Option<u16>,
    /// What turning by one radian counts as against moving, in metres (paper).
    #[arg(long, default_value_t = 0.1, value_parser = positive)]
    metres_per_radian: f64,
    /// By what share of the mean motion before it a change must exceed it: the paper's x (paper).
    #[arg(long, value_name = "X", default_value_t = 0.5, value_parser = positive)]
    acceptance: f64,
    /// Without the smoothing of motion and statistic, which costs 18 frames of delay (paper).
    #[arg(long)]
    unsmoothed: bool,
    /// Where to write the smooth path through the key poses, at the input's times.
    #[arg(long, value_name = "OUT.csv")]
    resample: Option<PathBuf>,
    /// Where to draw the statistic over time and the path of the first sensor.
    #[arg(long, value_name = "PICTURE.svg")]
    picture: Option<PathBuf>,
    /// Where to write the first sensor as it was recorded, on the smooth path and on one screw for each segment, with the screws' axes:
    /// an animation for browsers and Blender.
    #[arg(long, value_name = "MOTION.glb")]
    animation: Option<PathBuf>,
    /// Print a summary as one JSON object.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum MethodName {
    Hinge,
    Paper,
}

impl From<MethodName> for KeyframesMethod {
    fn from(name: MethodName) -> Self {
        match name {
            MethodName::Hinge => Self::Hinge,
            MethodName::Paper => Self::Paper,
        }
    }
}

pub(super) fn run(args: Find) -> Result<(), Error> {
    let poses = Poses::read(&args.poses).map_err(Error::failed)?;
    let ticks =
        Ticks::of(&poses).map_err(|reason| Error::failed(format!("{}: {reason}", args.poses.display())))?;
    let mut found = Vec::new();
    let mut resampled = poses.clone();
    let mut sensors = Vec::new();
    let table = args.table();
    for (index, name) in poses.sensors.iter().enumerate() {
        let sensor = Sensor::of(&poses, &ticks, index);
        let detector = Detector::new(Method::new(table.settings(ticks.rate_hz, sensor.orientation)));
        let mut summary = SensorSummary { name: name.clone(), ..SensorSummary::default() };
        for stretch in &sensor.stretches {
            let (keys, trace) = detector.clone().run(&stretch.poses);
            let spline = Spline::fit(&stretch.poses, &keys);
            summary.add(stretch, &keys, spline.as_ref());
            if let Some(spline) = &spline {
                stretch.resample(spline, sensor.orientation, &mut resampled);
            }
            if index == 0 && stretch.start == sensor.longest() {
                if let Some(path) = &args.picture {
                    draw(path, name, args.method, stretch, &trace, &keys, spline.as_ref())?;
                }
                if let Some(path) = &args.animation {
                    animate(path, &ticks, stretch, &keys, spline.as_ref())?;
                }
            }
            found.extend(keys.into_iter().map(|key| Found { start: stretch.start, sensor: index, key }));
        }
        sensors.push(summary.finish());
    }
    found.sort_by_key(|found| (found.frame(), found.sensor));
    write(&args.output, &found, &ticks, &poses.sensors).map_err(Error::failed)?;
    if let Some(path) = &args.resample {
        resampled.write(path).map_err(Error::failed)?;
    }
    let summary = Summary { frames: ticks.t_s.len(), rate_hz: ticks.rate_hz, keys: found.len(), sensors };
    if args.json {
        return print_json(&summary);
    }
    notify(&format!("{} frames at {:.4} Hz, {} changes", summary.frames, summary.rate_hz, summary.keys));
    Ok(())
}

impl Find {
    /// As a stage file would have it.
    fn table(&self) -> Keyframes {
        Keyframes {
            sensors: None,
            method: self.method.into(),
            window_frames: self.window,
            false_alarms_per_min: self.false_alarms_per_min,
            neighbourhood_frames: self.neighbourhood,
            metres_per_radian: self.metres_per_radian,
            acceptance: self.acceptance,
            smooth: !self.unsmoothed,
        }
    }
}

/// The frames of a file: its times.
struct Ticks {
    t_s: Vec<f64>,
    /// Tick of each row.
    of_row: Vec<usize>,
    rate_hz: f64,
}

impl Ticks {
    fn of(poses: &Poses) -> Result<Self, String> {
        let mut t_s: Vec<f64> = Vec::new();
        let mut of_row = Vec::with_capacity(poses.rows.len());
        for row in &poses.rows {
            match t_s.last() {
                Some(last) if row.t_s < *last => {
                    return Err(format!("expected times that rise, found {} s after {last} s", row.t_s));
                }
                Some(last) if row.t_s == *last => {}
                _ => t_s.push(row.t_s),
            }
            of_row.push(t_s.len() - 1);
        }
        let mut steps: Vec<f64> = t_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        if steps.is_empty() {
            return Err(format!("expected poses at two times at least, found {}", t_s.len()));
        }
        let middle = steps.len() / 2;
        let step = *steps.select_nth_unstable_by(middle, f64::total_cmp).1;
        Ok(Self { t_s, of_row, rate_hz: 1.0 / step })
    }
}

/// One sensor's motion, cut where it is missing for long.
struct Sensor {
    orientation: bool,
    stretches: Vec<Stretch>,
}

/// A motion without a gap.
struct Stretch {
    /// Its first frame.
    start: usize,
    poses: Vec<Isometry3<f64>>,
    /// Row of each frame; `None` where it was bridged.
    rows: Vec<Option<usize>>,
}

impl Sensor {
    fn of(poses: &Poses, ticks: &Ticks, index: usize) -> Self {
        let of_sensor = |row: &&PoseRow| row.sensor == index;
        let orientation = poses.rows.iter().filter(of_sensor).any(|row| row.orientation_wxyz.is_some());
        let mut stretches: Vec<Stretch> = Vec::new();
        for (number, (row, tick)) in poses.rows.iter().zip(&ticks.of_row).enumerate() {
            let wxyz = if orientation { row.orientation_wxyz } else { Some([1.0, 0.0, 0.0, 0.0]) };
            let pose = row.position_m.zip(wxyz).and_then(|(p, q)| posed_geometry::isometry(p, q));
            let Some(pose) = pose.filter(|_| row.sensor == index) else { continue };
            match stretches.last_mut() {
                Some(stretch) if *tick < stretch.end() => {} // A second row of the same frame.
                Some(stretch) if *tick - stretch.end() <= BRIDGED_FRAMES => stretch.push(*tick, pose, number),
                _ => stretches.push(Stretch { start: *tick, poses: vec![pose], rows: vec![Some(number)] }),
            }
        }
        Self { orientation, stretches }
    }

    /// First frame of the longest stretch.
    fn longest(&self) -> usize {
        self.stretches.iter().max_by_key(|stretch| stretch.poses.len()).map_or(0, |stretch| stretch.start)
    }
}

impl Stretch {
    fn end(&self) -> usize {
        self.start + self.poses.len()
    }

    fn push(&mut self, tick: usize, pose: Isometry3<f64>, row: usize) {
        let missing = tick - self.end();
        let last = self.poses[self.poses.len() - 1];
        for pose in bridge(&last, &pose, missing) {
            self.poses.push(pose);
            self.rows.push(None);
        }
        self.poses.push(pose);
        self.rows.push(Some(row));
    }

    /// Replaces the recorded poses by those of the path.
    fn resample(&self, spline: &Spline, orientation: bool, poses: &mut Poses) {
        for (offset, row) in self.rows.iter().enumerate() {
            let Some(row) = row.and_then(|row| poses.rows.get_mut(row)) else { continue };
            let pose = spline.pose(offset as f64);
            row.position_m = Some(pose.translation.vector.into());
            row.orientation_wxyz = orientation.then(|| posed_geometry::orientation_to_wxyz(&pose.rotation));
        }
    }
}

struct Found {
    start: usize,
    sensor: usize,
    key: KeyPose,
}

impl Found {
    fn frame(&self) -> usize {
        self.start + self.key.frame as usize
    }
}

fn write(
    path: &Path,
    found: &[Found],
    ticks: &Ticks,
    names: &[String],
) -> Result<(), posed_recording::table::TableError> {
    let mut table = TableWriter::create(path, &["frame", "t", "t_decided", "score", "sensor", "corner"])?;
    for found in found {
        let frame = found.frame();
        let decided = found.start + found.key.decided as usize;
        table.text(&frame.to_string())?;
        table.number(ticks.t_s[frame])?;
        table.number(ticks.t_s[decided.min(ticks.t_s.len() - 1)])?;
        table.number(found.key.score)?;
        table.text(&names[found.sensor])?;
        table.text(if found.key.corner { "1" } else { "0" })?;
        table.end_row()?;
    }
    table.finish()
}

fn draw(
    path: &Path,
    name: &str,
    method: MethodName,
    stretch: &Stretch,
    trace: &[Trace],
    keys: &[KeyPose],
    spline: Option<&Spline>,
) -> Result<(), Error> {
    let what = match method {
        MethodName::Hinge => "hinge fit",
        MethodName::Paper => "weighted means in se(3)",
    };
    let title =
        format!("{name} {what}: statistic (root scale) from frame {}, path with its spline", stretch.start);
    let text = crate::pictures::keyframes::draw(title.trim(), &stretch.poses, trace, keys, spline);
    output::replace(path, |file| file.write_all(text.as_bytes()))
}

/// The item as it was recorded, on both paths, and the axes of the screws (Figs. 12 to 14 of Merckel and Nishida).
fn animate(
    path: &Path,
    ticks: &Ticks,
    stretch: &Stretch,
    keys: &[KeyPose],
    spline: Option<&Spline>,
) -> Result<(), Error> {
    let frames = 0..stretch.poses.len();
    let item = |name: &str, colour, poses| Item { name: name.to_owned(), colour, poses };
    let mut items = vec![item("recorded", RECORDED, stretch.poses.clone())];
    if let Some(spline) = spline {
        items.push(item("spline", SMOOTH, frames.clone().map(|frame| spline.pose(frame as f64)).collect()));
    }
    let mut lines = Vec::new();
    if let Some(screws) = ScrewPath::new(&stretch.poses, keys) {
        items.push(item("screws", SCREW, frames.clone().map(|frame| screws.pose(frame as f64)).collect()));
        for ([first, last], screw) in screws.screws() {
            let direction = Vector3::from(screw.axis_direction);
            let half = direction * (0.5 * screw.advance_m.abs() + AXIS_END_M);
            let middle_m = Vector3::from(screw.axis_point_m) + direction * (0.5 * screw.advance_m);
            let name = format!("axis of frames {first} to {last}");
            lines.push(Line { name, colour: SCREW, points_m: vec![middle_m - half, middle_m + half] });
        }
    }
    let times_s = &ticks.t_s[stretch.start..stretch.end()];
    write_items(path, times_s, &items, &lines).map_err(Error::failed)
}

#[derive(Serialize)]
struct Summary {
    frames: usize,
    rate_hz: f64,
    keys: usize,
    sensors: Vec<SensorSummary>,
}

#[derive(Default, Serialize)]
struct SensorSummary {
    name: String,
    frames: usize,
    keys: usize,
    /// Root mean square distance of the spline from the recording.
    spline: Deviation,
    /// The same of one screw motion per segment.
    screw: Deviation,
}

impl SensorSummary {
    fn add(&mut self, stretch: &Stretch, keys: &[KeyPose], spline: Option<&Spline>) {
        let frames = stretch.poses.len();
        self.frames += frames;
        self.keys += keys.len();
        let all = 0..=frames - 1;
        let squares = |sum: &mut Deviation, one: Deviation| {
            sum.position_m += frames as f64 * one.position_m * one.position_m;
            sum.rotation_rad += frames as f64 * one.rotation_rad * one.rotation_rad;
        };
        if let (Some(spline), Some(screw)) = (spline, ScrewPath::new(&stretch.poses, keys)) {
            squares(&mut self.spline, spline.deviation(&stretch.poses, all.clone()));
            squares(&mut self.screw, screw.deviation(&stretch.poses, all));
        }
    }

    fn finish(mut self) -> Self {
        let frames = self.frames.max(1) as f64;
        for sum in [&mut self.spline, &mut self.screw] {
            sum.position_m = (sum.position_m / frames).sqrt();
            sum.rotation_rad = (sum.rotation_rad / frames).sqrt();
        }
        self
    }
}
