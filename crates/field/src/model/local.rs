//! A local correction: compact bumps around centres spread through the data.
//!
//! A Gaussian process seen through its inducing points: the prior of the correction is a field of standard
//! deviation `sigma_m` that forgets itself over `length_m`.

use nalgebra::{DMatrix, Vector3};
use serde::{Deserialize, Serialize};

/// Sum of Wendland's C2 functions `(1 - r)^4 (4 r + 1)`, each with a vector; r is the distance from a centre over the
/// radius. Wendland (1995), doi:10.1007/BF02123482.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Local {
    /// Radius of a bump, m.
    pub length_m: f64,
    /// Standard deviation of the correction before any data, per axis, m.
    pub sigma_m: f64,
    /// Centres, transmitter frame, m.
    pub centers_m: Vec<[f64; 3]>,
    /// One vector per centre, m; as many as centres.
    pub coefficients: Vec<[f64; 3]>,
}

/// Wendland (1995), C2 in three dimensions: `(1 - r)^4 (4 r + 1)` for r < 1.
fn bump(r: f64) -> f64 {
    if r >= 1.0 {
        return 0.0;
    }
    let s = (1.0 - r) * (1.0 - r);
    s * s * (4.0 * r + 1.0)
}

impl Local {
    /// The zero correction on centres picked from `points`, at least half a `length_m` apart, in their order.
    pub(crate) fn new(
        points: &[Vector3<f64>],
        length_m: f64,
        sigma_m: f64,
        spacing_m: f64,
        most: usize,
    ) -> Self {
        let mut spacing = spacing_m;
        loop {
            let mut centers: Vec<Vector3<f64>> = Vec::new();
            for point in points {
                if centers.iter().all(|center| (center - point).norm() > spacing) {
                    centers.push(*point);
                    if centers.len() > most {
                        break;
                    }
                }
            }
            if centers.len() <= most {
                let centers_m: Vec<[f64; 3]> = centers.into_iter().map(Into::into).collect();
                let coefficients = vec![[0.0; 3]; centers_m.len()];
                return Self { length_m: length_m.max(1.6 * spacing), sigma_m, centers_m, coefficients };
            }
            spacing *= 1.15;
        }
    }

    /// Says the value of each bump that reaches `z`.
    pub(crate) fn bumps(&self, z: &Vector3<f64>, mut each: impl FnMut(usize, f64)) {
        for (index, center) in self.centers_m.iter().enumerate() {
            let r2 = (z - Vector3::from(*center)).norm_squared() / (self.length_m * self.length_m);
            if r2 < 1.0 {
                each(index, bump(r2.sqrt()));
            }
        }
    }

    /// The correction at `z`, m.
    pub(crate) fn at(&self, z: &Vector3<f64>) -> Vector3<f64> {
        let mut sum = Vector3::zeros();
        self.bumps(z, |index, value| sum += Vector3::from(self.coefficients[index]) * value);
        sum
    }

    /// Weight of the prior between the coefficients, 1/m^2: the matrix of the bumps between centres over the
    /// variance of the field.
    pub(crate) fn prior(&self) -> DMatrix<f64> {
        let n = self.centers_m.len();
        let scale = 1.0 / (self.sigma_m * self.sigma_m);
        let mut prior = DMatrix::from_fn(n, n, |i, j| {
            let d = Vector3::from(self.centers_m[i]) - Vector3::from(self.centers_m[j]);
            scale * bump(d.norm() / self.length_m)
        });
        for k in 0..n {
            prior[(k, k)] += 1e-6 * scale;
        }
        prior
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bump_is_one_at_its_centre_and_nothing_beyond_its_radius() {
        let mut local = Local::new(&[Vector3::x()], 0.4, 0.01, 0.2, 10);
        local.coefficients[0] = [0.0, 0.0, 2.0];
        assert_eq!(local.at(&Vector3::x()), Vector3::new(0.0, 0.0, 2.0));
        assert_eq!(local.at(&Vector3::new(1.41, 0.0, 0.0)), Vector3::zeros());
        assert!((local.at(&Vector3::new(1.2, 0.0, 0.0)).z - 2.0 * 0.0625 * 3.0).abs() < 1e-12);
    }
}
