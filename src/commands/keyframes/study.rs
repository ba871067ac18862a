//! `posed keyframes study`: Table 2 of Merckel and Nishida (2010), for any method.

use nalgebra::Isometry3;
use posed_baselines::singular_spectrum::SingularSpectrum;
use posed_motion::keyframes::{Detector, HingeSettings, Method};
use posed_simulator::gesture::{CHANGES, Gesture, NOISE, count_errors};
use posed_stage::{Keyframes, KeyframesMethod};
use serde::Serialize;

use super::{Error, Shape, positive, print, print_json};

/// Half widths of the published table, and that of a method that is tried at one only, frames.
const WINDOWS: [usize; 5] = [10, 20, 30, 40, 50];
const WINDOW: usize = 30;
/// False positives and misses that the paper prints: a row for each level of noise, a column for each half width.
const PUBLISHED: [[(u32, u32); 5]; 7] = [
    [(0, 0), (0, 0), (0, 0), (1, 0), (1, 1)],
    [(0, 1), (0, 0), (0, 0), (1, 0), (1, 1)],
    [(2, 1), (0, 0), (0, 0), (1, 1), (1, 1)],
    [(19, 0), (1, 0), (0, 0), (0, 0), (0, 1)],
    [(27, 0), (10, 0), (0, 0), (0, 0), (0, 1)],
    [(28, 1), (13, 0), (4, 0), (1, 0), (0, 1)],
    [(28, 1), (10, 1), (4, 0), (3, 0), (4, 2)],
];
/// The threshold of a method without one is chosen on gestures from this seed on, so many of each level.
const OTHER_SEED: u64 = 1000;
const OTHERS: u64 = 5;

/// What to count.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  posed keyframes study --seeds 50\n  posed keyframes study --method paper --seeds 50\n  \
    posed keyframes study --method sst --seeds 2\n\n\
    Each cell: false positives and misses on gestures of 1000 frames with six changes, mean over the seeds. A detection less than\n\
    10 frames from a change finds it. The changes at 250 and 300 are 50 frames apart."
)]
pub(super) struct Args {
    /// `hinge`: the default; `paper`: Merckel and Nishida; `sst`: singular spectrum analysis (Moskvina and Zhigljavsky, 2003)
    /// over the whole series at N = 30, its threshold for each level chosen on other gestures.
    #[arg(long, value_enum, default_value = "hinge")]
    method: MethodName,
    /// Gestures in each cell.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u16).range(1..))]
    seeds: u16,
    /// How the pieces of the gestures look; `bent` is nearest to the published one.
    #[arg(long, value_enum, default_value = "bent")]
    shape: Shape,
    /// What turning by one radian counts as against moving, m (paper); that adds radians and centimetres.
    #[arg(long, default_value_t = 0.01, value_parser = positive)]
    metres_per_radian: f64,
    /// By what share of the mean motion before it a change must exceed it: the paper's x (paper).
    #[arg(long, value_name = "X", default_value_t = 0.5, value_parser = positive)]
    acceptance: f64,
    /// On either side a change exceeds all others within so many frames: the paper's n (paper) [default: N].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=500))]
    neighbourhood: Option<u16>,
    /// Without the smoothing of motion and statistic (paper).
    #[arg(long)]
    unsmoothed: bool,
    /// False alarms per minute that noise may cause (hinge).
    #[arg(long, default_value_t = 1.0, value_parser = positive)]
    false_alarms_per_min: f64,
    /// Print the table as one JSON object: windows, levels, false_positives, misses, rank_correlation.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum MethodName {
    Hinge,
    Paper,
    Sst,
}

/// Errors of one cell, mean over its gestures.
#[derive(Clone, Copy, Default, Serialize)]
struct Cell {
    false_positives: f64,
    misses: f64,
}

impl Cell {
    fn errors(&self) -> f64 {
        self.false_positives + self.misses
    }
}

/// A row of the table.
#[derive(Serialize)]
struct Level {
    sigma_m: f64,
    sigma_deg: f64,
    cells: Vec<Cell>,
}

#[derive(Serialize)]
struct Table {
    windows: Vec<usize>,
    levels: Vec<Level>,
    /// Sums over the cells.
    false_positives: f64,
    misses: f64,
    /// Of the cells' errors with those that are published (Spearman), where all windows were tried.
    rank_correlation: Option<f64>,
}

pub(super) fn run(args: &Args) -> Result<(), Error> {
    let table = match args.method {
        MethodName::Hinge => of_detectors(args, KeyframesMethod::Hinge),
        MethodName::Paper => of_detectors(args, KeyframesMethod::Paper),
        MethodName::Sst => of_sst(args),
    };
    if args.json { print_json(&table) } else { print(&sentences(&table)) }
}

fn gesture(args: &Args, seed: u64, level: usize) -> Vec<Isometry3<f64>> {
    Gesture { shape: args.shape.into(), ..Gesture::of_the_table(seed) }.noisy(NOISE[level])
}

fn of_detectors(args: &Args, method: KeyframesMethod) -> Table {
    let detector = |window: usize| {
        let keyframes = Keyframes {
            sensors: None,
            method,
            window_frames: window as u16,
            false_alarms_per_min: args.false_alarms_per_min,
            neighbourhood_frames: args.neighbourhood,
            metres_per_radian: args.metres_per_radian,
            acceptance: args.acceptance,
            smooth: !args.unsmoothed,
        };
        Detector::new(Method::new(keyframes.settings(HingeSettings::default().frame_rate_hz, true)))
    };
    // A threshold is computed once.
    let detectors = WINDOWS.map(detector);
    table(args, &WINDOWS, |_, poses| {
        let found = |detector: &Detector<Method>| {
            let (keys, _) = detector.clone().run(poses);
            keys.iter().map(|key| key.frame as usize).collect()
        };
        detectors.iter().map(found).collect()
    })
}

fn of_sst(args: &Args) -> Table {
    let transform = SingularSpectrum { window: WINDOW, ..SingularSpectrum::default() };
    let errors = |found: &[usize]| {
        let (false_positives, misses) = count_errors(found.iter().copied());
        false_positives + misses
    };
    let threshold = |level: usize| {
        let others: Vec<Vec<f64>> = (OTHER_SEED..OTHER_SEED + OTHERS)
            .map(|seed| transform.scores(&gesture(args, seed, level)))
            .collect();
        transform.threshold(&others, errors)
    };
    let thresholds: Vec<_> = (0..NOISE.len()).map(threshold).collect();
    table(args, &[WINDOW], |level, poses| vec![transform.peaks(&transform.scores(poses), thresholds[level])])
}

/// Counts the errors of what `detect` finds for each of the windows.
fn table(
    args: &Args,
    windows: &[usize],
    detect: impl Fn(usize, &[Isometry3<f64>]) -> Vec<Vec<usize>>,
) -> Table {
    let seeds = u64::from(args.seeds);
    let level = |(level, (sigma_m, sigma_deg)): (usize, (f64, f64))| {
        let mut cells = vec![Cell::default(); windows.len()];
        for seed in 0..seeds {
            for (cell, found) in cells.iter_mut().zip(detect(level, &gesture(args, seed, level))) {
                let (false_positives, misses) = count_errors(found);
                cell.false_positives += false_positives as f64 / seeds as f64;
                cell.misses += misses as f64 / seeds as f64;
            }
        }
        Level { sigma_m, sigma_deg, cells }
    };
    let levels: Vec<Level> = NOISE.into_iter().enumerate().map(level).collect();
    let cells = || levels.iter().flat_map(|level| &level.cells);
    let published: Vec<f64> =
        PUBLISHED.iter().flatten().map(|&(alarms, misses)| f64::from(alarms + misses)).collect();
    let errors: Vec<f64> = cells().map(Cell::errors).collect();
    Table {
        windows: windows.to_vec(),
        false_positives: cells().map(|cell| cell.false_positives).sum(),
        misses: cells().map(|cell| cell.misses).sum(),
        rank_correlation: (windows == WINDOWS).then(|| rank_correlation(&errors, &published)),
        levels,
    }
}

/// Ranks, ties shared.
fn ranks(values: &[f64]) -> Vec<f64> {
    let rank = |value: &f64| {
        let below = values.iter().filter(|other| *other < value).count() as f64;
        let equal = values.iter().filter(|other| *other == value).count() as f64;
        below + 0.5 * (equal - 1.0)
    };
    values.iter().map(rank).collect()
}

fn rank_correlation(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (ranks(a), ranks(b));
    let mean = (a.len() - 1) as f64 / 2.0;
    let product = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| (x - mean) * (y - mean)).sum::<f64>();
    product(&a, &b) / (product(&a, &a) * product(&b, &b)).sqrt()
}

/// The table for a person.
fn sentences(table: &Table) -> String {
    let mut text = String::from("false positives + misses\n  noise           ");
    for window in &table.windows {
        text += &format!("      N = {window}");
    }
    for level in &table.levels {
        text += &format!("\n  {:4.0} mm {:4.1} deg", 1e3 * level.sigma_m, level.sigma_deg);
        for cell in &level.cells {
            text += &format!(" {:5.1} + {:.1}", cell.false_positives, cell.misses);
        }
    }
    text += &format!("\n{:.1} false positives and {:.1} misses", table.false_positives, table.misses);
    text += &format!(" of {} changes", CHANGES.len() * NOISE.len() * table.windows.len());
    if let Some(correlation) = table.rank_correlation {
        let published = || PUBLISHED.iter().flatten();
        let (alarms, misses): (u32, u32) =
            (published().map(|cell| cell.0).sum(), published().map(|cell| cell.1).sum());
        text += &format!("; published {alarms} and {misses}, rank correlation of the cells {correlation:.2}");
    }
    text + "\n"
}
