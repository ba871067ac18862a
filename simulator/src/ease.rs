//! From 0 to 1 as movements begin and end: at rest.

/// Minimum jerk (Flash & Hogan 1985): two continuous derivatives. 0 below 0, 1 above 1.
pub(crate) fn minimum_jerk(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x.powi(3) * (10.0 - 15.0 * x + 6.0 * x * x)
}

/// The same with four continuous derivatives.
pub(crate) fn step(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x.powi(5) * (126.0 - 420.0 * x + 540.0 * x * x - 315.0 * x.powi(3) + 70.0 * x.powi(4))
}
