//! The network on a stream: one frame in, the scores of the frame `delay` before it out.
//!
//! What comes in: features frame by frame. What goes out: the same scores as [`SegmentationNetwork::forward`] on the whole
//! sequence, up to rounding. What it never does: compute a column twice, allocate per frame, forget the borders: frames
//! before the first and after the last are zero in every layer.

use posed_state::Plain;

use super::network::{Norm, SegmentationNetwork, activate};

/// The network on a stream, frame by frame: rings of the layers' inputs. It gives the scores of a pass over the whole
/// sequence.
#[derive(Clone, Debug, Default, PartialEq, Plain)]
pub struct Stream {
    rings: Vec<Ring>,
    /// One frame between two layers.
    column: Vec<f32>,
    next: Vec<f32>,
}

/// Input of one layer: the last `span + 1` frames.
#[derive(Clone, Debug, Default, PartialEq, Plain)]
struct Ring {
    frames: Vec<f32>,
    /// Frames that came in, zeros after the end included, and frames that went out.
    taken: u64,
    given: u64,
}

impl Stream {
    /// Before the first frame of a stream for this network.
    pub fn new(network: &SegmentationNetwork<f32>) -> Self {
        let rings = network
            .layers()
            .iter()
            .map(|layer| Ring { frames: vec![0.0; (layer.span() + 1) * layer.inputs], ..Ring::default() });
        let most = network.layers().iter().map(|layer| layer.inputs.max(layer.outputs)).max().unwrap_or(0);
        Self { rings: rings.collect(), column: Vec::with_capacity(most), next: Vec::with_capacity(most) }
    }

    /// Takes the next frame's features and returns the scores of the frame [`super::Shape::delay`] before it; `None`
    /// for the first ones.
    ///
    /// # Panics
    /// The features are not as many as the network's inputs, or the stream was made for another network.
    pub fn push(&mut self, network: &SegmentationNetwork<f32>, features: &[f32]) -> Option<&[f32]> {
        assert_eq!(features.len(), network.shape().inputs, "features");
        self.column.clear();
        self.column.extend_from_slice(features);
        self.run(network, 0).then_some(self.column.as_slice())
    }

    /// Ends the stream; `emit` gets the scores of the frames that are left, in order.
    pub fn finish(&mut self, network: &SegmentationNetwork<f32>, emit: &mut dyn FnMut(&[f32])) {
        for layer in 0..self.rings.len() {
            // What came in from outside, or has come from the layer below, which is complete by now.
            let frames = self.rings[layer].taken;
            while self.rings[layer].given < frames {
                self.column.clear();
                self.column.resize(network.layers()[layer].inputs, 0.0);
                if self.run(network, layer) {
                    emit(&self.column);
                }
            }
        }
    }

    /// Runs `column` through the layers from `first` on; true if it came out as scores.
    fn run(&mut self, network: &SegmentationNetwork<f32>, first: usize) -> bool {
        let last = network.layers().len() - 1;
        for (index, layer) in network.layers().iter().enumerate().skip(first) {
            let ring = &mut self.rings[index];
            let slots = layer.span() + 1;
            let newest = (ring.taken % slots as u64) as usize;
            ring.frames[newest * layer.inputs..][..layer.inputs].copy_from_slice(&self.column);
            ring.taken += 1;
            if ring.taken <= layer.ahead as u64 {
                return false;
            }
            ring.given += 1;
            self.next.clear();
            self.next.extend_from_slice(layer.bias(&network.parameters));
            for tap in 0..layer.width {
                // The newest frame is the last tap's; slots that nothing came into yet hold zeros.
                let slot = (newest + slots - (layer.width - 1 - tap) * layer.dilation) % slots;
                let x = &ring.frames[slot * layer.inputs..][..layer.inputs];
                add_product(x, layer.tap(&network.parameters, tap), &mut self.next);
            }
            let norm = network.shape().norm;
            if index < last {
                activate(&mut self.next, norm == Norm::Hidden && index + 1 == last);
            } else if norm == Norm::Scores {
                activate(&mut self.next, true);
            }
            std::mem::swap(&mut self.column, &mut self.next);
        }
        true
    }
}

/// `y += x W`, rows of `W` one after the other. After a ReLU about half of `x` is zero and skipped.
fn add_product(x: &[f32], weights: &[f32], y: &mut [f32]) {
    for (x, row) in x.iter().zip(weights.chunks_exact(y.len())) {
        if *x != 0.0 {
            y.iter_mut().zip(row).for_each(|(y, w)| *y += *x * *w);
        }
    }
}
