//! Segments: a network that learns here names what every frame of a motion shows.
//!
//! What comes in: positions of joints over time, any number of them, any of them missing; for training, with labels.
//! What goes out: a label and a confidence per frame; a model as a file. What it never does: look at a clock, depend on
//! the number of threads, allocate per frame once warm.
//!
//! ```text
//! positions -> ticks of the model's rate -> features (input) -> scores (network / stream) -> minimum durations
//!           (labeller)                                                                        (durations) -> Tick
//! train:  sequence -> crop, augment -> features -> network -> loss -> gradient -> adam -> Model
//! ```
//! Cheema et al. 2019. `docs/segments.md` has the figures.

mod adam;
mod augment;
mod checkpoint;
mod durations;
mod input;
mod joints;
mod labeller;
mod layer;
mod loss;
mod measures;
mod model;
mod network;
#[cfg(test)]
mod network_tests;
mod options;
mod real;
mod sequence;
mod stream;
#[cfg(test)]
mod tests;
mod train;

pub use augment::Augmentation;
pub use durations::Decoder;
pub use input::{Features, Memory, Position, Preparation};
pub use labeller::{Labeller, Tick, label};
pub use layer::Layer;
pub use loss::{Loss, best, cross_entropy, softmax};
pub use measures::{Measures, OVERLAPS, runs};
pub use model::{Card, Decision, Model, ModelError, Provenance};
pub use network::{Norm, SegmentationNetwork, Shape, Workspace};
pub use options::Options;
pub use real::{Real, View, ViewMut};
pub use sequence::{Sequence, Spoiling};
pub use stream::Stream;
pub use train::{Epoch, Trainer};
