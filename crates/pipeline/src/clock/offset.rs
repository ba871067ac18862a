//! A fixed offset between two devices, from motion that both have felt.
//!
//! What comes in: angular speeds of two sensors on one rigid body, each on its own times. What goes out: by how much
//! the second one's motion appears later. Speed does not depend on how a sensor is mounted, so nothing need be aligned.

/// Grid on which both are compared, s.
const GRID_S: f64 = 0.005;
/// Both are averaged over so many steps of the grid on either side: noise goes, and nothing is shifted.
const SMOOTHED: usize = 4;
/// Greatest offset that is looked for, s.
const REACH_S: f64 = 0.5;
/// Least common time, s.
const LEAST_S: f64 = 4.0;
/// A gap in either that is longer than this is left out, s.
const GAP_S: f64 = 0.1;

/// What correlating two motions has shown: an estimate. Without a high correlation and some motion it means nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Offset {
    /// By how much the second device's motion appears later than the first one's, s, within +-0.5; negative where it is earlier.
    /// Within a millisecond in simulated motion of 20 s (test of this module).
    pub later_s: f64,
    /// Correlation of the two speeds at that offset, -1 to 1.
    pub correlation: f64,
    /// Standard deviation of the speed over the common time, rad/s, the smaller of the two: with little motion there is little to
    /// compare.
    pub motion_rad_s: f64,
}

/// The offset between two angular speeds (pairs of time, s, and speed, rad/s; times rise, both on one clock). `None` with less
/// than 4 s of common time, with less than 3 s in which neither has a gap above 0.1 s, or without motion. Not causal: it takes
/// whole recordings.
///
/// The normalised cross-correlation of the speeds less their means, maximised over +-0.5 s; a parabola through the highest
/// value and its neighbours gives the fraction of a step.
pub fn offset(first: &[(f64, f64)], second: &[(f64, f64)]) -> Option<Offset> {
    let start_s = first.first()?.0.max(second.first()?.0);
    let end_s = first.last()?.0.min(second.last()?.0);
    let steps = ((end_s - start_s) / GRID_S).floor();
    if steps.is_nan() || steps * GRID_S < LEAST_S {
        return None;
    }
    let a = resample(first, start_s, steps as usize);
    let b = resample(second, start_s, steps as usize);
    let reach = (REACH_S / GRID_S) as i64;
    let at = |lag: i64| correlation(&a, &b, lag);
    let (best, peak) = (-reach..=reach)
        .filter_map(|lag| Some((lag, at(lag)?)))
        .max_by(|(_, (one, _)), (_, (other, _))| one.total_cmp(other))?;
    let (before, after) = (at(best - 1)?.0, at(best + 1)?.0);
    let bend = before - 2.0 * peak.0 + after;
    // At the edge of the reach there is no top.
    let fraction = if bend < 0.0 && best.abs() < reach { 0.5 * (before - after) / bend } else { 0.0 };
    Some(Offset { later_s: (best as f64 + fraction) * GRID_S, correlation: peak.0, motion_rad_s: peak.1 })
}

/// Values on the grid, smoothed; not a number where a gap is.
fn resample(values: &[(f64, f64)], start_s: f64, steps: usize) -> Vec<f64> {
    let mut at = 0;
    let raw: Vec<f64> = (0..steps)
        .map(|step| {
            let t_s = start_s + step as f64 * GRID_S;
            while at + 2 < values.len() && values[at + 1].0 <= t_s {
                at += 1;
            }
            let ((t0, v0), (t1, v1)) = (values[at], values[(at + 1).min(values.len() - 1)]);
            if t1 <= t0 || t1 - t0 > GAP_S { f64::NAN } else { v0 + (v1 - v0) * (t_s - t0) / (t1 - t0) }
        })
        .collect();
    let mean = |step: usize| {
        let window = raw.get(step.checked_sub(SMOOTHED)?..=step + SMOOTHED)?;
        Some(window.iter().sum::<f64>() / window.len() as f64)
    };
    (0..steps).map(|step| mean(step).unwrap_or(f64::NAN)).collect()
}

/// Correlation of `a` with `b` taken `lag` steps later, and the smaller of the two spreads; gaps left out.
fn correlation(a: &[f64], b: &[f64], lag: i64) -> Option<(f64, f64)> {
    let pairs = || {
        a.iter().enumerate().filter_map(|(step, x)| {
            let y = b.get(usize::try_from(step as i64 + lag).ok()?)?;
            (x.is_finite() && y.is_finite()).then_some((*x, *y))
        })
    };
    let (n, x, y) = pairs().fold((0.0, 0.0, 0.0), |(n, sx, sy), (x, y)| (n + 1.0, sx + x, sy + y));
    if n * GRID_S < LEAST_S - 2.0 * REACH_S {
        return None;
    }
    let (mx, my) = (x / n, y / n);
    let (xx, yy, xy) = pairs().fold((0.0, 0.0, 0.0), |(xx, yy, xy), (x, y)| {
        (xx + (x - mx) * (x - mx), yy + (y - my) * (y - my), xy + (x - mx) * (y - my))
    });
    let spread = (xx.min(yy) / n).sqrt();
    (xx > 0.0 && yy > 0.0).then(|| (xy / (xx * yy).sqrt(), spread))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A speed of some frequencies, sampled at a rate with a phase, and noise.
    fn speed(rate_hz: f64, phase_s: f64, shift_s: f64, noise: f64, seconds: f64) -> Vec<(f64, f64)> {
        let mut random = 1u64;
        (0..(rate_hz * seconds) as u32)
            .map(|k| {
                let t = phase_s + f64::from(k) / rate_hz;
                let moved = t - shift_s;
                random =
                    random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let uniform = (random >> 11) as f64 / (1u64 << 53) as f64 - 0.5;
                let wave = libm::sin(2.9 * moved) + 0.7 * libm::sin(7.3 * moved) * libm::cos(0.5 * moved);
                (t, 2.0 + wave.abs() + noise * uniform)
            })
            .collect()
    }

    #[test]
    fn an_offset_is_found_to_a_millisecond() {
        for shift_s in [0.037, -0.0213, 0.0, 0.31] {
            let first = speed(103.3, 0.0, 0.0, 0.4, 20.0);
            let second = speed(60.0, 0.004, shift_s, 0.2, 20.0);
            let found = offset(&first, &second).unwrap();
            assert!((found.later_s - shift_s).abs() < 1e-3, "{shift_s}: {found:?}");
            assert!(found.correlation > 0.9 && found.motion_rad_s > 0.2, "{found:?}");
        }
    }

    #[test]
    fn without_common_time_or_motion_there_is_none() {
        let moving = speed(100.0, 0.0, 0.0, 0.0, 20.0);
        let still: Vec<(f64, f64)> = moving.iter().map(|(t, _)| (*t, 0.0)).collect();
        assert_eq!(offset(&moving, &still), None);
        assert_eq!(offset(&moving, &moving[..100]), None);
        assert_eq!(offset(&[], &moving), None);
        let later: Vec<(f64, f64)> = moving.iter().map(|(t, v)| (t + 30.0, *v)).collect();
        assert_eq!(offset(&moving, &later), None);
    }
}
