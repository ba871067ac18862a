//! A figure's own axes: where a sensor is on the body rather than in the room.
//!
//! What comes in: a frame of positions. What goes out: the same from the figure's middle, turned about the vertical
//! until it faces as the training's figure does, and scaled to its size. A figure that flips through the transmitter
//! stands on its head in its own axes too. What it never does: rely on one sensor; those that do not fit count less.

use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::frames::Frames;
use super::memory::Point;
use posed_fusion::faults::{Class, Label};

/// Fewer sensors than this have no axes of their own.
const FEWEST: usize = 4;
/// Rounds in which sensors that do not fit lose weight, and rounds in which the axes are learnt.
const ROUNDS: usize = 3;
const LEARNING_ROUNDS: usize = 4;
/// No sensor is steadier than this, m: else one would outweigh all others.
const FLOOR_M: f64 = 0.05;

/// The axes of a set of sensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub(super) struct Body {
    /// Usual place of each sensor, m.
    #[serde(rename = "place_m")]
    position_m: Vec<Point>,
    /// Its usual distance from there, m.
    spread_m: Vec<f64>,
}

impl Body {
    /// Learns from frames and the labels of their sensors; `None` for few sensors.
    pub(super) fn learn(frames: &Frames, labels: &[Label]) -> Option<Self> {
        let sensors = frames.sensors.len();
        let clean = |k: usize, sensor: usize| labels[k * sensors + sensor].class == Class::Clean;
        let first = (0..frames.len()).find(|k| (0..sensors).all(|sensor| clean(*k, sensor)))?;
        if sensors < FEWEST {
            return None;
        }
        let position_m = frames.positions(first).chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
        let mut body = Self { position_m, spread_m: vec![1.0; sensors] };
        let (mut known, mut turned) = (vec![f64::NAN; 3 * sensors], vec![f64::NAN; 3 * sensors]);
        for _ in 0..LEARNING_ROUNDS {
            let mut sums = vec![[0.0; 5]; sensors];
            for k in 0..frames.len() {
                known.copy_from_slice(frames.positions(k));
                (0..sensors)
                    .filter(|sensor| !clean(k, *sensor))
                    .for_each(|s| known[3 * s..3 * s + 3].fill(f64::NAN));
                body.align(&known, 1.0, &mut turned);
                for (sum, p) in sums.iter_mut().zip(turned.chunks_exact(3)) {
                    if !p[0].is_nan() {
                        (0..3).for_each(|c| sum[c] += p[c]);
                        sum[3] += p.iter().map(|value| value * value).sum::<f64>();
                        sum[4] += 1.0;
                    }
                }
            }
            for (sensor, sum) in sums.iter().enumerate().filter(|(_, sum)| sum[4] > 0.0) {
                let mean: Point = std::array::from_fn(|c| sum[c] / sum[4]);
                let square = sum[3] / sum[4] - mean.iter().map(|value| value * value).sum::<f64>();
                body.position_m[sensor] = mean;
                body.spread_m[sensor] = square.max(0.0).sqrt().max(FLOOR_M);
            }
        }
        Some(body)
    }

    pub(super) fn fits(&self, sensors: usize) -> bool {
        self.position_m.len() == sensors && self.spread_m.len() == sensors
    }

    /// Turns a frame into the figure's axes; `size` is that of this body over that of the training's.
    pub(super) fn align(&self, frame: &[f64], size: f64, out: &mut [f64]) {
        let mut middle = [0.0; 3];
        let mut home = [0.0; 3];
        let (mut sin, mut cos) = (0.0, 1.0);
        for round in 0..ROUNDS {
            let (mut a, mut b, mut total) = ([0.0; 3], [0.0; 3], 0.0);
            let (mut cross, mut dot) = (0.0, 0.0);
            for pass in 0..2 {
                let sensors = self.position_m.iter().zip(&self.spread_m).zip(frame.chunks_exact(3));
                for ((position, spread), p) in sensors.filter(|(_, p)| !p[0].is_nan()) {
                    let mut weight = 1.0 / (spread * spread);
                    if round > 0 {
                        let (x, y) = ((p[0] - middle[0]) / size, (p[1] - middle[1]) / size);
                        let (dx, dy) = (
                            cos * x + sin * y + home[0] - position[0],
                            cos * y - sin * x + home[1] - position[1],
                        );
                        weight /= 1.0 + (dx * dx + dy * dy) / (4.0 * spread * spread);
                    }
                    if pass == 0 {
                        total += weight;
                        (0..3).for_each(|c| a[c] += weight * p[c]);
                        (0..3).for_each(|c| b[c] += weight * position[c]);
                    } else {
                        let (px, py) = (p[0] - a[0], p[1] - a[1]);
                        let (qx, qy) = (position[0] - b[0], position[1] - b[1]);
                        cross += weight * (qx * py - qy * px);
                        dot += weight * (qx * px + qy * py);
                    }
                }
                if pass == 0 {
                    if total <= 0.0 {
                        out.fill(f64::NAN);
                        return;
                    }
                    a = a.map(|value| value / total);
                    b = b.map(|value| value / total);
                }
            }
            let norm = libm::hypot(cross, dot);
            (sin, cos) = if norm > 0.0 { (cross / norm, dot / norm) } else { (0.0, 1.0) };
            (middle, home) = (a, b);
        }
        for (p, out) in frame.chunks_exact(3).zip(out.chunks_exact_mut(3)) {
            let d: Point = std::array::from_fn(|c| (p[c] - middle[c]) / size);
            let turned = [cos * d[0] + sin * d[1], cos * d[1] - sin * d[0], d[2]];
            out.copy_from_slice(&std::array::from_fn::<f64, 3, _>(|c| turned[c] + home[c]));
        }
    }
}
