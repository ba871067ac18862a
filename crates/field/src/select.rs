//! Choosing how rich the map may be, by blocks that were held out.
//!
//! Candidates: no correction, polynomials of rising degree, metal of rising number of sources, metal with a polynomial
//! rest, the best of these with local bumps. A richer one is taken only if it is better on held-out blocks by more
//! than the differences between the blocks leave open.

use nalgebra::Vector3;

use super::fit::{Fit, HeldOut, fit};
use super::model::{Local, Model, Polynomial};
use super::problem::Problem;
use super::report::CandidateModel;
use super::search::add_source;

/// Highest degree of a polynomial alone, and of one beside metal.
const DEGREES: usize = 6;
const REST_DEGREES: usize = 3;
/// A polynomial of degree 3 that loses to metal by this factor is not refined.
const HOPELESS: f64 = 0.8;
/// What bumps are expected to add, m.
const LOCAL_SIGMA_M: f64 = 0.003;
/// Most secondary sources.
const SOURCES: usize = 10;
/// Readings that are enough to find a source, and to compare candidates.
const SEARCH_READINGS: usize = 660;
const COMPARE_READINGS: usize = 3600;

/// A candidate that was fitted and judged.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    pub(crate) fit: Fit,
    pub(crate) held_out: HeldOut,
}

/// The outcome of a selection.
pub(crate) struct Chosen {
    pub(crate) candidate: Candidate,
    pub(crate) tried: Vec<CandidateModel>,
    pub(crate) polynomials: Vec<Model>,
}

/// Fits and judges all candidates.
pub(crate) struct Selection<'a> {
    problem: &'a Problem,
    compare: Problem,
    search: Problem,
    center: Vector3<f64>,
    scale_m: f64,
    best: Option<Candidate>,
    tried: Vec<CandidateModel>,
    polynomials: Vec<Model>,
    metal_only: bool,
}

impl<'a> Selection<'a> {
    pub(crate) fn new(problem: &'a Problem) -> Self {
        let (center, scale_m) = frame_of(&problem.z);
        let readings = problem.z.len();
        Self {
            problem,
            compare: problem.thinned(readings.div_ceil(COMPARE_READINGS)),
            search: problem.thinned(readings.div_ceil(SEARCH_READINGS)),
            center,
            scale_m,
            best: None,
            tried: Vec::new(),
            polynomials: Vec::new(),
            metal_only: false,
        }
    }

    /// Leaves out all that is not metal.
    pub(crate) fn metal_only(self) -> Self {
        Self { metal_only: true, ..self }
    }

    /// The chosen model, fitted to everything; `None` if not even the identity could be judged.
    pub(crate) fn choose(mut self, progress: &mut dyn FnMut(f64)) -> Option<Chosen> {
        self.consider(&Model::default(), 0);
        let metal = self.metal(progress);
        progress(0.6);
        if !self.metal_only {
            self.smooth(metal, progress);
        }
        let best = self.best.take()?;
        let model = best.fit.model.clone();
        let fitted = fit(self.problem, &model, 4)?;
        let held_out = fitted.held_out(self.problem)?;
        progress(1.0);
        let Self { tried, polynomials, .. } = self;
        Some(Chosen { candidate: Candidate { fit: fitted, held_out }, tried, polynomials })
    }

    /// Polynomials, alone and beside the best of metal alone, and bumps beside the best of all.
    fn smooth(&mut self, metal: Option<(f64, Model)>, progress: &mut dyn FnMut(f64)) {
        self.polynomials(metal.as_ref().map_or(f64::INFINITY, |(score, _)| *score));
        progress(0.75);
        if let Some((_, metal)) = metal {
            for degree in 1..=REST_DEGREES {
                let polynomial = Some(Polynomial::new(degree, &self.center, self.scale_m));
                self.consider(&Model { polynomial, ..metal.clone() }, 4);
            }
        }
        progress(0.85);
        if let Some(best) = self.best.as_ref().filter(|best| best.held_out.score() > 1.0) {
            self.local(&best.fit.model.clone());
        }
    }

    /// Polynomials of rising degree; the dear ones only where metal alone did not explain far more already.
    fn polynomials(&mut self, metal: f64) {
        let mut before = f64::INFINITY;
        for degree in 1..=DEGREES {
            let polynomial = Some(Polynomial::new(degree, &self.center, self.scale_m));
            let Some((score, model)) = self.consider(&Model { polynomial, ..Model::default() }, 4) else {
                break;
            };
            self.polynomials.push(model);
            let hopeless = degree >= 3 && metal < HOPELESS * score;
            if hopeless || (degree >= 4 && score > 0.97 * before) {
                break;
            }
            before = score;
        }
    }

    /// Adds sources as long as held-out blocks get better; returns the best model of metal alone.
    fn metal(&mut self, progress: &mut dyn FnMut(f64)) -> Option<(f64, Model)> {
        let mut model = Model::default();
        let mut best: Option<(f64, Model)> = None;
        let mut worse = 0;
        for count in 0..SOURCES {
            let Some(found) = add_source(&self.search, &model, 9) else { break };
            model = found.model;
            let Some((score, fitted)) = self.consider(&model, 6) else { break };
            model = fitted;
            if best.as_ref().is_none_or(|(least, _)| score < 0.995 * *least) {
                best = Some((score, model.clone()));
                worse = 0;
            } else {
                worse += 1;
                if worse == 2 {
                    break;
                }
            }
            progress(0.6 * (count + 1) as f64 / SOURCES as f64);
        }
        best
    }

    /// Local bumps beside a model.
    fn local(&mut self, model: &Model) {
        for (length_m, most) in [(1.2, 30), (0.8, 60)] {
            let local = Local::new(&self.search.z, length_m, LOCAL_SIGMA_M, 0.5 * length_m, most);
            self.consider(&Model { local: Some(local), ..model.clone() }, 2);
        }
    }

    /// Fits and judges a candidate, keeps it if it is the best; its score and fitted model.
    fn consider(&mut self, model: &Model, passes: usize) -> Option<(f64, Model)> {
        let fitted = fit(&self.compare, model, passes)?;
        let held_out = fitted.held_out(&self.compare)?;
        let score = held_out.score();
        self.tried.push(CandidateModel {
            what: fitted.model.describe(),
            parameters: fitted.model.parameters(),
            score,
            heldout_m: held_out.rms_m,
        });
        let model = fitted.model.clone();
        let candidate = Candidate { fit: fitted, held_out };
        let better = match &self.best {
            None => true,
            Some(best) => beats(&candidate, best),
        };
        if better {
            self.best = Some(candidate);
        }
        Some((score, model))
    }
}

/// Whether a candidate is better than the best so far: the simpler of two keeps its place unless the other one wins by
/// more than one standard error of the differences between the blocks.
pub(crate) fn beats(candidate: &Candidate, best: &Candidate) -> bool {
    let differences: Vec<f64> =
        candidate.held_out.scores.iter().zip(&best.held_out.scores).map(|(a, b)| a - b).collect();
    let n = differences.len() as f64;
    let mean = differences.iter().sum::<f64>() / n;
    let variance = differences.iter().map(|d| (d - mean) * (d - mean)).sum::<f64>() / (n - 1.0);
    let error = (variance / n).sqrt();
    if candidate.fit.model.parameters() > best.fit.model.parameters() {
        // What metal leaves over is seldom worth its loss of absolute position.
        let rest = |model: &Model| model.polynomial.is_some() || model.local.is_some();
        let models = (&candidate.fit.model, &best.fit.model);
        let least = if !models.0.sources.is_empty() && rest(models.0) { 0.03 } else { 0.002 };
        mean < -error.max(least * best.held_out.score())
    } else {
        mean < error
    }
}

/// Middle and half extent of the readings.
fn frame_of(z: &[Vector3<f64>]) -> (Vector3<f64>, f64) {
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    for z in z {
        low = low.inf(z);
        high = high.sup(z);
    }
    ((low + high) / 2.0, (0.5 * (high - low).max()).max(0.05))
}
