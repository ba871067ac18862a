//! Readings of the pole that are not measurements: stuck words, spikes, jumps at re-entry, places never seen.
//!
//! What comes in: a recording. What goes out: the recording without them, and which they were and why. A sensor out of
//! range repeats its last words; one wild spike would inflate the hull, so that the hull comes last.

use nalgebra::Vector3;
use posed_geometry::repetition::{Evidence, Repeats, Repetition};
use serde::Serialize;

use super::hull::Hull;
use super::noise::FieldNoise;
use super::pole::{PoleRun, median};
use super::problem::line;

/// A sensor that repeats its words while the others have moved so far is stuck, m.
const STUCK_MOTION_M: f64 = 0.01;
/// Deviations from the pole, against their neighbours in time, that are spikes: in standard deviations, and at least m.
const SPIKE_SIGMAS: f64 = 6.0;
const SPIKE_M: f64 = 0.004;
/// Neighbours in time on each side.
const NEIGHBOURS: usize = 3;
/// How far outside the hull of all readings a sensor must stand to be out of range, m.
const HULL_MARGIN_M: f64 = 0.01;
/// Least number of sensors in a frame.
pub(crate) const LEAST_SENSORS: usize = 4;

/// Why a reading is not believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// The same words again while the pole moved.
    Stuck,
    /// Off the pole, and off its own neighbours in time.
    Spike,
    /// As a spike, beside a gap or a stuck run.
    Jump,
    /// The pole says that the sensor is where no reading has ever been.
    Hull,
}

impl Reason {
    /// The word in files: `stuck`, `spike`, `jump` or `hull`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Stuck => "stuck",
            Self::Spike => "spike",
            Self::Jump => "jump",
            Self::Hull => "hull",
        }
    }
}

/// One reading that was taken out of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Rejected {
    /// Time of its frame, s.
    pub t_s: f64,
    /// Index of the sensor along the pole, from 0.
    pub sensor: usize,
    /// Why.
    pub reason: Reason,
}

/// Takes outliers out of a recording and returns them, in order of time and sensor.
///
/// Frames that are left with fewer than 4 sensors (or than the pole has) are emptied too, without an entry in the
/// answer. `noise`: of the readings, to tell a spike. It is not causal: a reading is judged by those before and after
/// it.
pub fn reject(run: &mut PoleRun, noise: &FieldNoise) -> Vec<Rejected> {
    let mut rejected = Vec::new();
    stuck(run, &mut rejected);
    spikes(run, noise, &mut rejected);
    hull(run, &mut rejected);
    // A frame of three sensors cannot say which of them is wrong.
    let least = LEAST_SENSORS.min(run.sensors.len());
    for frame in &mut run.frames {
        if frame.readings.iter().flatten().count() < least {
            frame.readings.iter_mut().for_each(|reading| *reading = None);
        }
    }
    rejected.sort_by(|a, b| a.t_s.total_cmp(&b.t_s).then(a.sensor.cmp(&b.sensor)));
    rejected
}

fn position(run: &PoleRun, frame: usize, sensor: usize) -> Option<Vector3<f64>> {
    run.frames[frame].readings[sensor].map(|reading| reading.position_m)
}

fn drop_reading(
    run: &mut PoleRun,
    frame: usize,
    sensor: usize,
    reason: Reason,
    rejected: &mut Vec<Rejected>,
) {
    run.frames[frame].readings[sensor] = None;
    rejected.push(Rejected { t_s: run.frames[frame].t_s, sensor, reason });
}

/// Words that stand still while the pole moves, but for the first of each run, which was measured.
fn stuck(run: &mut PoleRun, rejected: &mut Vec<Rejected>) {
    for sensor in 0..run.sensors.len() {
        let mut repetition = Repetition::default();
        let (mut first, mut repeated, mut dropped) = (0, Vec::new(), Vec::new());
        for frame in 0..run.frames.len() {
            let Some(position_m) = position(run, frame, sensor) else { continue };
            let moved = others_moved(run, first, frame, sensor) > STUCK_MOTION_M;
            let evidence = if moved { Evidence::Certain } else { Evidence::None };
            let repeats = repetition.take(<[f64; 3]>::from(position_m), evidence);
            if repeats == Repeats::Changed {
                repeated.clear();
                first = frame;
            } else {
                repeated.push(frame);
            }
            // By hindsight all of a run is known to be stuck, from its first repetition on.
            if repeats == Repeats::Stuck {
                dropped.append(&mut repeated);
            }
        }
        for frame in dropped {
            drop_reading(run, frame, sensor, Reason::Stuck, rejected);
        }
    }
}

/// How far the sensors that moved most went between two frames, m: stuck neighbours do not hide a motion.
fn others_moved(run: &PoleRun, from: usize, to: usize, sensor: usize) -> f64 {
    (0..run.sensors.len())
        .filter(|other| *other != sensor)
        .filter_map(|other| Some((position(run, to, other)? - position(run, from, other)?).norm()))
        .fold(0.0, f64::max)
}

/// Deviations of each sensor from the pole that the others make, against the median of its neighbours in time.
fn spikes(run: &mut PoleRun, noise: &FieldNoise, rejected: &mut Vec<Rejected>) {
    let deviations: Vec<Vec<Option<Vector3<f64>>>> =
        (0..run.frames.len()).map(|k| deviations(run, k)).collect();
    let mut wrong = Vec::new();
    for sensor in 0..run.sensors.len() {
        for (frame, each) in deviations.iter().enumerate() {
            let Some(deviation) = each[sensor] else { continue };
            let Some(p) = position(run, frame, sensor) else { continue };
            let range = frame.saturating_sub(NEIGHBOURS)..(frame + NEIGHBOURS + 1).min(run.frames.len());
            let near: Vec<Vector3<f64>> =
                range.filter(|other| *other != frame).filter_map(|other| deviations[other][sensor]).collect();
            if near.len() < NEIGHBOURS {
                continue;
            }
            let usual = Vector3::from_fn(|axis, _| {
                let mut values: Vec<f64> = near.iter().map(|d| d[axis]).collect();
                median(&mut values).unwrap_or(0.0)
            });
            // The line through the others adds its own noise.
            let sigma = (2.0 * noise.mean_square_m2(&p)).sqrt();
            if (deviation - usual).norm() > (SPIKE_SIGMAS * sigma).max(SPIKE_M) {
                let gap = |other: Option<usize>| {
                    other.and_then(|other| run.frames.get(other)).is_none_or(|f| f.readings[sensor].is_none())
                };
                let beside = gap(frame.checked_sub(1)) || gap(Some(frame + 1));
                wrong.push((frame, sensor, if beside { Reason::Jump } else { Reason::Spike }));
            }
        }
    }
    for (frame, sensor, reason) in wrong {
        drop_reading(run, frame, sensor, reason, rejected);
    }
}

/// Where each sensor is, less where a robust line through its frame says that it is.
fn deviations(run: &PoleRun, frame: usize) -> Vec<Option<Vector3<f64>>> {
    let known: Vec<(usize, Vector3<f64>)> =
        (0..run.sensors.len()).filter_map(|k| position(run, frame, k).map(|p| (k, p))).collect();
    let mut result = vec![None; run.sensors.len()];
    if known.len() < LEAST_SENSORS {
        return result;
    }
    let fit_without = |out: Option<usize>| {
        let used: Vec<_> = known.iter().filter(|(k, _)| Some(*k) != out).collect();
        let points: Vec<_> = used.iter().map(|(_, p)| *p).collect();
        let offsets: Vec<_> = used.iter().map(|(k, _)| run.offset_m(*k)).collect();
        let (middle, along) = line(&points, &offsets);
        let worst =
            used.iter().map(|(k, p)| (p - middle - along * run.offset_m(*k)).norm()).fold(0.0, f64::max);
        (worst, middle, along)
    };
    // One bad sensor bends the line through all: leave out the one without which the rest fits best, if it
    // makes a clear difference.
    let (all, mut middle, mut along) = fit_without(None);
    if known.len() > LEAST_SENSORS {
        let best = known.iter().map(|(k, _)| fit_without(Some(*k))).min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((worst, m, a)) = best
            && worst < 0.3 * all
        {
            (middle, along) = (m, a);
        }
    }
    for (k, p) in known {
        result[k] = Some(p - middle - along * run.offset_m(k));
    }
    result
}

/// Sensors that stand, by their pole, outside everything that was ever measured, and read something else.
fn hull(run: &mut PoleRun, rejected: &mut Vec<Rejected>) {
    let points: Vec<Vector3<f64>> = run.readings().map(|(_, _, reading)| reading.position_m).collect();
    let Some(hull) = Hull::new(points.iter()) else { return };
    for frame in 0..run.frames.len() {
        for (sensor, deviation) in deviations(run, frame).into_iter().enumerate() {
            let (Some(deviation), Some(p)) = (deviation, position(run, frame, sensor)) else { continue };
            // The distortion alone moves a sensor by centimetres; one that is out of range by more.
            if hull.outside_m(&(p - deviation)) > HULL_MARGIN_M && deviation.norm() > 0.05 {
                drop_reading(run, frame, sensor, Reason::Hull, rejected);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{PoleFrame, PoleReading};

    /// A pole of four sensors that goes `step_m` along x from frame to frame; the second repeats its words in frames 5 to 10.
    fn run(step_m: f64) -> PoleRun {
        let frame = |k: usize| PoleFrame {
            t_s: k as f64 * 0.01,
            readings: (0..4)
                .map(|sensor| {
                    let k = if sensor == 1 && (5..=10).contains(&k) { 5 } else { k };
                    let position_m = Vector3::new(k as f64 * step_m, sensor as f64 * 0.1, 0.3);
                    Some(PoleReading { position_m, orientation: None })
                })
                .collect(),
        };
        PoleRun {
            sensors: ["a", "b", "c", "d"].map(String::from).to_vec(),
            spacing_m: 0.1,
            frames: (0..20).map(frame).collect(),
        }
    }

    #[test]
    fn words_that_stand_still_while_the_pole_moves_are_rejected_and_the_first_is_kept() {
        let mut rejected = Vec::new();
        stuck(&mut run(0.01), &mut rejected);
        let frames: Vec<_> = rejected.iter().map(|r| ((r.t_s * 100.0).round() as usize, r.sensor)).collect();
        assert_eq!(frames, [(6, 1), (7, 1), (8, 1), (9, 1), (10, 1)]);
        rejected.clear();
        // At rest all repeat themselves.
        stuck(&mut run(0.0), &mut rejected);
        assert_eq!(rejected, []);
    }
}
