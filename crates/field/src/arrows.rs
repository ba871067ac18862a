//! A map as arrows, for a picture in three dimensions.
//!
//! What comes in: a map with its fast form. What goes out: places evenly spread over the calibrated volume, and where
//! the map puts them. It draws nothing.

use nalgebra::Vector3;

use super::prepared::Prepared;

/// Finest grid of arrows, m.
const FINEST_M: f64 = 0.15;

/// Pairs of a reading and its corrected position, on an even grid inside the calibrated hull, m.
///
/// The reading is in the transmitter frame, the corrected position in the frame of the anchors where the map has any.
/// About `most` pairs, fewer in a small hull: the grid is never finer than 0.15 m. The first call on a map makes its
/// fast form.
pub fn arrows(map: &Prepared, most: usize) -> Vec<[[f64; 3]; 2]> {
    let corrector = map.corrector();
    let hull = &map.map().hull;
    let [low, high] = hull.bounds_m();
    let size = high - low;
    // A convex body fills about half of its box.
    let step_m = libm::cbrt(0.5 * size.product() / most.max(1) as f64).max(FINEST_M);
    let counts = size.map(|length| (length / step_m) as usize + 1);
    let start = low + (size - (counts.map(|count| count as f64) - Vector3::repeat(1.0)) * step_m) / 2.0;
    let positions_m = (0..counts.x * counts.y * counts.z).map(|index| {
        let cell = [index % counts.x, index / counts.x % counts.y, index / (counts.x * counts.y)];
        start + Vector3::from(cell.map(|count| count as f64)) * step_m
    });
    positions_m
        .filter(|position_m| hull.outside_m(position_m) <= 0.0)
        .map(|position_m| [position_m.into(), corrector.position(&position_m).into()])
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FieldNoise, fit_known};

    #[test]
    fn arrows_fill_the_volume_and_point_where_the_map_goes() {
        let pairs: Vec<_> = (0..400)
            .map(|k| {
                let p = Vector3::new(f64::from(k % 7), f64::from(k % 11), f64::from(k % 13)) * 0.1;
                (p * 1.02, p)
            })
            .collect();
        let map = fit_known(&pairs, FieldNoise { sigma_signal: 0.0, floor_m: 1e-3 }).unwrap();
        let arrows = arrows(&Prepared::new(map), 100);
        assert!((40..200).contains(&arrows.len()), "{}", arrows.len());
        for [from, to] in arrows {
            let [from, to] = [from, to].map(Vector3::from);
            assert!((from / 1.02 - to).norm() < 2e-3, "{from} {to}");
        }
    }
}
