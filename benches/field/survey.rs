//! What an operator records in a scene: the pole, and anchors on which a sensor stood.

use nalgebra::Vector3;
use posed_field::{Anchor, PoleFrame, PoleReading, PoleRun};

use super::scenes::{Run, SENSORS, Scene};

/// The recording as the solver gets it, with the spacing that the operator states.
pub(crate) fn pole(run: &Run, spacing_m: f64) -> PoleRun {
    let rows = run.frames.iter().zip(&run.t_s).flat_map(|(frame, t_s)| {
        frame.iter().enumerate().map(move |(sensor, sample)| {
            (*t_s, sensor, PoleReading { position_m: sample.z, orientation: Some(sample.q) })
        })
    });
    PoleRun::new((0..SENSORS).map(|k| format!("bird-{}", k + 1)).collect(), spacing_m, rows).expect("a pole")
}

/// Three surveyed points: a sensor stands still for half a second at three places far from each other.
pub(crate) fn anchors(scene: &Scene, run: &Run, pole: &mut PoleRun, seed: u64) -> Vec<Anchor> {
    let points = [Vector3::new(1.1, -0.6, 0.5), Vector3::new(1.8, 0.5, 0.5), Vector3::new(1.2, 0.4, 1.2)];
    let mut t_s = run.t_s.last().copied().unwrap_or(0.0) + 1.0;
    let mut anchors = Vec::new();
    for (index, point) in points.into_iter().enumerate() {
        let start = t_s;
        for reading in scene.dwell(&point, 15, seed * 10 + index as u64) {
            let mut readings = vec![None; SENSORS];
            readings[0] = Some(PoleReading { position_m: reading, orientation: None });
            pole.frames.push(PoleFrame { t_s, readings });
            t_s += 1.0 / 30.0;
        }
        anchors.push(Anchor {
            name: format!("point {index}"),
            sensor: 0,
            t_s: [start, t_s],
            position_m: point,
        });
        t_s += 1.0;
    }
    anchors
}
