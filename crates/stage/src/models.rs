//! The models in use: the newest of each kind.
//!
//! What comes in: models as they are swapped in. What goes out: the entries of the input log that make a new pipeline use the
//! same ones. What it never does: keep a model that another one has replaced.

use serde::{Deserialize, Serialize};

use crate::input::{Input, Model};

/// The models in use: the newest of each kind ([`Model::replaced_by`]), and the file of the segmentation network. What a pipeline
/// needs beside its stage file and its snapshot to go on ([`Self::entries`]).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LoadedModels {
    swapped: Vec<Model>,
    /// The file of the segmentation network.
    #[serde(with = "posed_geometry::bytes")]
    network: Vec<u8>,
}

impl LoadedModels {
    /// Takes a model in the place of the one that it replaces, else behind all others. Its numbers are not checked.
    pub fn insert(&mut self, model: &Model) {
        match self.swapped.iter_mut().find(|known| known.replaced_by(model)) {
            Some(known) => known.clone_from(model),
            None => self.swapped.push(model.clone()),
        }
    }

    /// Takes the file of a segmentation network in place of the one before; an empty one leaves none. It is not read.
    pub fn insert_network(&mut self, file: &[u8]) {
        self.network.clear();
        self.network.extend_from_slice(file);
    }

    /// The models, in the order in which the first of each kind came.
    pub fn iter(&self) -> impl Iterator<Item = &Model> {
        self.swapped.iter()
    }

    /// The file of the segmentation network; empty if there is none.
    pub fn network(&self) -> &[u8] {
        &self.network
    }

    /// Whether there is neither a model nor a segmentation network.
    pub fn is_empty(&self) -> bool {
        self.swapped.is_empty() && self.network.is_empty()
    }

    /// What a new pipeline takes in order to use them: the models in the order of [`Self::iter`], then the network if there is
    /// one. Each is a copy.
    pub fn entries(&self) -> impl Iterator<Item = Input> {
        let network = Some(&self.network).filter(|file| !file.is_empty());
        self.swapped.iter().cloned().map(Input::Model).chain(network.cloned().map(Input::SegmentationNetwork))
    }
}

impl FromIterator<Model> for LoadedModels {
    fn from_iter<T: IntoIterator<Item = Model>>(models: T) -> Self {
        let mut all = Self::default();
        models.into_iter().for_each(|model| all.insert(&model));
        all
    }
}
