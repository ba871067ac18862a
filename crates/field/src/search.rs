//! Finding metal: which further source would explain most of what remains.
//!
//! Every candidate enters linearly through its strength, so that its gain is known without fitting it; the best few
//! are then fitted in place and strength.

use nalgebra::{Matrix3, SMatrix, Vector3};
use posed_geometry::parallel::*;

use super::fit::{Fit, fit};
use super::model::metal::{Metal, times};
use super::model::rotation::turning;
use super::model::{Kind, Model, Source};
use super::problem::Problem;
use posed_geometry::so3;

/// Spacing of the candidates for objects, m, and how far outside the readings they may stand.
const STEP_M: f64 = 0.3;
const MARGIN_M: f64 = 0.75;
/// Readings nearer than this to a candidate are not asked, and the transmitter is no metal, m.
const NEAREST_M: f64 = 0.15;
/// Strongest believable object, m^3: iron of 0.6 m; and plane.
const STRONGEST_OBJECT_M3: f64 = 0.2;
const STRONGEST_PLANE: f64 = 1.2;
/// All candidates are asked about every so many-th row; so many of the best about all; so many starts are fitted out.
const SIFTING: usize = 3;
const PROMISING: usize = 200;
const CONTENDERS: usize = 2;
/// Image distances that are tried, m.
const IMAGES_M: [f64; 8] = [0.4, 0.6, 0.9, 1.3, 1.8, 2.4, 3.2, 4.5];

/// A reading relative to the candidates.
struct WhitenedReading {
    position_m: Vector3<f64>,
    whitened: SMatrix<f64, 3, 9>,
}

struct Row {
    seen: Vec<WhitenedReading>,
    residual: Vec<f64>,
    pose: Vec<[f64; 5]>,
}

/// The model with one more source, fitted; the best of a few starts. `None` if none helps.
pub(crate) fn add_source(problem: &Problem, model: &Model, passes: usize) -> Option<Fit> {
    let rows = see(problem, model);
    let few: Vec<&Row> = rows.iter().step_by(SIFTING).collect();
    let mut found = ranked(&few, candidates(problem));
    found.truncate(PROMISING);
    let rows: Vec<&Row> = rows.iter().collect();
    let found = ranked(&rows, found.into_iter().map(|(_, source)| source).collect());
    let mut starts: Vec<Source> = Vec::new();
    for kind in [Kind::Plane, Kind::Object] {
        let most = if kind == Kind::Plane { 2 } else { 3 };
        let mut taken = 0;
        for (_, source) in found.iter().filter(|(_, source)| source.kind == kind) {
            let position = Vector3::from(source.position_m);
            let apart = |other: &Source| (position - Vector3::from(other.position_m)).norm() > 1.5 * STEP_M;
            if taken < most && starts.iter().filter(|other| other.kind == kind).all(apart) {
                starts.push(*source);
                taken += 1;
            }
        }
    }
    let begun = starts.par_iter().map(|start| {
        let mut model = model.clone();
        model.sources.push(*start);
        fit(problem, &model, passes.div_ceil(3))
    });
    let mut begun: Vec<Fit> = begun.collect::<Vec<_>>().into_iter().flatten().collect();
    begun.sort_by(|a, b| a.total.cost.total_cmp(&b.total.cost));
    begun.truncate(CONTENDERS);
    let ended = begun.par_iter().map(|start| {
        let rest = passes - passes.div_ceil(3);
        fit(problem, &start.model, rest).filter(|fit| believable(&fit.model))
    });
    let ended: Vec<Option<Fit>> = ended.collect();
    ended.into_iter().flatten().min_by(|a, b| a.total.cost.total_cmp(&b.total.cost))
}

/// Candidates by how much each would explain, the best first.
fn ranked(rows: &[&Row], candidates: Vec<Source>) -> Vec<(f64, Source)> {
    let mut found: Vec<(f64, Source)> =
        candidates.into_par_iter().filter_map(|candidate| gain(rows, candidate)).collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found
}

/// Whether all sources are of a size that metal can have.
fn believable(model: &Model) -> bool {
    model.sources.iter().all(|source| {
        let strongest = match source.kind {
            Kind::Plane => STRONGEST_PLANE,
            Kind::Object => STRONGEST_OBJECT_M3,
        };
        source.strength.abs() < strongest && Vector3::from(source.position_m).norm() > NEAREST_M
    })
}

fn see(problem: &Problem, model: &Model) -> Vec<Row> {
    let metal = Metal::new(&model.sources);
    let mut rows = Vec::with_capacity(problem.groups());
    problem.each_residual(model, |start, count, scratch| {
        let seen: Option<Vec<WhitenedReading>> = (0..count)
            .map(|k| {
                let z = &problem.z[start + k];
                let position = metal.position(z)?;
                let mut by_field = position.by_field;
                // A source moves a joint by moving its sensor and by turning the way from there.
                let way = scratch.shift.get(k).filter(|way| **way != Vector3::zeros());
                if let Some(way) = way {
                    by_field -= so3::hat(way) * turning(&metal, z, &position)?;
                }
                Some(WhitenedReading { position_m: position.p, whitened: scratch.whitener[k] * by_field })
            })
            .collect();
        if let Some(seen) = seen {
            let residual = (0..3 * count).map(|k| scratch.residual[k]).collect();
            let pose = (0..3 * count).map(|k| [0, 1, 2, 3, 4].map(|b| scratch.pose[(k, b)])).collect();
            rows.push(Row { seen, residual, pose });
        }
    });
    rows
}

/// How much of the squared residual a candidate of the best strength takes away.
fn gain(rows: &[&Row], candidate: Source) -> Option<(f64, Source)> {
    let position = Vector3::from(candidate.position_m);
    let prepared = Unit::new(&candidate);
    let (mut cross, mut square) = (0.0_f64, 0.0_f64);
    let mut v: Vec<f64> = Vec::new();
    for row in rows {
        v.clear();
        // Beside the metal nothing is linear.
        let near = |seen: &WhitenedReading| (seen.position_m - position).norm() < NEAREST_M;
        if candidate.kind == Kind::Object && row.seen.iter().any(near) {
            continue;
        }
        for seen in &row.seen {
            v.extend(times(&seen.whitened, &prepared.field(&seen.position_m)).iter());
        }
        let mut own = [0.0; 5];
        for (value, pose) in v.iter().zip(&row.pose) {
            for b in 0..5 {
                own[b] += value * pose[b];
            }
        }
        for ((value, pose), residual) in v.iter().zip(&row.pose).zip(&row.residual) {
            let value = value - (0..5).map(|b| own[b] * pose[b]).sum::<f64>();
            cross += value * residual;
            square += value * value;
        }
    }
    let strength = -cross / square;
    let strongest = match candidate.kind {
        Kind::Plane => 0.6 * STRONGEST_PLANE,
        Kind::Object => 0.6 * STRONGEST_OBJECT_M3,
    };
    (strength.is_finite() && strength.abs() < strongest)
        .then(|| (cross * cross / square, Source { strength, ..candidate }))
}

/// A candidate with its moments computed once.
struct Unit {
    position: Vector3<f64>,
    moments: Matrix3<f64>,
}

impl Unit {
    fn new(source: &Source) -> Self {
        Self { position: Vector3::from(source.position_m), moments: source.moments() }
    }

    fn field(&self, p: &Vector3<f64>) -> Matrix3<f64> {
        super::model::dipole::field(&(p - self.position)) * self.moments
    }
}

fn candidates(problem: &Problem) -> Vec<Source> {
    let mut candidates = Vec::new();
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            for distance in IMAGES_M {
                let mut position_m = [0.0; 3];
                position_m[axis] = sign * distance;
                candidates.push(Source { kind: Kind::Plane, position_m, strength: 1.0 });
            }
        }
    }
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    for z in &problem.z {
        low = low.inf(z);
        high = high.sup(z);
    }
    low -= Vector3::repeat(MARGIN_M);
    high += Vector3::repeat(MARGIN_M);
    // A larger stage gets a coarser grid, not more candidates.
    let extent = high - low;
    let step = STEP_M.max(libm::cbrt(extent.x * extent.y * extent.z / 2500.0));
    let steps = (extent / step).map(|n| n.ceil() as usize);
    for i in 0..=steps.x {
        for j in 0..=steps.y {
            for k in 0..=steps.z {
                let position = low + Vector3::new(i as f64, j as f64, k as f64) * step;
                if position.norm() > 2.0 * NEAREST_M {
                    candidates.push(Source {
                        kind: Kind::Object,
                        position_m: position.into(),
                        strength: 1.0,
                    });
                }
            }
        }
    }
    candidates
}
