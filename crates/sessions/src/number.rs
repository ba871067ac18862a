//! Rounding of what is kept: the same numbers live, in a replay, in the store and in a report.

/// To a millionth of a second.
pub(crate) fn time_s(t_s: f64) -> f64 {
    to(1e6, t_s)
}

/// To a hundredth of a degree.
pub(crate) fn degrees(angle_deg: f64) -> f64 {
    to(100.0, angle_deg)
}

/// To a tenth of a point.
pub(crate) fn points(points: f64) -> f64 {
    to(10.0, points)
}

fn to(parts: f64, value: f64) -> f64 {
    (value * parts).round() / parts
}
