//! Softmax cross entropy per frame, with weights that mask frames.
//!
//! What comes in: scores, the class of each frame, a weight per frame (zero: not learned from). What goes out: the
//! weighted sum of the losses in nats, how many frames are right, and the slope by the scores. What it never does:
//! divide; the caller knows over how many frames it means.

use super::real::Real;

/// What the frames of a pass sum up to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Loss {
    /// Sum of the weighted losses, nats.
    pub sum: f64,
    /// Sum of the weights.
    pub weight: f64,
    /// Sum of the weights of the frames whose highest score is the right one.
    pub right: f64,
}

impl Loss {
    /// Adds the sums of another part.
    pub fn add(&mut self, other: Self) {
        self.sum += other.sum;
        self.weight += other.weight;
        self.right += other.right;
    }

    /// Mean loss per frame, nats; 0 without frames.
    pub fn mean(&self) -> f64 {
        self.sum / self.weight.max(f64::MIN_POSITIVE)
    }

    /// Weighted share of frames whose highest score is the right one, 0 to 1; 0 without frames.
    pub fn accuracy(&self) -> f64 {
        self.right / self.weight.max(f64::MIN_POSITIVE)
    }
}

/// Index of the largest score; the lowest of equals, 0 without scores.
pub fn best<R: Real>(scores: &[R]) -> usize {
    let mut best = 0;
    for (class, score) in scores.iter().enumerate() {
        if *score > scores[best] {
            best = class;
        }
    }
    best
}

/// Turns scores into probabilities in place; their sum is 1.
pub fn softmax<R: Real>(scores: &mut [R]) {
    let most = scores.get(best(scores)).copied().unwrap_or_default();
    let mut sum = R::ZERO;
    for score in scores.iter_mut() {
        *score = (*score - most).exp();
        sum += *score;
    }
    scores.iter_mut().for_each(|score| *score = *score / sum);
}

/// Sums the weighted cross entropy of `scores` (frame by frame, `classes` each) against `truth`, one class per frame,
/// and writes to `slope` its derivative by the scores, in their shape. Frames of weight 0 do not count.
///
/// `smoothing` is the share of the target that is spread over all classes, 0 to 1.
pub fn cross_entropy<R: Real>(
    scores: &[R],
    classes: usize,
    truth: &[u16],
    weights: &[f32],
    smoothing: f64,
    slope: &mut Vec<R>,
) -> Loss {
    slope.clear();
    slope.extend_from_slice(scores);
    let mut loss = Loss::default();
    let spread = smoothing / classes as f64;
    for ((row, class), weight) in slope.chunks_exact_mut(classes).zip(truth).zip(weights) {
        if *weight == 0.0 {
            row.fill(R::ZERO);
            continue;
        }
        let (class, weight) = (usize::from(*class), f64::from(*weight));
        let right = best(row) == class;
        softmax(row);
        for (index, value) in row.iter_mut().enumerate() {
            let target = spread + if index == class { 1.0 - smoothing } else { 0.0 };
            if target > 0.0 {
                loss.sum -= weight * target * libm::log(value.to_f64().max(1e-30));
            }
            *value = R::of(weight) * (*value - R::of(target));
        }
        loss.weight += weight;
        loss.right += if right { weight } else { 0.0 };
    }
    loss
}
