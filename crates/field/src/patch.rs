//! One cell of a grid in which a spline is too coarse: a polynomial of degree 4 along each axis.
//!
//! What comes in: a function on the unit cube. What goes out: four numbers anywhere in it. Beside metal a field is steep but
//! analytic, so that five Chebyshev nodes along each axis do what a grid would need a tenth of its spacing for.

/// Nodes along each axis.
const NODES: usize = 5;
/// Chebyshev nodes of the unit interval: `(1 - cos((2 k + 1) pi / 10)) / 2`.
const KNOTS: [f64; NODES] =
    [0.024_471_741_852_423, 0.206_107_373_853_763, 0.5, 0.793_892_626_146_237, 0.975_528_258_147_577];

/// Every other node.
const FEW: usize = NODES.div_ceil(2);

/// Values at the nodes, x fastest.
#[derive(Clone, Debug)]
pub(crate) struct Patch {
    values: [[f32; 4]; NODES * NODES * NODES],
}

impl Patch {
    /// Asks for the values at the nodes; `None` where one has none.
    pub(crate) fn new(mut at: impl FnMut([f64; 3]) -> Option<[f64; 4]>) -> Option<Self> {
        let mut values = [[0.0; 4]; NODES * NODES * NODES];
        for (k, value) in values.iter_mut().enumerate() {
            let [i, j, l] = [k % NODES, k / NODES % NODES, k / (NODES * NODES)];
            *value = at([KNOTS[i], KNOTS[j], KNOTS[l]])?.map(|x| x as f32);
        }
        Some(Self { values })
    }

    /// Asks at every other node only; at the others it has what a polynomial of degree 2 along each axis makes of these.
    pub(crate) fn sketch(mut at: impl FnMut([f64; 3]) -> Option<[f64; 4]>) -> Option<Self> {
        let mut few = [[0.0; 4]; FEW * FEW * FEW];
        for (k, value) in few.iter_mut().enumerate() {
            *value = at([k % FEW, k / FEW % FEW, k / (FEW * FEW)].map(|node| KNOTS[2 * node]))?;
        }
        let values = std::array::from_fn(|k| {
            let [x, y, z] = [k % NODES, k / NODES % NODES, k / (NODES * NODES)].map(few_weights);
            let mut sum = [0.0; 4];
            for (k, value) in few.iter().enumerate() {
                let w = x[k % FEW] * y[k / FEW % FEW] * z[k / (FEW * FEW)];
                (0..4).for_each(|c| sum[c] += w * value[c]);
            }
            sum.map(|x| x as f32)
        });
        Some(Self { values })
    }

    /// The value at a place of the unit cube.
    #[inline]
    pub(crate) fn at(&self, position: [f32; 3]) -> [f32; 4] {
        let [wx, wy, wz] = position.map(weights);
        let mut sum = [0.0_f32; 4];
        for (plane, wz) in self.values.chunks_exact(NODES * NODES).zip(wz) {
            for (row, wy) in plane.chunks_exact(NODES).zip(wy) {
                let mut line = [0.0_f32; 4];
                for (value, wx) in row.iter().zip(wx) {
                    for c in 0..4 {
                        line[c] += wx * value[c];
                    }
                }
                let w = wy * wz;
                for c in 0..4 {
                    sum[c] += w * line[c];
                }
            }
        }
        sum
    }
}

/// Lagrange's polynomials of the nodes.
fn weights(t: f32) -> [f32; NODES] {
    const SCALES: [f32; NODES] = scales();
    let away: [f32; NODES] = std::array::from_fn(|k| t - KNOTS[k] as f32);
    let mut weights = SCALES;
    let (mut before, mut after) = (1.0, 1.0);
    for k in 0..NODES {
        weights[k] *= before;
        before *= away[k];
        weights[NODES - 1 - k] *= after;
        after *= away[NODES - 1 - k];
    }
    weights
}

/// Lagrange's polynomials of every other node, at a node.
fn few_weights(node: usize) -> [f64; FEW] {
    std::array::from_fn(|k| {
        let others = (0..FEW).filter(|other| *other != k).map(|other| KNOTS[2 * other]);
        others.map(|other| (KNOTS[node] - other) / (KNOTS[2 * k] - other)).product()
    })
}

/// One over the product of each node's distances from the others.
const fn scales() -> [f32; NODES] {
    let mut scales = [0.0; NODES];
    let mut k = 0;
    while k < NODES {
        let (mut product, mut other) = (1.0, 0);
        while other < NODES {
            if other != k {
                product *= KNOTS[k] - KNOTS[other];
            }
            other += 1;
        }
        scales[k] = (1.0 / product) as f32;
        k += 1;
    }
    scales
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_polynomial_of_degree_four_comes_back() {
        let f = |[x, y, z]: [f64; 3]| [x.powi(4) - y * z, x * y.powi(3), 0.3 - z.powi(4), 1.0];
        let patch = Patch::new(|position| Some(f(position))).unwrap();
        for position in [[0.0, 0.0, 0.0], [1.0, 0.0, 0.5], [0.3, 0.9, 0.1], [1.0, 1.0, 1.0]] {
            for (found, expected) in patch.at(position.map(|x| x as f32)).iter().zip(f(position)) {
                assert!((f64::from(*found) - expected).abs() < 3e-6, "{position:?} {found} {expected}");
            }
        }
    }

    #[test]
    fn a_sketch_is_a_polynomial_of_degree_two_and_asks_a_fifth() {
        let f = |[x, y, z]: [f64; 3]| [x.powi(2) - y * z.powi(2), x * y, 0.3 - z, 1.0];
        let mut asked = 0;
        let sketch = Patch::sketch(|position| {
            asked += 1;
            Some(f(position))
        })
        .unwrap();
        assert_eq!(asked, 27);
        for position in [[0.0, 0.0, 0.0], [1.0, 0.0, 0.5], [0.3, 0.9, 0.1]] {
            for (found, expected) in sketch.at(position.map(|x| x as f32)).iter().zip(f(position)) {
                assert!((f64::from(*found) - expected).abs() < 3e-6, "{position:?} {found} {expected}");
            }
        }
    }

    #[test]
    fn a_field_beside_metal_is_met_to_a_fifth_of_a_millimetre() {
        // A dipole one and a half cells away, nine centimetres strong at the near side.
        let f = |[x, y, z]: [f64; 3]| {
            let r = libm::hypot(libm::hypot(x + 1.5, y - 0.5), z - 0.5);
            [0.3 / r.powi(3), 0.0, 0.0, 1.0]
        };
        let patch = Patch::new(|position| Some(f(position))).unwrap();
        for k in 0..50 {
            let position = [0.37, 0.71, 0.19].map(|step: f64| (step * f64::from(k)).fract());
            let found = f64::from(patch.at(position.map(|x| x as f32))[0]);
            assert!((found - f(position)[0]).abs() < 2e-4, "{position:?} {found}");
        }
    }
}
