//! A training put aside, to be taken up again where it stopped.
//!
//! What comes in: a training, or the bytes of an earlier one. What goes out: the bytes, or the same training going on:
//! the model is the same as without a break. What it never does: go on with other options or other data.

use serde::{Deserialize, Serialize};

use super::network::SegmentationNetwork;
use super::options::Options;
use super::train::{Best, Trainer};

/// All of a training that its options and data do not give.
#[derive(Serialize, Deserialize)]
struct Checkpoint {
    format: String,
    options: Options,
    /// Frames of each sequence: other data shows.
    frames: Vec<u64>,
    epoch: u32,
    steps: u64,
    best: Option<(u32, f64, f64)>,
    /// Parameters, their mean, Adam's moments, and the best parameters, one after the other.
    #[serde(with = "floats")]
    numbers: Vec<f32>,
}

const FORMAT: &str = "posed-segments-training-1";

impl Trainer {
    /// The training as it stands, as bytes for `Trainer::resume`; options and data are not in it.
    ///
    /// # Panics
    /// Never: plain data is written to memory.
    pub fn checkpoint(&self) -> Vec<u8> {
        let mut numbers = self.network.parameters.clone();
        numbers.extend(&self.average);
        numbers.extend(&self.adam.first);
        numbers.extend(&self.adam.second);
        if let Some(best) = &self.best {
            numbers.extend(&best.parameters);
        }
        let checkpoint = Checkpoint {
            format: FORMAT.to_owned(),
            options: self.options().clone(),
            frames: self.frames(),
            epoch: self.epoch,
            steps: self.adam.steps,
            best: self.best.as_ref().map(|best| (best.epoch, best.loss, best.accuracy)),
            numbers,
        };
        rmp_serde::to_vec_named(&checkpoint).expect("plain data can be written to memory")
    }

    /// Takes up a training that was put aside, on the same options and data; it goes on as if it had not stopped.
    ///
    /// # Errors
    /// One sentence: the bytes are none, or of another training.
    pub fn resume(&mut self, bytes: &[u8]) -> Result<(), String> {
        let checkpoint: Checkpoint = rmp_serde::from_slice(bytes)
            .map_err(|error| format!("this is no training put aside: {error}"))?;
        let count = self.network.parameters.len();
        let parts = if checkpoint.best.is_some() { 5 } else { 4 };
        // More epochs are the same training going on for longer only where the steps do not depend on their number.
        if checkpoint.format != FORMAT
            || checkpoint.options != *self.options()
            || checkpoint.frames != self.frames()
            || checkpoint.numbers.len() != parts * count
        {
            return Err(
                "this training has other options or other data; train anew without --resume".to_owned()
            );
        }
        let part = |index: usize| checkpoint.numbers[index * count..(index + 1) * count].to_vec();
        let shape = self.network.shape().clone();
        self.network = SegmentationNetwork::new(shape, part(0)).ok_or("this training has another network")?;
        self.average = part(1);
        (self.adam.first, self.adam.second, self.adam.steps) = (part(2), part(3), checkpoint.steps);
        let best = checkpoint.best;
        self.best = best.map(|(epoch, loss, accuracy)| Best { epoch, loss, accuracy, parameters: part(4) });
        self.epoch = checkpoint.epoch;
        Ok(())
    }
}

/// Many floats as one byte string rather than as an array of numbers.
pub(super) mod floats {
    use serde::{Deserializer, Serializer, de};

    pub(in super::super) fn serialize<S: Serializer>(
        numbers: &[f32],
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        serializer.serialize_bytes(&bytes)
    }

    pub(in super::super) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Vec<f32>, D::Error> {
        struct Floats;
        impl de::Visitor<'_> for Floats {
            type Value = Vec<f32>;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a byte string of floats")
            }
            fn visit_bytes<E: de::Error>(self, bytes: &[u8]) -> Result<Vec<f32>, E> {
                if !bytes.len().is_multiple_of(4) {
                    return Err(E::invalid_length(bytes.len(), &self));
                }
                Ok(bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
            }
        }
        deserializer.deserialize_bytes(Floats)
    }
}
