//! From joint positions to what the network sees.
//!
//! What comes in: positions of joints in the room, frame by frame at the model's rate, any of them missing. What goes
//! out: features, scaled with constants of the training set. What it never does: look ahead, or let where in the room
//! somebody stands and where he faces (unless asked to) change a feature.
//!
//! The body's own axes: origin in the centre (the mean of the joints that are there), x forward, y to the left, z up.
//! Left is where the left joints are, on a slow mean over all pairs, so that a twist or crossed arms do not turn it.

use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::joints;

/// Time constant of the facing direction, s.
const FACING_S: f64 = 0.3;
/// Time constant of the mean speeds, s.
const SPEEDS_S: f64 = 0.5;
/// Smallest scale of a feature, as a share of the root mean square scale of its kind: what hardly moves in the
/// training set is not blown up to the size of what does.
const FLOOR: f64 = 0.3;
/// Smallest span of a coordinate in the paper's image, as a share of the largest.
const LEAST_SPAN: f64 = 0.01;

/// A position in the room, z up, m; `None` where it is not known.
pub type Position = Option<[f64; 3]>;

/// How positions of joints become features; part of the model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[serde(deny_unknown_fields)]
pub struct Preparation {
    /// Names of the joints, in the order in which positions are given.
    pub joints: Vec<String>,
    /// Frames per second of the features, Hz.
    pub rate_hz: f64,
    /// Which features.
    pub features: Features,
    /// Indices of left and right joints of the same name.
    pub pairs: Vec<[usize; 2]>,
    /// Subtracted from each feature.
    pub offset: Vec<f32>,
    /// Multiplies each feature then.
    pub scale: Vec<f32>,
    /// Typical distance of a joint from the centre, m: shows files in other units.
    pub size_m: f64,
}

/// Which features the network sees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Plain)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub struct Features {
    /// Axes turned to where the body faces.
    pub facing: bool,
    /// Velocities beside the positions.
    pub velocities: bool,
    /// Mean speeds of the last half second: how much moves, whatever its rhythm.
    pub speeds: bool,
    /// Joint rows of the paper's image: the joints resized to so many rows; absent: one row per joint.
    pub rows: Option<usize>,
}

impl Features {
    /// What the default model sees.
    pub const BODY: Self = Self { facing: true, velocities: true, speeds: true, rows: None };
}

/// What is remembered from frame to frame; `Memory::default()` at the start of a stream.
#[derive(Clone, Debug, Default, PartialEq, Plain)]
pub struct Memory {
    /// Mean direction to the left, horizontal; zero before the first one.
    left: [f64; 2],
    /// Joints of the frame before, in the room.
    last: Vec<Position>,
    speeds: Vec<f32>,
    raw: Vec<f32>,
    features: Vec<f32>,
}

impl Preparation {
    /// Learns the constants from sequences, each given as frames of `joints.len()` positions at `rate_hz`.
    pub(super) fn learn<'a>(
        joints: Vec<String>,
        rate_hz: f64,
        features: Features,
        sequences: impl Iterator<Item = &'a [Position]>,
    ) -> Self {
        let pairs = joints::pairs(&joints);
        let mut preparation =
            Self { joints, rate_hz, features, pairs, offset: Vec::new(), scale: Vec::new(), size_m: 0.0 };
        let raw = preparation.raw_features();
        let (mut sum, mut squares, mut counts) = (vec![0.0; raw], vec![0.0; raw], vec![0.0_f64; raw]);
        let (mut low, mut high) = (vec![f64::INFINITY; raw], vec![f64::NEG_INFINITY; raw]);
        for sequence in sequences {
            let mut memory = Memory::default();
            for positions in sequence.chunks_exact(preparation.joints.len()) {
                preparation.measure(positions, &mut memory);
                for (index, value) in memory.raw.iter().enumerate() {
                    let value = f64::from(*value);
                    // A joint that is missing, or the first frame's velocity.
                    if !value.is_finite() {
                        continue;
                    }
                    counts[index] += 1.0;
                    sum[index] += value;
                    squares[index] += value * value;
                    low[index] = low[index].min(value);
                    high[index] = high[index].max(value);
                }
            }
        }
        let mean = |sums: &[f64], index: usize| sums[index] / counts[index].max(1.0);
        let positions = 3 * preparation.joints.len();
        let mean_square = (0..positions).map(|index| mean(&squares, index)).sum::<f64>();
        preparation.size_m = (mean_square / preparation.joints.len().max(1) as f64).sqrt();
        if features.velocities || features.facing {
            let deviation: Vec<f64> = (0..raw)
                .map(|index| (mean(&squares, index) - mean(&sum, index).powi(2)).max(0.0).sqrt())
                .collect();
            preparation.offset = (0..raw).map(|index| mean(&sum, index) as f32).collect();
            // Positions, velocities, speeds and the centre's each have a floor of their own.
            let mut rest = deviation.as_slice();
            for size in [positions, positions, 3, positions, 3] {
                let (part, others) = rest.split_at(size.min(rest.len()));
                rest = others;
                let square = part.iter().map(|d| d * d).sum::<f64>() / part.len().max(1) as f64;
                let floor = (FLOOR * square.sqrt()).max(1e-9);
                preparation.scale.extend(part.iter().map(|d| (1.0 / d.max(floor)) as f32));
            }
        } else {
            // The paper's image: each coordinate of each joint from 0 to 1. On one scale per axis for all joints, as
            // the paper may be read as well, a network hardly sees what moves little (`docs/segments.md`).
            let low = |index: usize| if counts[index] > 0.0 { low[index] } else { 0.0 };
            let span = |index: usize| (high[index] - low(index)).max(0.0);
            let floor = (LEAST_SPAN * (0..raw).map(span).fold(0.0, f64::max)).max(1e-9);
            preparation.offset = (0..raw).map(|index| low(index) as f32).collect();
            preparation.scale = (0..raw).map(|index| (1.0 / span(index).max(floor)) as f32).collect();
        }
        preparation
    }

    /// Features per frame, the length of what `push` returns.
    pub fn inputs(&self) -> usize {
        match self.features.rows {
            Some(rows) => rows * self.raw_features() / self.joints.len().max(1),
            None => self.raw_features(),
        }
    }

    /// Whether there is one finite offset and scale per feature.
    pub(super) fn numbers_fit(&self) -> bool {
        let fits = |numbers: &[f32]| {
            numbers.len() == self.raw_features() && numbers.iter().all(|number| number.is_finite())
        };
        fits(&self.offset) && fits(&self.scale)
    }

    fn raw_features(&self) -> usize {
        let positions = 3 * self.joints.len();
        let Features { velocities, speeds, .. } = self.features;
        positions + (positions + 3) * (usize::from(velocities) + usize::from(speeds))
    }

    /// Features of the next frame, given its positions in the order of `joints` (m, z up). Frames come at `rate_hz`.
    pub fn push<'a>(&self, positions: &[Position], memory: &'a mut Memory) -> &'a [f32] {
        self.measure(positions, memory);
        for ((value, offset), scale) in memory.raw.iter_mut().zip(&self.offset).zip(&self.scale) {
            // A missing value arrives as no number and leaves as the mean.
            *value = (*value - offset) * scale;
            if !value.is_finite() {
                *value = 0.0;
            }
        }
        let Memory { raw, features, .. } = memory;
        features.clear();
        match self.features.rows {
            None => features.extend_from_slice(raw),
            Some(rows) => resize(raw, self.joints.len(), rows, features),
        }
        features
    }

    /// Unscaled features of the next frame; not a number where a joint is missing.
    fn measure(&self, positions: &[Position], memory: &mut Memory) {
        let missing = [f64::NAN; 3];
        let (mut centre, mut known) = ([0.0; 3], 0.0_f64);
        for position in positions.iter().flatten() {
            centre.iter_mut().zip(position).for_each(|(sum, value)| *sum += value);
            known += 1.0;
        }
        let centre = (known > 0.0).then(|| centre.map(|sum| sum / known));
        self.follow_left(positions, memory);
        let left = memory.left;
        let facing = self.features.facing && left != [0.0; 2];
        let turned = |v: [f64; 3]| {
            if facing {
                // Forward is to the right of left.
                [v[0] * left[1] - v[1] * left[0], v[0] * left[0] + v[1] * left[1], v[2]]
            } else {
                v
            }
        };
        let less = |a: Position, b: Position| match (a, b) {
            (Some(a), Some(b)) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]],
            _ => missing,
        };
        memory.raw.clear();
        for position in positions {
            memory.raw.extend(turned(less(*position, centre)).map(|value| value as f32));
        }
        if self.features.velocities || self.features.speeds {
            let first = memory.raw.len();
            memory.last.resize(positions.len(), None);
            // Joint by joint, so that a joint that comes and goes moves no other.
            for (position, last) in positions.iter().zip(&memory.last) {
                let velocity = less(*position, *last).map(|value| value * self.rate_hz);
                memory.raw.extend(turned(velocity).map(|value| value as f32));
            }
            let (mut sum, mut both) = ([0.0; 3], 0.0);
            for (position, last) in positions.iter().zip(&memory.last) {
                if let (Some(position), Some(last)) = (position, last) {
                    (0..3).for_each(|axis| sum[axis] += position[axis] - last[axis]);
                    both += 1.0;
                }
            }
            let velocity = sum.map(|sum| if both > 0.0 { sum / both * self.rate_hz } else { f64::NAN });
            memory.raw.extend(turned(velocity).map(|value| value as f32));
            memory.last.copy_from_slice(positions);
            let keep = libm::exp(-1.0 / (SPEEDS_S * self.rate_hz)) as f32;
            memory.speeds.resize(memory.raw.len() - first, 0.0);
            for (mean, velocity) in memory.speeds.iter_mut().zip(&memory.raw[first..]) {
                if velocity.is_finite() {
                    *mean = keep * *mean + (1.0 - keep) * velocity.abs();
                }
            }
            if !self.features.velocities {
                memory.raw.truncate(first);
            }
            if self.features.speeds {
                memory.raw.extend_from_slice(&memory.speeds);
            }
        }
    }

    /// Follows the direction to the left.
    fn follow_left(&self, positions: &[Position], memory: &mut Memory) {
        let mut left = [0.0, 0.0];
        for [l, r] in &self.pairs {
            if let (Some(Some(l)), Some(Some(r))) = (positions.get(*l), positions.get(*r)) {
                left[0] += l[0] - r[0];
                left[1] += l[1] - r[1];
            }
        }
        let length = libm::hypot(left[0], left[1]);
        if length > 1e-6 {
            let keep =
                if memory.left == [0.0; 2] { 0.0 } else { libm::exp(-1.0 / (FACING_S * self.rate_hz)) };
            let mean: [f64; 2] =
                std::array::from_fn(|i| keep * memory.left[i] + (1.0 - keep) * left[i] / length);
            let length = libm::hypot(mean[0], mean[1]);
            if length > 1e-6 {
                memory.left = mean.map(|value| value / length);
            }
        }
    }
}

/// The joints that a row of an image of `rows` rows lies between, and its share of the second.
pub(super) fn neighbours(row: usize, rows: usize, joints: usize) -> ([usize; 2], f32) {
    let place = ((row as f32 + 0.5) * joints as f32 / rows as f32 - 0.5).clamp(0.0, joints as f32 - 1.0);
    let below = place as usize;
    ([below, (below + 1).min(joints - 1)], place - below as f32)
}

/// Stretches an image of `joints` rows to `rows`, linearly between the centres of the rows.
fn resize(raw: &[f32], joints: usize, rows: usize, out: &mut Vec<f32>) {
    let channels = raw.len() / joints.max(1);
    for row in 0..rows {
        let ([below, above], share) = neighbours(row, rows, joints);
        for channel in 0..channels {
            let (a, b) = (raw[below * channels + channel], raw[above * channels + channel]);
            out.push(a + share * (b - a));
        }
    }
}
