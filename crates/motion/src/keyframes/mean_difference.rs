//! Change points as a difference of means in se(3).
//!
//! L. Merckel and T. Nishida, "Change-point detection on the Lie group SE(3) for segmenting gesture-defined spatial rigid
//! motion" (2010, SciTePress; no DOI found).
//!
//! What comes in: poses `M_0, M_1, ...`, one per frame, evenly spaced. What goes out: [`MeanDifference`], a
//! [`Statistic`] of whose peaks a [`Detector`](super::Detector) makes key poses.
//!
//! With the twists `phi_j = Log(M_j^-1 M_(j+1))` and the half width `N` of the mask, the weighted means after and before
//! a frame are
//!
//! ```text
//! zeta_R(i) = sum over k = 0 .. N-1 of (N - k) / (2 N + 1) phi_(i + k)
//! zeta_L(i) = sum over k = 0 .. N-1 of (k + 1) / (2 N + 1) phi_(i - N + k)
//! eta(i)    = | zeta_R(i) - zeta_L(i) |,  the Frobenius norm of the 4 x 4 matrix: sqrt(2 |w|^2 + |v|^2)
//! ```
//! A frame changes where `eta` exceeds all others within `n` frames (eq. 23), and `x | zeta_L |`. It does not depend on the frame of
//! reference, but on where the sensor sits on the body and, through [`MeanDifferenceSettings::metres_per_radian`],
//! on the unit of length. A change is decided `N + n` frames late, with both smoothers 18 later.
//!
//! Repaired or chosen here, where the paper errs or is silent:
//! - The logarithm of eq. (10) cancels for the small rotations between consecutive poses (3e-3 at 1e-6 rad); it is the closed
//!   form of [`posed_geometry::se3`] instead.
//! - A single jump makes two equal maxima, both of which the paper's strict "greater" refuses: the first one counts.
//! - The sizes of the smoothers are not printed: a Gaussian over 17 poses, and a parabola over 21 values of `eta`.
//! - Turning counts as 0.1 m per radian by default. The paper adds radians and centimetres, which is 0.01.

use nalgebra::{Isometry3, Vector3};

use super::basis::dot;
use super::smooth::{mean_rotation, parabola_weights};
use super::{Score, Statistic, Window};
use posed_geometry::se3;
use posed_state::Plain;

/// Half width of the Gaussian that smooths the motion, frames, and its standard deviation.
const MOTION_HALF: usize = 8;
const MOTION_SIGMA: f64 = 4.0;
/// Half width of the Savitzky-Golay filter of order 2 that smooths the statistic, frames.
const SCORE_HALF: usize = 10;
/// The running sums are formed anew after so many frames, so that rounding cannot pile up.
const RENEW_FRAMES: u32 = 1000;

/// Settings of [`MeanDifference`]. The default: `N = n` = 30 frames, 0.1 m per radian, `x` = 0.5, smoothed.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct MeanDifferenceSettings {
    /// `N`: half width of the mask, frames; 0 counts as 1.
    pub window: usize,
    /// `n`: on either side a peak must exceed all others within so many frames; 0 counts as 1. The paper proposes `N`.
    pub neighbourhood: usize,
    /// What a rotation by 1 rad counts as against a displacement, m. The paper adds rad and cm: 0.01.
    pub metres_per_radian: f64,
    /// `x`: a peak must exceed this share of the mean twist before it.
    pub acceptance: f64,
    /// Smooth the motion and the statistic, as the paper does; it costs 18 frames of delay.
    pub smooth: bool,
}

impl Default for MeanDifferenceSettings {
    fn default() -> Self {
        Self { window: 30, neighbourhood: 30, metres_per_radian: 0.1, acceptance: 0.5, smooth: true }
    }
}

/// Scaled twist: its length is the Frobenius norm of the paper's 4 x 4 matrix.
type Scaled = [f64; 6];

/// The statistic `eta`, frame by frame, with a constant cost: poses (m; sensor to the frame of reference) in, scores in m per
/// frame out, [`lag_frames`](Statistic::lag_frames) late. Every change counts as a corner. It has no randomness.
#[derive(Clone, Debug, Plain)]
pub struct MeanDifference {
    settings: MeanDifferenceSettings,
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
#[derive(Clone, Copy, Debug, Default, Plain)]
struct Sums {
    plain_left: Scaled,
    plain_right: Scaled,
    weighted_left: Scaled,
    weighted_right: Scaled,
}

impl MeanDifference {
    /// The statistic before its first pose.
    pub fn new(settings: MeanDifferenceSettings) -> Self {
        let n = settings.window.max(1);
        let (motion_half, score_half) = if settings.smooth { (MOTION_HALF, SCORE_HALF) } else { (0, 0) };
        Self {
            settings: MeanDifferenceSettings { window: n, ..settings },
            poses: Window::new(2 * motion_half + 1),
            motion_weights: gaussian(motion_half),
            last: None,
            twists: Window::new(2 * n),
            sums: Sums::default(),
            until_renewal: 0,
            scores: Window::new(2 * score_half + 1),
            means: Window::new(2 * score_half + 1),
            score_weights: parabola_weights(score_half),
        }
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
        let mut position = Vector3::zeros();
        for (pose, weight) in poses.iter().zip(&self.motion_weights) {
            position += Vector3::new(pose[0], pose[1], pose[2]) * *weight;
        }
        let turned = poses.iter().zip(&self.motion_weights).map(|(pose, weight)| (&pose[3..], *weight));
        let rotation = mean_rotation(turned, &poses[MOTION_HALF][3..]);
        Some(Isometry3::from_parts(position.into(), rotation))
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

impl Statistic for MeanDifference {
    fn push(&mut self, pose: &Isometry3<f64>) -> Option<Score> {
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
        let threshold = self.settings.acceptance * mean;
        Some(Score { value, threshold, accepted: value > threshold, corner: true })
    }

    fn lag_frames(&self) -> usize {
        self.settings.window + self.motion_weights.len() / 2 + self.score_weights.len() / 2
    }

    fn reach_frames(&self) -> usize {
        self.settings.neighbourhood.max(1)
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

/// Gaussian weights that sum to one.
fn gaussian(half: usize) -> Vec<f64> {
    let weight = |k: usize| {
        let z = (k as f64 - half as f64) / MOTION_SIGMA;
        libm::exp(-0.5 * z * z)
    };
    let weights: Vec<f64> = (0..2 * half + 1).map(weight).collect();
    let sum: f64 = weights.iter().sum();
    weights.into_iter().map(|weight| weight / sum).collect()
}

#[cfg(test)]
#[path = "mean_difference_tests.rs"]
mod tests;
