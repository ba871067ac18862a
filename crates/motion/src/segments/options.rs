//! How to train; a model keeps how it was trained.

use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::augment::Augmentation;
use super::input::Features;
use super::network::Norm;
use super::sequence::Spoiling;

/// How to train. The defaults are what `docs/segments.md` justifies.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[serde(deny_unknown_fields)]
pub struct Options {
    /// Seed of all that is random; the same seed and data give the same model.
    pub seed: u64,
    /// Most epochs.
    pub epochs: u32,
    /// Times that every frame is seen in an epoch, on average.
    pub passes: f64,
    /// Frames per second of the model, Hz; the sequences' own if absent.
    pub rate_hz: Option<f64>,
    /// Length of what is learned from at once, s; whole sequences if absent.
    pub crop_s: Option<f64>,
    /// Crops per step.
    pub batch: usize,
    /// Length of the first steps; it falls to zero along a cosine unless `constant_rate`.
    pub learning_rate: f64,
    /// Whether the steps stay as long as they are.
    pub constant_rate: bool,
    /// Weight decay, without unit.
    pub decay: f64,
    /// Share of channels that a crop does without, 0 to 1.
    pub dropout: f64,
    /// Share of the target spread over all classes, 0 to 1.
    pub smoothing: f64,
    /// Weight of the past in the mean over the parameters that becomes the model, 0 to 1; 0: the last ones.
    pub averaging: f64,
    /// Width of the border around each change of label that is not learned from, s.
    pub mask_s: f64,
    /// Share of the frames held out to stop by, 0 to 1; 0: none.
    pub held_out: f64,
    /// Epochs without a better held-out loss after which training stops; 0: never.
    pub patience: u32,
    /// What the network sees.
    pub features: Features,
    /// Filters of the dilated layers.
    pub filters: Vec<usize>,
    /// Taps of each dilated layer.
    pub width: usize,
    /// Frames the network may look ahead; half its receptive field if absent.
    pub ahead: Option<usize>,
    /// Where NormReLU acts.
    pub norm: Norm,
    /// Shortest duration of a class, as a share of its shortest segment in the training set.
    pub minimum: f64,
    /// Longest minimum duration, s.
    pub longest_minimum_s: f64,
    /// Natural logarithm of the probability of a change of class, per frame; below 0.
    pub switch: f64,
    /// Longest time that a decision takes after the network's own delay, s.
    pub wait_s: f64,
    /// Changes that keep the label.
    pub augmentation: Augmentation,
    /// Changes for the worse, to see how much is tolerated.
    pub spoiling: Spoiling,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            seed: 1,
            epochs: 30,
            passes: 4.0,
            rate_hz: Some(24.0),
            crop_s: Some(6.0),
            batch: 1,
            learning_rate: 1e-3,
            constant_rate: false,
            decay: 0.01,
            dropout: 0.1,
            smoothing: 0.05,
            averaging: 0.99,
            mask_s: 11.0 / 72.0,
            held_out: 0.0,
            patience: 0,
            features: Features::BODY,
            filters: vec![64, 64, 128, 256],
            width: 3,
            ahead: None,
            norm: Norm::Hidden,
            minimum: 0.5,
            longest_minimum_s: 2.0,
            switch: -4.0,
            wait_s: 3.0,
            augmentation: Augmentation::default(),
            spoiling: Spoiling::default(),
        }
    }
}
