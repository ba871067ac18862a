//! A pole in the air with known truth.

use nalgebra::Vector3;
use posed_field::{PoleReading, PoleRun};

/// Middle and direction at a time, s.
pub(super) fn truth(t: f64) -> (Vector3<f64>, Vector3<f64>) {
    let middle =
        Vector3::new(1.2 + 0.3 * libm::sin(0.9 * t), 0.4 * libm::cos(0.7 * t), 0.6 + 0.2 * libm::sin(t));
    let direction = Vector3::new(libm::cos(1.1 * t), libm::sin(1.1 * t), libm::sin(0.8 * t)).normalize();
    (middle, direction)
}

/// Four sensors 0.3 m apart at 30 Hz, with noise that is the same everywhere.
pub(super) fn run(seconds: f64, sigma_m: f64) -> PoleRun {
    // As good as noise, and the same everywhere.
    let mut count = 0.0_f64;
    let mut noise = || {
        count += 1.0;
        sigma_m * 3.464 * ((libm::sin(count) * 43_758.545_3).rem_euclid(1.0) - 0.5)
    };
    let names = ["a", "b", "c", "d"].map(String::from).to_vec();
    let rows: Vec<_> = (0..(30.0 * seconds) as u32)
        .flat_map(|frame| (0..4).map(move |sensor| (frame, sensor)))
        .map(|(frame, sensor)| {
            let t = f64::from(frame) / 30.0;
            let (middle, direction) = truth(t);
            let p = middle + direction * (0.3 * (sensor as f64 - 1.5));
            let p = p + Vector3::new(noise(), noise(), noise());
            (t, sensor, PoleReading { position_m: p, orientation: None })
        })
        .collect();
    PoleRun::new(names, 0.3, rows).unwrap()
}
