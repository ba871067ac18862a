//! Holds what was published against the truth.

use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};
use posed_simulator::truth::{Class, TruthCycle};
use posed_stage::output::{Estimate, SensorState};

use posed_rig::Rig;

/// One step of a position word of a 36 inch range, m; words are cut, not rounded, to 14 bits.
const POSITION_STEP_M: f64 = 36.0 * 0.0254 / 8192.0;
/// The same for what the steps of four quaternion words turn, rad.
const ROTATION_STEP_RAD: f64 = 5e-4;

/// What was published in a span of time.
#[derive(Debug, Default)]
pub(super) struct Judgement {
    pub(super) frames: usize,
    /// Frames in which a sensor was not `ok`.
    pub(super) broken: usize,
    /// Sensor values published as `ok` or `repaired`.
    pub(super) good: usize,
    /// Of these, records and filtered poses beyond 5 sigma, and either beyond 20 mm or 5 degrees.
    pub(super) wrong_measured: usize,
    pub(super) wrong_pose: usize,
    pub(super) wrong_coarse: usize,
    /// Largest error over its sigma.
    pub(super) worst_sigmas: f64,
    pub(super) worst_mm: f64,
    /// The first wrong ones, in words.
    pub(super) examples: Vec<String>,
}

impl Judgement {
    pub(super) fn wrong(&self) -> usize {
        self.wrong_measured + self.wrong_pose
    }
}

/// Errors of a pose over what the scene's noise is there: (sigmas, m, rad).
fn error(pose: &Isometry3<f64>, truth: &Isometry3<f64>, noise: f64) -> (f64, f64, f64) {
    let r = truth.translation.vector.norm();
    // Across the ray sqrt(5)/3 r^4 s in two directions, along it r^4 s / sqrt(54). The signals' principal
    // values are 2, -1, -1: rotation about the ray sqrt(1/2) r^3 s, about either axis across it sqrt(2) r^3 s.
    let sigma_m = noise * r.powi(4) * (10.0 / 9.0 + 1.0f64 / 54.0).sqrt();
    let sigma_rad = noise * r.powi(3) * 4.5f64.sqrt();
    let off_m = (pose.translation.vector - truth.translation.vector).norm();
    let off_rad = pose.rotation.angle_to(&truth.rotation);
    let sigmas_m = (off_m - 3f64.sqrt() * POSITION_STEP_M).max(0.0) / sigma_m;
    let sigmas_rad = (off_rad - ROTATION_STEP_RAD).max(0.0) / sigma_rad;
    (sigmas_m.max(sigmas_rad), off_m, off_rad)
}

pub(super) fn isometry(position_m: [f64; 3], [w, x, y, z]: [f64; 4]) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    Isometry3::from_parts(Vector3::from(position_m).into(), rotation)
}

/// Cycles of one device in the order of their times.
pub(super) fn cycles(rig: &Rig, device: usize) -> Vec<&TruthCycle> {
    rig.host.truth.iter().filter(|cycle| cycle.device == device).collect()
}

/// The cycle nearest in time.
pub(super) fn nearest<'a>(cycles: &[&'a TruthCycle], t_s: f64) -> &'a TruthCycle {
    let at = cycles.partition_point(|cycle| cycle.t.as_secs_f64() < t_s);
    let distance = |cycle: &&&TruthCycle| (cycle.t.as_secs_f64() - t_s).abs();
    let near = cycles[at.saturating_sub(1)..(at + 1).min(cycles.len())].iter();
    near.min_by(|a, b| distance(a).total_cmp(&distance(b))).expect("cycles")
}

/// Judges what was published of a device's sensors from `from_s` to `until_s`.
///
/// Truth is that of the cycle nearest to the published time: a wrong number of a cycle is a wrong pose.
pub(super) fn judge(rig: &Rig, device: usize, from_s: f64, until_s: f64, noise: f64) -> Judgement {
    let cycles = cycles(rig, device);
    let mut out = Judgement::default();
    for estimate in within(rig, from_s, until_s) {
        let t_s = estimate.t_valid.as_secs_f64();
        let truth = nearest(&cycles, t_s);
        out.frames += 1;
        let state = |row: &posed_simulator::truth::TruthRow| estimate.sensors[row.sensor].state;
        out.broken += usize::from(truth.sensors.iter().any(|row| state(row) != SensorState::Ok));
        for (place, row) in truth.sensors.iter().enumerate() {
            let sensor = &estimate.sensors[row.sensor];
            if !matches!(sensor.state, SensorState::Ok | SensorState::Repaired) {
                continue;
            }
            out.good += 1;
            let words = |what: &str, (sigmas, off_m, off_rad): (f64, f64, f64)| {
                let mm = off_m * 1e3;
                format!(
                    "{t_s:.4} s, sensor {}, {what} ({:?}, {:?}): {sigmas:.1} sigma, {mm:.2} mm, {:.2} deg",
                    row.sensor,
                    sensor.state,
                    row.class,
                    off_rad.to_degrees()
                )
            };
            let mut note = |what: &str, off: (f64, f64, f64)| {
                out.worst_sigmas = out.worst_sigmas.max(off.0);
                out.worst_mm = out.worst_mm.max(off.1 * 1e3);
                out.wrong_coarse += usize::from(off.1 > 0.02 || off.2 > 5f64.to_radians());
                let wrong = off.0.is_nan() || off.0 > 5.0;
                if wrong && out.examples.len() < 8 {
                    out.examples.push(words(what, off));
                }
                usize::from(wrong)
            };
            // What was not repaired must be right as it came.
            if sensor.state == SensorState::Ok
                && let Some(measured) = &sensor.measured
                && let (Some(p), Some(q)) = (measured.position_m, measured.orientation_wxyz)
            {
                let truth = nearest(&cycles, measured.t_valid.as_secs_f64()).sensors[place].pose;
                out.wrong_measured += note("measured", error(&isometry(p, q), &truth, noise));
            }
            let pose = sensor.pose.expect("what is good has a pose");
            let pose = isometry(pose.position_m.unwrap(), pose.orientation_wxyz);
            out.wrong_pose += note("pose", error(&pose, &row.pose, noise));
        }
    }
    out
}

/// Frames with a time in a span.
pub(super) fn within(rig: &Rig, from_s: f64, until_s: f64) -> impl Iterator<Item = &Estimate> {
    rig.estimates().filter(move |estimate| (from_s..until_s).contains(&estimate.t_valid.as_secs_f64()))
}

/// Samples of a sensor that were measured since `from_s`, less those published as `ok`.
///
/// What `status` has to say under `lost`, from the truth's side.
pub(super) fn lost(rig: &Rig, device: usize, sensor: usize, from_s: f64) -> u64 {
    let cycles = cycles(rig, device);
    let last_s = rig.estimates().last().expect("a frame").t_valid.as_secs_f64();
    let half_s = 0.5 * cycles[1].t.seconds_since(cycles[0].t);
    let after = |t_s: f64| t_s > from_s && t_s < last_s + half_s;
    let measured = cycles.iter().filter(|cycle| after(cycle.t.as_secs_f64())).count();
    let ok = |e: &&Estimate| after(nearest(&cycles, e.t_valid.as_secs_f64()).t.as_secs_f64());
    let ok = rig
        .estimates()
        .filter(ok)
        .filter(|estimate| estimate.sensors[sensor].state == SensorState::Ok)
        .count();
    measured as u64 - ok as u64
}

/// The count of each sensor and when it was taken: between two cycles after all that came.
pub(super) fn counted(rig: &Rig, device: usize) -> (f64, Vec<u64>) {
    let cycles = cycles(rig, device);
    let half_s = 0.5 * cycles[1].t.seconds_since(cycles[0].t);
    let last_s = rig.estimates().last().map_or(0.0, |estimate| estimate.t_valid.as_secs_f64());
    let lost = rig.pipeline.status().sensors.iter().map(|sensor| sensor.lost).collect();
    (nearest(&cycles, last_s).t.as_secs_f64() + half_s, lost)
}

/// Whether any sensor of the device is of this class in the cycle nearest to a time.
pub(super) fn class_at(cycles: &[&TruthCycle], t_s: f64, sensor: usize) -> Class {
    let cycle = nearest(cycles, t_s);
    cycle.sensors.iter().find(|row| row.sensor == sensor).map_or(Class::Clean, |row| row.class)
}
