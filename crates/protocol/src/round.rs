//! Rounding to the stated resolution. The quotient of two exact doubles is the double nearest to the decimal, so its
//! shortest text has no more digits than the resolution asks for.

use posed_drivers::Timestamp;

/// Steps per metre of a position.
pub const POSITION: f64 = 1e5;
/// Steps per metre of a standard deviation.
pub const SIGMA: f64 = 1e6;
/// Steps per unit of a quaternion component.
pub const QUATERNION: f64 = 1e6;
/// Steps per unit of a velocity (m/s or rad/s).
pub const VELOCITY: f64 = 1e4;
/// Steps per degree of an angle.
pub const DEGREES: f64 = 1e3;
/// Steps per hertz of a rate.
pub(crate) const RATE: f64 = 1e3;
/// Steps per second of an age.
pub(crate) const AGE: f64 = 1e3;
/// Steps per second of a capture time's uncertainty.
pub(crate) const CLOCK: f64 = 1e6;

/// Steps per unit of a probability.
pub(crate) const PROBABILITY: f64 = 1e3;

/// `value` in whole steps of `1 / steps`.
pub fn steps(steps: f64, value: f64) -> f64 {
    (value * steps).round()
}

/// `value` to the nearest `1 / steps`; never a negative zero.
pub fn to(steps: f64, value: f64) -> f64 {
    self::steps(steps, value) / steps + 0.0
}

/// Steps per unit of the statistic of key poses, by what is a large value of it: by one method some tens without unit, by the other
/// centimetres a frame.
pub(crate) fn score(large: f64) -> f64 {
    if large < 1.0 { 1e6 } else { 1e3 }
}

/// Each component to the nearest `1 / steps`.
pub fn each<const N: usize>(steps: f64, values: [f64; N]) -> [f64; N] {
    values.map(|value| to(steps, value))
}

/// `value` to four significant digits; magnitudes below 1e-18 are zero.
pub(crate) fn significant(value: f64) -> f64 {
    let magnitude = value.abs();
    if magnitude.is_nan() || magnitude < 1e-18 {
        return 0.0;
    }
    let digits = 3 - libm::log10(magnitude).floor() as i32;
    if digits >= 0 {
        to(10f64.powi(digits.min(22)), value)
    } else {
        let steps = 10f64.powi(-digits);
        (value / steps).round() * steps
    }
}

/// To the nearest microsecond since the stage's epoch, as messages say times.
pub fn microseconds(t: Timestamp) -> i64 {
    (t.as_nanos().saturating_add(500)).div_euclid(1000)
}

/// Microseconds as seconds.
pub(crate) fn seconds(t_us: i64) -> f64 {
    t_us as f64 / 1e6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_as_short_as_the_resolution() {
        assert_eq!(to(POSITION, 0.123456789).to_string(), "0.12346");
        assert_eq!(to(POSITION, -1e-9).to_string(), "0");
        assert_eq!(to(QUATERNION, std::f64::consts::FRAC_1_SQRT_2).to_string(), "0.707107");
        assert_eq!(significant(1.23456789e-8).to_string(), "0.00000001235");
        assert_eq!(significant(-123456.0).to_string(), "-123500");
        assert_eq!(seconds(1_234_567).to_string(), "1.234567");
    }
}
