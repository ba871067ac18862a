//! Dilated temporal fully-convolutional network, as published: its shape and its training.
//!
//! N. Cheema, S. Hosseini, J. Sprenger, E. Herrmann, H. Du, K. Fischer and P. Slusallek, "Fine-grained semantic segmentation
//! of motion capture data using dilated temporal fully-convolutional networks" (2019, doi:10.48550/arXiv.1903.00695).
//!
//! What comes in: labelled sequences of joint positions. What goes out: a model that
//! [`Labeller`](posed_motion::segments::Labeller) runs like any other, once a
//! [`Trainer`](posed_motion::segments::Trainer) has been given [`options`]. The network of [`shape`] has five layers of
//! 64, 64, 128, 256, 512 filters of width `w = 3` and dilation `w^(l-1)`,
//!
//! ```text
//! y(t) = ReLU( sum over i of f(i) x(t + d (i - (w - 1) / 2)) + b ),   NormReLU(y) = y / (max over channels of y + 1e-5)
//! ```
//! and a linear classifier; NormReLU follows the last of them. One frame sees `w^5 = 243`.
//!
//! The default of posed is this network with other input, augmentation, regularisation and a decision with minimum
//! durations; `docs/segments.md` states what each of them gives.
//!
//! Repaired or chosen here, where the paper errs or is silent:
//! - The printed sum is causal; the network is not: half of each layer's span lies ahead.
//! - The largest value for NormReLU is that of the frame, not of the whole tensor, which would tie a frame to all others.
//! - NormReLU on the classifier's scores, another reading of the text, keeps softmax of ten classes below 0.232.
//! - The number of epochs that fits the data here is 25 (the paper: 100 on its own).
//! - Each coordinate of each joint is scaled to 0 .. 1 over the training set; the paper does not say over what.

use posed_motion::segments::{Augmentation, Features, Norm, Options, Shape};

/// Shape of the network for `inputs` features a frame and `classes` labels. `inputs` are three for each row of the image, of
/// which the paper has 224. Resized from the joints of a body, these can express no more than the joints' own rows:
/// [`SegmentationNetwork::folded`](posed_motion::segments::SegmentationNetwork::folded).
pub fn shape(inputs: usize, classes: usize) -> Shape {
    let filters = vec![64, 64, 128, 256, 512];
    Shape { inputs, filters, width: 3, classes, ahead: None, norm: Norm::Hidden }
}

/// Training of the network of [`shape`]: whole sequences at their own rate, one per step, Adam at a constant 1e-3, 25 passes,
/// each coordinate from 0 to 1; nothing is changed, masked or averaged, and the likeliest class of each frame is its label.
/// [`Features::rows`] resizes the image.
pub fn options() -> Options {
    let Shape { filters, width, ahead, norm, .. } = shape(0, 0);
    Options {
        epochs: 25,
        passes: 1.0,
        rate_hz: None,
        crop_s: None,
        batch: 1,
        learning_rate: 1e-3,
        constant_rate: true,
        decay: 0.0,
        dropout: 0.0,
        smoothing: 0.0,
        averaging: 0.0,
        mask_s: 0.0,
        features: Features::default(),
        filters,
        width,
        ahead,
        norm,
        minimum: 0.0,
        switch: 0.0,
        wait_s: 0.0,
        augmentation: Augmentation::OFF,
        ..Options::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posed_motion::segments::{SegmentationNetwork, Workspace};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn the_network_has_the_printed_numbers() {
        let image = shape(224 * 3, 10);
        assert_eq!(image.parameters(), 663_562);
        assert_eq!(shape(19 * 3, 10).parameters(), 545_482);
        assert_eq!((image.receptive_field(), image.delay()), (243, 121));
        let wide = Shape { width: 5, ..shape(57, 10) };
        assert_eq!(wide.receptive_field(), 3125);
        for ahead in [0, 12, 36, 121] {
            let shape = Shape { ahead: Some(ahead), ..shape(57, 10) };
            assert_eq!((shape.delay(), shape.receptive_field()), (ahead, 243));
        }
    }

    #[test]
    fn a_change_reaches_exactly_121_frames_to_each_side() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        // Without NormReLU, whose arg max hides changes of other channels only behind rounding; the reach is the same.
        let shape = Shape { norm: Norm::Off, ..shape(57, 10) };
        let network = SegmentationNetwork::<f32>::random(shape, &mut rng);
        let (frames, at) = (400, 200);
        let mut x: Vec<f32> = (0..57 * frames).map(|_| rng.random_range(-1.0..1.0)).collect();
        let mut work = Workspace::default();
        network.forward(&x, &[], &mut work);
        let before = work.scores().to_vec();
        x[at * 57..(at + 1) * 57].iter_mut().for_each(|v| *v += 5.0);
        network.forward(&x, &[], &mut work);
        let changed: Vec<usize> = before
            .chunks(10)
            .zip(work.scores().chunks(10))
            .enumerate()
            .filter(|(_, (a, b))| a != b)
            .map(|(frame, _)| frame)
            .collect();
        assert_eq!((changed[0], changed[changed.len() - 1]), (at - 121, at + 121));
    }
}
