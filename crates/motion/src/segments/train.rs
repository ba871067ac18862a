//! Training: labelled sequences in, a model out, epoch by epoch.
//!
//! What comes in: sequences, options, a seed. What goes out: a network whose every number follows from these, on any
//! number of threads. What it never does: look at a clock, learn from frames without a label, at masked borders or
//! in the held-out part.

use posed_geometry::parallel::*;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::adam::Adam;
use super::augment::Crop;
use super::input::Preparation;
use super::loss::{Loss, cross_entropy};
use super::model::{Card, Decision, Model, Provenance, VERSION};
use super::network::{SegmentationNetwork, Shape, Workspace};
use super::options::Options;
use super::sequence::{Sequence, Spoiling, near_borders};

/// How an epoch went.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Epoch {
    /// Its number, from 1.
    pub number: u32,
    /// Mean training loss over the steps of the epoch, nats per frame.
    pub loss: f64,
    /// Share of training frames named right, 0 to 1, on augmented crops and without minimum durations.
    pub accuracy: f64,
    /// Loss (nats per frame) and accuracy of the held-out part, by the averaged parameters; `None` without one.
    pub held_out: Option<(f64, f64)>,
}

/// A training under way, epoch by epoch. The answer does not depend on the number of threads; the same seed gives the
/// same model.
pub struct Trainer {
    options: Options,
    sequences: Vec<Sequence>,
    /// Weight of each frame of each sequence: in training, and held out.
    weights: Vec<Vec<f32>>,
    held_out: Vec<Vec<f32>>,
    preparation: Preparation,
    /// Class that a class becomes in a mirror.
    mirrored: Vec<u16>,
    pub(super) network: SegmentationNetwork<f32>,
    pub(super) average: Vec<f32>,
    pub(super) adam: Adam,
    pub(super) best: Option<Best>,
    pub(super) epoch: u32,
    minimum_s: Vec<f64>,
    slots: Vec<Slot>,
}

/// The parameters with the lowest held-out loss so far.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Best {
    pub(super) epoch: u32,
    pub(super) loss: f64,
    pub(super) accuracy: f64,
    pub(super) parameters: Vec<f32>,
}

/// Buffers of one crop of a batch.
#[derive(Default)]
struct Slot {
    crop: Crop,
    work: Workspace<f32>,
    slope: Vec<f32>,
    dropout: Vec<f32>,
    gradient: Vec<f32>,
    loss: Loss,
}

impl Trainer {
    /// Prepares a training on sequences of these joints and labels. Sequences of fewer than two frames are left out.
    ///
    /// # Errors
    /// One sentence: there is nothing to learn from, or an option makes no sense.
    pub fn new(
        options: Options,
        joints: Vec<String>,
        labels: &[String],
        mut sequences: Vec<Sequence>,
    ) -> Result<Self, String> {
        sequences.retain(|sequence| sequence.frames() > 1);
        let labelled = sequences.iter().flat_map(|sequence| sequence.classes.iter().flatten()).count();
        if labelled == 0 || labels.len() < 2 {
            return Err("there is nothing to distinguish; give labelled frames of two classes or more".into());
        }
        let rate_hz = options.rate_hz.unwrap_or_else(|| rate_of(&sequences));
        if !(rate_hz.is_finite() && rate_hz > 0.0) {
            return Err("the times of the sequences do not rise".into());
        }
        let crops: Vec<Crop> = sequences.iter().map(|sequence| Crop::whole(sequence, rate_hz)).collect();
        let preparation =
            Preparation::learn(joints, rate_hz, options.features, crops.iter().map(|crop| crop.positions()));
        let shape = Shape {
            inputs: preparation.inputs(),
            filters: options.filters.clone(),
            width: options.width,
            classes: labels.len(),
            ahead: options.ahead,
            norm: options.norm,
        };
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        let network = SegmentationNetwork::random(shape, &mut rng);
        let minimum_s = shortest_s(&sequences, labels.len())
            .map(|shortest_s| (options.minimum * shortest_s).min(options.longest_minimum_s))
            .collect();
        let mut weights = Vec::new();
        let mut held_out = Vec::new();
        for sequence in &mut sequences {
            let masked = near_borders(&sequence.classes, frames_of(options.mask_s, sequence));
            let held = held_out_part(sequence, options.held_out, &mut rng);
            let weight = |frame: usize, wanted: bool| {
                let known = sequence.classes[frame].is_some() && !masked[frame];
                f32::from(u8::from(known && held[frame] == wanted))
            };
            weights.push((0..sequence.frames()).map(|frame| weight(frame, false)).collect::<Vec<_>>());
            held_out.push((0..sequence.frames()).map(|frame| weight(frame, true)).collect::<Vec<_>>());
            options.spoiling.apply(&mut sequence.classes, labels.len() as u16, &mut rng);
        }
        let mirrored = (0..labels.len())
            .map(|class| super::joints::mirrored(&labels[class], labels).unwrap_or(class) as u16)
            .collect();
        let count = network.parameters.len();
        Ok(Self {
            average: network.parameters.clone(),
            slots: (0..options.batch.max(1)).map(|_| Slot::default()).collect(),
            options,
            sequences,
            weights,
            held_out,
            preparation,
            mirrored,
            network,
            adam: Adam::new(count),
            best: None,
            epoch: 0,
            minimum_s,
        })
    }

    /// How many epochs are done, and how many there are at most.
    pub fn progress(&self) -> (u32, u32) {
        (self.epoch, self.options.epochs)
    }

    /// Frames of each sequence.
    pub(super) fn frames(&self) -> Vec<u64> {
        self.sequences.iter().map(|sequence| sequence.frames() as u64).collect()
    }

    /// What the network sees.
    pub fn preparation(&self) -> &Preparation {
        &self.preparation
    }

    /// How it is trained.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The network with the best parameters so far: of the lowest held-out loss; without a held-out part the averaged
    /// ones, or the newest where nothing is averaged.
    pub fn network(&self) -> SegmentationNetwork<f32> {
        let mut network = self.network.clone();
        match &self.best {
            Some(best) => network.parameters.clone_from(&best.parameters),
            None if self.options.averaging > 0.0 => network.parameters.clone_from(&self.average),
            None => {}
        }
        network
    }

    /// The model with the best parameters so far, ready to label. `labels`: names of the classes; `files`: names and
    /// frames of what it was trained on, for its provenance.
    pub fn model(&self, labels: &[String], files: Vec<(String, u64)>) -> Model {
        let network = self.network();
        let provenance = Provenance {
            program: concat!("posed ", env!("CARGO_PKG_VERSION")).to_owned(),
            options: self.options.clone(),
            epochs: self.epoch,
            files,
            held_out_accuracy: self.best.as_ref().map(|best| best.accuracy),
        };
        let decision = Decision {
            minimum_s: self.minimum_s.clone(),
            switch: self.options.switch,
            wait_s: self.options.wait_s,
        };
        let card = Card {
            version: VERSION,
            labels: labels.to_vec(),
            preparation: self.preparation.clone(),
            shape: network.shape().clone(),
            decision,
            provenance,
        };
        Model { card, network }
    }

    /// Whether training is over: all epochs done, or no better held-out loss for `Options::patience` epochs.
    pub fn is_done(&self) -> bool {
        let stale = self.best.as_ref().is_some_and(|best| self.epoch - best.epoch >= self.options.patience);
        self.epoch >= self.options.epochs || (self.options.patience > 0 && stale)
    }

    /// Trains for one epoch and says how it went.
    pub fn epoch(&mut self) -> Epoch {
        let mut rng = ChaCha8Rng::seed_from_u64(self.options.seed);
        // A stream of its own per epoch: a resumed training draws what an unbroken one would.
        rng.set_stream(1 + u64::from(self.epoch));
        let plan = self.plan(&mut rng);
        let steps = plan.len().div_ceil(self.slots.len());
        let mut total = Loss::default();
        let mut slots = std::mem::take(&mut self.slots);
        for (step, items) in plan.chunks(slots.len()).enumerate() {
            slots.par_iter_mut().zip(items).for_each(|(slot, (sequence, start_s, seed))| {
                self.learn_from(*sequence, *start_s, *seed, slot);
            });
            let used = &mut slots[..items.len()];
            let mut loss = Loss::default();
            used.iter().for_each(|slot| loss.add(slot.loss));
            total.add(loss);
            if loss.weight == 0.0 {
                continue;
            }
            // In the order of the batch, whoever was first.
            let (first, others) = used.split_at_mut(1);
            let sum = &mut first[0].gradient;
            for slot in others.iter() {
                sum.iter_mut().zip(&slot.gradient).for_each(|(sum, part)| *sum += part);
            }
            let scale = 1.0 / loss.weight as f32;
            sum.iter_mut().for_each(|value| *value *= scale);
            let done = (f64::from(self.epoch) + step as f64 / steps as f64) / f64::from(self.options.epochs);
            let rate = self.options.learning_rate * self.warmth(done);
            self.adam.step(&mut self.network.parameters, sum, rate as f32, self.options.decay as f32);
            // A short memory at first: the mean must not hold on to the beginning.
            let steps = self.adam.steps as f64;
            let keep = self.options.averaging.min(steps / (steps + 10.0)) as f32;
            for (mean, value) in self.average.iter_mut().zip(&self.network.parameters) {
                *mean = keep * *mean + (1.0 - keep) * value;
            }
        }
        self.slots = slots;
        self.epoch += 1;
        let held_out = self.validate();
        Epoch {
            number: self.epoch,
            loss: total.mean(),
            accuracy: total.accuracy(),
            held_out: held_out.map(|loss| (loss.mean(), loss.accuracy())),
        }
    }

    /// Share of the learning rate after a share `done` of the training.
    fn warmth(&self, done: f64) -> f64 {
        if self.options.constant_rate {
            1.0
        } else {
            0.5 + 0.5 * libm::cos(std::f64::consts::PI * done.min(1.0))
        }
    }

    /// The crops of an epoch: sequence, start, seed.
    fn plan(&self, rng: &mut ChaCha8Rng) -> Vec<(usize, f64, u64)> {
        let mut plan = Vec::new();
        for (index, sequence) in self.sequences.iter().enumerate() {
            let (start_s, end_s) = sequence.span_s();
            let whole = end_s - start_s;
            match self.options.crop_s {
                Some(crop_s) if whole > crop_s => {
                    let count = (self.options.passes * whole / crop_s).ceil().max(1.0) as usize;
                    for _ in 0..count {
                        // A third of a crop may hang over either end, so that the ends are seen as often.
                        let at = rng.random_range(-crop_s / 3.0..whole - crop_s * 2.0 / 3.0);
                        plan.push((index, start_s + at, rng.random()));
                    }
                }
                _ => {
                    for _ in 0..self.options.passes.ceil().max(1.0) as usize {
                        plan.push((index, start_s, rng.random()));
                    }
                }
            }
        }
        plan.shuffle(rng);
        plan
    }

    /// Cuts a crop, changes it, and leaves its loss and gradient in the slot.
    fn learn_from(&self, index: usize, start_s: f64, seed: u64, slot: &mut Slot) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let sequence = &self.sequences[index];
        let rate_hz = self.preparation.rate_hz;
        let cut = &mut slot.crop;
        let stretch = self.options.augmentation.stretch(&mut rng);
        cut.take(sequence, &self.weights[index], start_s, self.options.crop_s, rate_hz, stretch);
        self.options.augmentation.change(cut, &self.preparation, &self.mirrored, &mut rng);
        cut.featurise(&self.preparation);
        slot.dropout.clear();
        if self.options.dropout > 0.0 {
            let channels = self.options.filters.iter().sum();
            let keep = 1.0 - self.options.dropout;
            let mut factor = || if rng.random_bool(keep) { 1.0 / keep as f32 } else { 0.0 };
            slot.dropout.extend((0..channels).map(|_| factor()));
        }
        self.network.forward(&cut.features, &slot.dropout, &mut slot.work);
        slot.loss = cross_entropy(
            slot.work.scores(),
            self.network.shape().classes,
            &cut.classes,
            &cut.weights,
            self.options.smoothing,
            &mut slot.slope,
        );
        slot.gradient.clear();
        slot.gradient.resize(self.network.parameters.len(), 0.0);
        let Slot { work, gradient, slope, dropout, .. } = slot;
        self.network.backward(&cut.features, dropout, slope, work, gradient, None);
    }

    /// Loss of the held-out part; remembers the best parameters.
    fn validate(&mut self) -> Option<Loss> {
        if self.held_out.iter().flatten().all(|weight| *weight == 0.0) {
            return None;
        }
        let mut network = self.network.clone();
        if self.options.averaging > 0.0 {
            network.parameters.clone_from(&self.average);
        }
        let losses: Vec<Loss> = self
            .sequences
            .par_iter()
            .zip(&self.held_out)
            .map(|(sequence, weights)| {
                let mut crop = Crop::default();
                let start_s = sequence.span_s().0;
                crop.take(sequence, weights, start_s, None, self.preparation.rate_hz, 1.0);
                crop.featurise(&self.preparation);
                let (mut work, mut loss) = (Workspace::default(), Loss::default());
                let Shape { inputs, classes, .. } = *network.shape();
                for part in network.shape().parts_that_score(&crop.weights) {
                    network.infer(&crop.features[part.start * inputs..part.end * inputs], &mut work);
                    let (truth, weights) = (&crop.classes[part.clone()], &crop.weights[part]);
                    loss.add(cross_entropy(work.scores(), classes, truth, weights, 0.0, &mut Vec::new()));
                }
                loss
            })
            .collect();
        let mut loss = Loss::default();
        losses.into_iter().for_each(|part| loss.add(part));
        if self.best.as_ref().is_none_or(|best| loss.mean() < best.loss) {
            let parameters = network.parameters;
            self.best =
                Some(Best { epoch: self.epoch, loss: loss.mean(), accuracy: loss.accuracy(), parameters });
        }
        Some(loss)
    }
}

impl Spoiling {
    /// Replaces labels.
    pub fn apply(&self, classes: &mut [Option<u16>], count: u16, rng: &mut ChaCha8Rng) {
        let near = near_borders(classes, self.border_frames);
        for (class, near) in classes.iter_mut().zip(near) {
            let share = self.label_noise.max(if near { self.border_noise } else { 0.0 });
            if class.is_some() && share > 0.0 && rng.random_bool(share.min(1.0)) {
                *class = Some(rng.random_range(0..count));
            }
        }
    }
}

/// Duration of the shortest segment of each class, s; 0 for a class that does not occur.
fn shortest_s(sequences: &[Sequence], classes: usize) -> impl Iterator<Item = f64> + use<> {
    let mut shortest = vec![f64::INFINITY; classes];
    for sequence in sequences {
        let mut first = 0;
        for frame in 1..=sequence.frames() {
            if sequence.classes.get(frame) != Some(&sequence.classes[first]) {
                if let Some(class) = sequence.classes[first] {
                    let duration_s = sequence.t_s[frame - 1] - sequence.t_s[first];
                    let shortest = &mut shortest[usize::from(class)];
                    *shortest = shortest.min(duration_s);
                }
                first = frame;
            }
        }
    }
    shortest.into_iter().map(|shortest_s| if shortest_s.is_finite() { shortest_s } else { 0.0 })
}

/// Frames per second of the sequences, from the median time between two frames.
fn rate_of(sequences: &[Sequence]) -> f64 {
    let mut steps: Vec<f64> =
        sequences.iter().flat_map(|s| s.t_s.windows(2).map(|pair| pair[1] - pair[0])).collect();
    steps.sort_by(f64::total_cmp);
    1.0 / steps.get(steps.len() / 2).copied().unwrap_or(f64::NAN)
}

fn frames_of(seconds: f64, sequence: &Sequence) -> usize {
    let (start_s, end_s) = sequence.span_s();
    (seconds * (sequence.frames() - 1) as f64 / (end_s - start_s).max(1e-9)).round() as usize
}

/// Blocks of two seconds, evenly spread, that make up `share` of a sequence.
fn held_out_part(sequence: &Sequence, share: f64, rng: &mut ChaCha8Rng) -> Vec<bool> {
    const BLOCK_S: f64 = 2.0;
    if share <= 0.0 {
        return vec![false; sequence.frames()];
    }
    let every_s = BLOCK_S / share.min(0.9);
    let shift_s = rng.random_range(0.0..every_s);
    let start_s = sequence.span_s().0;
    sequence.t_s.iter().map(|t_s| (t_s - start_s + shift_s) % every_s < BLOCK_S).collect()
}
