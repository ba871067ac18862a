//! A trained model as a file: safetensors, readable by any program that reads them.
//!
//! What comes in: what training found. What goes out: one file with the weights as tensors (`layer1.weight`,
//! `[tap][input][output]`, `layer1.bias`, ...) and all else as JSON in its metadata, and the same back. What it
//! never does: load a file whose parts do not fit together.

use std::collections::HashMap;

use posed_state::Plain;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};

use super::input::{Features, Preparation};
use super::network::{SegmentationNetwork, Shape};
use super::options::Options;

/// Key of the metadata.
const KEY: &str = "posed-segments";
/// Version of the metadata that this program writes and reads.
pub(super) const VERSION: u32 = 1;

/// A trained model: everything that labelling needs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[serde(try_from = "File", into = "File")]
pub struct Model {
    /// Labels, joints, rate, decision and origin.
    pub card: Card,
    /// The network and its weights.
    pub network: SegmentationNetwork<f32>,
}

/// A model as its file, inside other data.
#[derive(Clone, Serialize, Deserialize)]
struct File(#[serde(with = "posed_geometry::bytes")] Vec<u8>);

impl From<Model> for File {
    fn from(model: Model) -> Self {
        // Only a file beyond all memory cannot be made; an empty one is refused when it is read.
        Self(model.to_bytes().unwrap_or_default())
    }
}

impl TryFrom<File> for Model {
    type Error = ModelError;

    fn try_from(file: File) -> Result<Self, ModelError> {
        Self::from_bytes(&file.0)
    }
}

/// All of a model but its weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[serde(deny_unknown_fields)]
pub struct Card {
    /// Version of this card.
    pub version: u32,
    /// Names of the classes.
    pub labels: Vec<String>,
    /// Joints, scaling, rate.
    pub preparation: Preparation,
    /// What the network looks like.
    pub shape: Shape,
    /// How scores become labels.
    pub decision: Decision,
    /// Where it comes from.
    pub provenance: Provenance,
}

/// Most classes of a model: every one may follow every other.
const MOST_LABELS: usize = 1024;
/// Most frames of all minimum durations together.
const MOST_STATES: usize = 16_384;
/// Most memory that a model may take when it runs live, bytes.
const MOST_BYTES: usize = 256 << 20;
/// Most multiplications per second of a stream: what a core does.
const MOST_PRODUCTS_PER_S: f64 = 4e9;

/// How scores become labels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[serde(deny_unknown_fields)]
pub struct Decision {
    /// Shortest duration of each class, s.
    pub minimum_s: Vec<f64>,
    /// Log probability of a change of class, per frame.
    pub switch: f64,
    /// Longest time that a decision takes after the network's own delay, s.
    pub wait_s: f64,
}

/// Where a model comes from. It decides nothing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// Program and version.
    pub program: String,
    /// How it was trained.
    pub options: Options,
    /// Epochs done.
    pub epochs: u32,
    /// What it was trained on: name of each file, and its frames.
    pub files: Vec<(String, u64)>,
    /// Share of the held-out frames named right, without minimum durations; null without a held-out part.
    pub held_out_accuracy: Option<f64>,
}

/// Why a file is no model.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// Not of this format.
    #[error("this is no model of segments: {0}")]
    Format(String),
    /// Parts that do not fit together.
    #[error("this model is damaged: {0}")]
    Damaged(String),
}

impl Model {
    /// Index of each of the model's joints among `names`; `None` where a joint is missing.
    ///
    /// # Errors
    /// One sentence: more than half of the joints are missing.
    pub fn columns<'a>(
        &self,
        names: impl Iterator<Item = &'a str> + Clone,
    ) -> Result<Vec<Option<usize>>, String> {
        let joints = &self.card.preparation.joints;
        let place = |joint: &String| names.clone().position(|name| name == joint);
        let columns: Vec<Option<usize>> = joints.iter().map(place).collect();
        if 2 * columns.iter().flatten().count() < joints.len() {
            let names: Vec<&str> = names.collect();
            return Err(format!("expected the joints {}, found {}", joints.join(", "), names.join(", ")));
        }
        Ok(columns)
    }

    /// The file's bytes.
    ///
    /// # Errors
    /// The file would be too large for its format.
    pub fn to_bytes(&self) -> Result<Vec<u8>, ModelError> {
        let format = |error: &dyn std::fmt::Display| ModelError::Format(error.to_string());
        let mut tensors = Vec::new();
        for (index, layer) in self.network.layers().iter().enumerate() {
            let bytes = |from: usize, count: usize| -> Vec<u8> {
                self.network.parameters()[from..from + count].iter().flat_map(|v| v.to_le_bytes()).collect()
            };
            let weight = bytes(layer.offset, layer.weights());
            let bias = bytes(layer.offset + layer.weights(), layer.outputs);
            let number = index + 1;
            let shape = vec![layer.width, layer.inputs, layer.outputs];
            tensors.push((format!("layer{number}.weight"), shape, weight));
            tensors.push((format!("layer{number}.bias"), vec![layer.outputs], bias));
        }
        let mut views = Vec::with_capacity(tensors.len());
        for (name, shape, bytes) in &tensors {
            let view = TensorView::new(Dtype::F32, shape.clone(), bytes).map_err(|error| format(&error))?;
            views.push((name.as_str(), view));
        }
        let card = serde_json::to_string(&self.card).map_err(|error| format(&error))?;
        let metadata = Some(HashMap::from([(KEY.to_owned(), card)]));
        safetensors::serialize(views, metadata).map_err(|error| format(&error))
    }

    /// Reads a file's bytes. A network that was trained on an image of more rows than joints comes back with a row per
    /// joint, which gives the same scores for less work.
    ///
    /// # Errors
    /// They are no model, of another version, or damaged.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, ModelError> {
        let format = |error: &dyn std::fmt::Display| ModelError::Format(error.to_string());
        let damaged = |what: &str| ModelError::Damaged(what.to_owned());
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(|error| format(&error))?;
        let card = header.metadata().as_ref().and_then(|metadata| metadata.get(KEY));
        let card = card.ok_or_else(|| format(&"it has no `posed-segments` in its metadata"))?;
        let card: Card = serde_json::from_str(card).map_err(|error| format(&error))?;
        if card.version != VERSION {
            return Err(format(&format_args!("version {}, this program reads {VERSION}", card.version)));
        }
        card.check().map_err(damaged)?;
        let tensors = SafeTensors::deserialize(bytes).map_err(|error| format(&error))?;
        // No more than there can be: the card is not to be trusted with memory.
        let mut parameters = Vec::with_capacity(card.shape.parameters().min(bytes.len() / 4));
        for (index, layer) in card.shape.layers().iter().enumerate() {
            let number = index + 1;
            let parts =
                [("weight", vec![layer.width, layer.inputs, layer.outputs]), ("bias", vec![layer.outputs])];
            for (part, shape) in parts {
                let tensor =
                    tensors.tensor(&format!("layer{number}.{part}")).map_err(|error| format(&error))?;
                if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
                    return Err(ModelError::Damaged(format!("layer{number}.{part} is not f32 {shape:?}")));
                }
                let numbers =
                    tensor.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
                parameters.extend(numbers);
            }
        }
        if parameters.iter().any(|value| !value.is_finite()) {
            return Err(damaged("weights that are not finite"));
        }
        let network = SegmentationNetwork::new(card.shape.clone(), parameters)
            .ok_or_else(|| damaged("weights are missing"))?;
        Ok(Self { card, network }.folded())
    }

    fn folded(mut self) -> Self {
        let Some(rows) = self.card.preparation.features.rows else { return self };
        let joints = self.card.preparation.joints.len();
        self.network = self.network.folded(rows, joints);
        self.card.preparation.features.rows = None;
        self.card.shape = self.network.shape().clone();
        self
    }
}

impl Card {
    fn check(&self) -> Result<(), &'static str> {
        let check = |ok: bool, what| if ok { Ok(()) } else { Err(what) };
        let Self { labels, preparation, shape, decision, .. } = self;
        check(labels.len() >= 2 && labels.len() == shape.classes, "as many labels as classes")?;
        check(!preparation.joints.is_empty() && preparation.joints.len() <= 10_000, "joints")?;
        check((1.0..=1000.0).contains(&preparation.rate_hz), "rate_hz from 1 to 1000")?;
        let joint = |joint: &usize| *joint < preparation.joints.len();
        check(preparation.pairs.iter().flatten().all(joint), "pairs of joints that are there")?;
        check(
            preparation.inputs() == shape.inputs && shape.inputs <= 1_000_000,
            "as many features as inputs",
        )?;
        let Features { rows, velocities, speeds, .. } = preparation.features;
        check(rows.is_none_or(|rows| rows > 0 && !velocities && !speeds), "an image of positions only")?;
        check(preparation.numbers_fit(), "offset and scale per feature")?;
        check((1..=9).contains(&shape.width) && shape.width % 2 == 1, "an odd width from 1 to 9")?;
        check((1..=8).contains(&shape.filters.len()), "1 to 8 layers")?;
        check(shape.filters.iter().all(|filters| (1..=8192).contains(filters)), "1 to 8192 filters")?;
        let second = |value: &f64| (0.0..=600.0).contains(value);
        check(decision.minimum_s.len() == labels.len(), "a duration per label")?;
        check(decision.minimum_s.iter().all(second) && second(&decision.wait_s), "durations up to 600 s")?;
        check(decision.switch.is_finite() && decision.switch <= 0.0, "switch of at most 0")?;
        check(labels.len() <= MOST_LABELS, "at most 1024 labels")?;
        check(self.is_affordable(), "less memory and work than one stage has for it")
    }

    /// Whether it can run live: each number of it may be within its range where their product is not.
    fn is_affordable(&self) -> bool {
        let rate_hz = self.preparation.rate_hz;
        let ticks = |seconds: f64| (seconds * rate_hz).round() as usize;
        let states: usize = self.decision.minimum_s.iter().map(|seconds| ticks(*seconds).max(1)).sum();
        let waiting = (ticks(self.decision.wait_s) + 2).next_power_of_two();
        let layers = self.shape.layers();
        let seen: usize = layers.iter().map(|layer| (layer.span() + 1) * layer.inputs).sum();
        let numbers = self.shape.parameters() + seen + waiting * (states + self.labels.len());
        let products_per_s = self.shape.parameters() as f64 * rate_hz;
        states <= MOST_STATES && 4 * numbers <= MOST_BYTES && products_per_s <= MOST_PRODUCTS_PER_S
    }
}
