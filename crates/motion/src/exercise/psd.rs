//! The period of a recording of repetitions.
//!
//! What comes in: frames of channels. What goes out: how well each channel repeats itself, and periods worth trying,
//! the likeliest first. What it never does: decide; the teacher tries them.
//!
//! Welch's combined power spectral density (Weber et al. 2011, section III), with two changes: every channel is
//! scaled to its own variance and weighted by how much of its power stands in its peak, so that streams of different
//! units may be mixed and still channels do not vote; and half and double of a peak are tried too rather than ruled
//! on beforehand.

use std::f64::consts::{PI, TAU};

/// Longest Welch segment, s.
const SEGMENT_S: f64 = 40.96;
/// Highest frequency of repetitions, Hz.
const HIGHEST_HZ: f64 = 2.0;
/// Lowest, Hz.
const LOWEST_HZ: f64 = 0.05;
/// Two candidates nearer than this ratio are one.
const SAME: f64 = 1.15;

/// Periods in frames worth trying, the likeliest first, at most `most`.
///
/// `frames` has `width` values per frame, NaN where there is none. `shortest` and `longest` bound the period, frames.
pub(super) fn periods(
    frames: &[f64],
    width: usize,
    rate_hz: f64,
    [shortest, longest]: [f64; 2],
    most: usize,
) -> Vec<f64> {
    let low = LOWEST_HZ.max(rate_hz / longest) / 1.05;
    let high = HIGHEST_HZ.min(rate_hz / shortest) * 1.05;
    if high <= low {
        return Vec::new();
    }
    // Steps of 2 % resolve any peak that a segment of this length can have.
    let count = (libm::log(high / low) / libm::log(1.02_f64)).ceil() as usize + 2;
    let grid: Vec<f64> = (0..count).map(|i| low * 1.02_f64.powi(i as i32 - 1)).collect();
    let combined = combined_psd(frames, width, rate_hz, &grid);
    // Power is in peaks whose width is constant in Hz: on the logarithmic grid slow peaks look wider, not higher.
    let mut peaks: Vec<(f64, f64)> = (1..count - 1)
        .filter(|i| combined[*i] > combined[i - 1] && combined[*i] >= combined[i + 1])
        .map(|i| (combined[i], grid[i] * libm::pow(1.02_f64, parabola(&combined[i - 1..=i + 1]))))
        .collect();
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
    peaks.truncate(3);
    let mut found: Vec<f64> = Vec::new();
    for factor in [1.0, 2.0, 0.5] {
        for (_, frequency_hz) in &peaks {
            let period = factor * rate_hz / frequency_hz;
            let new = found.iter().all(|known| period / known > SAME || known / period > SAME);
            if new && (shortest / 1.05..=longest * 1.05).contains(&period) {
                found.push(period);
            }
        }
    }
    found.truncate(most);
    found
}

/// Sum over the channels of the power at each frequency of `grid`.
fn combined_psd(frames: &[f64], width: usize, rate_hz: f64, grid: &[f64]) -> Vec<f64> {
    let length = frames.len() / width.max(1);
    let segment = length.min((SEGMENT_S * rate_hz) as usize);
    let mut combined = vec![0.0; grid.len()];
    if segment < 4 {
        return combined;
    }
    for channel in 0..width {
        let mut power = vec![0.0; grid.len()];
        let mut variance = 0.0;
        let mut start = 0;
        while start + segment <= length {
            let mut piece: Vec<f64> =
                (start..start + segment).map(|frame| frames[frame * width + channel]).collect();
            detrend(&mut piece);
            variance += piece.iter().map(|value| value * value).sum::<f64>() / segment as f64;
            for (index, value) in piece.iter_mut().enumerate() {
                *value *= 0.5 - 0.5 * libm::cos(TAU * index as f64 / segment as f64);
            }
            for (power, frequency_hz) in power.iter_mut().zip(grid) {
                *power += goertzel(&piece, frequency_hz / rate_hz);
            }
            start += (segment / 2).max(1);
        }
        if variance > 0.0 {
            // The share of the variance in the peak, squared: once to scale, once as weight.
            let peak = power.iter().copied().fold(0.0, f64::max) / variance;
            for (combined, power) in combined.iter_mut().zip(&power) {
                *combined += power / variance * peak;
            }
        }
    }
    combined
}

/// Takes the best straight line out; missing values become 0.
fn detrend(values: &mut [f64]) {
    let (mut n, mut sx, mut sy, mut sxx, mut sxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (x, y) in values.iter().enumerate().filter(|(_, y)| y.is_finite()) {
        let x = x as f64;
        n += 1.0;
        sx += x;
        sy += y;
        sxx += x * x;
        sxy += x * y;
    }
    let determinant = n * sxx - sx * sx;
    let slope = if determinant > 0.0 { (n * sxy - sx * sy) / determinant } else { 0.0 };
    let offset = if n > 0.0 { (sy - slope * sx) / n } else { 0.0 };
    for (x, y) in values.iter_mut().enumerate() {
        *y = if y.is_finite() { *y - offset - slope * x as f64 } else { 0.0 };
    }
}

/// Squared magnitude of the Fourier component at `frequency` cycles per sample.
fn goertzel(values: &[f64], frequency: f64) -> f64 {
    let coefficient = 2.0 * libm::cos(2.0 * PI * frequency);
    let (mut before, mut last) = (0.0, 0.0);
    for value in values {
        (before, last) = (last, value + coefficient * last - before);
    }
    (last * last + before * before - coefficient * last * before) / (values.len() * values.len()) as f64
}

/// Place of the peak of the parabola through three values, from -0.5 to 0.5 about the middle one.
fn parabola(values: &[f64]) -> f64 {
    let curvature = values[0] - 2.0 * values[1] + values[2];
    if curvature < 0.0 { (0.5 * (values[0] - values[2]) / curvature).clamp(-0.5, 0.5) } else { 0.0 }
}

/// How well each channel repeats itself after `period` frames: the highest correlation of the channel with itself a
/// period later (within 15 %), from 0 to 1, over the frames `range`. A still channel gets 0.
pub(super) fn repeatability(
    frames: &[f64],
    width: usize,
    period: f64,
    range: std::ops::Range<usize>,
) -> Vec<f64> {
    (0..width)
        .map(|channel| {
            let value = |frame: usize| frames[frame * width + channel];
            let lags = (0.85 * period) as usize..=(1.15 * period).ceil() as usize;
            lags.map(|lag| correlation(&value, &range, lag)).fold(0.0, f64::max)
        })
        .collect()
}

fn correlation(value: &impl Fn(usize) -> f64, range: &std::ops::Range<usize>, lag: usize) -> f64 {
    let (mut n, mut sx, mut sy, mut sxx, mut syy, mut sxy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for frame in range.start..range.end.saturating_sub(lag) {
        let (x, y) = (value(frame), value(frame + lag));
        if x.is_finite() && y.is_finite() {
            n += 1.0;
            sx += x;
            sy += y;
            sxx += x * x;
            syy += y * y;
            sxy += x * y;
        }
    }
    let (vx, vy) = (n * sxx - sx * sx, n * syy - sy * sy);
    let floor = 1e-9 * n * (sxx + syy);
    if vx > floor && vy > floor && vx * vy > 0.0 { (n * sxy - sx * sy) / (vx * vy).sqrt() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::super::viterbi::tests::Random;
    use super::*;

    /// Channel 0: a sine of the period with a strong second harmonic; channel 1: still but for a small noise.
    fn sine(period: f64, frames: usize, harmonic: f64) -> Vec<f64> {
        let mut random = Random::new(3);
        (0..frames)
            .flat_map(|frame| {
                let phase = TAU * frame as f64 / period;
                [libm::sin(phase) + harmonic * libm::sin(2.0 * phase), 1e-3 * random.unit()]
            })
            .collect()
    }

    #[test]
    fn given_a_sine_its_period_comes_first() {
        for period in [20.0, 53.0, 111.0] {
            let found = periods(&sine(period, 900, 0.0), 2, 25.0, [10.0, 200.0], 4);
            assert!((found[0] / period - 1.0).abs() < 0.02, "{period}: {found:?}");
        }
    }

    #[test]
    fn given_a_stronger_second_harmonic_the_true_period_is_among_them() {
        let found = periods(&sine(80.0, 900, 1.5), 2, 25.0, [10.0, 200.0], 6);
        assert!(found.iter().any(|period| (period / 80.0 - 1.0).abs() < 0.03), "{found:?}");
    }

    #[test]
    fn given_bounds_they_are_kept() {
        for period in periods(&sine(80.0, 900, 0.5), 2, 25.0, [10.0, 60.0], 6) {
            assert!((9.5..=63.0).contains(&period), "{period}");
        }
        assert!(periods(&[], 2, 25.0, [10.0, 60.0], 6).is_empty());
    }

    #[test]
    fn a_channel_that_repeats_is_distinguished_from_one_that_does_not() {
        let repeat = repeatability(&sine(50.0, 500, 0.3), 2, 50.0, 0..500);
        assert!(repeat[0] > 0.99 && repeat[1] < 0.5, "{repeat:?}");
    }
}
