//! The body in place of the pole: from a session of a person who wears sensors to a map.
//!
//! What comes in: positions and orientations of sensors on segments, which segments meet in a joint, and at least one
//! measured bone. What goes out: a map, as from the pole. What it never does: take a scale from the readings.
//!
//! Both sensors at a joint must put it in the same place. Where the joint lies relative to each sensor is unknown but
//! constant; it is fitted in turns with the map. The same metal that shifts a sensor turns it, and with it the way to its
//! joint: both are fitted at once. Skin moves by a centimetre: expect millimetres where a pole gives tenths.

use nalgebra::{DMatrix, DVector, Matrix3, UnitQuaternion, Vector3};

use super::coverage;
use super::fit::{fit, uncorrected};
use super::hull::Hull;
use super::joint_range::JointRange;
use super::map::{Aligned, FieldMap, VERSION};
use super::model::Model;
use super::model::metal::Metal;
use super::model::rotation::by_metal;
use super::noise::FieldNoise;
use super::pole::{PoleRun, median};
use super::problem::Problem;
use super::report::{Code, Reason, Report};
use super::select::{Candidate, Chosen, Selection, beats};
use super::solve::{Solution, unbelievable, uncertainty};

/// Held-out blocks: of this length, s, dealt out to this many folds.
const BLOCK_S: f64 = 4.0;
const FOLDS: usize = 10;
/// Pairs of readings at joints that are enough.
const ENOUGH: usize = 7000;
/// Iterations between offsets and map; the basis is chosen anew in some.
const ITERATIONS: usize = 6;
const CHOOSE_EVERY: usize = 3;
/// Least and first gap at a joint that is expected whatever the map, per axis, m: skin moves.
const LEAST_GAP_M: f64 = 3e-4;
const FIRST_GAP_M: f64 = 5e-3;
/// Noise of a tracker's signals, 1/m^3: limbs are too quick to tell it from the readings, and skin hides it anyway.
const SIGMA_SIGNAL: f64 = 1e-4;
/// How well it is known where a sensor sits, per axis, m; readings that follow each other say the same for so many.
const SEAT_M: f64 = 5e-3;
const ALIKE: f64 = 20.0;
/// Least share of the cells that must be covered.
const LEAST_COVERED: f64 = 0.4;

/// Two sensors on body segments that meet in a joint. Skin between sensor and bone is not modelled.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Name, for messages.
    pub name: String,
    /// Indices of the two sensors in `PoleRun::sensors`.
    pub sensors: [usize; 2],
    /// What is known of each sensor's way to the joint; without it the way is estimated from the readings alone.
    pub ways: [Option<Way>; 2],
    /// How far it turns; looks at it beyond that are left out. `None`: anyhow.
    pub range: Option<JointRange>,
}

/// Where a joint lies from a sensor, as far as it is known before the readings are looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Way {
    /// From the sensor to the joint, sensor axes, m.
    pub m: Vector3<f64>,
    /// Standard deviation per axis, m.
    pub sigma_m: f64,
}

impl Way {
    /// One by a stated mounting: known to 5 mm.
    pub fn stated(m: Vector3<f64>) -> Self {
        Self { m, sigma_m: SEAT_M }
    }

    /// Whether it is as well known as a stated one: such ones tell a scale.
    fn is_stated(&self) -> bool {
        self.sigma_m <= SEAT_M
    }

    /// One of which nothing is known.
    const UNKNOWN: Self = Self { m: Vector3::new(0.0, 0.0, 0.0), sigma_m: 0.3 };
}

/// A body segment with one sensor and two joints.
#[derive(Clone, Debug, PartialEq)]
pub struct Bone {
    /// Name, for messages.
    pub name: String,
    /// Index of its sensor in `PoleRun::sensors`.
    pub sensor: usize,
    /// Indices of its two joints in `Limbs::joints`.
    pub joints: [usize; 2],
    /// Measured distance between the joints, m; `None` where it was not measured.
    pub length_m: Option<f64>,
    /// Standard deviation of that length, m; below 0.1 mm it counts as 0.1 mm.
    pub sigma_m: f64,
}

/// Which sensors meet in which joints, and what is known of the lengths between them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Limbs {
    /// All joints between two sensors.
    pub joints: Vec<Joint>,
    /// All body segments with a sensor and two such joints.
    pub bones: Vec<Bone>,
}

impl Limbs {
    /// The same with nothing but what is stated of the ways.
    fn without_guesses(&self) -> Self {
        let mut limbs = self.clone();
        for way in limbs.joints.iter_mut().flat_map(|joint| &mut joint.ways) {
            *way = way.filter(Way::is_stated);
        }
        limbs
    }
}

/// One look at a joint.
struct Look {
    fold: usize,
    joint: usize,
    z: [Vector3<f64>; 2],
    q: [UnitQuaternion<f64>; 2],
}

/// A look as the current model corrects it.
struct Corrected {
    y: [Vector3<f64>; 2],
    rotation: [Matrix3<f64>; 2],
}

/// Estimates a map from a session of a person who wears sensors. `progress` hears shares of the work from 0 to 1.
///
/// The spacing of `run` is not used; sensors need orientations. `map` is `None` with fewer than 200 pairs of poses at
/// joints, without any measured length or sensor-to-joint vector, or where nothing can be fitted; otherwise check
/// `report.accepted`. Expect millimetres where a pole gives tenths; without a model of metal alone positions are right
/// up to a rigid motion. Figures: `docs/field.md`.
pub fn solve_limbs(run: PoleRun, limbs: &Limbs, progress: &mut dyn FnMut(f64)) -> Solution {
    let points: Vec<Vector3<f64>> = run.readings().map(|(_, _, reading)| reading.position_m).collect();
    let mut report = Report { readings: points.len(), model: "identity".into(), ..Report::unknown() };
    let refuse = |mut report: Report, code, text: &str| {
        report.reasons.push(Reason { code, text: text.to_owned() });
        Solution { map: None, report, polynomials: Vec::new(), rejected: Vec::new() }
    };
    let looks = looks(&run, limbs, &mut report.rejected);
    let Some(hull) = Hull::new(points.iter()).filter(|_| looks.len() >= 200) else {
        return refuse(
            report,
            Code::Coverage,
            "hardly any instant with orientations on both sides of a joint",
        );
    };
    let scaled = limbs.bones.iter().any(|bone| bone.length_m.is_some())
        || limbs.joints.iter().flat_map(|joint| joint.ways).flatten().any(|way| way.is_stated());
    if !scaled {
        let text = "no bone is measured: state the body's height, or a bone's length; a scale is never taken from the readings";
        return refuse(report, Code::Spacing, text);
    }
    let noise = FieldNoise { sigma_signal: SIGMA_SIGNAL, floor_m: 0.0 };
    report.covered = coverage::visited(&run, &hull);
    if report.covered < LEAST_COVERED {
        let text =
            format!("only {:.0} % of the volume was visited; move about in it", 100.0 * report.covered);
        report.reasons.push(Reason { code: Code::Coverage, text });
    }
    // What is thought of the joints before may lead astray as well as ahead: both ways are gone, and held-out joints decide.
    let unguided = limbs.without_guesses();
    let is_guided = unguided != *limbs;
    let share_of = if is_guided { 0.45 } else { 0.9 };
    let guided = is_guided
        .then(|| follow_both(&looks, limbs, &noise, &mut |share| progress(share_of * share)))
        .flatten();
    let begun = 0.9 - share_of;
    let plain = follow_both(&looks, &unguided, &noise, &mut |share| progress(begun + share_of * share));
    let Some(followed) = better(guided, plain, &noise) else {
        return refuse(report, Code::Improvement, "the readings fit no body at all");
    };
    let Followed { chosen: Chosen { candidate, tried, polynomials }, problem, raw, gap_m } = followed;
    let model = candidate.fit.model.clone();
    let raw = raw.with_noise(&weighting(&noise, gap_m));
    let before = uncorrected(&raw);
    report.raw_m = before.as_ref().map_or(f64::NAN, |(fitted, _)| fitted.rms_m());
    let without = before.map_or_else(Vec::new, |(_, held_out)| held_out.scores);
    report.tried = tried;
    report.model = model.describe();
    report.residual_m = candidate.fit.rms_m();
    report.heldout_m = candidate.held_out.rms_m;
    report.noise_m = gap_m;
    // What skin leaves at a joint is known from the map alone.
    report.judge_improvement(&candidate.held_out.scores, &without, 0.0, "joints fit");
    let absolute = model.is_metal_alone();
    let uncertainty = uncertainty(&problem, &model, &candidate.held_out, &hull, &noise, absolute);
    report.reasons.extend(unbelievable(&model, &hull, &points));
    report.warnings.push(if absolute {
        "from a body: absolute position rests on the model of the metal alone".into()
    } else {
        "from a body: positions are right up to a rigid motion only".into()
    });
    report.accepted = report.reasons.is_empty();
    progress(1.0);
    let map = FieldMap {
        version: VERSION,
        sensors: run.sensors,
        spacing_m: 0.0,
        model,
        rotation: None,
        noise,
        alignment: Aligned::default(),
        hull,
        uncertainty,
        report: report.clone(),
    };
    Solution { map: Some(map), report, polynomials, rejected: Vec::new() }
}

/// Where iterations between joints and map have led.
struct Followed {
    chosen: Chosen,
    problem: Problem,
    /// The same joints as they lay before there was a map.
    raw: Problem,
    gap_m: f64,
}

fn weighting(noise: &FieldNoise, gap_m: f64) -> FieldNoise {
    FieldNoise { floor_m: libm::hypot(noise.floor_m, gap_m), ..*noise }
}

/// Fits joints and map in turns twice: where the joints lie makes up for part of what a model lacks, and a model is chosen for them, so that metal must
/// find its own.
fn follow_both(
    looks: &[Look],
    limbs: &Limbs,
    noise: &FieldNoise,
    progress: &mut dyn FnMut(f64),
) -> Option<Followed> {
    let smooth = follow(looks, limbs, noise, false, &mut |share| progress(0.5 * share));
    let metal = follow(looks, limbs, noise, true, &mut |share| progress(0.5 + 0.5 * share));
    better(smooth, metal, noise)
}

/// Fits joints and map in turns; the map of any kind, or of metal alone.
fn follow(
    looks: &[Look],
    limbs: &Limbs,
    noise: &FieldNoise,
    metal_only: bool,
    progress: &mut dyn FnMut(f64),
) -> Option<Followed> {
    let mut gap_m = FIRST_GAP_M;
    let mut model = Model::default();
    let mut ways = vec![[Vector3::zeros(); 2]; limbs.joints.len()];
    let mut raw: Option<Problem> = None;
    for iteration in 0..=ITERATIONS {
        let corrected = correct(looks, &model);
        fit_ways(looks, &corrected, limbs, gap_m, &mut ways);
        gap_m = typical_gap(looks, &corrected, &ways).clamp(LEAST_GAP_M, 4.0 * FIRST_GAP_M);
        let problem = problem_of(looks, &ways, &weighting(noise, gap_m));
        let raw = raw.get_or_insert_with(|| problem.clone());
        if iteration == ITERATIONS || iteration % CHOOSE_EVERY == 0 {
            let selection = Selection::new(&problem);
            let selection = if metal_only { selection.metal_only() } else { selection };
            let chosen = selection.choose(&mut |_| {})?;
            if iteration == ITERATIONS {
                let raw = raw.clone();
                return Some(Followed { chosen, problem, raw, gap_m });
            }
            model = chosen.candidate.fit.model;
        } else if let Some(fitted) = fit(&problem, &model, 3) {
            model = fitted.model;
        }
        progress((iteration + 1) as f64 / (ITERATIONS + 1) as f64);
    }
    None
}

/// The one of two whose held-out joints fit better, each with its own joints, all gaps worth the same; the second unless the first is surely better.
fn better(first: Option<Followed>, second: Option<Followed>, noise: &FieldNoise) -> Option<Followed> {
    let (first, second) = match (first, second) {
        (Some(first), Some(second)) => (first, second),
        (first, second) => return first.or(second),
    };
    let weighting = weighting(noise, first.gap_m.min(second.gap_m));
    let judge = |followed: &Followed| {
        let problem = followed.problem.with_noise(&weighting);
        let fit = fit(&problem, &followed.chosen.candidate.fit.model, 2)?;
        let held_out = fit.held_out(&problem)?;
        Some(Candidate { fit, held_out })
    };
    let second_wins = match (judge(&first), judge(&second)) {
        (Some(first), Some(second)) => !beats(&first, &second),
        (first, _) => first.is_none(),
    };
    Some(if second_wins { second } else { first })
}

/// All looks at joints, thinned out evenly; counts those in `beyond` that no joint allows.
fn looks(run: &PoleRun, limbs: &Limbs, beyond: &mut usize) -> Vec<Look> {
    let start_s = run.frames.first().map_or(0.0, |frame| frame.t_s);
    let stride = (run.frames.len() * limbs.joints.len()).div_ceil(ENOUGH).max(1);
    let mut looks = Vec::new();
    for frame in run.frames.iter().step_by(stride) {
        for (index, joint) in limbs.joints.iter().enumerate() {
            let [a, b] = joint.sensors.map(|sensor| frame.readings.get(sensor).copied().flatten());
            let (Some(a), Some(b)) = (a, b) else { continue };
            let (Some(qa), Some(qb)) = (a.orientation, b.orientation) else { continue };
            if joint.range.is_some_and(|range| !range.allows(&[qa, qb])) {
                *beyond += 1;
                continue;
            }
            let fold = ((frame.t_s - start_s) / BLOCK_S) as usize;
            looks.push(Look { fold, joint: index, z: [a.position_m, b.position_m], q: [qa, qb] });
        }
    }
    looks
}

fn correct(looks: &[Look], model: &Model) -> Vec<Corrected> {
    let evaluator = model.evaluator();
    let metal = model.metal();
    looks
        .iter()
        .map(|look| {
            let y = look.z.map(|z| evaluator.correct(&z));
            let rotation = [0, 1].map(|k| {
                let undone = |metal: &Metal| by_metal(metal, &look.z[k], &y[k]) * look.q[k];
                metal.as_ref().map_or(look.q[k], undone).to_rotation_matrix().into_inner()
            });
            Corrected { y, rotation }
        })
        .collect()
}

fn gap(corrected: &Corrected, ways: &[Vector3<f64>; 2]) -> Vector3<f64> {
    let ends = [0, 1].map(|k| corrected.y[k] + corrected.rotation[k] * ways[k]);
    ends[0] - ends[1]
}

/// Robust standard deviation of the gaps at joints, per axis and sensor, m.
fn typical_gap(looks: &[Look], corrected: &[Corrected], ways: &[[Vector3<f64>; 2]]) -> f64 {
    let mut sizes: Vec<f64> = looks
        .iter()
        .zip(corrected)
        .map(|(look, corrected)| gap(corrected, &ways[look.joint]).norm())
        .collect();
    // The median length of a vector with three independent numbers of deviation 1 is 1.538; two sensors share it.
    median(&mut sizes).unwrap_or(0.0) / (1.538 * std::f64::consts::SQRT_2)
}

/// Where joints lie relative to their sensors: linear in the ways, but for the lengths of bones.
fn fit_ways(
    looks: &[Look],
    corrected: &[Corrected],
    limbs: &Limbs,
    gap_m: f64,
    ways: &mut [[Vector3<f64>; 2]],
) {
    let size = 6 * limbs.joints.len();
    let at = |joint: usize, side: usize| 6 * joint + 3 * side;
    let sigma2 = 2.0 * gap_m * gap_m * ALIKE;
    for round in 0..10 {
        let mut matrix = DMatrix::<f64>::zeros(size, size);
        let mut right = DVector::<f64>::zeros(size);
        for (look, corrected) in looks.iter().zip(corrected) {
            let apart = gap(corrected, &ways[look.joint]).norm() / (3.0 * 1.4 * gap_m);
            let weight = if round > 0 && apart > 1.0 { 1.0 / apart } else { 1.0 } / sigma2;
            let [a, b] = [at(look.joint, 0), at(look.joint, 1)];
            let across = corrected.rotation[0].transpose() * corrected.rotation[1] * weight;
            let between = (corrected.y[1] - corrected.y[0]) * weight;
            for axis in 0..3 {
                matrix[(a + axis, a + axis)] += weight;
                matrix[(b + axis, b + axis)] += weight;
            }
            let mut block = matrix.view_mut((a, b), (3, 3));
            block -= &across;
            let mut block = matrix.view_mut((b, a), (3, 3));
            block -= &across.transpose();
            let mut part = right.rows_mut(a, 3);
            part += corrected.rotation[0].transpose() * between;
            let mut part = right.rows_mut(b, 3);
            part -= corrected.rotation[1].transpose() * between;
        }
        for (index, joint) in limbs.joints.iter().enumerate() {
            for side in 0..2 {
                // An axis about which a joint does not bend says nothing: then as near to the sensor as can be.
                let way = joint.ways[side].unwrap_or(Way::UNKNOWN);
                let weight = 1.0 / (way.sigma_m * way.sigma_m);
                for axis in 0..3 {
                    matrix[(at(index, side) + axis, at(index, side) + axis)] += weight;
                    right[at(index, side) + axis] += weight * way.m[axis];
                }
            }
        }
        if round > 0 {
            add_bones(limbs, ways, &at, &mut matrix, &mut right);
        }
        let Some(solved) = matrix.cholesky() else { return };
        let solved = solved.solve(&right);
        for (index, pair) in ways.iter_mut().enumerate() {
            for (side, way) in pair.iter_mut().enumerate() {
                way.copy_from(&solved.rows(at(index, side), 3));
            }
        }
    }
}

/// Holds the distance of two joints on one segment to its measured length, linearised where the ways are now.
fn add_bones(
    limbs: &Limbs,
    ways: &[[Vector3<f64>; 2]],
    at: &impl Fn(usize, usize) -> usize,
    matrix: &mut DMatrix<f64>,
    right: &mut DVector<f64>,
) {
    for bone in &limbs.bones {
        let Some(length_m) = bone.length_m else { continue };
        let weight = 1.0 / (bone.sigma_m * bone.sigma_m).max(1e-8);
        let side = |joint: usize| usize::from(limbs.joints[joint].sensors[1] == bone.sensor);
        let [a, b] = bone.joints;
        let [side_a, side_b] = [side(a), side(b)];
        let Some(along) = (ways[a][side_a] - ways[b][side_b]).try_normalize(1e-6) else { continue };
        let [a, b] = [at(a, side_a), at(b, side_b)];
        for (row, row_sign) in [(a, 1.0), (b, -1.0)] {
            for i in 0..3 {
                for (column, column_sign) in [(a, 1.0), (b, -1.0)] {
                    for k in 0..3 {
                        matrix[(row + i, column + k)] +=
                            weight * row_sign * column_sign * along[i] * along[k];
                    }
                }
                right[row + i] += weight * row_sign * along[i] * length_m;
            }
        }
    }
}

fn problem_of(looks: &[Look], ways: &[[Vector3<f64>; 2]], noise: &FieldNoise) -> Problem {
    let mut problem = Problem::new(FOLDS);
    for look in looks {
        let way = |k: usize| look.q[k] * ways[look.joint][k];
        problem.push_joint(look.fold, [(look.z[0], way(0)), (look.z[1], way(1))], noise);
    }
    problem
}
