//! A polynomial correction: one vector per monomial of the scaled position.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Highest degree.
pub(crate) const MAX_DEGREE: usize = 6;
/// Monomials of the highest degree in three variables.
pub(crate) const MAX_MONOMIALS: usize = 84;
/// Standard deviation of a coefficient before any data, m: alone, where it only fixes what a pole cannot see, and
/// beside metal, where little should be left and the metal knows where the transmitter is.
const PRIOR_SIGMA_M: f64 = 0.5;
const PRIOR_BESIDE_METAL_M: f64 = 0.005;

/// Sum of the monomials of `(z - center) / scale`, each with a vector; z is the reading in the transmitter frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Polynomial {
    /// Total degree, 0 to 6.
    pub degree: usize,
    /// Middle of the data, transmitter frame, m.
    pub center_m: [f64; 3],
    /// Half the extent of the data, m; not zero.
    pub scale_m: f64,
    /// One vector per monomial, m (rad for rotations): by total degree, then by falling powers of x, then of y.
    pub coefficients: Vec<[f64; 3]>,
}

/// Number of monomials up to `degree` in three variables.
pub(crate) fn count(degree: usize) -> usize {
    (degree + 1) * (degree + 2) * (degree + 3) / 6
}

impl Polynomial {
    /// The zero polynomial.
    pub(crate) fn new(degree: usize, center: &Vector3<f64>, scale_m: f64) -> Self {
        let degree = degree.min(MAX_DEGREE);
        Self { degree, center_m: (*center).into(), scale_m, coefficients: vec![[0.0; 3]; count(degree)] }
    }

    /// Whether degree and number of coefficients fit.
    pub(crate) fn check(&self) -> Result<(), String> {
        if self.degree > MAX_DEGREE
            || self.coefficients.len() != count(self.degree)
            || !self.scale_m.is_normal()
        {
            return Err(format!("a polynomial of degree {} has other coefficients", self.degree));
        }
        Ok(())
    }

    /// Values of all monomials at `z`: by total degree, then by falling powers of x, then of y. Returns how many.
    ///
    /// Each monomial is one of the degree below times x, y or z.
    pub(crate) fn monomials(&self, z: &Vector3<f64>, values: &mut [f64; MAX_MONOMIALS]) -> usize {
        let [x, y, w] = [0, 1, 2].map(|k| (z[k] - self.center_m[k]) / self.scale_m);
        values[0] = 1.0;
        let (mut below, mut next) = (0, 1);
        for degree in 1..=self.degree {
            // The degree below has `rows` groups of equal power of x, of 1, 2, .. entries.
            let size = degree * (degree + 1) / 2;
            for k in 0..size {
                values[next + k] = values[below + k] * x;
            }
            // Of those without x, the last `degree` of the degree below: times y, and the very last times z.
            let free = below + size - degree;
            for k in 0..degree {
                values[next + size + k] = values[free + k] * y;
            }
            values[next + size + degree] = values[below + size - 1] * w;
            below = next;
            next += size + degree + 1;
        }
        next
    }

    /// The correction at `z`, m.
    pub(crate) fn at(&self, z: &Vector3<f64>) -> Vector3<f64> {
        let mut values = [0.0; MAX_MONOMIALS];
        let count = self.monomials(z, &mut values);
        let mut sum = Vector3::zeros();
        for (value, coefficient) in values[..count].iter().zip(&self.coefficients) {
            sum += Vector3::from(*coefficient) * *value;
        }
        sum
    }

    /// Weight of the prior on each coefficient, 1/m^2.
    pub(crate) fn prior_weight(beside_metal: bool) -> f64 {
        if beside_metal { PRIOR_BESIDE_METAL_M.powi(-2) } else { PRIOR_SIGMA_M.powi(-2) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_monomials_are_there_once() {
        let polynomial = Polynomial::new(4, &Vector3::zeros(), 1.0);
        let mut values = [0.0; MAX_MONOMIALS];
        // Powers of distinct primes: each product names its monomial.
        let n = polynomial.monomials(&Vector3::new(2.0, 3.0, 5.0), &mut values);
        let mut expected: Vec<f64> = (0..=4)
            .flat_map(|a| (0..=4 - a).flat_map(move |b| (0..=4 - a - b).map(move |c| (a, b, c))))
            .map(|(a, b, c)| 2f64.powi(a) * 3f64.powi(b) * 5f64.powi(c))
            .collect();
        let mut found = values[..n].to_vec();
        expected.sort_by(f64::total_cmp);
        found.sort_by(f64::total_cmp);
        assert_eq!(n, count(4));
        assert_eq!(found, expected);
    }
}
