//! What a map can be made of: metal, a polynomial, local bumps, in any combination.
//!
//! What comes in: a reading in the transmitter frame. What goes out: the corrected position, and its derivatives by
//! all parameters. The metal is undone first; polynomial and bumps are functions of the reading and add up.

pub(crate) mod dipole;
pub(crate) mod local;
pub(crate) mod metal;
pub(crate) mod polynomial;
pub(crate) mod rotation;

use nalgebra::{DMatrix, DVector, Vector3};
use serde::{Deserialize, Serialize};

pub use local::Local;
pub use metal::{Kind, Source};
pub use polynomial::Polynomial;

use metal::{Metal, SOURCE_PARAMETERS};
use polynomial::MAX_MONOMIALS;

/// A source nearer than this to a corrected reading is no source, m.
const CLEARANCE_M: f64 = 0.08;

/// A correction of positions: from the reading to the true position, both in the transmitter frame. Without any part it
/// is the identity.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Model {
    /// Image planes and induced dipoles; the metal is undone first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sources: Vec<Source>,
    /// Smooth rest, or all of it; added, as a function of the reading.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub polynomial: Option<Polynomial>,
    /// Local rest, as bumps; added, as a function of the reading.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub local: Option<Local>,
}

impl Model {
    /// Number of parameters: 4 per source, 3 per coefficient of polynomial and bumps.
    pub fn parameters(&self) -> usize {
        SOURCE_PARAMETERS * self.sources.len()
            + self.polynomial.as_ref().map_or(0, |polynomial| 3 * polynomial.coefficients.len())
            + self.local.as_ref().map_or(0, |local| 3 * local.coefficients.len())
    }

    /// Its parts in words, as `1 plane + 2 objects + degree 3 + 40 bumps`; `identity` without any.
    pub fn describe(&self) -> String {
        let planes = self.sources.iter().filter(|source| source.kind == Kind::Plane).count();
        let objects = self.sources.len() - planes;
        let mut parts = Vec::new();
        if planes > 0 {
            parts.push(format!("{planes} plane{}", if planes > 1 { "s" } else { "" }));
        }
        if objects > 0 {
            parts.push(format!("{objects} object{}", if objects > 1 { "s" } else { "" }));
        }
        parts.extend(self.polynomial.as_ref().map(|p| format!("degree {}", p.degree)));
        parts.extend(self.local.as_ref().map(|l| format!("{} bumps", l.centers_m.len())));
        if parts.is_empty() { "identity".into() } else { parts.join(" + ") }
    }

    /// All parameters in order: sources (position, strength), polynomial, bumps.
    pub(crate) fn values(&self) -> DVector<f64> {
        let mut values = Vec::with_capacity(self.parameters());
        for source in &self.sources {
            values.extend(source.position_m);
            values.push(source.strength);
        }
        values.extend(self.polynomial.iter().flat_map(|p| p.coefficients.iter().flatten()));
        values.extend(self.local.iter().flat_map(|l| l.coefficients.iter().flatten()));
        DVector::from_vec(values)
    }

    /// The same model with other parameters.
    pub(crate) fn with_values(&self, values: &DVector<f64>) -> Self {
        let mut model = self.clone();
        let mut next = values.iter().copied();
        let mut take = |slot: &mut f64| *slot = next.next().unwrap_or(*slot);
        for source in &mut model.sources {
            source.position_m.iter_mut().for_each(&mut take);
            take(&mut source.strength);
        }
        model.polynomial.iter_mut().flat_map(|p| p.coefficients.iter_mut().flatten()).for_each(&mut take);
        model.local.iter_mut().flat_map(|l| l.coefficients.iter_mut().flatten()).for_each(&mut take);
        model
    }

    /// Adds the weight of the prior to a normal matrix, and its pull to the gradient at `values`; returns its cost.
    pub(crate) fn add_prior(
        &self,
        values: &DVector<f64>,
        normal: &mut DMatrix<f64>,
        gradient: &mut DVector<f64>,
    ) -> f64 {
        let mut cost = 0.0;
        let mut start = SOURCE_PARAMETERS * self.sources.len();
        if let Some(polynomial) = &self.polynomial {
            let weight = Polynomial::prior_weight(!self.sources.is_empty());
            for k in start..start + 3 * polynomial.coefficients.len() {
                normal[(k, k)] += weight;
                gradient[k] += weight * values[k];
                cost += weight * values[k] * values[k];
            }
            start += 3 * polynomial.coefficients.len();
        }
        if let Some(local) = &self.local {
            let prior = local.prior();
            for i in 0..prior.nrows() {
                for j in 0..prior.ncols() {
                    let weight = prior[(i, j)];
                    for axis in 0..3 {
                        let (a, b) = (start + 3 * i + axis, start + 3 * j + axis);
                        normal[(a, b)] += weight;
                        gradient[a] += weight * values[b];
                        cost += weight * values[a] * values[b];
                    }
                }
            }
        }
        cost
    }

    /// The corrected position of reading `z` among metal that was prepared before.
    pub(crate) fn correct_in(&self, metal: Option<&Metal>, z: &Vector3<f64>) -> Vector3<f64> {
        self.correct_by(metal, z, |metal| metal.correct(z))
    }

    /// The same, at any price: from a `guess` or from all around where the first try finds nothing.
    pub(crate) fn answer_in(
        &self,
        metal: Option<&Metal>,
        z: &Vector3<f64>,
        guess: Option<Vector3<f64>>,
    ) -> Vector3<f64> {
        self.correct_by(metal, z, |metal| metal.find(z, guess))
    }

    /// The same where the metal folds no space; `None` where it may.
    pub(crate) fn plain_in(&self, metal: &Metal, z: &Vector3<f64>) -> Option<Vector3<f64>> {
        let place = metal.find_plain(z)?;
        Some(self.correct_by(Some(metal), z, |_| Some(place)))
    }

    /// The same from the place that somebody has found for the reading among the metal.
    pub(crate) fn correct_by(
        &self,
        metal: Option<&Metal>,
        z: &Vector3<f64>,
        position: impl Fn(&Metal) -> Option<Vector3<f64>>,
    ) -> Vector3<f64> {
        let position = metal.and_then(|metal| position(metal).filter(|p| metal.clearance(p) > CLEARANCE_M));
        let mut y = position.unwrap_or(*z);
        if let Some(polynomial) = &self.polynomial {
            y += polynomial.at(z);
        }
        if let Some(local) = &self.local {
            y += local.at(z);
        }
        y
    }

    /// Its metal, prepared.
    pub(crate) fn metal(&self) -> Option<Metal> {
        (!self.sources.is_empty()).then(|| Metal::new(&self.sources))
    }

    /// Whether it is of metal and nothing else: then it knows where the transmitter is.
    pub(crate) fn is_metal_alone(&self) -> bool {
        self.polynomial.is_none() && self.local.is_none() && !self.sources.is_empty()
    }

    /// Ready to be asked.
    pub(crate) fn evaluator(&self) -> Evaluator<'_> {
        Evaluator { model: self, metal: self.metal() }
    }
}

/// A model with what depends on its parameters alone computed once.
pub(crate) struct Evaluator<'a> {
    model: &'a Model,
    metal: Option<Metal>,
}

impl Evaluator<'_> {
    /// The metal, if there is any.
    pub(crate) fn metal(&self) -> Option<&Metal> {
        self.metal.as_ref()
    }

    /// How many sources it has.
    pub(crate) fn sources(&self) -> usize {
        self.model.sources.len()
    }

    /// The metal with one number of a source moved by `step`: position (0 to 2), then strength, by source.
    pub(crate) fn moved(&self, parameter: usize, step: f64) -> Metal {
        let mut sources = self.model.sources.clone();
        let source = &mut sources[parameter / SOURCE_PARAMETERS];
        match parameter % SOURCE_PARAMETERS {
            3 => source.strength += step,
            axis => source.position_m[axis] += step,
        }
        Metal::new(&sources)
    }

    /// The corrected position of reading `z`. Beside a source, where the metal leaves no answer, the reading stands.
    pub(crate) fn correct(&self, z: &Vector3<f64>) -> Vector3<f64> {
        self.model.correct_in(self.metal.as_ref(), z)
    }

    /// The corrected position and, into `rows` (3 rows by column-major parameters, zero on entry), its derivatives.
    pub(crate) fn with_derivatives(&self, z: &Vector3<f64>, rows: &mut [f64]) -> Vector3<f64> {
        let mut y = *z;
        let mut start = 0;
        if let Some(metal) = &self.metal {
            if let Some(position) =
                metal.position(z).filter(|position| metal.clearance(&position.p) > CLEARANCE_M)
            {
                y = position.p;
                metal.parameters(&position, |k, d| rows[3 * k..3 * k + 3].copy_from_slice(d.as_slice()));
            }
            start = SOURCE_PARAMETERS * self.model.sources.len();
        }
        if let Some(polynomial) = &self.model.polynomial {
            let mut values = [0.0; MAX_MONOMIALS];
            let count = polynomial.monomials(z, &mut values);
            for (k, value) in values[..count].iter().enumerate() {
                for axis in 0..3 {
                    y[axis] += value * polynomial.coefficients[k][axis];
                    rows[3 * (start + 3 * k + axis) + axis] = *value;
                }
            }
            start += 3 * count;
        }
        if let Some(local) = &self.model.local {
            local.bumps(z, |k, value| {
                for axis in 0..3 {
                    y[axis] += value * local.coefficients[k][axis];
                    rows[3 * (start + 3 * k + axis) + axis] = value;
                }
            });
        }
        y
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Metal, polynomial and bumps at once, all parameters different from zero.
    fn model() -> Model {
        let sources = vec![Source { kind: Kind::Plane, position_m: [0.1, -0.05, -0.8], strength: 0.06 }];
        let polynomial = Polynomial::new(2, &Vector3::new(1.0, 0.0, 0.5), 0.8);
        let local = Local::new(&[Vector3::x(), Vector3::y()], 1.5, 0.01, 0.4, 10);
        let model = Model { sources, polynomial: Some(polynomial), local: Some(local) };
        let values = model.values();
        model.with_values(&DVector::from_fn(values.len(), |k, _| values[k] + 0.001 * (k as f64 - 20.0)))
    }

    #[test]
    fn parameters_survive_being_taken_out_and_put_in() {
        let model = model();
        assert_eq!(model.values().len(), model.parameters());
        assert_eq!(model.with_values(&model.values()), model);
        let json = serde_json::to_string(&model).unwrap();
        assert_eq!(serde_json::from_str::<Model>(&json).unwrap(), model);
    }

    #[test]
    fn derivatives_are_differences() {
        let model = model();
        let z = Vector3::new(0.9, 0.3, 0.6);
        let n = model.parameters();
        let mut rows = vec![0.0; 3 * n];
        let y = model.evaluator().with_derivatives(&z, &mut rows);
        assert!((y - model.evaluator().correct(&z)).norm() < 1e-12);
        let values = model.values();
        let h = 1e-6;
        for k in 0..n {
            let mut moved = [values.clone(), values.clone()];
            moved[0][k] += h;
            moved[1][k] -= h;
            let [plus, minus] = moved.map(|v| model.with_values(&v).evaluator().correct(&z));
            let difference = (plus - minus) / (2.0 * h);
            assert!((Vector3::from_column_slice(&rows[3 * k..3 * k + 3]) - difference).norm() < 1e-6, "{k}");
        }
    }

    #[test]
    fn the_prior_is_a_quadratic_form() {
        let model = model();
        let n = model.parameters();
        let values = model.values();
        let (mut normal, mut gradient) = (DMatrix::zeros(n, n), DVector::zeros(n));
        let cost = model.add_prior(&values, &mut normal, &mut gradient);
        assert!((&normal * &values - &gradient).norm() < 1e-9 * gradient.norm());
        assert!((values.dot(&gradient) - cost).abs() < 1e-9 * cost);
    }
}
