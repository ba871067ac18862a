//! Levenberg-Marquardt over a [`Problem`], and what held-out blocks say about its result.

use nalgebra::{DMatrix, DVector};
use posed_geometry::parallel::*;

use super::model::Model;
use super::problem::{Normal, Problem};

/// A fitted model, with what is needed to judge it.
#[derive(Clone, Debug)]
pub(crate) struct Fit {
    pub(crate) model: Model,
    /// Normal equations of each fold at the solution, without the prior.
    pub(crate) folds: Vec<Normal>,
    /// All of them and the prior.
    pub(crate) total: Normal,
}

/// Fits a model from where it stands; `None` if it has no answer there.
pub(crate) fn fit(problem: &Problem, start: &Model, passes: usize) -> Option<Fit> {
    let mut best = judge(problem, start)?;
    let mut damping = if start.sources.is_empty() { 0.0 } else { 1e-3 };
    for _ in 0..passes {
        let Some(step) = solve(&best.total.matrix, &best.total.gradient, damping) else {
            damping = (damping * 10.0_f64).max(1e-6);
            continue;
        };
        let values = best.model.values() - step;
        match judge(problem, &best.model.with_values(&values)) {
            Some(next) if next.total.cost < best.total.cost => {
                let gain = 1.0 - next.total.cost / best.total.cost;
                best = next;
                damping *= 0.1;
                if gain < 1e-4 {
                    break;
                }
            }
            _ => {
                if damping > 1e3 || (damping == 0.0 && start.sources.is_empty()) {
                    break;
                }
                damping = (damping * 10.0).max(1e-6);
            }
        }
    }
    Some(best)
}

fn judge(problem: &Problem, model: &Model) -> Option<Fit> {
    let folds = problem.normals(model);
    let parameters = model.parameters();
    let mut total = folds.first()?.clone();
    for fold in &folds[1..] {
        total.add(fold);
    }
    debug_assert_eq!(total.matrix.nrows(), parameters);
    total.cost += model.add_prior(&model.values(), &mut total.matrix, &mut total.gradient);
    total.cost.is_finite().then(|| Fit { model: model.clone(), folds, total })
}

/// Solves (H + damping diag H) x = g.
fn solve(matrix: &DMatrix<f64>, gradient: &DVector<f64>, damping: f64) -> Option<DVector<f64>> {
    let mut damped = matrix.clone();
    for k in 0..damped.nrows() {
        damped[(k, k)] *= 1.0 + damping;
        damped[(k, k)] += 1e-12;
    }
    Some(damped.cholesky()?.solve(gradient))
}

/// What held-out blocks say of a fit.
#[derive(Clone, Debug)]
pub(crate) struct HeldOut {
    /// Models fitted without each fold.
    pub(crate) models: Vec<Model>,
    /// Bounded loss per number of each fold, at the model fitted without it.
    pub(crate) scores: Vec<f64>,
    /// Rms of the held-out residuals, 3-D, m.
    pub(crate) rms_m: f64,
}

impl HeldOut {
    pub(crate) fn score(&self) -> f64 {
        self.scores.iter().sum::<f64>() / self.scores.len() as f64
    }
}

/// What is left without a map, and on each held-out block.
pub(crate) fn uncorrected(problem: &Problem) -> Option<(Fit, HeldOut)> {
    let fitted = fit(problem, &Model::default(), 0)?;
    let held_out = fitted.held_out(problem)?;
    Some((fitted, held_out))
}

impl Fit {
    /// Leaves out one fold after the other, by one Gauss-Newton step from the solution; `None` if a model fitted
    /// without a fold has no answer in it.
    pub(crate) fn held_out(&self, problem: &Problem) -> Option<HeldOut> {
        let values = self.model.values();
        let each: Option<Vec<(Model, Normal)>> = (0..self.folds.len())
            .into_par_iter()
            .map(|fold| {
                let without = &self.total.matrix - &self.folds[fold].matrix;
                let step = solve(&without, &self.folds[fold].gradient, 1e-9)?;
                let model = self.model.with_values(&(&values + step));
                let normal = problem.cost_of(&model, fold);
                Some((model, normal))
            })
            .collect();
        let each = each?;
        let square: f64 = each.iter().map(|(_, normal)| normal.square_m2).sum();
        let readings: f64 = each.iter().map(|(_, normal)| normal.readings).sum();
        let scores = each.iter().map(|(_, normal)| normal.bounded / normal.freedoms.max(1.0)).collect();
        let models = each.into_iter().map(|(model, _)| model).collect();
        Some(HeldOut { models, scores, rms_m: (square / readings.max(1.0)).sqrt() })
    }

    /// Rms of the residuals, 3-D, m.
    pub(crate) fn rms_m(&self) -> f64 {
        (self.total.square_m2 / self.total.readings.max(1.0)).sqrt()
    }
}
