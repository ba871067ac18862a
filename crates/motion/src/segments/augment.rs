//! Changes of a sequence that keep its label, so that other actors and other sensors are named right too.
//!
//! What comes in: a cut of a sequence. What goes out: the cut turned, mirrored, stretched, scaled, with joints
//! missing. What it never does: touch the sequence itself.

use posed_state::Plain;
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use super::input::{Memory, Position, Preparation};
use super::sequence::Sequence;

/// Random changes of a crop that keep its label, and how large they are.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[serde(deny_unknown_fields)]
pub struct Augmentation {
    /// Rotation about the vertical by up to this either way, rad; it has no effect where axes are turned to the body
    /// anyway.
    pub yaw_rad: f64,
    /// Whether half of the cuts are mirrored.
    pub mirror: bool,
    /// Slower or faster by up to this share, 0 to 1.
    pub stretch: f64,
    /// Larger or smaller by up to this share, 0 to 1.
    pub scale: f64,
    /// Probability that a joint is missing in a crop, 0 to 1.
    pub drop_joint: f64,
    /// Standard deviation of a constant displacement per joint and axis, as a share of the body's size.
    pub displace: f64,
}

impl Augmentation {
    /// No change.
    pub const OFF: Self =
        Self { yaw_rad: 0.0, mirror: false, stretch: 0.0, scale: 0.0, drop_joint: 0.0, displace: 0.0 };

    /// Seconds of the recording per second of the cut.
    pub(super) fn stretch(&self, rng: &mut impl Rng) -> f64 {
        if self.stretch > 0.0 { 1.0 + rng.random_range(-self.stretch..self.stretch) } else { 1.0 }
    }

    /// Changes a cut; `mirrored` states which class each class becomes in a mirror.
    pub(super) fn change(
        &self,
        crop: &mut Crop,
        preparation: &Preparation,
        mirrored: &[u16],
        rng: &mut impl Rng,
    ) {
        let yaw = if self.yaw_rad > 0.0 { rng.random_range(-self.yaw_rad..self.yaw_rad) } else { 0.0 };
        let scale = if self.scale > 0.0 { 1.0 + rng.random_range(-self.scale..self.scale) } else { 1.0 };
        let (sin, cos) = libm::sincos(yaw);
        let mirror = self.mirror && rng.random_bool(0.5);
        let joints = crop.joints;
        let mut moved: Vec<Option<[f64; 3]>> = Vec::with_capacity(joints);
        for _ in 0..joints {
            let missing = self.drop_joint > 0.0 && rng.random_bool(self.drop_joint);
            let mut displace = || {
                if self.displace > 0.0 { self.displace * preparation.size_m * normal(rng) } else { 0.0 }
            };
            let by = [displace(), displace(), displace()];
            moved.push((!missing).then_some(by));
        }
        for frame in crop.positions.chunks_exact_mut(joints.max(1)) {
            for (position, moved) in frame.iter_mut().zip(&moved) {
                *position = match (*position, moved) {
                    (Some([x, y, z]), Some(by)) => {
                        let y = if mirror { -y } else { y };
                        let [x, y, z] = [x * cos - y * sin, x * sin + y * cos, z].map(|v| v * scale);
                        Some([x + by[0], y + by[1], z + by[2]])
                    }
                    _ => None,
                };
            }
            if mirror {
                preparation.pairs.iter().for_each(|[left, right]| frame.swap(*left, *right));
            }
        }
        if mirror {
            crop.classes.iter_mut().for_each(|class| *class = mirrored[usize::from(*class)]);
        }
    }
}

impl Default for Augmentation {
    fn default() -> Self {
        Self {
            yaw_rad: std::f64::consts::PI,
            mirror: true,
            stretch: 0.2,
            scale: 0.1,
            drop_joint: 0.1,
            displace: 0.02,
        }
    }
}

/// Normally distributed with variance 1, near enough: the sum of twelve uniform numbers.
fn normal(rng: &mut impl Rng) -> f64 {
    (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
}

/// A cut of a sequence at the model's rate.
#[derive(Clone, Debug, Default)]
pub(super) struct Crop {
    joints: usize,
    positions: Vec<Position>,
    /// Class of each frame; meaningless where its weight is zero.
    pub(super) classes: Vec<u16>,
    /// Weight of each frame in the loss.
    pub(super) weights: Vec<f32>,
    /// What the network sees.
    pub(super) features: Vec<f32>,
    memory: Memory,
}

impl Crop {
    /// A whole sequence at another rate.
    pub(super) fn whole(sequence: &Sequence, rate_hz: f64) -> Self {
        let mut crop = Self::default();
        crop.take(sequence, &vec![1.0; sequence.frames()], sequence.span_s().0, None, rate_hz, 1.0);
        crop
    }

    pub(super) fn positions(&self) -> &[Position] {
        &self.positions
    }

    /// Cuts `length_s` (of the cut; all if absent) from `start_s` on, `stretch` seconds of the sequence to a second.
    pub(super) fn take(
        &mut self,
        sequence: &Sequence,
        weights: &[f32],
        start_s: f64,
        length_s: Option<f64>,
        rate_hz: f64,
        stretch: f64,
    ) {
        self.joints = sequence.joints;
        self.positions.clear();
        self.classes.clear();
        self.weights.clear();
        let (first_s, last_s) = sequence.span_s();
        let step_s = stretch / rate_hz;
        let end_s = length_s.map_or(last_s, |length| (start_s + length * stretch).min(last_s));
        let from = ((first_s - start_s) / step_s).ceil().max(0.0);
        let mut hint = 0;
        let mut tick = from;
        loop {
            let t_s = start_s + tick * step_s;
            if t_s > end_s + 1e-9 {
                break;
            }
            let frame = sequence.at(t_s, &mut hint, &mut self.positions);
            self.classes.push(sequence.classes[frame].unwrap_or(0));
            self.weights.push(if sequence.classes[frame].is_some() { weights[frame] } else { 0.0 });
            tick += 1.0;
        }
    }

    /// Computes the features of all frames.
    pub(super) fn featurise(&mut self, preparation: &Preparation) {
        self.memory = Memory::default();
        self.features.clear();
        for frame in self.positions.chunks_exact(self.joints.max(1)) {
            let features = preparation.push(frame, &mut self.memory);
            self.features.extend_from_slice(features);
        }
    }
}
