//! The device's own dipole model, and its answer to a field that is a little different.
//!
//! Units of mu0 m / 4 pi: the field of the source at distance r is of the order of `r^-3`, 1/m^3.

use nalgebra::{Matrix3, SMatrix, Vector3};

/// Field of three unit dipoles at `p` from them, one column per source axis: `(3 p p' / r^2 - I) / r^3`.
pub(crate) fn field(p: &Vector3<f64>) -> Matrix3<f64> {
    let r2 = p.norm_squared();
    let inverse_r3 = 1.0 / (r2 * r2.sqrt());
    let mut field = p * p.transpose() * (3.0 * inverse_r3 / r2);
    for k in 0..3 {
        field[(k, k)] -= inverse_r3;
    }
    field
}

/// Derivatives of [`field`] by the three components of `p`.
pub(crate) fn field_gradient(p: &Vector3<f64>) -> [Matrix3<f64>; 3] {
    let r2 = p.norm_squared();
    let inverse_r5 = 1.0 / (r2 * r2 * r2.sqrt());
    let outer = p * p.transpose();
    [0, 1, 2].map(|l| {
        let mut d = outer * (-15.0 * p[l] * inverse_r5 / r2);
        for k in 0..3 {
            d[(k, l)] += 3.0 * p[k] * inverse_r5;
            d[(l, k)] += 3.0 * p[k] * inverse_r5;
            d[(k, k)] += 3.0 * p[l] * inverse_r5;
        }
        d
    })
}

/// What the device makes of a field.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reading {
    /// The position that it reports, on the side of the given hint.
    pub(crate) position: Vector3<f64>,
    gram: Matrix3<f64>,
    u: Vector3<f64>,
    r: f64,
}

/// Solves the pure dipole model: range from the trace of `B'B`, direction from its leading eigenvector.
///
/// `hint` is near the solution. The leading eigenvalue is about four times the others, so that the 32nd power of
/// the matrix leaves nothing else; it is at least a third of the trace, so that nothing vanishes.
pub(crate) fn solve(field: &Matrix3<f64>, hint: &Vector3<f64>) -> Reading {
    let gram = field.transpose() * field;
    let trace = gram.trace();
    let mut power = gram / trace;
    for _ in 0..5 {
        power *= power;
    }
    reading(gram, trace, &power, hint)
}

/// The same where metal is so near that two eigenvalues are nearly alike: the 1024th power.
pub(crate) fn solve_closely(field: &Matrix3<f64>, hint: &Vector3<f64>) -> Reading {
    let gram = field.transpose() * field;
    let trace = gram.trace();
    let mut power = gram / trace;
    for _ in 0..10 {
        power *= power;
        power /= power.trace();
    }
    reading(gram, trace, &power, hint)
}

fn reading(gram: Matrix3<f64>, trace: f64, power: &Matrix3<f64>, hint: &Vector3<f64>) -> Reading {
    let mut u = power * hint;
    u /= u.norm();
    let r = libm::cbrt(6.0 / trace).sqrt();
    Reading { position: u * r, gram, u, r }
}

impl Reading {
    /// Derivative of the position by the nine numbers of the field `b` (column by column).
    pub(crate) fn derivative(&self, b: &Matrix3<f64>) -> SMatrix<f64, 3, 9> {
        let Self { gram, u, r, .. } = self;
        let trace = gram.trace();
        let leading = u.dot(&(gram * u));
        let uu = u * u.transpose();
        // Inverse of (lambda I - G) across u; u itself is moved out of the way.
        let across = (Matrix3::identity() - uu)
            * (Matrix3::identity() * leading - gram + uu * leading)
                .try_inverse()
                .unwrap_or_else(Matrix3::zeros);
        let bu = b * u;
        let mut derivative = SMatrix::<f64, 3, 9>::zeros();
        for column in 0..3 {
            for row in 0..3 {
                // dG u for a unit change of b[(row, column)].
                let mut change = b.row(row).transpose() * u[column];
                change[column] += bu[row];
                let dr = -r / (6.0 * trace) * 2.0 * b[(row, column)];
                derivative.set_column(3 * column + row, &(u * dr + across * change * *r));
            }
        }
        derivative
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solving_the_source_itself_gives_the_position_back() {
        let p = Vector3::new(0.7, -1.1, 0.4);
        assert!((solve(&field(&p), &Vector3::x()).position - p).norm() < 1e-12);
    }

    #[test]
    fn the_gradient_of_the_field_is_its_difference() {
        let p = Vector3::new(0.7, -1.1, 0.4);
        let h = 1e-6;
        for (l, gradient) in field_gradient(&p).iter().enumerate() {
            let mut step = Vector3::zeros();
            step[l] = h;
            let difference = (field(&(p + step)) - field(&(p - step))) / (2.0 * h);
            assert!((gradient - difference).norm() < 1e-7);
        }
    }

    #[test]
    fn the_derivative_of_the_solution_is_its_difference() {
        let p = Vector3::new(0.7, -1.1, 0.4);
        let b = field(&p) + Matrix3::new(0.02, -0.01, 0.03, 0.0, 0.01, -0.02, 0.01, 0.02, -0.03);
        let reading = solve(&b, &p);
        let derivative = reading.derivative(&b);
        let h = 1e-7;
        for k in 0..9 {
            let mut plus = b;
            let mut minus = b;
            plus[k] += h;
            minus[k] -= h;
            let difference = (solve(&plus, &p).position - solve(&minus, &p).position) / (2.0 * h);
            assert!((derivative.column(k) - difference).norm() < 1e-6, "{k}");
        }
    }
}
