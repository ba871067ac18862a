//! The statistic of Merckel and Nishida, "Change-point detection on the Lie group SE(3) for segmenting
//! gesture-defined spatial rigid motion" (2010).
//!
//! What comes in: poses. What goes out: `eta`, the length of the difference between the weighted mean of the twists
//! after a frame and of those before it, and whether the paper accepts a peak there. It does not depend on the frame
//! of reference, but on where the sensor sits on the body and, through the lever, on the unit of length.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::peaks::Score;
use super::window::Window;
use crate::geometry::se3;

/// Half width of the Gaussian that smooths the motion, frames, and its standard deviation.
const MOTION_HALF: usize = 8;
const MOTION_SIGMA: f64 = 4.0;
/// Half width of the Savitzky-Golay filter of order 2 that smooths the statistic, frames.
const SCORE_HALF: usize = 10;
/// The running sums are formed anew after so many frames, so that rounding cannot pile up.
const RENEW_FRAMES: u32 = 1000;

/// Settings of the paper's method.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PaperSettings {
    /// `N`: half width of the mask, and the reach within which a peak must exceed all others, frames.
    pub window: usize,
    /// What a turn by 1 rad counts as against a displacement, m. The paper adds rad and cm: 0.01.
    pub metres_per_radian: f64,
    /// `x`: a peak must exceed this share of the mean twist before it.
    pub acceptance: f64,
    /// Smooth the motion and the statistic, as the paper does.
    pub smooth: bool,
}

impl Default for PaperSettings {
    fn default() -> Self {
        Self { window: 30, metres_per_radian: 0.1, acceptance: 0.5, smooth: true }
    }
}

/// Scaled twist: its length is the Frobenius norm of the paper's 4 x 4 matrix.
type Scaled = [f64; 6];

/// The paper's statistic, frame by frame, with a constant cost.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Paper {
    settings: PaperSettings,
    /// Position and quaternion (w, x, y, z), signs as they come.
    poses: Window<[f64; 7]>,
    motion_weights: Vec<f64>,
    last: Option<Isometry3<f64>>,
    /// Twists phi of the mask: `N` before the frame and `N` from it on.
    twists: Window<Scaled>,
    sums: Sums,
    until_renewal: u32,
    scores: Window<f64>,
    /// |zetaL| beside `scores`.
    means: Window<f64>,
    score_weights: Vec<f64>,
}

/// Plain and index-weighted sums over both halves of the mask.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Sums {
    plain_left: Scaled,
    plain_right: Scaled,
    weighted_left: Scaled,
    weighted_right: Scaled,
}

impl Paper {
    pub(super) fn new(settings: PaperSettings) -> Self {
        let n = settings.window.max(1);
        let (motion_half, score_half) = if settings.smooth { (MOTION_HALF, SCORE_HALF) } else { (0, 0) };
        Self {
            settings: PaperSettings { window: n, ..settings },
            poses: Window::new(2 * motion_half + 1),
            motion_weights: gaussian(motion_half),
            last: None,
            twists: Window::new(2 * n),
            sums: Sums::default(),
            until_renewal: 0,
            scores: Window::new(2 * score_half + 1),
            means: Window::new(2 * score_half + 1),
            score_weights: savitzky_golay(score_half),
        }
    }

    /// How many frames a score is behind the pose that completes it.
    pub(super) fn lag(&self) -> usize {
        self.settings.window + self.motion_weights.len() / 2 + self.score_weights.len() / 2
    }

    pub(super) fn push(&mut self, pose: &Isometry3<f64>) -> Option<Score> {
        let pose = self.smooth(pose)?;
        let last = self.last.replace(pose)?;
        self.slide(self.scaled(&se3::log(&last.inv_mul(&pose))));
        self.twists.full()?;
        let scale = 1.0 / (2 * self.settings.window + 1) as f64;
        let (left, right) = (&self.sums.weighted_left, &self.sums.weighted_right);
        let delta: f64 = left.iter().zip(right).map(|(l, r)| (r - l) * (r - l)).sum();
        self.scores.push(scale * delta.sqrt());
        self.means.push(scale * left.iter().map(|l| l * l).sum::<f64>().sqrt());
        let value = dot(self.scores.full()?, &self.score_weights);
        let mean = self.means.full()?[self.score_weights.len() / 2];
        Some(Score { value, accepted: value > self.settings.acceptance * mean, corner: true })
    }

    /// Weighted mean of positions and of quaternions: to first order the mean in the tangent space of the centre
    /// pose, but without 17 logarithms, and well behaved for noise of any size.
    fn smooth(&mut self, pose: &Isometry3<f64>) -> Option<Isometry3<f64>> {
        if self.motion_weights.len() == 1 {
            return Some(*pose);
        }
        let (p, q) = (&pose.translation.vector, &pose.rotation);
        self.poses.push([p.x, p.y, p.z, q.w, q.i, q.j, q.k]);
        let poses = self.poses.full()?;
        let centre = &poses[MOTION_HALF];
        let mut sum = [0.0; 7];
        for (pose, weight) in poses.iter().zip(&self.motion_weights) {
            let cosine: f64 = (3..7).map(|c| pose[c] * centre[c]).sum();
            let turned = if cosine < 0.0 { -weight } else { *weight };
            for c in 0..3 {
                sum[c] += weight * pose[c];
            }
            for c in 3..7 {
                sum[c] += turned * pose[c];
            }
        }
        // All quaternions are within a right angle of the centre's, so the sum is not zero.
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(sum[3], sum[4], sum[5], sum[6]));
        Some(Isometry3::from_parts(Translation3::new(sum[0], sum[1], sum[2]), rotation))
    }

    fn scaled(&self, twist: &se3::Twist) -> Scaled {
        let lever = std::f64::consts::SQRT_2 * self.settings.metres_per_radian;
        let (w, v): (Vector3<f64>, &Vector3<f64>) = (twist.angular * lever, &twist.linear);
        [w.x, w.y, w.z, v.x, v.y, v.z]
    }

    /// Moves the mask on by one frame.
    fn slide(&mut self, newest: Scaled) {
        let n = self.settings.window;
        if let Some(twists) = self.twists.full()
            && self.until_renewal > 0
        {
            self.until_renewal -= 1;
            let (oldest, middle) = (twists[0], twists[n]);
            let count = n as f64;
            let Sums { plain_left, plain_right, weighted_left, weighted_right } = &mut self.sums;
            for c in 0..6 {
                plain_right[c] += newest[c] - middle[c];
                weighted_right[c] += plain_right[c] - count * middle[c];
                weighted_left[c] += count * middle[c] - plain_left[c];
                plain_left[c] += middle[c] - oldest[c];
            }
            self.twists.push(newest);
        } else {
            self.twists.push(newest);
            if let Some(twists) = self.twists.full() {
                self.sums = Sums::of(twists);
                self.until_renewal = RENEW_FRAMES;
            }
        }
    }
}

impl Sums {
    fn of(twists: &[Scaled]) -> Self {
        let n = twists.len() / 2;
        let mut sums = Self::default();
        for (k, (left, right)) in twists[..n].iter().zip(&twists[n..]).enumerate() {
            for c in 0..6 {
                sums.plain_left[c] += left[c];
                sums.plain_right[c] += right[c];
                sums.weighted_left[c] += (k + 1) as f64 * left[c];
                sums.weighted_right[c] += (n - k) as f64 * right[c];
            }
        }
        sums
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Gaussian weights that sum to one.
fn gaussian(half: usize) -> Vec<f64> {
    let weight = |k: usize| {
        let z = (k as f64 - half as f64) / MOTION_SIGMA;
        (-0.5 * z * z).exp()
    };
    let weights: Vec<f64> = (0..2 * half + 1).map(weight).collect();
    let sum: f64 = weights.iter().sum();
    weights.into_iter().map(|weight| weight / sum).collect()
}

/// Weights of the value at the centre of a least-squares parabola (Savitzky and Golay, 1964).
fn savitzky_golay(half: usize) -> Vec<f64> {
    if half == 0 {
        return vec![1.0];
    }
    let m = half as f64;
    let norm = (2.0 * m + 3.0) * (2.0 * m + 1.0) * (2.0 * m - 1.0);
    let weight = |k: usize| {
        let k = k as f64 - m;
        3.0 * (3.0 * m * m + 3.0 * m - 1.0 - 5.0 * k * k) / norm
    };
    (0..2 * half + 1).map(weight).collect()
}

#[cfg(test)]
#[path = "paper_tests.rs"]
mod tests;
