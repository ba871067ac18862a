//! The table of scenes: the cascade, the joint solver, and the best that its own basis could do.

use nalgebra::{UnitQuaternion, Vector3};
use posed_baselines::cascade::{Options, cascade};
use posed_field::{FieldNoise, refit_known, refit_pole, rigid, solve};

use super::cpu;
use super::scenes::{SPACING_M, Sample, scenes};
use super::survey::{anchors, pole};

pub(crate) type Pair = (Vector3<f64>, Vector3<f64>);

/// Places of which the map reports more than this of itself are flagged as `extrapolated`, m.
const VOUCHED_M: f64 = 0.05;

/// Rms distance, mm.
fn absolute_mm(pairs: &[Pair]) -> f64 {
    1e3 * (pairs.iter().map(|(a, b)| (a - b).norm_squared()).sum::<f64>() / pairs.len() as f64).sqrt()
}

/// Rms distance after rigid alignment, mm.
pub(crate) fn aligned_mm(pairs: &[Pair]) -> f64 {
    let motion = rigid(pairs);
    let moved: Vec<Pair> =
        pairs.iter().map(|(a, b)| (motion.rotation * a + motion.translation.vector, *b)).collect();
    absolute_mm(&moved)
}

fn median_mm(pairs: &[Pair]) -> f64 {
    let motion = rigid(pairs);
    let mut errors: Vec<f64> =
        pairs.iter().map(|(a, b)| (motion.rotation * a + motion.translation.vector - b).norm()).collect();
    errors.sort_by(f64::total_cmp);
    1e3 * errors[errors.len() / 2]
}

#[derive(Default, Clone, Copy)]
struct Row {
    raw: f64,
    raw_absolute: f64,
    cascade_residual: f64,
    cascade_once: f64,
    cascade_eight: f64,
    solved: f64,
    median: f64,
    vouched: f64,
    doubted: f64,
    polynomial: f64,
    best: f64,
    begun: f64,
    anchored: f64,
    covered: f64,
    raw_deg: f64,
    solved_deg: f64,
    seconds: f64,
    busy_s: f64,
}

#[expect(
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "the table is the answer, and time a column"
)]
pub(crate) fn run(seeds: u64, only: Option<&str>) {
    println!(
        "| scene | raw | cascade residual | cascade once | cascade 8x | solved | (median) | where sigma < 5 cm | left out, % | best polynomial | same basis, \
         truth | pole, begun at the truth | raw, absolute | 3 anchors, absolute | covered by 2 sigma, % | rotation raw, deg | solved, deg | s | on one core, s |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    for scene in scenes().iter().filter(|scene| only.is_none_or(|only| scene.name.contains(only))) {
        let mut sum = Row::default();
        let mut models = Vec::new();
        for seed in 1..=seeds {
            let run = scene.run(seed);
            let recording = pole(&run, SPACING_M);
            let pairs = |map: &dyn Fn(&Vector3<f64>) -> Vector3<f64>| -> Vec<Pair> {
                run.tests.iter().map(|sample| (map(&sample.z), sample.p)).collect()
            };
            sum.raw += aligned_mm(&pairs(&|z| *z));
            sum.raw_absolute += absolute_mm(&pairs(&|z| *z));
            if let (Some(once), Some(eight)) = (
                cascade(&recording, &Options { rounds: 1, ..Options::default() }),
                cascade(&recording, &Options::default()),
            ) {
                sum.cascade_residual += 1e3 * eight.residuals_m.last().copied().unwrap_or(f64::NAN);
                sum.cascade_once += aligned_mm(&pairs(&|z| once.network.correct(z)));
                sum.cascade_eight += aligned_mm(&pairs(&|z| eight.network.correct(z)));
            }
            let (begun, busy_s) = (std::time::Instant::now(), cpu::process_s());
            let solution = solve(recording, &[], &mut |_| {});
            sum.seconds += begun.elapsed().as_secs_f64();
            sum.busy_s += cpu::process_s() - busy_s;
            let Some(map) = solution.map else { continue };
            models.push(if map.report.accepted { map.report.model.clone() } else { "refused".into() });
            let corrector = map.corrector();
            let solved = pairs(&|z| corrector.position(z));
            sum.solved += aligned_mm(&solved);
            sum.median += median_mm(&solved);
            let vouched: Vec<Pair> = run
                .tests
                .iter()
                .filter(|sample| corrector.correct(&sample.z).sigma_m < VOUCHED_M)
                .map(|sample| (corrector.position(&sample.z), sample.p))
                .collect();
            sum.vouched += aligned_mm(&vouched);
            sum.doubted += 100.0 * (1.0 - vouched.len() as f64 / run.tests.len() as f64);
            sum.polynomial += solution
                .polynomials
                .iter()
                .map(|model| aligned_mm(&pairs(&|z| model.correct(z))))
                .fold(f64::INFINITY, f64::min);
            let truth: Vec<Pair> =
                run.frames.iter().flatten().filter(|s| !s.stuck).map(|sample| (sample.z, sample.p)).collect();
            let noise = FieldNoise { floor_m: 3e-4, ..map.noise };
            if let Some(best) = refit_known(&map.model, &truth, noise) {
                sum.best += aligned_mm(&pairs(&|z| best.correct(z)));
                if let Some(begun) = refit_pole(pole(&run, SPACING_M), &best) {
                    sum.begun += aligned_mm(&pairs(&|z| begun.correct(z)));
                }
            }
            let noisy: Vec<Pair> = run.noisy.iter().map(|s| (corrector.position(&s.z), s.p)).collect();
            // A rigid fit to all would be bent by the few that are decimetres off.
            let sure: Vec<Pair> = run
                .noisy
                .iter()
                .zip(&noisy)
                .filter(|(sample, _)| corrector.correct(&sample.z).sigma_m < VOUCHED_M)
                .map(|(_, pair)| *pair)
                .collect();
            let motion = rigid(&sure);
            let covered = run.noisy.iter().filter(|sample| {
                let corrected = corrector.correct(&sample.z);
                let p = motion.rotation * corrected.position_m + motion.translation.vector;
                (p - sample.p).norm() < 2.0 * corrected.sigma_m
            });
            sum.covered += 100.0 * covered.count() as f64 / run.noisy.len() as f64;
            let turned = |of: &dyn Fn(&Sample) -> UnitQuaternion<f64>| {
                let square: f64 = run.tests.iter().map(|s| of(s).angle_to(&s.truth).powi(2)).sum();
                (square / run.tests.len() as f64).sqrt().to_degrees()
            };
            sum.raw_deg += turned(&|s| s.q);
            sum.solved_deg += turned(&|s| corrector.orientation(&s.z, &s.q));
            let mut recording = pole(&run, SPACING_M);
            let anchors = anchors(scene, &run, &mut recording, seed);
            if let Some(map) = solve(recording, &anchors, &mut |_| {}).map {
                let corrector = map.corrector();
                sum.anchored += absolute_mm(&pairs(&|z| corrector.position(z)));
            }
        }
        let n = seeds as f64;
        println!(
            "| {} | {:.1} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.1} | {:.2} | {:.1} | {:.2} | {:.2} | {:.1} | {:.1} |",
            scene.name,
            sum.raw / n,
            sum.cascade_residual / n,
            sum.cascade_once / n,
            sum.cascade_eight / n,
            sum.solved / n,
            sum.median / n,
            sum.vouched / n,
            sum.doubted / n,
            sum.polynomial / n,
            sum.best / n,
            sum.begun / n,
            sum.raw_absolute / n,
            sum.anchored / n,
            sum.covered / n,
            sum.raw_deg / n,
            sum.solved_deg / n,
            sum.seconds / n,
            sum.busy_s / n
        );
        println!("<!-- {}: {} -->", scene.name, models.join("; "));
    }
}
