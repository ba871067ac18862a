//! The published cascade in its forms: which filter follows the pole, and whether the network learns from a grid.

use nalgebra::Vector3;
use posed_baselines::cascade::{Filter, Options, cascade};

use super::scenes::{SPACING_M, scenes};
use super::survey::pole;
use super::table::{Pair, aligned_mm};

/// Forms, and the spacing of their grid, m.
const FORMS: [(&str, Filter, Option<f64>); 4] = [
    ("13 states as printed", Filter::Printed, None),
    ("13 states, repaired", Filter::Repaired, None),
    ("10 states, smoothed", Filter::Reduced, None),
    ("the same on a grid of 0.1 m", Filter::Reduced, Some(0.1)),
];

/// Prints, for each scene and form, the distance of network and filter after eight rounds, and the rms error after rigid alignment after one
/// round and eight, mm, in the mean of the seeds that gave one; and the mean step of the filter's first three iterations, um.
#[expect(clippy::print_stdout, reason = "the table is the answer")]
pub(crate) fn run(seeds: u64, only: Option<&str>) {
    println!("| scene | form | residual, mm | once, mm | 8 rounds, mm | steps of the filter, um | seeds |");
    println!("|---|---|---|---|---|---|---|");
    for scene in scenes().iter().filter(|scene| only.is_none_or(|only| scene.name.contains(only))) {
        let runs: Vec<_> = (1..=seeds).map(|seed| scene.run(seed)).collect();
        for (name, filter, grid_m) in FORMS {
            let (mut residual, mut once, mut eight, mut steps, mut n) = (0.0, 0.0, 0.0, [0.0; 3], 0.0);
            for run in &runs {
                let recording = pole(run, SPACING_M);
                let [first, last] =
                    [1, 8].map(|rounds| cascade(&recording, &Options { filter, rounds, grid_m }));
                let (Some(first), Some(last)) = (first, last) else { continue };
                let error = |map: &dyn Fn(&Vector3<f64>) -> Vector3<f64>| {
                    let pairs: Vec<Pair> =
                        run.tests.iter().map(|sample| (map(&sample.z), sample.p)).collect();
                    aligned_mm(&pairs)
                };
                residual += 1e3 * last.residuals_m.last().copied().unwrap_or(f64::NAN);
                once += error(&|z| first.network.correct(z));
                eight += error(&|z| last.network.correct(z));
                for (sum, step) in steps.iter_mut().zip(last.track.steps.mean_m()) {
                    *sum += 1e6 * step;
                }
                n += 1.0;
            }
            let [a, b, c] = steps.map(|sum| sum / n);
            println!(
                "| {} | {name} | {:.2} | {:.2} | {:.2} | {a:.0}, {b:.1}, {c:.2} | {n} |",
                scene.name,
                residual / n,
                once / n,
                eight / n
            );
        }
    }
}
