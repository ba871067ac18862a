//! Four numbers on a regular grid, looked up smoothly.

use nalgebra::Vector3;
use posed_geometry::parallel::*;
use serde::{Deserialize, Serialize};

use super::patch::Patch;

/// Cells without a patch: where the spline is good, and where nothing smooth is.
const SPLINE: u16 = u16::MAX;
const TORN: u16 = u16::MAX - 1;
/// Where a patch is compared in its cell.
const TRIED: [[f64; 3]; 5] =
    [[0.4, 0.6, 0.35], [0.1, 0.1, 0.9], [0.9, 0.1, 0.1], [0.1, 0.9, 0.1], [0.9, 0.9, 0.9]];
/// Where a sketch is off by so many tolerances the cell is torn: the answers there are the dearest, and a sketch asks for a fifth of them.
/// A patch that holds comes closer: beside its sketch it is better by the square of its rate of convergence, which is 8 beside
/// metal that is as near as a patch bears (Trefethen, "Approximation theory and approximation practice", theorem 8.2).
const TORN_TOLERANCES: f64 = 100.0;
/// Most nodes of a grid: a larger stage gets a coarser one.
const MOST_NODES: f64 = 150_000.0;

/// Where the nodes of a regular grid are, transmitter frame; x runs fastest, then y, then z.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shape {
    /// Node with the lowest coordinates, m.
    pub low_m: [f64; 3],
    /// Distance of neighbouring nodes, the same along every axis, m.
    pub step_m: f64,
    /// Number of nodes along x, y, z; at least 4 each.
    pub counts: [usize; 3],
}

impl Shape {
    /// A grid over a box and `margin_m` around it.
    pub(crate) fn around(bounds: &[Vector3<f64>; 2], margin_m: f64, step_m: f64) -> Self {
        let low = bounds[0] - Vector3::repeat(margin_m);
        let extent = bounds[1] + Vector3::repeat(margin_m) - low;
        let step_m = step_m.max(libm::cbrt(extent.x * extent.y * extent.z / MOST_NODES));
        let counts = [0, 1, 2].map(|axis| ((extent[axis] / step_m).ceil() as usize + 1).max(4));
        Self { low_m: low.into(), step_m, counts }
    }

    /// Number of nodes.
    pub(crate) fn len(&self) -> usize {
        self.counts.iter().product()
    }

    /// Indices of the eight nodes around `p`; at the edge outside.
    pub(crate) fn nodes_around(&self, p: &Vector3<f64>) -> [usize; 8] {
        let [i, j, k] = [0, 1, 2].map(|axis| {
            let x = ((p[axis] - self.low_m[axis]) / self.step_m).max(0.0);
            (x as usize).min(self.counts[axis] - 2)
        });
        let [nx, ny, _] = self.counts;
        std::array::from_fn(|n| ((k + (n >> 2)) * ny + j + (n >> 1 & 1)) * nx + i + (n & 1))
    }

    /// Place of node `index`, m.
    pub(crate) fn position_m(&self, index: usize) -> Vector3<f64> {
        let [nx, ny, _] = self.counts;
        let at = [index % nx, index / nx % ny, index / (nx * ny)];
        Vector3::from_fn(|axis, _| self.low_m[axis] + at[axis] as f64 * self.step_m)
    }
}

/// Values at the nodes, and coefficients of the cubic B-spline through them.
#[derive(Clone, Debug)]
pub(crate) struct Grid {
    shape: Shape,
    values: Vec<[f32; 4]>,
    spline: Vec<[f32; 4]>,
    /// What to ask in the cell above each node: [`SPLINE`], [`TORN`] or a patch; empty where nobody compared.
    details: Vec<u16>,
    patches: Vec<Patch>,
}

/// What a cell needs where the spline may be too coarse.
enum Cell {
    Smooth,
    Patched(Box<Patch>),
    Torn,
}

impl Grid {
    /// Asks for the values at all nodes.
    pub(crate) fn new(shape: Shape, at: impl Fn(&Vector3<f64>) -> [f64; 4] + Sync) -> Self {
        Self::by_index(shape, |_, position_m| at(position_m))
    }

    /// The same with each node's index.
    pub(crate) fn by_index(shape: Shape, at: impl Fn(usize, &Vector3<f64>) -> [f64; 4] + Sync) -> Self {
        let values: Vec<[f32; 4]> = (0..shape.len())
            .into_par_iter()
            .map(|index| at(index, &shape.position_m(index)).map(|x| x as f32))
            .collect();
        let spline = coefficients(&shape, &values);
        Self { shape, values, spline, details: Vec::new(), patches: Vec::new() }
    }

    /// Compares the spline with what it stands for in each cell. A cell in which its first three numbers are
    /// wrong by more than the `tolerance` (where there is one) gets a patch; one in which a patch is too, or where
    /// what it stands for is not smooth (`None`), is remembered as torn.
    pub(crate) fn refine(
        &mut self,
        tolerance: impl Fn(&Vector3<f64>) -> Option<f64> + Sync,
        exact: impl Fn(&Vector3<f64>) -> Option<[f64; 4]> + Sync,
    ) {
        let step = self.shape.step_m;
        let this = &*self;
        let refined: Vec<Cell> = (0..this.shape.len())
            .into_par_iter()
            .map(|index| {
                let low = this.shape.position_m(index);
                let within = |share: [f64; 3]| low + Vector3::from(share) * step;
                let Some(tolerance) = tolerance(&within([0.5; 3])) else { return Cell::Smooth };
                this.refined(tolerance, within, |share| exact(&within(share))).unwrap_or(Cell::Torn)
            })
            .collect();
        self.details = vec![SPLINE; refined.len()];
        for (detail, refined) in self.details.iter_mut().zip(refined) {
            match refined {
                Cell::Smooth => {}
                Cell::Patched(patch) if self.patches.len() < usize::from(TORN) => {
                    *detail = self.patches.len() as u16;
                    self.patches.push(*patch);
                }
                Cell::Patched(_) | Cell::Torn => *detail = TORN,
            }
        }
    }

    /// What one cell needs, by places `within` it; `None` where what it stands for has no answer.
    fn refined(
        &self,
        tolerance: f64,
        within: impl Fn([f64; 3]) -> Vector3<f64>,
        exact: impl Fn([f64; 3]) -> Option<[f64; 4]>,
    ) -> Option<Cell> {
        let first = far(&self.cubic(&within([0.5; 3])), &exact([0.5; 3])?);
        // Where the middle is nearly too bad, other places may be.
        if first < 0.25 * tolerance {
            return Some(Cell::Smooth);
        }
        let mut truth = [[0.0; 4]; TRIED.len()];
        for (truth, share) in truth.iter_mut().zip(TRIED) {
            *truth = exact(share)?;
        }
        let all = |said: &dyn Fn([f64; 3]) -> [f64; 4], tolerance: f64| {
            TRIED.iter().zip(&truth).all(|(share, truth)| far(&said(*share), truth) <= tolerance)
        };
        if first <= tolerance && all(&|share| self.cubic(&within(share)), tolerance) {
            return Some(Cell::Smooth);
        }
        let holds = |patch: &Patch, tolerance: f64| {
            all(&|share| patch.at(share.map(|x| x as f32)).map(f64::from), tolerance)
        };
        if !holds(&Patch::sketch(&exact)?, TORN_TOLERANCES * tolerance) {
            return None;
        }
        let patch = Patch::new(&exact)?;
        holds(&patch, tolerance).then(|| Cell::Patched(Box::new(patch)))
    }

    /// As [`Grid::cubic`], but from the patch where there is one; and whether that is right, which it is not where the
    /// function is torn.
    #[inline]
    pub(crate) fn fine(&self, p: &Vector3<f64>) -> ([f64; 4], bool) {
        let ([i, j, k], rest) = self.cell(p, 1);
        let [nx, ny, _] = self.shape.counts;
        let detail = self.details.get((k * ny + j) * nx + i).copied().unwrap_or(SPLINE);
        match self.patches.get(usize::from(detail)) {
            Some(patch) => (patch.at(rest).map(f64::from), true),
            None => (self.cubic(p), detail != TORN),
        }
    }

    /// A grid of one number.
    pub(crate) fn linear(shape: Shape, numbers: &[f64]) -> Self {
        let values = (0..shape.len())
            .map(|k| [0.0, 0.0, 0.0, numbers.get(k).copied().unwrap_or(0.0) as f32])
            .collect::<Vec<_>>();
        Self { shape, values, spline: Vec::new(), details: Vec::new(), patches: Vec::new() }
    }

    /// Node to the lower side along each axis, and how far beyond it, in steps.
    fn cell(&self, p: &Vector3<f64>, edge: usize) -> ([usize; 3], [f32; 3]) {
        let mut node = [0; 3];
        let mut rest = [0.0; 3];
        for axis in 0..3 {
            let last = self.shape.counts[axis] - 1;
            let x = (p[axis] - self.shape.low_m[axis]) / self.shape.step_m;
            // Not a number ends at the low side, where it does no harm.
            let x = x.max(edge as f64).min((last - edge) as f64);
            node[axis] = (x as usize).min(last - edge - 1);
            rest[axis] = (x - node[axis] as f64) as f32;
        }
        (node, rest)
    }

    /// How far outside the grid, m.
    pub(crate) fn beyond(&self, p: &Vector3<f64>) -> f64 {
        let mut square = 0.0;
        for axis in 0..3 {
            let low = self.shape.low_m[axis];
            let high = low + (self.shape.counts[axis] - 1) as f64 * self.shape.step_m;
            let out = (low - p[axis]).max(p[axis] - high).max(0.0);
            square += out * out;
        }
        square.sqrt()
    }

    /// Linear between the eight nodes around.
    pub(crate) fn trilinear(&self, p: &Vector3<f64>) -> [f64; 4] {
        let ([i, j, k], [x, y, z]) = self.cell(p, 0);
        let [nx, ny, _] = self.shape.counts;
        let mut sum = [0.0_f32; 4];
        for (dk, wz) in [(0, 1.0 - z), (1, z)] {
            for (dj, wy) in [(0, 1.0 - y), (1, y)] {
                let start = ((k + dk) * ny + j + dj) * nx + i;
                for (value, wx) in self.values[start..start + 2].iter().zip([1.0 - x, x]) {
                    let w = wx * wy * wz;
                    for c in 0..4 {
                        sum[c] += w * value[c];
                    }
                }
            }
        }
        sum.map(f64::from)
    }

    /// Twice continuously differentiable, through the nodes.
    #[inline]
    pub(crate) fn cubic(&self, p: &Vector3<f64>) -> [f64; 4] {
        let ([i, j, k], rest) = self.cell(p, 1);
        let [nx, ny, _] = self.shape.counts;
        let [wx, wy, wz] = rest.map(weights);
        let mut sum = [0.0_f32; 4];
        for (dk, wz) in wz.iter().enumerate() {
            for (dj, wy) in wy.iter().enumerate() {
                let w = wy * wz;
                let start = ((k + dk - 1) * ny + j + dj - 1) * nx + i - 1;
                let row = &self.spline[start..start + 4];
                let mut line = [0.0_f32; 4];
                for (value, wx) in row.iter().zip(&wx) {
                    for c in 0..4 {
                        line[c] += wx * value[c];
                    }
                }
                for c in 0..4 {
                    sum[c] += w * line[c];
                }
            }
        }
        sum.map(f64::from)
    }
}

/// Distance of the first three numbers.
fn far(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    Vector3::from_fn(|k, _| a[k] - b[k]).norm()
}

/// Weights of the uniform cubic B-spline.
fn weights(t: f32) -> [f32; 4] {
    let s = 1.0 - t;
    let sixth = 1.0 / 6.0;
    [
        sixth * s * s * s,
        sixth * (4.0 - 6.0 * t * t + 3.0 * t * t * t),
        sixth * (4.0 - 6.0 * s * s + 3.0 * s * s * s),
        sixth * t * t * t,
    ]
}

/// Coefficients whose spline runs through the values: along each axis the tridiagonal system
/// `(c[i-1] + 4 c[i] + c[i+1]) / 6 = v[i]`, with free ends.
fn coefficients(shape: &Shape, values: &[[f32; 4]]) -> Vec<[f32; 4]> {
    let mut data: Vec<[f64; 4]> = values.iter().map(|value| value.map(f64::from)).collect();
    let [nx, ny, nz] = shape.counts;
    for (count, stride) in [(nx, 1), (ny, nx), (nz, nx * ny)] {
        let starts = (0..data.len()).filter(|index| index / stride % count == 0);
        let mut upper = vec![0.0; count];
        // Ends: second difference zero, so that c[0] = v[0].
        for k in 1..count - 1 {
            upper[k] = 1.0 / (4.0 - upper[k - 1]);
        }
        for start in starts {
            for k in 1..count - 1 {
                let before = data[start + (k - 1) * stride];
                let here = &mut data[start + k * stride];
                for (here, before) in here.iter_mut().zip(before) {
                    *here = (6.0 * *here - before) * upper[k];
                }
            }
            for k in (1..count - 1).rev() {
                let after = data[start + (k + 1) * stride];
                for (here, after) in data[start + k * stride].iter_mut().zip(after) {
                    *here -= upper[k] * after;
                }
            }
        }
    }
    data.into_iter().map(|value| value.map(|x| x as f32)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Grid {
        let shape = Shape::around(&[Vector3::new(0.3, -1.0, 0.2), Vector3::new(2.4, 1.0, 1.4)], 0.1, 0.08);
        Grid::new(shape, |p| [0.05 * libm::sin(2.0 * p.x) * p.y, p.z * p.z * 0.1, 0.3 * p.x - p.y, 1.0])
    }

    #[test]
    fn the_spline_runs_through_the_nodes_and_near_the_function_between_them() {
        let grid = grid();
        for index in (0..grid.shape.len()).step_by(97) {
            let (p, values) = (grid.shape.position_m(index), grid.values[index].map(f64::from));
            // The outermost ring is only there to be leant on.
            if grid.cell(&p, 1).1.iter().all(|rest| (0.0..=1.0).contains(rest)) && inner(&grid, &p) {
                for (a, b) in grid.cubic(&p).iter().zip(values) {
                    assert!((a - b).abs() < 1e-6, "{p} {a} {b}");
                }
            }
        }
        for k in 0..50 {
            let p = Vector3::new(
                0.5 + 0.03 * f64::from(k),
                -0.7 + 0.02 * f64::from(k),
                0.4 + 0.01 * f64::from(k),
            );
            let expected = [0.05 * libm::sin(2.0 * p.x) * p.y, p.z * p.z * 0.1, 0.3 * p.x - p.y, 1.0];
            for (a, b) in grid.cubic(&p).iter().zip(expected) {
                assert!((a - b).abs() < 1e-5, "{p} {a} {b}");
            }
            assert!((grid.trilinear(&p)[2] - expected[2]).abs() < 1e-5);
        }
    }

    fn inner(grid: &Grid, p: &Vector3<f64>) -> bool {
        (0..3).all(|axis| {
            let x = (p[axis] - grid.shape.low_m[axis]) / grid.shape.step_m;
            x > 1.5 && x < grid.shape.counts[axis] as f64 - 2.5
        })
    }

    #[test]
    fn outside_and_not_a_number_are_answered_by_the_edge() {
        let grid = grid();
        assert!(grid.cubic(&Vector3::repeat(50.0)).iter().all(|x| x.is_finite()));
        assert!(grid.cubic(&Vector3::repeat(f64::NAN)).iter().all(|x| x.is_finite()));
        assert!(grid.beyond(&Vector3::new(12.5, 0.0, 0.5)) > 9.9);
        assert_eq!(grid.beyond(&Vector3::new(1.0, 0.0, 0.5)), 0.0);
    }
}
