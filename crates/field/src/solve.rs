//! The joint solver: from a recording of the pole to a map, or to the reason why there is none.
//!
//! What comes in: a recording, anchors if there are any. What goes out: the map with its report. What it never does:
//! estimate the spacing, or accept a map that it cannot show to be better on blocks that it has not seen.

use nalgebra::{Isometry3, Vector3};
use posed_geometry::parallel::*;

use super::anchors::{Anchor, LEAST_ANCHORS, dwells, judge, rigid};
use super::coverage::{self, Ask};
use super::estimate;
use super::fit::{HeldOut, fit, uncorrected};
use super::hull::Hull;
use super::map::{Aligned, FieldMap, Uncertainty, VERSION, coarse};
use super::model::{Model, Polynomial};
use super::noise::FieldNoise;
use super::orientation;
use super::outliers::{Rejected, reject};
use super::pole::PoleRun;
use super::problem::Problem;
use super::report::{Code, Reason, Report};
use super::select::{Chosen, Selection};
use super::trust;

/// Held-out blocks: of this length, s, dealt out to this many folds.
const BLOCK_S: f64 = 2.0;
const FOLDS: usize = 10;
/// What no candidate is expected to explain, per axis, m. It keeps the readings nearest to the transmitter, whose
/// noise is a few micrometres, from outweighing all others.
const MODEL_FLOOR_M: f64 = 3e-4;
/// Largest believable correction, m, and largest share of places where it may fold.
const LARGEST_CORRECTION_M: f64 = 0.3;
const MOST_FOLDED: f64 = 0.02;
/// How far around a place what was left unexplained counts, m, and readings that are enough to know it.
const EXCESS_REACH_M: f64 = 0.3;
const EXCESS_READINGS: usize = 3000;

/// A solved recording: a map or the reason why there is none.
#[derive(Clone, Debug)]
pub struct Solution {
    /// The map; `report.accepted` says whether it may be used. Absent where there was nothing to fit.
    pub map: Option<FieldMap>,
    /// Whether the map is accepted, why not, and its figures; the same as in the map.
    pub report: Report,
    /// Polynomials that were tried beside, fitted to the same readings, to compare with.
    pub polynomials: Vec<Model>,
    /// Readings that were taken out as outliers; empty for a body.
    pub rejected: Vec<Rejected>,
}

/// Solves a recording of the pole. `progress` hears shares of the work from 0 to 1; `anchors` may be empty.
///
/// It never fails: a recording that is not good enough gives reasons in the report. `map` is `None` where no instant
/// has four believable sensors or nothing can be fitted; otherwise check `report.accepted`. Without three anchors or a
/// model of metal alone positions are right up to a rigid motion. The work is spread over threads. Method:
/// `docs/methods/field.md`, after Piperakis et al. (about 2005) in its question, not in its answer; accuracy and
/// duration: `docs/field.md`.
pub fn solve(mut run: PoleRun, anchors: &[Anchor], progress: &mut dyn FnMut(f64)) -> Solution {
    let raw_noise = estimate::noise(&run);
    let measured = run.clone();
    let rejected = reject(&mut run, &raw_noise);
    let noise = estimate::noise(&run);
    let points: Vec<Vector3<f64>> = run.readings().map(|(_, _, reading)| reading.position_m).collect();
    let mut report = Report { readings: points.len(), rejected: rejected.len(), ..Report::unknown() };
    let Some(hull) = Hull::new(points.iter()) else {
        let text = "no instant with four believable sensors".to_owned();
        report.reasons.push(Reason { code: Code::Coverage, text });
        return Solution { map: None, report, polynomials: Vec::new(), rejected };
    };
    let coverage = coverage::judge(&run, &hull);
    report.covered = coverage.cells;
    report.reasons.extend(coverage.asks.iter().map(Ask::reason));
    progress(0.05);
    let problem = problem_of(&run, &with_model_floor(noise));
    let chosen = Selection::new(&problem).choose(&mut |share| progress(0.05 + 0.7 * share));
    let Some(Chosen { candidate, tried, polynomials }) = chosen else {
        let text = "the readings fit no pole at all".to_owned();
        report.reasons.push(Reason { code: Code::Improvement, text });
        return Solution { map: None, report, polynomials: Vec::new(), rejected };
    };
    report.raw_m = tried.first().map_or(f64::NAN, |tried| tried.heldout_m);
    let without = uncorrected(&problem).map_or_else(Vec::new, |(_, held_out)| held_out.scores);
    report.tried = tried;
    report.model = candidate.fit.model.describe();
    report.residual_m = candidate.fit.rms_m();
    report.heldout_m = candidate.held_out.rms_m;
    report.noise_m = expected_rms_m(&points, &noise, run.sensors.len());
    // Losses are in units of the noise, which third differences tell.
    report.judge_improvement(&candidate.held_out.scores, &without, 1.0, "readings get");
    let model = candidate.fit.model.clone();
    let scale = Polynomial::new(0, &Vector3::from(hull.center_m), half_extent(&hull));
    let rotation = orientation::fit(&run, &model, &scale);
    progress(0.85);
    let absolute = model.is_metal_alone();
    let uncertainty = uncertainty(&problem, &model, &candidate.held_out, &hull, &noise, absolute);
    let typical_m = {
        let mut sigmas = uncertainty.sigma_m.clone();
        super::pole::median(&mut sigmas).unwrap_or(0.0)
    };
    let mut alignment = Aligned::default();
    // On a point the pole may stand in a corner where few sensors see anything.
    let dwells = dwells(&measured, anchors, &noise);
    if !anchors.is_empty() && dwells.len() < LEAST_ANCHORS {
        report.warnings.push(format!(
            "{} of {} anchors have readings; absolute position needs {LEAST_ANCHORS}",
            dwells.len(),
            anchors.len()
        ));
    }
    let evaluator = model.evaluator();
    let corrected: Vec<Vector3<f64>> = dwells.iter().map(|dwell| evaluator.correct(&dwell.reading)).collect();
    if let Some(verdict) = judge(&dwells, &corrected, typical_m, absolute) {
        alignment = verdict.alignment;
        report.anchors_m = Some(verdict.rms_m);
        if let Some(error) = verdict.scale_error {
            let text = format!(
                "the anchors say that lengths are {:.2} % too {}: measure the spacing again (stated {:.1} mm, \
                 {:.1} mm would fit)",
                100.0 * error.abs(),
                if error > 0.0 { "long" } else { "short" },
                1e3 * run.spacing_m,
                1e3 * run.spacing_m / (1.0 + error)
            );
            report.reasons.push(Reason { code: Code::Spacing, text });
        }
    } else if absolute {
        report
            .warnings
            .push("no three anchors: absolute position rests on the model of the metal alone".into());
    } else {
        report.warnings.push("no three anchors: positions are right up to a rigid motion only".into());
    }
    report.reasons.extend(unbelievable(&model, &hull, &points));
    report.accepted = report.reasons.is_empty();
    drop(evaluator);
    let map = FieldMap {
        version: VERSION,
        sensors: run.sensors,
        spacing_m: run.spacing_m,
        model,
        rotation,
        noise,
        alignment,
        hull,
        uncertainty,
        report: report.clone(),
    };
    progress(1.0);
    Solution { map: Some(map), report, polynomials, rejected }
}

/// Where the readings of a pole alone lead the parameters of `model`: begun at the truth, what no solver can do better.
/// Outliers are taken out and the noise is estimated as in `solve`. `None` where the least squares fail.
pub fn refit_pole(mut run: PoleRun, model: &Model) -> Option<Model> {
    let raw_noise = estimate::noise(&run);
    reject(&mut run, &raw_noise);
    let noise = with_model_floor(estimate::noise(&run));
    Some(fit(&problem_of(&run, &noise), model, 10)?.model)
}

fn with_model_floor(noise: FieldNoise) -> FieldNoise {
    FieldNoise { floor_m: libm::hypot(noise.floor_m, MODEL_FLOOR_M), ..noise }
}

/// Why a map cannot be right, whatever the held-out blocks say of it.
pub(crate) fn unbelievable(model: &Model, hull: &Hull, points: &[Vector3<f64>]) -> Option<Reason> {
    let evaluator = model.evaluator();
    let folded = trust::folded(model, hull);
    let mut lengths: Vec<f64> = points.par_iter().map(|z| (evaluator.correct(z) - z).norm()).collect();
    lengths.sort_by(f64::total_cmp);
    let largest_m = lengths[lengths.len() * 99 / 100];
    (largest_m > LARGEST_CORRECTION_M || folded > MOST_FOLDED).then(|| Reason {
        code: Code::Improvement,
        text: format!(
            "the map is not believable: corrections up to {:.0} mm, and space folds at {:.0} % of the places",
            1e3 * largest_m,
            100.0 * folded
        ),
    })
}

/// Frames in blocks of two seconds, dealt out to the folds.
pub(crate) fn problem_of(run: &PoleRun, noise: &FieldNoise) -> Problem {
    let mut problem = Problem::new(FOLDS);
    let start = run.frames.first().map_or(0.0, |frame| frame.t_s);
    let mut row = Vec::new();
    for frame in &run.frames {
        run.row(frame, &mut row);
        problem.push_pole(((frame.t_s - start) / BLOCK_S) as usize, &row, noise);
    }
    problem
}

/// Rms residual that noise alone leaves: the pole's own five numbers take their share.
fn expected_rms_m(points: &[Vector3<f64>], noise: &FieldNoise, sensors: usize) -> f64 {
    let mean = points.iter().map(|p| noise.mean_square_m2(p)).sum::<f64>() / points.len() as f64;
    (mean * (1.0 - 5.0 / (3.0 * sensors as f64))).sqrt()
}

fn half_extent(hull: &Hull) -> f64 {
    let [low, high] = hull.bounds_m();
    (0.5 * (high - low).max()).max(0.05)
}

/// How far the models that were fitted without a block disagree (jackknife), and what none of them explains nearby.
pub(crate) fn uncertainty(
    problem: &Problem,
    model: &Model,
    held_out: &HeldOut,
    hull: &Hull,
    noise: &FieldNoise,
    absolute: bool,
) -> Uncertainty {
    let shape = coarse(hull);
    let positions_m: Vec<Vector3<f64>> =
        (0..shape.len()).map(|k| hull.inward(&shape.position_m(k))).collect();
    let evaluator = model.evaluator();
    let whole: Vec<Vector3<f64>> = positions_m.par_iter().map(|z| evaluator.correct(z)).collect();
    let squares: Vec<Vec<f64>> = held_out
        .models
        .par_iter()
        .map(|without| {
            let evaluator = without.evaluator();
            let pairs: Vec<_> =
                positions_m.iter().zip(&whole).map(|(z, y)| (evaluator.correct(z), *y)).collect();
            let motion = if absolute { Isometry3::identity() } else { rigid(&pairs) };
            pairs
                .iter()
                .map(|(a, b)| (motion.rotation * a + motion.translation.vector - b).norm_squared())
                .collect()
        })
        .collect();
    let excesses = excesses(problem, model, held_out, noise);
    let folds = held_out.models.len() as f64;
    let sigma_m = (0..positions_m.len())
        .into_par_iter()
        .map(|k| {
            let jackknife = (folds - 1.0) / folds * squares.iter().map(|fold| fold[k]).sum::<f64>();
            (jackknife + excess_near(&excesses, &positions_m[k])).sqrt()
        })
        .collect();
    Uncertainty { shape, sigma_m }
}

/// Places of readings that were held out, the square of each residual, and what noise alone would make it, m^2.
fn excesses(
    problem: &Problem,
    model: &Model,
    held_out: &HeldOut,
    noise: &FieldNoise,
) -> Vec<(Vector3<f64>, f64, f64)> {
    let evaluator = model.evaluator();
    let squares: Vec<Vec<(Vector3<f64>, f64, f64)>> = held_out
        .models
        .par_iter()
        .enumerate()
        .map(|(fold, without)| problem.squares_of(without, fold))
        .collect();
    let squares: Vec<_> = squares.into_iter().flatten().collect();
    let stride = squares.len().div_ceil(EXCESS_READINGS).max(1);
    squares
        .par_iter()
        .step_by(stride)
        .map(|(z, square, freedom)| {
            (*z, *square, freedom * trust::stretched_m2(noise, z, |z| evaluator.correct(z)))
        })
        .collect()
}

/// Mean square near a place beyond the noise, m^2.
fn excess_near(readings: &[(Vector3<f64>, f64, f64)], position_m: &Vector3<f64>) -> f64 {
    let (mut square, mut expected, mut weights) = (0.0, 0.0, 0.0);
    for (z, of, noise) in readings {
        let far = (z - position_m).norm_squared() / (EXCESS_REACH_M * EXCESS_REACH_M);
        let weight = 1.0 / ((1.0 + far) * (1.0 + far) * (1.0 + far));
        square += weight * of;
        expected += weight * noise;
        weights += weight;
    }
    // The noise is known to a tenth; only what goes beyond is a fault of the map.
    ((square - 1.21 * expected) / weights).max(0.0)
}
