//! The network against numeric derivatives and itself as a stream.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::loss::cross_entropy;
use super::network::{Norm, SegmentationNetwork, Shape, Workspace};
use super::stream::Stream;

fn random(count: usize, seed: u64) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(|_| rng.random_range(-1.0..1.0)).collect()
}

fn small(norm: Norm, ahead: Option<usize>) -> Shape {
    Shape { inputs: 4, filters: vec![5, 6, 7], width: 3, classes: 3, ahead, norm }
}

/// Cross entropy and its slope by all parameters and the input, against central differences.
#[test]
fn gradients_agree_with_central_differences() {
    for (norm, ahead) in
        [(Norm::Hidden, None), (Norm::Scores, None), (Norm::Off, Some(2)), (Norm::Hidden, Some(0))]
    {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut network = SegmentationNetwork::<f64>::random(small(norm, ahead), &mut rng);
        let biases = random(network.parameters.len(), 3);
        network.parameters.iter_mut().zip(biases).for_each(|(p, b)| *p += 0.1 * b);
        let frames = 31;
        let mut x = random(4 * frames, 4);
        let truth: Vec<u16> = (0..frames).map(|t| (t / 7 % 3) as u16).collect();
        let weights: Vec<f32> = (0..frames).map(|t| [1.0, 0.0, 0.5][t % 3]).collect();
        let dropout: Vec<f64> = (0..18).map(|c| if c % 5 == 0 { 0.0 } else { 1.25 }).collect();
        let value = |network: &SegmentationNetwork<f64>, x: &[f64]| {
            let mut work = Workspace::default();
            network.forward(x, &dropout, &mut work);
            cross_entropy(work.scores(), 3, &truth, &weights, 0.1, &mut Vec::new()).sum
        };
        let mut work = Workspace::default();
        network.forward(&x, &dropout, &mut work);
        let mut slope = Vec::new();
        cross_entropy(work.scores(), 3, &truth, &weights, 0.1, &mut slope);
        let mut gradient = vec![0.0; network.parameters.len()];
        let mut dx = Vec::new();
        network.backward(&x, &dropout, &slope, &mut work, &mut gradient, Some(&mut dx));
        let step = 1e-6;
        let off = |numeric: f64, exact: f64| (numeric - exact).abs() / exact.abs().max(1.0);
        let mut worst = 0.0_f64;
        for (index, gradient) in gradient.iter().enumerate() {
            let old = network.parameters[index];
            network.parameters[index] = old + step;
            let above = value(&network, &x);
            network.parameters[index] = old - step;
            let below = value(&network, &x);
            network.parameters[index] = old;
            worst = worst.max(off((above - below) / (2.0 * step), *gradient));
        }
        for (index, dx) in dx.iter().enumerate() {
            let old = x[index];
            x[index] = old + step;
            let above = value(&network, &x);
            x[index] = old - step;
            let below = value(&network, &x);
            x[index] = old;
            worst = worst.max(off((above - below) / (2.0 * step), *dx));
        }
        assert!(worst < 1e-6, "{norm:?} {ahead:?}: {worst:e}");
    }
}

#[test]
fn ten_classes_with_normed_scores_never_pass_a_quarter() {
    let mut scores = [0.0_f64; 10];
    scores[3] = 1.0;
    let loss = cross_entropy(&scores, 10, &[3], &[1.0], 0.0, &mut Vec::new());
    assert!((loss.sum - 1.461).abs() < 1e-3, "{}", loss.sum);
}

/// Two blocks apart, two so near that they share what they see, and the ends.
#[test]
fn parts_score_as_the_whole_does() {
    for ahead in [None, Some(0), Some(4)] {
        let shape = small(Norm::Hidden, ahead);
        let network = SegmentationNetwork::<f32>::random(shape.clone(), &mut ChaCha8Rng::seed_from_u64(5));
        let x: Vec<f32> = random(4 * 300, 6).iter().map(|v| *v as f32).collect();
        let mut work = Workspace::default();
        network.infer(&x, &mut work);
        let whole = work.scores().to_vec();
        let weighted = [0..3, 60..70, 150..160, 170..171, 290..300];
        let weights: Vec<f32> = (0..300)
            .map(|at| if weighted.iter().any(|part| part.contains(&at)) { 1.0 } else { 0.0 })
            .collect();
        let parts = shape.parts_that_score(&weights);
        assert_eq!(parts.len(), 4, "{ahead:?}: {parts:?}");
        let mut scored = 0;
        for part in parts {
            network.infer(&x[4 * part.start..4 * part.end], &mut work);
            for (at, scores) in part.zip(work.scores().chunks(3)).filter(|(at, _)| weights[*at] > 0.0) {
                scored += 1;
                for (a, b) in scores.iter().zip(&whole[3 * at..]) {
                    assert!((a - b).abs() < 1e-6, "{ahead:?} {at}: {a} {b}");
                }
            }
        }
        assert_eq!(scored, 34);
    }
}

/// Borders included: every frame of the sequence, whatever the look-ahead, whatever its length.
#[test]
fn a_stream_says_what_the_batch_says() {
    for (norm, ahead) in
        [(Norm::Hidden, None), (Norm::Scores, Some(0)), (Norm::Off, Some(4)), (Norm::Hidden, Some(12))]
    {
        let shape = small(norm, ahead);
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let mut network = SegmentationNetwork::<f32>::random(shape.clone(), &mut rng);
        network.parameters.iter_mut().for_each(|p| *p += 0.05);
        for frames in [1, 5, 13, 14, 60] {
            let x: Vec<f32> = random(4 * frames, 12).iter().map(|v| *v as f32).collect();
            let mut work = Workspace::default();
            network.infer(&x, &mut work);
            let mut stream = Stream::new(&network);
            let mut streamed = Vec::new();
            for (index, row) in x.chunks(4).enumerate() {
                let scores = stream.push(&network, row);
                assert_eq!(scores.is_some(), index >= shape.delay());
                streamed.extend_from_slice(scores.unwrap_or(&[]));
            }
            stream.finish(&network, &mut |scores| streamed.extend_from_slice(scores));
            assert_eq!(streamed.len(), 3 * frames, "{ahead:?} {frames}");
            for (a, b) in streamed.iter().zip(work.scores()) {
                assert!((a - b).abs() < 1e-5, "{norm:?} {ahead:?} {frames}: {a} {b}");
            }
        }
    }
}
