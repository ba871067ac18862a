//! Pairs on a grid: where a pole is waved, the middle of a room is sampled a hundred times as densely as its corners.
//!
//! "We can generate a 3D grid inside the convex hull of the sensor measurements and use the filtered data to interpolate calibrated values
//! for those points" (section 5): linearly, by least squares over the readings near each node.

use std::collections::BTreeMap;

use nalgebra::{Matrix4, Matrix4x3, Vector3, Vector4};
use posed_field::Hull;

/// Readings within so many spacings of a node speak for it, and no fewer than so many.
const REACH: f64 = 1.5;
const LEAST: usize = 8;

/// From pairs of measured and filtered positions (transmitter frame, m) to those at the nodes of a grid of `spacing_m` within the hull of
/// the measured ones that have at least eight readings around them. Pairs in the order of their nodes, x first.
pub(super) fn on_grid(
    pairs: &[(Vector3<f64>, Vector3<f64>)],
    spacing_m: f64,
) -> Vec<(Vector3<f64>, Vector3<f64>)> {
    let Some(hull) = Hull::new(pairs.iter().map(|(z, _)| z)) else { return Vec::new() };
    let cell = |z: &Vector3<f64>| [0, 1, 2].map(|axis| (z[axis] / spacing_m).round() as i64);
    let mut cells: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
    for (index, (z, _)) in pairs.iter().enumerate() {
        cells.entry(cell(z)).or_default().push(index);
    }
    let near = |[x, y, z]: [i64; 3]| {
        let around = (-2..=2_i64).flat_map(move |i| {
            (-2..=2_i64).flat_map(move |j| (-2..=2_i64).map(move |k| [x + i, y + j, z + k]))
        });
        around.filter_map(|at| cells.get(&at)).flatten().map(|index| &pairs[*index])
    };
    let node = |[x, y, z]: [i64; 3]| Vector3::new(x as f64, y as f64, z as f64) * spacing_m;
    let within = cells.keys().copied().filter(|at| hull.outside_m(&node(*at)) <= 0.0);
    within.filter_map(|at| Some((node(at), interpolate(node(at), near(at), REACH * spacing_m)?))).collect()
}

/// The filtered position at `node`: a linear fit of the corrections around it, the near ones first.
fn interpolate<'a>(
    node: Vector3<f64>,
    near: impl Iterator<Item = &'a (Vector3<f64>, Vector3<f64>)>,
    reach_m: f64,
) -> Option<Vector3<f64>> {
    let (mut normal, mut right, mut count) = (Matrix4::zeros(), Matrix4x3::zeros(), 0);
    for (z, p) in near {
        let way = (z - node) / reach_m;
        let distance = way.norm();
        if distance >= 1.0 {
            continue;
        }
        // The weights of a local regression.
        let weight = (1.0 - distance.powi(3)).powi(3);
        let terms = Vector4::new(1.0, way.x, way.y, way.z);
        normal += terms * terms.transpose() * weight;
        right += terms * (p - z).transpose() * weight;
        count += 1;
    }
    if count < LEAST {
        return None;
    }
    // Readings of one plane show no slope across it.
    let ridge = Matrix4::from_diagonal(&Vector4::new(0.0, 1.0, 1.0, 1.0)) * (1e-6 * normal[(0, 0)]);
    let fitted = (normal + ridge).cholesky()?.solve(&right);
    Some(node + fitted.row(0).transpose())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_distortion_is_interpolated_as_it_is() {
        let correct = |z: &Vector3<f64>| z * 1.02 + Vector3::new(0.01, -0.02 * z.x, 0.0);
        let pairs: Vec<_> = (0..4000)
            .map(|k| {
                let k = f64::from(k);
                // Dense in one corner.
                let axis = |f: f64| libm::pow((k * f).rem_euclid(1.0), 2.0);
                let z = Vector3::new(axis(0.618_03), axis(0.414_21), axis(0.732_05));
                (z, correct(&z))
            })
            .collect();
        let grid = on_grid(&pairs, 0.2);
        assert!(grid.len() > 50 && grid.len() < 6 * 6 * 6, "{}", grid.len());
        for (z, p) in &grid {
            assert!((p - correct(z)).norm() < 1e-4, "{z} {p}");
        }
        assert!(on_grid(&[], 0.1).is_empty());
    }
}
