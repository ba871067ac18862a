//! `posed faults study`: Table I and Figs. 8 to 10 of Miller et al. (2006).

#![expect(clippy::disallowed_methods, reason = "how long a training takes is part of the answer")]

use std::path::{Path, PathBuf};
use std::time::Instant;

use indicatif::{ProgressBar, ProgressStyle};
use nalgebra::{Matrix3, Vector3};
use posed_fusion::faults::Class;
use posed_motion::fault_map::{Frames, Rules, Separation, Size, separation};
use posed_recording::table::TableReader;
use serde::Serialize;

use super::{Error, Reading, TrainingArgs, WHOLE_FRAME, print, print_json, read};

/// What to study, and against which classes.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  posed faults study scripted.csv --rule paper --as-published\n  \
    posed faults study scripted.csv --truth truth.csv --neurons 31,41 --sides 21 --repetitions 5\n\n\
    Columns: used cells, their share, overlaps (cells with frames of several classes) beside the change-overs of the classes, purity (share\n\
    of frames in cells of their class), grouping (share of neighbouring cells of one class), mean distance from the winner, seconds of\n\
    training. With repetitions means, and the range of the overlaps.")]
pub(super) struct Args {
    /// Poses of a recording that shows all kinds of frames.
    poses: PathBuf,
    #[command(flatten)]
    reading: Reading,
    /// The classes of its frames, in place of those that the rules find: t,class with clean, inverted, anomalous or unknown; of what
    /// `posed faults detect` writes, the rows of whole frames.
    #[arg(long, value_name = "LABELS.csv")]
    truth: Option<PathBuf>,
    /// Neurons per sensor.
    #[arg(long, value_name = "N,N", value_delimiter = ',', default_value = "11,21,31,41,51", value_parser = clap::value_parser!(u16).range(2..=500))]
    neurons: Vec<u16>,
    /// Rows and columns of the second layer.
    #[arg(long, value_name = "N,N", value_delimiter = ',', default_value = "11,21,31,41,51", value_parser = clap::value_parser!(u16).range(2..=100))]
    sides: Vec<u16>,
    /// Trainings of each size, with one seed after the other.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
    repetitions: u16,
    /// What is done to the positions before a map sees them, of which the paper thinks for later: `centre` takes the mean of the frame's
    /// sensors off, `sphere` also makes their scatter a unit ball.
    #[arg(long, value_enum, default_value = "none")]
    preprocess: Preprocess,
    #[command(flatten)]
    training: TrainingArgs,
    /// Print all runs as one JSON object.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum Preprocess {
    None,
    Centre,
    Sphere,
}

/// One training.
#[derive(Serialize)]
struct Run {
    seed: u64,
    /// How long the training took.
    seconds: f64,
    #[serde(flatten)]
    separation: Separation,
}

#[derive(Serialize)]
struct Studied {
    sizes: Vec<Run>,
}

pub(super) fn run(args: &Args) -> Result<(), Error> {
    let frames = read(&args.poses, &args.reading)?;
    let classes = match &args.truth {
        Some(path) => read_classes(path, &frames)?,
        None => Rules::learn(&frames).1.frames.iter().map(|label| label.class).collect(),
    };
    let seen = preprocess(&frames, args.preprocess);
    let repetitions = usize::from(args.repetitions);
    let bar = ProgressBar::new((args.neurons.len() * args.sides.len() * repetitions) as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} maps, {eta} left") {
        bar.set_style(style);
    }
    let mut runs = Vec::new();
    for (neurons, side) in
        args.neurons.iter().flat_map(|neurons| args.sides.iter().map(move |side| (*neurons, *side)))
    {
        for repetition in 0..u64::from(args.repetitions) {
            let seed = args.training.seed.wrapping_add(repetition);
            let training = TrainingArgs { seed, ..args.training };
            let size = Size { neurons: neurons.into(), side: side.into() };
            let begun = Instant::now();
            let (fault_map, _) = training
                .train(&seen, size)
                .map_err(|error| Error::failed(format!("{}: {error}", args.poses.display())))?;
            let seconds = begun.elapsed().as_secs_f64();
            runs.push(Run { seed, seconds, separation: separation(&fault_map, &seen, &classes) });
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    if args.json {
        return print_json(&Studied { sizes: runs });
    }
    print("neurons side used  share overlaps (range) change-overs purity grouping error seconds\n")?;
    for runs in runs.chunks(repetitions) {
        print(&row(runs))?;
    }
    Ok(())
}

/// The runs of one size as a row.
fn row(runs: &[Run]) -> String {
    let mean = |of: fn(&Run) -> f64| runs.iter().map(of).sum::<f64>() / runs.len() as f64;
    let overlaps = || runs.iter().map(|run| run.separation.overlaps);
    let Some(Run { separation: Separation { neurons, side, changeovers, .. }, .. }) = runs.first() else {
        return String::new();
    };
    format!(
        "{neurons:7} {side:4} {:4.0} {:5.1}% {:8.1} ({}-{}) {changeovers:12} {:6.4} {:8.3} {:.4} {:7.2}\n",
        mean(|run| run.separation.used as f64),
        100.0 * mean(|run| run.separation.used_share),
        mean(|run| run.separation.overlaps as f64),
        overlaps().min().unwrap_or(0),
        overlaps().max().unwrap_or(0),
        mean(|run| run.separation.purity),
        mean(|run| run.separation.grouping),
        mean(|run| run.separation.error),
        mean(|run| run.seconds),
    )
}

/// The class of each frame, by its time; a frame without one is unknown.
fn read_classes(path: &Path, frames: &Frames) -> Result<Vec<Class>, Error> {
    let mut table = TableReader::open(path).map_err(Error::failed)?;
    let [t, class] = table.require(["t", "class"]).map_err(Error::failed)?;
    let sensor = table.column("sensor").map_err(Error::failed)?;
    let mut classes = vec![Class::Unknown; frames.len()];
    let mut known = 0;
    while table.next_row().map_err(Error::failed)? {
        if sensor.is_some_and(|sensor| table.text(sensor) != WHOLE_FRAME) {
            continue;
        }
        let named = [Class::Clean, Class::Inverted, Class::Anomalous, Class::Unknown];
        let Some(class) = named.into_iter().find(|named| named.name() == table.text(class)) else {
            return Err(Error::failed(table.cell_error(class, "clean, inverted, anomalous or unknown")));
        };
        let t_s = table.required_number(t).map_err(Error::failed)?;
        let frame = frames.t_s.partition_point(|at| *at < t_s - 1e-6);
        if frames.t_s.get(frame).is_some_and(|at| (at - t_s).abs() <= 1e-6) {
            classes[frame] = class;
            known += 1;
        }
    }
    if known == 0 {
        return Err(Error::Failed(format!("{}: no time of a frame in it", path.display())));
    }
    Ok(classes)
}

/// Positions as a map is to see them.
fn preprocess(frames: &Frames, how: Preprocess) -> Frames {
    if how == Preprocess::None {
        return frames.clone();
    }
    // Joints are where positions are.
    let mut seen = Frames { orientations_wxyz: Vec::new(), ..frames.clone() };
    let present = |p: &[f64]| p.iter().all(|x| x.is_finite());
    for frame in seen.positions_m.chunks_exact_mut(3 * frames.sensors.len().max(1)) {
        let (mut mean, mut n) = (Vector3::zeros(), 0.0);
        for p in frame.chunks_exact(3).filter(|p| present(p)) {
            mean += Vector3::from_column_slice(p);
            n += 1.0;
        }
        mean /= f64::max(n, 1.0);
        for p in frame.chunks_exact_mut(3) {
            p.iter_mut().zip(mean.iter()).for_each(|(x, mean)| *x -= mean);
        }
    }
    if how == Preprocess::Sphere {
        let (mut scatter, mut n) = (Matrix3::zeros(), 0.0);
        for p in seen.positions_m.chunks_exact(3).filter(|p| present(p)) {
            let p = Vector3::from_column_slice(p);
            scatter += p * p.transpose();
            n += 1.0;
        }
        let eigen = (scatter / f64::max(n, 1.0)).symmetric_eigen();
        let root = eigen.eigenvalues.map(|value| value.max(1e-12).sqrt().recip());
        let whiten = eigen.eigenvectors * Matrix3::from_diagonal(&root) * eigen.eigenvectors.transpose();
        for p in seen.positions_m.chunks_exact_mut(3) {
            p.copy_from_slice((whiten * Vector3::from_column_slice(p)).as_slice());
        }
    }
    seen
}
