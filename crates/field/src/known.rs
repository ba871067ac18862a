//! A map from readings whose true places are known: from a survey, a robot, a simulation.
//!
//! The same choice between the same candidates as the pole's, with the same held-out blocks, here of every tenth part
//! of the readings in their order.

use nalgebra::Vector3;

use super::corrector::Corrector;
use super::fit::fit;
use super::hull::Hull;
use super::map::{Aligned, FieldMap, Uncertainty, VERSION, coarse};
use super::model::Model;
use super::noise::FieldNoise;
use super::problem::Problem;
use super::report::Report;
use super::select::{Chosen, Selection};

const FOLDS: usize = 10;
/// Readings that follow each other belong to one block.
const BLOCK: usize = 50;

fn problem(pairs: &[(Vector3<f64>, Vector3<f64>)], noise: &FieldNoise) -> Problem {
    let mut problem = Problem::new(FOLDS);
    for (index, (reading, position_m)) in pairs.iter().enumerate() {
        problem.push_known(index / BLOCK, *reading, *position_m, noise);
    }
    problem
}

/// Fits a map to pairs of reading and true position (transmitter frame, m), from a survey, a robot or a simulation.
///
/// The model is chosen by held-out blocks of 50 readings in their order. The map is marked as accepted without any
/// check of coverage, has no correction of orientations and one uncertainty everywhere: the held-out rms. `None`
/// without pairs, or where no candidate can be fitted.
pub fn fit_known(pairs: &[(Vector3<f64>, Vector3<f64>)], noise: FieldNoise) -> Option<FieldMap> {
    let hull = Hull::new(pairs.iter().map(|(reading, _)| reading))?;
    let weighting = FieldNoise { floor_m: noise.floor_m.max(1e-4), ..noise };
    let problem = problem(pairs, &weighting);
    let Chosen { candidate: chosen, tried, .. } = Selection::new(&problem).choose(&mut |_| {})?;
    let shape = coarse(&hull);
    let excess_m2 = chosen.held_out.rms_m.powi(2);
    let uncertainty = Uncertainty { sigma_m: vec![excess_m2.sqrt(); shape.len()], shape };
    let report = Report {
        accepted: true,
        residual_m: chosen.fit.rms_m(),
        heldout_m: chosen.held_out.rms_m,
        raw_m: tried.first().map_or(f64::NAN, |tried| tried.heldout_m),
        model: chosen.fit.model.describe(),
        readings: pairs.len(),
        covered: 1.0,
        tried,
        ..Report::default()
    };
    Some(FieldMap {
        version: VERSION,
        sensors: Vec::new(),
        spacing_m: 0.0,
        model: chosen.fit.model,
        rotation: None,
        noise,
        alignment: Aligned::default(),
        hull,
        uncertainty,
        report,
    })
}

/// Fits a model of the same parts as `model`, begun at its parameters, to pairs of reading and true position
/// (transmitter frame, m): the best that such a model could do. `None` where the least squares fail.
pub fn refit_known(
    model: &Model,
    pairs: &[(Vector3<f64>, Vector3<f64>)],
    noise: FieldNoise,
) -> Option<Model> {
    let problem = problem(pairs, &FieldNoise { floor_m: noise.floor_m.max(1e-4), ..noise });
    Some(fit(&problem, model, 10)?.model)
}

impl Model {
    /// The corrected position of a reading, transmitter frame, m, straight from the model: no grid, no alignment, no
    /// fade outside the hull. Slow beside `Corrector::position`, which prepares the metal once.
    pub fn correct(&self, reading_m: &Vector3<f64>) -> Vector3<f64> {
        self.answer_in(self.metal().as_ref(), reading_m, None)
    }
}

impl Corrector {
    /// Corrects a batch of readings (transmitter frame, m) as `Corrector::position` does. `corrected_m` is emptied
    /// first and then holds one position per reading.
    pub fn positions(&self, readings_m: &[Vector3<f64>], corrected_m: &mut Vec<Vector3<f64>>) {
        corrected_m.clear();
        corrected_m.extend(readings_m.iter().map(|z| self.position(z)));
    }
}
