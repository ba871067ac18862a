//! How noisy the readings are, from the readings alone.
//!
//! A rigid pole moves smoothly and the distortion is smooth, so that third differences over time of what deviates
//! from a straight pole hold nothing but noise. Bins over the range tell the part that grows with `r^4` from the floor.

use nalgebra::Vector3;

use super::noise::FieldNoise;
use super::pole::{PoleRun, median};
use super::problem::line;

/// Readings per bin.
const BIN: usize = 200;
/// Sum of the squares of the weights 1, -3, 3, -1.
const THIRD_DIFFERENCE: f64 = 20.0;
/// Median of a chi-square with two degrees of freedom.
const MEDIAN_CHI2_2: f64 = 1.386_294;
/// Least floor: a device's words have a step, m.
const LEAST_FLOOR_M: f64 = 1e-4;

/// Estimates the noise of a recording of the pole from the recording alone: signal part and floor.
///
/// Only frames count in which every sensor was measured, four of them in a row. Without any the answer is no signal
/// part and the least floor, 1e-4 m. Outliers are tolerated by medians over bins of 200 readings; take them out first
/// all the same.
pub fn noise(run: &PoleRun) -> FieldNoise {
    let count = run.sensors.len();
    // Deviations from the pole of the last four frames, per sensor.
    let mut past: Vec<Vec<(Vector3<f64>, Vector3<f64>)>> = vec![Vec::new(); count];
    let mut squares: Vec<(f64, f64)> = Vec::new();
    for frame in &run.frames {
        let known: Vec<(usize, Vector3<f64>)> = frame
            .readings
            .iter()
            .enumerate()
            .filter_map(|(k, reading)| reading.map(|reading| (k, reading.position_m)))
            .collect();
        if known.len() < count {
            past.iter_mut().for_each(Vec::clear);
            continue;
        }
        let points: Vec<_> = known.iter().map(|(_, p)| *p).collect();
        let offsets: Vec<_> = known.iter().map(|(k, _)| run.offset_m(*k)).collect();
        let (middle, along) = line(&points, &offsets);
        for (k, p) in &known {
            let history = &mut past[*k];
            history.push((*p, p - middle - along * run.offset_m(*k)));
            if history.len() == 4 {
                let difference = history[0].1 - 3.0 * history[1].1 + 3.0 * history[2].1 - history[3].1;
                let r = p.norm();
                let u = p / r;
                let across = difference - u * u.dot(&difference);
                squares.push((r, across.norm_squared()));
                history.remove(0);
            }
        }
    }
    // The pose of the pole, five of 3 n numbers, hides part of the noise.
    let seen = 1.0 - 5.0 / (3.0 * count as f64);
    let scale = 1.0 / (MEDIAN_CHI2_2 * THIRD_DIFFERENCE * seen);
    squares.sort_by(|a, b| a.0.total_cmp(&b.0));
    let bins: Vec<(f64, f64)> = squares
        .chunks(BIN.min(squares.len().max(1)))
        .filter(|bin| bin.len() * 2 >= BIN.min(squares.len()))
        .filter_map(|bin| {
            let r = bin[bin.len() / 2].0;
            let mut values: Vec<f64> = bin.iter().map(|(_, square)| *square).collect();
            median(&mut values).map(|square| (r, square * scale))
        })
        .collect();
    fit_bins(&bins)
}

/// Least squares of `s^2 k^2 r^8 + f^2` to the variances, relative errors alike, both parts not negative.
fn fit_bins(bins: &[(f64, f64)]) -> FieldNoise {
    let unit = FieldNoise { sigma_signal: 1.0, floor_m: 0.0 };
    let solve = |use_signal: bool, use_floor: bool| {
        let (mut aa, mut ab, mut bb, mut ay, mut by) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (r, variance) in bins {
            let across = unit.disc_m(*r).1;
            let a = if use_signal { across * across / variance } else { 0.0 };
            let b = if use_floor { 1.0 / variance } else { 0.0 };
            aa += a * a;
            ab += a * b;
            bb += b * b;
            ay += a;
            by += b;
        }
        match (use_signal, use_floor) {
            (true, true) => {
                let determinant = aa * bb - ab * ab;
                ((ay * bb - by * ab) / determinant, (by * aa - ay * ab) / determinant)
            }
            (true, false) => (ay / aa, 0.0),
            _ => (0.0, by / bb),
        }
    };
    let (mut signal, mut floor) = solve(true, true);
    if floor.is_nan() || floor < 0.0 {
        (signal, floor) = solve(true, false);
    }
    if signal.is_nan() || signal < 0.0 {
        (signal, floor) = solve(false, true);
    }
    let root = |x: f64| if x.is_finite() { x.max(0.0).sqrt() } else { 0.0 };
    FieldNoise { sigma_signal: root(signal), floor_m: root(floor).max(LEAST_FLOOR_M) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_of_an_exact_law_give_it_back() {
        let truth = FieldNoise { sigma_signal: 2e-4, floor_m: 3e-4 };
        let bins: Vec<_> = (5..25)
            .map(|k| {
                let r = 0.1 * f64::from(k);
                (r, truth.disc_m(r).1.powi(2) + truth.floor_m.powi(2))
            })
            .collect();
        let found = fit_bins(&bins);
        assert!((found.sigma_signal - 2e-4).abs() < 1e-9 && (found.floor_m - 3e-4).abs() < 1e-9, "{found:?}");
        let flat: Vec<_> = bins.iter().map(|(r, _)| (*r, 1e-6)).collect();
        let found = fit_bins(&flat);
        assert!(found.sigma_signal < 1e-12 && (found.floor_m - 1e-3).abs() < 1e-9, "{found:?}");
    }
}
