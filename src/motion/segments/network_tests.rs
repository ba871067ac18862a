//! The network against the paper's counts, numeric derivatives and itself as a stream.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::loss::cross_entropy;
use super::network::{Network, Norm, Shape, Workspace};
use super::stream::Stream;

fn random(count: usize, seed: u64) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(|_| rng.random_range(-1.0..1.0)).collect()
}

fn small(norm: Norm, ahead: Option<usize>) -> Shape {
    Shape { inputs: 4, filters: vec![5, 6, 7], width: 3, classes: 3, ahead, norm }
}

#[test]
fn the_paper_s_network_has_the_paper_s_numbers() {
    let image = Shape::paper(224 * 3, 10);
    assert_eq!(image.parameters(), 663_562);
    assert_eq!(Shape::paper(19 * 3, 10).parameters(), 545_482);
    assert_eq!((image.receptive_field(), image.delay()), (243, 121));
    let wide = Shape { width: 5, ..Shape::paper(57, 10) };
    assert_eq!(wide.receptive_field(), 3125);
    for ahead in [0, 12, 36, 121] {
        let shape = Shape { ahead: Some(ahead), ..Shape::paper(57, 10) };
        assert_eq!((shape.delay(), shape.receptive_field()), (ahead, 243));
    }
}

#[test]
fn a_change_reaches_exactly_121_frames_to_each_side() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    // Without NormReLU, whose arg max hides changes of other channels only behind rounding; the reach is the same.
    let shape = Shape { norm: Norm::Off, ..Shape::paper(57, 10) };
    let network = Network::<f32>::random(shape, &mut rng);
    let (frames, at) = (400, 200);
    let mut x: Vec<f32> = random(57 * frames, 2).iter().map(|v| *v as f32).collect();
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

/// Cross entropy and its slope by all parameters and the input, against central differences.
#[test]
fn gradients_agree_with_central_differences() {
    for (norm, ahead) in
        [(Norm::Hidden, None), (Norm::Scores, None), (Norm::Off, Some(2)), (Norm::Hidden, Some(0))]
    {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut network = Network::<f64>::random(small(norm, ahead), &mut rng);
        let biases = random(network.parameters.len(), 3);
        network.parameters.iter_mut().zip(biases).for_each(|(p, b)| *p += 0.1 * b);
        let frames = 31;
        let mut x = random(4 * frames, 4);
        let truth: Vec<u16> = (0..frames).map(|t| (t / 7 % 3) as u16).collect();
        let weights: Vec<f32> = (0..frames).map(|t| [1.0, 0.0, 0.5][t % 3]).collect();
        let dropout: Vec<f64> = (0..18).map(|c| if c % 5 == 0 { 0.0 } else { 1.25 }).collect();
        let value = |network: &Network<f64>, x: &[f64]| {
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
        let network = Network::<f32>::random(shape.clone(), &mut ChaCha8Rng::seed_from_u64(5));
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
        let mut network = Network::<f32>::random(shape.clone(), &mut rng);
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
