//! `posed faults train|detect|study|generate`: faulty frames of a set of magnetic sensors.

mod generate;
mod study;

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::reading::Reading;
use super::{Error, notify, output, print, print_json};
use crate::pictures::faults as picture;
use posed_baselines::fault_map;
use posed_fusion::faults::{Cause, Class, Label};
use posed_motion::fault_map::Frames;
use posed_motion::fault_map::{FaultMap, FaultMapError, Labels, Size};
use posed_motion::fault_map::{Separation, separation};
use posed_motion::fault_map::{Training, Width};
use posed_recording::table::{
    PoseColumns, PoseRow, PoseWriter, Poses, Sequences, TableError, TableReader, TableWriter,
};
use posed_recording::{is_recording, raw_poses};

/// What a row of labels names in place of a sensor where it speaks of the whole frame.
const WHOLE_FRAME: &str = "*";

/// Learns, finds and studies faulty frames.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  posed faults train scripted.csv -o FAULTS.json\n  \
    posed faults detect FAULTS.json session.csv -o labels.csv --picture map.svg\n\n\
    Positions are in transmitter axes turned z up, in metres. Nobody labels anything: classes are identified by physics.")]
pub(crate) struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Trains the two-layer map on a recording and names its cells.
    #[command(after_help = "Example:\n  posed faults train scripted.csv -o FAULTS.json --labels labels.csv")]
    Train(TrainArgs),
    /// Labels the frames of a recording.
    #[command(after_help = "Example:\n  posed faults detect FAULTS.json session.csv -o labels.csv")]
    Detect(DetectArgs),
    /// Trains maps of 25 sizes and reports how well each separates the classes, and how long it takes.
    Study(study::Args),
    /// Writes a person's session with faults whose truth is known.
    Generate(generate::Args),
}

#[derive(Clone, Copy, clap::Args)]
struct TrainingArgs {
    /// How weights are moved: the paper's rule, row by row, on positions as they are; or all rows at once, on positions
    /// in the figure's own axes.
    #[arg(long, value_enum, default_value = "batch")]
    rule: RuleName,
    /// Passes over the frames at most; absent: 100 for the paper's rule, 30 for batch.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..))]
    epochs: Option<u16>,
    /// Neighbourhood of one neuron throughout, as published, and no early end.
    #[arg(long)]
    as_published: bool,
    /// Frames per epoch at most, drawn anew each time; 0 for all.
    #[arg(long, default_value_t = 1000)]
    subset: usize,
    /// Seed of the order of frames.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum RuleName {
    Paper,
    Batch,
}

impl TrainingArgs {
    fn train(&self, frames: &Frames, size: Size) -> Result<(FaultMap, Labels), FaultMapError> {
        let training = Training {
            width: if self.as_published { Width::Fixed } else { Width::Shrink },
            stop: !self.as_published,
            seed: self.seed,
            ..Training::default()
        };
        match self.rule {
            RuleName::Paper => {
                let published = fault_map::published();
                let training = Training {
                    epochs: self.epochs.map_or(published.epochs, usize::from),
                    subset: if self.as_published { 0 } else { self.subset },
                    body: published.body,
                    ..training
                };
                fault_map::train(frames, size, &training)
            }
            // This rule is cheap enough for all frames.
            RuleName::Batch => {
                let epochs = self.epochs.map_or(training.epochs, usize::from);
                FaultMap::train(frames, size, &Training { epochs, ..training })
            }
        }
    }
}

#[derive(clap::Args)]
struct TrainArgs {
    /// Poses of a recording that shows all kinds of frames: .mcap, or a table with a row for each sensor or columns for each joint.
    poses: PathBuf,
    #[command(flatten)]
    reading: Reading,
    /// Where to write the network.
    #[arg(short, long, value_name = "FAULTS.json")]
    output: PathBuf,
    /// Where to write the automatic labels.
    #[arg(long, value_name = "OUT.csv")]
    labels: Option<PathBuf>,
    /// Neurons per sensor.
    #[arg(long, default_value_t = 41, value_parser = clap::value_parser!(u16).range(2..=500))]
    neurons: u16,
    /// Rows and columns of the second layer.
    #[arg(long, default_value_t = 21, value_parser = clap::value_parser!(u16).range(2..=100))]
    side: u16,
    #[command(flatten)]
    training: TrainingArgs,
    /// Print a summary as one JSON object.
    #[arg(long)]
    json: bool,
}

#[derive(clap::Args)]
struct DetectArgs {
    /// The network.
    fault_map: PathBuf,
    /// Poses of the same sensors.
    poses: PathBuf,
    #[command(flatten)]
    reading: Reading,
    /// Where to write the labels.
    #[arg(short, long, value_name = "LABELS.csv")]
    output: PathBuf,
    /// Where to draw the map and the distance over time.
    #[arg(long, value_name = "PICTURE.svg")]
    picture: Option<PathBuf>,
    /// Where to write the positions with inverted ones mirrored back and anomalous ones left out.
    #[arg(long, value_name = "POSES.csv")]
    repaired: Option<PathBuf>,
    /// Print a summary as one JSON object.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    match args.command {
        Command::Train(args) => train(&args),
        Command::Detect(args) => detect(&args),
        Command::Study(args) => study::run(&args),
        Command::Generate(args) => generate::run(&args),
    }
}

/// Poses of a table, a row for each sensor or columns for each joint; or the raw ones of a recording: its poses have been repaired already.
fn read(path: &Path, reading: &Reading) -> Result<Frames, Error> {
    if is_recording(path) {
        let read = raw_poses::read(path);
        return read.map_err(|error| Error::failed(format!("{}: {error}", path.display())));
    }
    let read = || {
        let table = TableReader::open(path)?;
        if table.columns().iter().any(|column| column.ends_with("_x")) {
            return Ok(Sequences::from_table(table, &reading.options())?.poses());
        }
        Ok(Poses::from_table(table)?.frames())
    };
    read().map_err(|error: TableError| Error::failed(error))
}

#[derive(Serialize)]
struct Trained {
    frames: usize,
    sensors: usize,
    epochs: usize,
    classes: Counts,
    map: Separation,
}

#[derive(Default, Serialize)]
struct Counts {
    clean: usize,
    inverted: usize,
    anomalous: usize,
    unknown: usize,
}

impl Counts {
    fn of(classes: impl IntoIterator<Item = Class>) -> Self {
        let mut counts = Self::default();
        for class in classes {
            *match class {
                Class::Clean => &mut counts.clean,
                Class::Inverted => &mut counts.inverted,
                Class::Anomalous => &mut counts.anomalous,
                Class::Unknown => &mut counts.unknown,
            } += 1;
        }
        counts
    }

    fn sentence(&self) -> String {
        let Self { clean, inverted, anomalous, unknown } = self;
        format!("{clean} clean, {inverted} inverted, {anomalous} anomalous, {unknown} unknown")
    }
}

fn train(args: &TrainArgs) -> Result<(), Error> {
    let frames = read(&args.poses, &args.reading)?;
    let size = Size { neurons: usize::from(args.neurons), side: usize::from(args.side) };
    let (fault_map, labels) = args
        .training
        .train(&frames, size)
        .map_err(|error| Error::failed(format!("{}: {error}", args.poses.display())))?;
    let classes: Vec<Class> = labels.frames.iter().map(|label| label.class).collect();
    let map = separation(&fault_map, &frames, &classes);
    output::replace(&args.output, |file| {
        serde_json::to_writer(&mut *file, &fault_map).map_err(std::io::Error::from)?;
        file.write_all(b"\n")
    })?;
    if let Some(path) = &args.labels {
        write_labels(path, &frames, &labels, None).map_err(Error::failed)?;
    }
    let summary = Trained {
        frames: frames.len(),
        sensors: frames.sensors.len(),
        epochs: fault_map.epochs,
        classes: Counts::of(classes),
        map,
    };
    if args.json {
        return print_json(&summary);
    }
    notify(&format!("{} frames: {}; {} epochs", summary.frames, summary.classes.sentence(), summary.epochs));
    Ok(())
}

#[derive(Serialize)]
struct Detected {
    frames: usize,
    classes: Counts,
}

fn detect(args: &DetectArgs) -> Result<(), Error> {
    let text =
        std::fs::read(&args.fault_map).map_err(|error| Error::file("read", &args.fault_map, &error))?;
    let fault_map: FaultMap = serde_json::from_slice(&text)
        .map_err(|error| Error::failed(format!("{}: {error}", args.fault_map.display())))?;
    let frames = fault_map
        .adapt(&read(&args.poses, &args.reading)?)
        .map_err(|error| Error::failed(format!("{}: {error}", args.poses.display())))?;
    let mut labels = Labels::default();
    let mut drawn = Vec::with_capacity(frames.len());
    let mut sensor_distances = Vec::with_capacity(frames.len() * frames.sensors.len());
    fault_map.watch().follow(&fault_map, &frames, |_, judged| {
        labels.frames.push(judged.label);
        labels.sensors.extend_from_slice(judged.sensors);
        sensor_distances.extend_from_slice(judged.distances_m);
        let distance = judged.winner.map_or(f64::NAN, |winner| winner.distance);
        drawn.push((judged.winner.map(|winner| winner.cell), distance, judged.label.class));
    });
    let distances: Vec<f64> = drawn.iter().map(|frame| frame.1).collect();
    let distances = Some((&distances[..], &sensor_distances[..]));
    write_labels(&args.output, &frames, &labels, distances).map_err(Error::failed)?;
    if let Some(path) = &args.picture {
        let title = format!("{}: winner cells by class", args.poses.display());
        let text = picture::draw(&title, fault_map.size(), &fault_map.cells, &drawn);
        output::replace(path, |file| file.write_all(text.as_bytes()))?;
    }
    if let Some(path) = &args.repaired {
        write_repaired(path, &frames, &labels).map_err(Error::failed)?;
    }
    let summary =
        Detected { frames: frames.len(), classes: Counts::of(labels.frames.iter().map(|label| label.class)) };
    if args.json {
        return print_json(&summary);
    }
    notify(&format!("{} frames: {}", summary.frames, summary.classes.sentence()));
    Ok(())
}

/// One row per sensor, and one for the frame. Distances are those of the frames from their cells, and of the sensors
/// from the nearest place of the training, m.
fn write_labels(
    path: &Path,
    frames: &Frames,
    labels: &Labels,
    distances: Option<(&[f64], &[f64])>,
) -> Result<(), TableError> {
    let columns = ["t", "frame", "sensor", "label", "cause", "distance", "repaired"];
    let mut table = TableWriter::create(path, &columns)?;
    let sensors = frames.sensors.len();
    for (k, t_s) in frames.t_s.iter().enumerate() {
        let mut row = |sensor: &str, label: Label, distance: f64| {
            table.number(*t_s)?;
            table.text(&k.to_string())?;
            table.text(sensor)?;
            table.text(label.class.name())?;
            table.text(label.cause.map_or("", Cause::name))?;
            table.number(distance)?;
            // Of a sensor: its mirror image is where it was. Of the frame: that of all that are inverted.
            table.text(if label.class == Class::Inverted { "1" } else { "0" })?;
            table.end_row()
        };
        for (sensor, name) in frames.sensors.iter().enumerate() {
            let at = k * sensors + sensor;
            row(name, labels.sensors[at], distances.map_or(f64::NAN, |distances| distances.1[at]))?;
        }
        row(WHOLE_FRAME, labels.frames[k], distances.map_or(f64::NAN, |distances| distances.0[k]))?;
    }
    table.finish()
}

/// What is left once inverted positions are mirrored back and anomalous ones are gone.
fn write_repaired(path: &Path, frames: &Frames, labels: &Labels) -> Result<(), TableError> {
    write_poses(path, frames, |at, p| {
        let label = labels.sensors[at];
        let is_left = !matches!(label.class, Class::Anomalous | Class::Unknown);
        is_left.then(|| label.mirror().map_or(p, |mirror| mirror.apply(p)))
    })
}

/// Writes what `keep` leaves of each pose's position, by its place among all, frame by frame.
fn write_poses(
    path: &Path,
    frames: &Frames,
    keep: impl Fn(usize, [f64; 3]) -> Option<[f64; 3]>,
) -> Result<(), TableError> {
    let orientation = !frames.orientations_wxyz.is_empty();
    let columns = PoseColumns { sensor: true, orientation, ..PoseColumns::default() };
    let mut table = PoseWriter::create(path, columns)?;
    let sensors = frames.sensors.len();
    for (k, t_s) in frames.t_s.iter().enumerate() {
        for (sensor, p) in frames.positions(k).chunks_exact(3).enumerate() {
            let at = k * sensors + sensor;
            let Some(position_m) = keep(at, [p[0], p[1], p[2]]) else { continue };
            let q = frames.orientations_wxyz.get(4 * at..4 * at + 4);
            let orientation_wxyz = q.map(|q| [q[0], q[1], q[2], q[3]]).filter(|q| q[0].is_finite());
            let row =
                PoseRow { t_s: *t_s, sensor, position_m: Some(position_m), orientation_wxyz, state: None };
            table.row(&frames.sensors[sensor], None, &row)?;
        }
    }
    table.finish()
}
