//! How far a corrected position may be off, and whether a map folds space.
//!
//! What comes in: a map. What goes out: the expected error of every place: what the calibration does not know, the
//! noise of a reading as the correction stretches it, and what metal leaves undecided. Beside metal two places can give
//! the same reading; no map can distinguish them, but it can say so.

use nalgebra::{Matrix3, Vector3};
use posed_geometry::parallel::*;

use super::grid::{Grid, Shape};
use super::hull::Hull;
use super::map::FieldMap;
use super::model::metal::Metal;
use super::model::{Kind, Model};
use super::noise::FieldNoise;

/// Step of derivatives by differences, m.
const STEP_M: f64 = 0.04;
/// Distance of the places at which readings are tried out, and least distance of a sensor from metal's surface, m.
const TRIED_STEP_M: f64 = 0.07;
const CLEAR_M: f64 = 0.05;
/// The same beside an object, and how far that reaches at most, m.
const CLOSE_STEP_M: f64 = 0.04;
const CLOSE_REACH_M: f64 = 0.6;
/// Where an object moves readings by no more than this of a sensor's own way it tears nothing apart.
const GENTLE: f64 = 0.05;
/// How far outside the hull a sensor may stand whose reading falls inside, m.
const TRIED_MARGIN_M: f64 = 0.3;
/// A place that is missed by more was taken for another one, m; and the share of these that a sigma need not cover.
const MISTAKEN_M: f64 = 0.02;
const RARE: f64 = 0.03;
/// What is said of a reading for which the metal has no answer, m.
const NO_ANSWER_M: f64 = 0.2;
/// Distance of the places at which a map may fold, m.
const FOLD_STEP_M: f64 = 0.08;
/// A volume that shrinks to less than this share is folded.
const LEAST_VOLUME: f64 = 0.2;

/// 3-D rms error (m) at the nodes of a grid.
pub(crate) fn sigma(map: &FieldMap, positions: &Grid, shape: &Shape, metal: Option<&Metal>) -> Vec<f64> {
    let known = Grid::linear(map.uncertainty.shape.clone(), &map.uncertainty.sigma_m);
    let correct = |z: &Vector3<f64>| {
        let [x, y, w, _] = positions.cubic(z);
        z + Vector3::new(x, y, w)
    };
    let undecided = metal.map(|metal| undecided(map, metal, shape));
    (0..shape.len())
        .into_par_iter()
        .map(|index| {
            let z = shape.position_m(index);
            let calibration = known.trilinear(&z)[3].powi(2);
            let noise = stretched_m2(&map.noise, &z, correct);
            let undecided = undecided.as_ref().map_or(0.0, |squares| squares[index]);
            (calibration + noise + undecided).sqrt()
        })
        .collect()
}

/// Expected square of what a reading's noise becomes by a correction: the trace of `J C J'`, m^2.
pub(crate) fn stretched_m2(
    noise: &FieldNoise,
    z: &Vector3<f64>,
    correct: impl Fn(&Vector3<f64>) -> Vector3<f64>,
) -> f64 {
    let (along, across) = noise.disc_m(z.norm());
    let u = z.try_normalize(1e-9).unwrap_or_else(Vector3::x);
    let covariance = u * u.transpose() * (along * along - across * across)
        + Matrix3::identity() * (across * across + noise.floor_m * noise.floor_m);
    let derivative = derivative(z, correct);
    (derivative * covariance * derivative.transpose()).trace()
}

fn derivative(z: &Vector3<f64>, correct: impl Fn(&Vector3<f64>) -> Vector3<f64>) -> Matrix3<f64> {
    Matrix3::from_columns(&[0, 1, 2].map(|axis| {
        let mut step = Vector3::zeros();
        step[axis] = STEP_M;
        (correct(&(z + step)) - correct(&(z - step))) / (2.0 * STEP_M)
    }))
}

/// Mean square (m^2) of what the map makes of the readings at places all over the hull, at the nodes near the readings.
fn undecided(map: &FieldMap, metal: &Metal, shape: &Shape) -> Vec<f64> {
    let low_high = map.hull.bounds_m();
    let mut tried = vec![(Shape::around(&low_high, TRIED_MARGIN_M, TRIED_STEP_M), 1.0)];
    // Beside an object readings are torn apart: there places are tried that lie closer together.
    for source in map.model.sources.iter().filter(|source| source.kind == Kind::Object) {
        let center = Vector3::from(source.position_m);
        let reach_m = gentle_m(center.norm(), source.strength.abs()).min(CLOSE_REACH_M);
        if metal.surface(&(center + Vector3::x() * reach_m)) > CLEAR_M {
            let close = Shape::around(&[center, center], reach_m, CLOSE_STEP_M);
            tried.push((close, (CLOSE_STEP_M / TRIED_STEP_M).powi(3)));
        }
    }
    let off = |position_m: Vector3<f64>| {
        if map.hull.outside_m(&position_m) > TRIED_MARGIN_M || metal.surface(&position_m) < CLEAR_M {
            return None;
        }
        let z = metal.reading(&position_m);
        let place = metal.find(&z, None);
        let found = map.model.correct_by(Some(metal), &z, |_| place);
        // A polynomial or bumps beside the metal have no reading of their own: what they add is no doubt.
        let rest = found - place.unwrap_or(z);
        Some((z, (found - rest - position_m).norm_squared()))
    };
    let mut sums = vec![Sheets::default(); shape.len()];
    for (nodes, volume) in &tried {
        let found: Vec<Option<(Vector3<f64>, f64)>> =
            (0..nodes.len()).into_par_iter().map(|index| off(nodes.position_m(index))).collect();
        for (z, square) in found.into_iter().flatten() {
            for corner in shape.nodes_around(&z) {
                sums[corner].add(*volume, square);
            }
        }
    }
    sums.into_par_iter()
        .enumerate()
        .map(|(index, sheets)| {
            let z = shape.position_m(index);
            let answered =
                map.hull.outside_m(&z) > 0.0 || metal.find(&z, None).is_some_and(|p| metal.surface(&p) > 0.0);
            sheets.mean_square_m2() + if answered { 0.0 } else { NO_ANSWER_M * NO_ANSWER_M }
        })
        .collect()
}

/// How far from an object readings are gentle, m. At `far_m` from the transmitter its dipole is at most `4 strength / r^3` of the
/// field there, which moves readings by a third of `far_m` times that, and a reading's way by the derivative of it, `4 far strength / r^4`.
fn gentle_m(far_m: f64, strength_m3: f64) -> f64 {
    (4.0 * far_m * strength_m3 / GENTLE).sqrt().sqrt()
}

/// The places whose readings fall near a node: those that the map finds, and those that it takes for another place.
#[derive(Clone, Copy, Debug, Default)]
struct Sheets {
    found: (f64, f64),
    mistaken: (f64, f64),
}

impl Sheets {
    fn add(&mut self, volume: f64, square_m2: f64) {
        let of = if square_m2 > MISTAKEN_M * MISTAKEN_M { &mut self.mistaken } else { &mut self.found };
        of.0 += volume;
        of.1 += volume * square_m2;
    }

    /// Mistakes that are rarer than two sigma allows are left out.
    fn mean_square_m2(&self) -> f64 {
        let all = self.found.0 + self.mistaken.0;
        if self.mistaken.0 > RARE * all {
            (self.found.1 + self.mistaken.1) / all
        } else {
            self.found.1 / self.found.0.max(1e-12)
        }
    }
}

/// Share of the places inside the hull where a model folds or tears space.
pub(crate) fn folded(model: &Model, hull: &Hull) -> f64 {
    let evaluator = model.evaluator();
    let shape = Shape::around(&hull.bounds_m(), FOLD_STEP_M, FOLD_STEP_M);
    let corrected: Vec<Option<Vector3<f64>>> = (0..shape.len())
        .into_par_iter()
        .map(|index| {
            let z = shape.position_m(index);
            (hull.outside_m(&z) < 0.0).then(|| evaluator.correct(&z))
        })
        .collect();
    let [nx, ny, _] = shape.counts;
    let (mut bad, mut all) = (0.0, 0.0);
    for (index, here) in corrected.iter().enumerate() {
        let next = [1, nx, nx * ny].map(|stride| corrected.get(index + stride).copied().flatten());
        let (Some(here), [Some(x), Some(y), Some(z)]) = (here, next) else { continue };
        let volume = Matrix3::from_columns(&[x - here, y - here, z - here]).determinant();
        let share = volume / shape.step_m.powi(3);
        all += 1.0;
        bad += f64::from(u8::from(share.is_nan() || share < LEAST_VOLUME));
    }
    if all > 0.0 { bad / all } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;

    use super::*;
    use crate::map::{Aligned, Uncertainty, VERSION, coarse};
    use crate::model::{Polynomial, Source};
    use crate::report::Report;

    #[test]
    fn a_correction_that_doubles_lengths_doubles_the_noise() {
        let noise = FieldNoise { sigma_signal: 1e-4, floor_m: 1e-3 };
        let z = Vector3::new(1.2, 0.4, -0.3);
        let square = stretched_m2(&noise, &z, |z| z * 2.0);
        assert!((square / noise.mean_square_m2(&z) - 4.0).abs() < 1e-9);
    }

    #[test]
    fn a_map_that_turns_space_inside_out_folds_and_a_mild_one_does_not() {
        let corners: Vec<Vector3<f64>> = (0..8)
            .map(|k| Vector3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2)))
            .collect();
        let hull = Hull::new(corners.iter()).unwrap();
        let mut polynomial = Polynomial::new(1, &Vector3::zeros(), 1.0);
        let mut share = |x: f64| {
            polynomial.coefficients[1] = [x, 0.0, 0.0];
            folded(&Model { polynomial: Some(polynomial.clone()), ..Model::default() }, &hull)
        };
        assert_eq!(share(0.1), 0.0);
        assert_eq!(share(-1.5), 1.0);
    }

    #[test]
    fn beside_strong_iron_a_map_says_that_it_cannot_tell() {
        let iron = Source { kind: Kind::Object, position_m: [1.2, -1.5, 1.5], strength: 0.0034 };
        let model = Model { sources: vec![iron], ..Model::default() };
        let corners: Vec<Vector3<f64>> = (0..8)
            .map(|k| {
                Vector3::new(
                    f64::from(k & 1) + 0.6,
                    f64::from(k >> 1 & 1) * 2.0 - 1.45,
                    f64::from(k >> 2) + 0.5,
                )
            })
            .collect();
        let hull = Hull::new(corners.iter()).unwrap();
        let shape = coarse(&hull);
        let map = FieldMap {
            version: VERSION,
            sensors: Vec::new(),
            spacing_m: 0.3,
            model,
            rotation: None,
            noise: FieldNoise { sigma_signal: 1e-4, floor_m: 3e-4 },
            alignment: Aligned::default(),
            hull,
            uncertainty: Uncertainty { sigma_m: vec![1e-3; shape.len()], shape },
            report: Report::default(),
        };
        let corrector = map.corrector();
        let metal = Metal::new(&map.model.sources);
        let sigma = |p: Vector3<f64>| corrector.correct(&metal.reading(&p));
        assert!(!sigma(Vector3::new(1.0, 0.0, 0.8)).extrapolated);
        assert!(sigma(Vector3::new(1.0, 0.0, 0.8)).sigma_m < 0.02);
        let position_m = Vector3::new(1.1, -0.3, 0.9);
        let turned = Isometry3::new(Vector3::new(3.0, -1.0, 0.5), Vector3::new(0.3, 1.2, -0.7));
        let elsewhere = FieldMap { alignment: Aligned::from(&turned), ..map.clone() }.corrector();
        let seen = elsewhere.reading(&(turned * nalgebra::Point3::from(position_m)).coords);
        assert!((seen - metal.reading(&position_m)).norm() < 2e-4, "{seen}");
        // Ten centimetres beside the surface: what is read there is read elsewhere too.
        let beside = sigma(Vector3::new(1.21, -1.39, 1.30));
        assert!(beside.extrapolated && beside.sigma_m > 0.05, "{beside:?}");
    }
}
