//! The law of the hinge statistic in noise, and from it the threshold for a rate of false alarms.
//!
//! For white noise each of the statistic's `m` channels is the square of a Student variable with `dof` degrees of
//! freedom. Its peaks: a frame on, the fitted hinge has decorrelated by `b`, so that near a high value the
//! statistic is a random walk, and the rate of peaks above `x = r^2` is `b r g(r) v(r sqrt(2 b))` a frame,
//! with `g` the density of `r` and `v(y) = exp(-0.583 y)` for the steps between frames (Siegmund, "Sequential
//! Analysis", 1985). Nothing here allocates after construction; nothing runs per frame.

/// Grid of radii on which densities are tabulated.
const STEP: f64 = 0.05;
const LARGEST: f64 = 30.0;
/// Intervals of the quadrature over the angle.
const ANGLES: usize = 64;

/// Density of the root of a sum of squares of independent Student variables, on a grid.
struct RadialDensity {
    /// Density over `r^(channels - 1)`, which is smooth at zero; its logarithm.
    log: Vec<f64>,
    channels: i32,
}

impl RadialDensity {
    /// One channel: the absolute value of a Student variable.
    fn student(dof: f64) -> Self {
        let log_unscaled = |t: f64| -0.5 * (dof + 1.0) * libm::log1p(t * t / dof);
        let scale = libm::log(2.0 * gamma_ratio(0.5 * dof) / (dof * std::f64::consts::PI).sqrt());
        let values = (0..=(LARGEST / STEP) as usize).map(|k| log_unscaled(k as f64 * STEP) + scale);
        Self { log: values.collect(), channels: 1 }
    }

    fn at(&self, r: f64) -> f64 {
        self.reduced(r) * r.powi(self.channels - 1)
    }

    fn reduced(&self, r: f64) -> f64 {
        let place = (r / STEP).min((self.log.len() - 2) as f64 + 0.999_999);
        let k = place as usize;
        let share = place - k as f64;
        libm::exp(self.log[k] * (1.0 - share) + self.log[k + 1] * share)
    }

    /// The density with the channels of both.
    fn with(&self, other: &Self) -> Self {
        let (p, q) = (self.channels, other.channels);
        let value = |k: usize| {
            let r = k as f64 * STEP;
            let integral = quarter_turn(|angle| {
                let (sin, cos) = libm::sincos(angle);
                self.reduced(r * cos) * other.reduced(r * sin) * cos.powi(p - 1) * sin.powi(q - 1)
            });
            libm::log(integral)
        };
        Self { log: (0..self.log.len()).map(value).collect(), channels: p + q }
    }
}

/// `Gamma(x + 1/2) / Gamma(x)`, by the series for large `x`.
fn gamma_ratio(x: f64) -> f64 {
    if x < 20.0 {
        return gamma_ratio(x + 1.0) * x / (x + 0.5);
    }
    let y = 1.0 / x;
    x.sqrt() * (1.0 - y / 8.0 + y * y / 128.0 + 5.0 * y.powi(3) / 1024.0 - 21.0 * y.powi(4) / 32768.0)
}

/// Integral from 0 to a right angle by Simpson's rule.
fn quarter_turn(value: impl Fn(f64) -> f64) -> f64 {
    let step = std::f64::consts::FRAC_PI_2 / ANGLES as f64;
    let weight = |k| match k {
        0 | ANGLES => 1.0,
        k if k % 2 == 1 => 4.0,
        _ => 2.0,
    };
    (0..=ANGLES).map(|k| weight(k) * value(k as f64 * step)).sum::<f64>() * step / 3.0
}

/// Threshold of the statistic that peaks pass at `rate` a frame.
///
/// `channels` is 3 or 6, `dof` the degrees of freedom of each channel's variance, `decorrelation` one minus the
/// correlation of a channel's hinge with that of the next frame.
pub(super) fn threshold(channels: usize, dof: f64, decorrelation: f64, rate: f64) -> f64 {
    let one = RadialDensity::student(dof);
    let two = one.with(&one);
    let three = two.with(&one);
    let density = if channels > 3 { three.with(&three) } else { three };
    let rate_above = |r: f64| {
        let overshoot = libm::exp(-0.583 * r * (2.0 * decorrelation).sqrt());
        decorrelation * r * density.at(r) * overshoot
    };
    // The law of peaks is one of high values: search down from the far end.
    let mut r = LARGEST;
    while r > 1.0 && rate_above(r) < rate {
        r -= 0.1 * STEP;
    }
    r * r
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_degrees_of_freedom_give_chi_square() {
        let one = RadialDensity::student(1e6);
        let three = one.with(&one).with(&one);
        let six = three.with(&three);
        for r in [0.5f64, 1.0, 2.5, 4.0, 6.0] {
            let chi = r.powi(5) * libm::exp(-0.5 * r * r) / 8.0;
            assert!((six.at(r) / chi - 1.0).abs() < 5e-3, "{r}: {} {chi}", six.at(r));
        }
    }

    #[test]
    fn one_student_variable_squared_is_f_and_two_agree_with_the_closed_tail() {
        // Student with 3 degrees of freedom: 2 / (pi sqrt 3 (1 + t^2 / 3)^2), here of the absolute value.
        let one = RadialDensity::student(3.0);
        for t in [0.0f64, 1.0, 5.0, 20.0] {
            let exact = 4.0 / (std::f64::consts::PI * 3f64.sqrt() * (1.0 + t * t / 3.0).powi(2));
            assert!((one.at(t) / exact - 1.0).abs() < 1e-3, "{t}");
        }
        // The whole of a density is one.
        let two = one.with(&one);
        let whole: f64 = (0..600).map(|k| two.at((f64::from(k) + 0.5) * STEP) * STEP).sum();
        assert!((whole - 1.0).abs() < 2e-3, "{whole}");
    }

    #[test]
    fn the_sheets_share_of_frames_above_25_is_found() {
        // A sum of six F(1, 2N - 3) passes 25 in 0.40 % of frames at N = 10 and 0.08 % at N = 30.
        for (n, share) in [(10.0, 0.0040), (30.0, 0.0008)] {
            let one = RadialDensity::student(2.0 * n - 3.0);
            let three = one.with(&one).with(&one);
            let six = three.with(&three);
            let tail: f64 = (0..500).map(|k| six.at(5.0 + (f64::from(k) + 0.5) * STEP) * STEP).sum();
            assert!((tail / share - 1.0).abs() < 0.1, "N = {n}: {tail}");
        }
    }
}
