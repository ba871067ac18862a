//! One dilated convolution over time, forwards and backwards.
//!
//! What comes in: frames of `inputs` channels, one after the other. What goes out: as many frames of `outputs`
//! channels, and gradients. What it never does: copy its input into windows; each tap is one matrix product on
//! shifted frames, and frames beyond either end are zero.

use posed_state::Plain;

use super::real::{Real, View, ViewMut};

/// One dilated convolution: where its numbers lie in the parameters, and which frames each output sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Plain)]
pub struct Layer {
    /// Channels in.
    pub inputs: usize,
    /// Channels out.
    pub outputs: usize,
    /// Number of taps.
    pub width: usize,
    /// Frames from tap to tap.
    pub dilation: usize,
    /// Frames that the last tap lies ahead of the output.
    pub ahead: usize,
    /// Index of the weights `[tap][input][output]` in the parameters; the biases follow them.
    pub offset: usize,
}

impl Layer {
    /// Number of weights.
    pub fn weights(&self) -> usize {
        self.width * self.inputs * self.outputs
    }

    /// Number of weights and biases.
    pub fn parameters(&self) -> usize {
        self.weights() + self.outputs
    }

    /// Frames from the first tap to the last.
    pub fn span(&self) -> usize {
        (self.width - 1) * self.dilation
    }

    /// Weights of one tap, `[input][output]`.
    pub(super) fn tap<'a, R>(&self, parameters: &'a [R], tap: usize) -> &'a [R] {
        let size = self.inputs * self.outputs;
        &parameters[self.offset + tap * size..][..size]
    }

    /// Biases.
    pub(super) fn bias<'a, R>(&self, parameters: &'a [R]) -> &'a [R] {
        &parameters[self.offset + self.weights()..][..self.outputs]
    }

    /// Frames of the output that a tap reaches: first and end of the output, first of the input.
    fn reach(&self, tap: usize, frames: usize) -> (usize, usize, usize) {
        // Input frame = output frame + tap * dilation + ahead - span.
        let (forward, back) = (tap * self.dilation + self.ahead, self.span());
        let first = back.saturating_sub(forward);
        let end = (frames + back).saturating_sub(forward).min(frames);
        (first.min(end), end, (first + forward).saturating_sub(back))
    }

    /// `y(t) = bias + sum over taps of x(t + tap * dilation + ahead - span) W(tap)`.
    pub(super) fn forward<R: Real>(&self, parameters: &[R], x: &[R], frames: usize, y: &mut Vec<R>) {
        y.clear();
        for _ in 0..frames {
            y.extend_from_slice(self.bias(parameters));
        }
        for tap in 0..self.width {
            let (first, end, from) = self.reach(tap, frames);
            if first < end {
                R::add_product(
                    View::new(&x[from * self.inputs..], end - first, self.inputs),
                    View::new(self.tap(parameters, tap), self.inputs, self.outputs),
                    ViewMut::new(&mut y[first * self.outputs..], end - first, self.outputs),
                );
            }
        }
    }

    /// Adds the derivative by the weights and biases to `gradient`, and writes the one by the input to `dx`.
    pub(super) fn backward<R: Real>(
        &self,
        parameters: &[R],
        x: &[R],
        dy: &[R],
        frames: usize,
        gradient: &mut [R],
        dx: Option<&mut Vec<R>>,
    ) {
        let size = self.inputs * self.outputs;
        for row in dy.chunks_exact(self.outputs) {
            let biases = &mut gradient[self.offset + self.weights()..];
            biases.iter_mut().zip(row).for_each(|(sum, value)| *sum += *value);
        }
        for tap in 0..self.width {
            let (first, end, from) = self.reach(tap, frames);
            if first < end {
                R::add_product(
                    View::new(&x[from * self.inputs..], end - first, self.inputs).transposed(),
                    View::new(&dy[first * self.outputs..], end - first, self.outputs),
                    ViewMut::new(&mut gradient[self.offset + tap * size..], self.inputs, self.outputs),
                );
            }
        }
        let Some(dx) = dx else { return };
        dx.clear();
        dx.resize(frames * self.inputs, R::ZERO);
        for tap in 0..self.width {
            let (first, end, from) = self.reach(tap, frames);
            if first < end {
                R::add_product(
                    View::new(&dy[first * self.outputs..], end - first, self.outputs),
                    View::new(self.tap(parameters, tap), self.inputs, self.outputs).transposed(),
                    ViewMut::new(&mut dx[from * self.inputs..], end - first, self.inputs),
                );
            }
        }
    }
}
