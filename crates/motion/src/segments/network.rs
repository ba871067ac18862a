//! The dilated temporal fully-convolutional network: joint features in, one score per class and frame out.
//!
//! What comes in: frames of features, one after the other. What goes out: as many frames of scores (log odds up to a
//! constant per frame), or gradients. What it never does: look further than its receptive field.
//!
//! Cheema et al. 2019: layers of dilation `width^l`, each followed by a ReLU; NormReLU after the last; a linear
//! classifier per frame. The paper's printed sum is causal; its network is not: half of each layer's span lies ahead,
//! unless [`Shape::ahead`] allows less.

use std::ops::Range;

use posed_state::Plain;
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use super::input::neighbours;
use super::layer::Layer;
use super::real::Real;

/// Keeps NormReLU finite where no channel is active.
const EPSILON: f64 = 1e-5;

/// What a segmentation network looks like: dilated convolutions and a classifier per frame (Cheema et al. 2019).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, Plain)]
#[serde(deny_unknown_fields)]
pub struct Shape {
    /// Features per frame.
    pub inputs: usize,
    /// Filters of each dilated layer.
    pub filters: Vec<usize>,
    /// Taps of each dilated layer; the dilation of a layer is `width` times that of the one before.
    pub width: usize,
    /// Classes.
    pub classes: usize,
    /// Frames the network may look ahead; half its receptive field if absent.
    pub ahead: Option<usize>,
    /// Where the largest channel of a frame is scaled to one.
    pub norm: Norm,
}

/// Where NormReLU, `ReLU(x) / (max over channels ReLU(x) + 1e-5)`, acts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Plain)]
#[serde(rename_all = "snake_case")]
pub enum Norm {
    /// On the last dilated layer, before the classifier.
    #[default]
    Hidden,
    /// On the classifier's scores, as another reading of its source has it; ten classes then never exceed 0.232.
    Scores,
    /// Nowhere.
    Off,
}

impl Shape {
    /// Frames that one score sees: `width` to the power of the number of layers.
    pub fn receptive_field(&self) -> usize {
        1 + self.layers().iter().map(Layer::span).sum::<usize>()
    }

    /// Frames by which a score lags behind the newest frame it sees; the delay of the network when it runs live.
    pub fn delay(&self) -> usize {
        self.layers().iter().map(|layer| layer.ahead).sum()
    }

    /// Number of weights and biases.
    pub fn parameters(&self) -> usize {
        self.layers().iter().map(Layer::parameters).sum()
    }

    /// The parts of a sequence that it takes to score the frames that have a weight.
    pub(super) fn parts_that_score(&self, weights: &[f32]) -> Vec<Range<usize>> {
        let ahead = self.delay();
        let back = self.receptive_field() - 1 - ahead;
        let mut parts: Vec<Range<usize>> = Vec::new();
        for (frame, _) in weights.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
            let (first, end) = (frame.saturating_sub(back), (frame + ahead + 1).min(weights.len()));
            match parts.last_mut() {
                Some(part) if first <= part.end => part.end = end,
                _ => parts.push(first..end),
            }
        }
        parts
    }

    /// The dilated layers and the classifier. The narrow layers look ahead first, where frames ahead are few.
    pub(super) fn layers(&self) -> Vec<Layer> {
        let mut left = self.ahead.unwrap_or(usize::MAX);
        let (mut inputs, mut offset, mut dilation) = (self.inputs, 0, 1);
        let mut layers = Vec::with_capacity(self.filters.len() + 1);
        let widths = self.filters.iter().map(|filters| (*filters, self.width)).chain([(self.classes, 1)]);
        for (outputs, width) in widths {
            let ahead = ((width - 1) * dilation / 2).min(left);
            left -= ahead;
            let layer = Layer { inputs, outputs, width, dilation, ahead, offset };
            offset += layer.parameters();
            inputs = outputs;
            dilation *= self.width;
            layers.push(layer);
        }
        layers
    }
}

/// The network and its numbers; `f32` to work with, `f64` to check gradients with.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct SegmentationNetwork<R> {
    shape: Shape,
    layers: Vec<Layer>,
    /// All weights and biases, layer by layer.
    pub(super) parameters: Vec<R>,
}

/// What a forward pass leaves behind for the backward pass, and buffers of both.
#[derive(Clone, Debug, Default)]
pub struct Workspace<R> {
    /// Output of each layer, after its activation and dropout.
    outputs: Vec<Vec<R>>,
    /// The last dilated layer before NormReLU.
    rectified: Vec<R>,
    slope: Vec<R>,
    next_slope: Vec<R>,
}

impl<R: Real> Workspace<R> {
    /// Scores of the last pass, one per class, frame by frame; they are not probabilities: see `softmax`.
    pub fn scores(&self) -> &[R] {
        self.outputs.last().map_or(&[], Vec::as_slice)
    }
}

impl<R: Real> SegmentationNetwork<R> {
    /// A network with these numbers; `None` if there are not as many as the shape has.
    pub fn new(shape: Shape, parameters: Vec<R>) -> Option<Self> {
        let layers = shape.layers();
        (shape.parameters() == parameters.len()).then_some(Self { shape, layers, parameters })
    }

    /// A network with weights drawn uniformly (Glorot & Bengio 2010) and biases zero.
    pub fn random(shape: Shape, rng: &mut impl Rng) -> Self {
        let layers = shape.layers();
        let mut parameters = Vec::with_capacity(shape.parameters());
        for layer in &layers {
            let fan = (layer.width * (layer.inputs + layer.outputs)) as f64;
            let bound = (6.0 / fan).sqrt();
            parameters.extend((0..layer.weights()).map(|_| R::of(rng.random_range(-bound..bound))));
            parameters.extend((0..layer.outputs).map(|_| R::ZERO));
        }
        Self { shape, layers, parameters }
    }

    /// The network that gives these scores for the joints themselves, this one being for an image of them that is
    /// resized to `rows`: resizing is linear, and goes into the first layer.
    ///
    /// # Panics
    /// The inputs are no whole number of rows.
    pub fn folded(&self, rows: usize, joints: usize) -> Self {
        let image = self.layers[0];
        assert_eq!(image.inputs % rows, 0, "whole rows");
        let channels = image.inputs / rows;
        let size = channels * image.outputs;
        let (weights, others) = self.parameters.split_at(image.weights());
        let mut parameters = vec![R::ZERO; image.width * joints * size];
        for (index, weights) in weights.chunks_exact(size).enumerate() {
            let (tap, row) = (index / rows, index % rows);
            let ([below, above], share) = neighbours(row, rows, joints);
            for (joint, share) in [(below, 1.0 - share), (above, share)] {
                let sums = &mut parameters[(tap * joints + joint) * size..][..size];
                sums.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += R::of(share.into()) * *weight);
            }
        }
        parameters.extend_from_slice(others);
        let shape = Shape { inputs: joints * channels, ..self.shape.clone() };
        let layers = shape.layers();
        Self { shape, layers, parameters }
    }

    /// What it looks like.
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// All weights and biases, layer by layer: `[tap][input][output]`, then the biases.
    pub fn parameters(&self) -> &[R] {
        &self.parameters
    }

    pub(super) fn layers(&self) -> &[Layer] {
        &self.layers
    }

    /// Computes the scores of all frames of `x` into `work`, and no more than these. `x`: features, frame by frame;
    /// beyond its ends there is nothing.
    ///
    /// # Panics
    /// `x` is no whole number of frames.
    pub fn infer(&self, x: &[R], work: &mut Workspace<R>) {
        self.pass(x, &[], work, |_, _| {});
    }

    /// Computes the scores of all frames of `x`, and what [`SegmentationNetwork::backward`] needs. `dropout` holds a factor per channel
    /// of each dilated layer's output, one layer after the other; empty for none.
    ///
    /// # Panics
    /// `x` is no whole number of frames.
    pub fn forward(&self, x: &[R], dropout: &[R], work: &mut Workspace<R>) {
        self.pass(x, dropout, work, Vec::clone_from);
    }

    fn pass(&self, x: &[R], dropout: &[R], work: &mut Workspace<R>, keep: fn(&mut Vec<R>, &Vec<R>)) {
        assert_eq!(x.len() % self.shape.inputs, 0, "whole frames");
        let frames = x.len() / self.shape.inputs;
        work.outputs.resize(self.layers.len(), Vec::new());
        let mut factors = dropout;
        for (index, layer) in self.layers.iter().enumerate() {
            let (before, rest) = work.outputs.split_at_mut(index);
            let y = &mut rest[0];
            layer.forward(&self.parameters, before.last().map_or(x, Vec::as_slice), frames, y);
            let hidden = index + 1 < self.layers.len();
            if hidden || self.shape.norm == Norm::Scores {
                y.iter_mut().for_each(rectify);
            }
            let last_hidden = index + 2 == self.layers.len();
            let normed = match self.shape.norm {
                Norm::Hidden => last_hidden,
                Norm::Scores => !hidden,
                Norm::Off => false,
            };
            if normed {
                keep(&mut work.rectified, y);
                y.chunks_exact_mut(layer.outputs).for_each(normalise);
            }
            if hidden && !factors.is_empty() {
                let (mine, others) = factors.split_at(layer.outputs);
                for row in y.chunks_exact_mut(layer.outputs) {
                    row.iter_mut().zip(mine).for_each(|(value, factor)| *value *= *factor);
                }
                factors = others;
            }
        }
    }

    /// Adds to `gradient` the derivative of a loss whose derivative by the scores is `d_scores`, after a forward pass
    /// with the same `x` and `dropout`. Writes the derivative by `x` to `dx` if asked to.
    pub fn backward(
        &self,
        x: &[R],
        dropout: &[R],
        d_scores: &[R],
        work: &mut Workspace<R>,
        gradient: &mut [R],
        dx: Option<&mut Vec<R>>,
    ) {
        let frames = x.len() / self.shape.inputs;
        let Workspace { outputs, rectified, slope, next_slope } = work;
        slope.clear();
        slope.extend_from_slice(d_scores);
        let mut dx = dx;
        let mut end = dropout.len();
        for (index, layer) in self.layers.iter().enumerate().rev() {
            let hidden = index + 1 < self.layers.len();
            if hidden && !dropout.is_empty() {
                let mine = &dropout[end - layer.outputs..end];
                end -= layer.outputs;
                for row in slope.chunks_exact_mut(layer.outputs) {
                    row.iter_mut().zip(mine).for_each(|(value, factor)| *value *= *factor);
                }
            }
            let last_hidden = index + 2 == self.layers.len();
            match self.shape.norm {
                Norm::Hidden if last_hidden => unnormalise_all(slope, rectified, layer.outputs),
                Norm::Scores if !hidden => unnormalise_all(slope, rectified, layer.outputs),
                _ if hidden => {
                    let y = &outputs[index];
                    for (slope, y) in slope.iter_mut().zip(y) {
                        if *y <= R::ZERO {
                            *slope = R::ZERO;
                        }
                    }
                }
                _ => {}
            }
            let (input, below) = match index.checked_sub(1) {
                Some(below) => (outputs[below].as_slice(), Some(&mut *next_slope)),
                None => (x, dx.take()),
            };
            layer.backward(&self.parameters, input, slope, frames, gradient, below);
            std::mem::swap(slope, next_slope);
        }
    }
}

fn rectify<R: Real>(value: &mut R) {
    // As written, what is no number becomes zero.
    *value = if *value > R::ZERO { *value } else { R::ZERO };
}

/// ReLU, then NormReLU where it acts, on one frame of a layer's sums.
pub(super) fn activate<R: Real>(row: &mut [R], normed: bool) {
    row.iter_mut().for_each(rectify);
    if normed {
        normalise(row);
    }
}

fn largest<R: Real>(row: &[R]) -> (usize, R) {
    let mut best = (0, R::ZERO);
    for (index, value) in row.iter().enumerate() {
        if *value > best.1 {
            best = (index, *value);
        }
    }
    best
}

fn normalise<R: Real>(row: &mut [R]) {
    // Lanes, of which the compiler makes vectors.
    let mut lanes = [R::ZERO; 16];
    let (whole, rest) = row.as_chunks::<16>();
    for values in whole.iter().map(<[R; 16]>::as_slice).chain([rest]) {
        for (most, value) in lanes.iter_mut().zip(values) {
            *most = if *value > *most { *value } else { *most };
        }
    }
    let scale = R::ONE / (largest(&lanes).1 + R::of(EPSILON));
    row.iter_mut().for_each(|value| *value *= scale);
}

/// Turns the slope by NormReLU(x) into the one by x, frame by frame; `rectified` is ReLU(x).
fn unnormalise_all<R: Real>(slope: &mut [R], rectified: &[R], channels: usize) {
    for (slope, rectified) in slope.chunks_exact_mut(channels).zip(rectified.chunks_exact(channels)) {
        let (index, most) = largest(rectified);
        let scale = R::ONE / (most + R::of(EPSILON));
        let mut along = R::ZERO;
        for (slope, value) in slope.iter_mut().zip(rectified) {
            along += *slope * *value;
            *slope = if *value > R::ZERO { *slope * scale } else { R::ZERO };
        }
        if most > R::ZERO {
            slope[index] += -(along * scale * scale);
        }
    }
}
