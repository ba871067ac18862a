//! Where the pole has been: a convex body around all readings.
//!
//! The true hull of many thousand noisy points has thousands of facets; this one is their bound in 128 evenly spread
//! directions, at most a percent of its size larger, and costs the same for any recording.

use std::sync::LazyLock;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Number of directions.
const DIRECTIONS: usize = 128;

/// Convex bound of a cloud of points in 128 fixed directions, transmitter frame. It is at most a percent of its size
/// larger than the convex hull.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hull {
    /// Mean of the points, m; always inside.
    pub center_m: [f64; 3],
    /// Farthest reach from the origin in each of the 128 directions (a Fibonacci lattice), m.
    pub reach_m: Vec<f64>,
}

/// The directions: a Fibonacci lattice on the sphere. Computed once: maps ask for them at every node.
pub(crate) fn directions() -> impl Iterator<Item = Vector3<f64>> {
    static LATTICE: LazyLock<[Vector3<f64>; DIRECTIONS]> = LazyLock::new(|| {
        let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
        std::array::from_fn(|k| {
            let z = 1.0 - (2.0 * k as f64 + 1.0) / DIRECTIONS as f64;
            let r = (1.0 - z * z).sqrt();
            let (sin, cos) = libm::sincos(golden * k as f64);
            Vector3::new(r * cos, r * sin, z)
        })
    });
    LATTICE.iter().copied()
}

impl Hull {
    /// Bounds points (transmitter frame, m); `None` without any.
    pub fn new<'a>(points: impl Iterator<Item = &'a Vector3<f64>> + Clone) -> Option<Self> {
        let count = points.clone().count();
        if count == 0 {
            return None;
        }
        let center = points.clone().sum::<Vector3<f64>>() / count as f64;
        let reach_m = directions()
            .map(|direction| points.clone().map(|p| p.dot(&direction)).fold(f64::NEG_INFINITY, f64::max))
            .collect();
        Some(Self { center_m: center.into(), reach_m })
    }

    /// How far outside `p` is, m; negative inside, zero on the bound. Beyond an edge or a corner it is less than the
    /// distance.
    pub fn outside_m(&self, p: &Vector3<f64>) -> f64 {
        directions().zip(&self.reach_m).map(|(d, reach)| p.dot(&d) - reach).fold(f64::NEG_INFINITY, f64::max)
    }

    /// The point of the hull on the straight way from `p` (m) to the middle; `p` itself inside.
    pub fn inward(&self, p: &Vector3<f64>) -> Vector3<f64> {
        let center = Vector3::from(self.center_m);
        let way = p - center;
        let mut share: f64 = 1.0;
        for (direction, reach) in directions().zip(&self.reach_m) {
            let far = way.dot(&direction);
            let room = reach - center.dot(&direction);
            if far > room && far > 0.0 {
                share = share.min((room / far).max(0.0));
            }
        }
        center + way * share
    }

    /// An axis-aligned box around it, m: lowest and highest corner. It is approximate, to a percent or so of its size.
    pub fn bounds_m(&self) -> [Vector3<f64>; 2] {
        let center = Vector3::from(self.center_m);
        let mut bounds = [center, center];
        for axis in 0..3 {
            for (end, sign) in [(0, -1.0), (1, 1.0)] {
                let mut probe = center;
                probe[axis] += sign * 100.0;
                bounds[end][axis] = self.inward(&probe)[axis];
            }
        }
        // Rays from the middle do not reach the corners: the reach in the nearest direction does.
        for (direction, reach) in directions().zip(&self.reach_m) {
            for axis in 0..3 {
                if direction[axis].abs() > 0.98 {
                    let end = usize::from(direction[axis] > 0.0);
                    let at = direction[axis].signum() * reach.abs().max(1e-9) * reach.signum();
                    bounds[end][axis] =
                        if end == 1 { bounds[end][axis].max(at) } else { bounds[end][axis].min(at) };
                }
            }
        }
        bounds
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hull_of_a_cube_holds_it_and_little_more() {
        let corners: Vec<Vector3<f64>> = (0..8)
            .map(|k| Vector3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2)))
            .collect();
        let hull = Hull::new(corners.iter()).unwrap();
        assert!(corners.iter().all(|c| hull.outside_m(c) < 1e-12));
        assert!(hull.outside_m(&Vector3::repeat(0.5)) < -0.4);
        assert!(hull.outside_m(&Vector3::new(1.2, 0.5, 0.5)) > 0.1);
        let inward = hull.inward(&Vector3::new(3.0, 0.5, 0.5));
        assert!((inward.x - 1.0).abs() < 0.12 && hull.outside_m(&inward) < 1e-9, "{inward}");
        let [low, high] = hull.bounds_m();
        assert!(low.amax() < 0.25 && (high - Vector3::repeat(1.0)).amax() < 0.25);
    }

    #[test]
    fn nothing_has_no_hull() {
        assert!(Hull::new([].iter()).is_none());
    }
}
