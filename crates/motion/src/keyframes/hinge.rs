//! The hinge-fit statistic: does the velocity change in the middle of this window?
//!
//! What comes in: poses. What goes out: for six channels (position, and the rotation from the window's mean
//! rotation) the squared coefficient of a hinge fitted beside a parabola, over its variance. It is free of units and
//! of the frame of reference, and its law in noise is known, so that a threshold is a rate of false alarms.
//!
//! Two things keep that rate where the noise is not white or the motion no parabola. Correlated residuals
//! mean fewer samples than there are frames: the statistic is divided by what noise of the correlation seen in
//! the residuals would make of it. And a peak is only accepted where a hinge explains more than the fourth
//! power of time does, which is what a smooth motion has beyond a parabola.

use nalgebra::{Isometry3, Quaternion, UnitQuaternion};
use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::basis::{Basis, Correlation, MODEL, dot};
use super::smooth::mean_rotation;
use super::{Score, Statistic, Window};
use posed_geometry::so3;

/// The correlation of the noise is averaged over so many windows.
const MEMORY_WINDOWS: f64 = 16.0;
/// A window's own correlation counts when it is so many standard deviations above the average.
const GUARD_SIGMAS: f64 = 3.0;

/// Settings of the hinge fit. The default is N = 30, one false alarm per minute, 100 Hz, with orientations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct HingeSettings {
    /// `N`: frames on either side of the middle, and the reach within which a peak must exceed all others; below 5 it
    /// counts as 5. Larger finds finer changes, later, and hides changes that are near each other.
    pub window: usize,
    /// False alarms per minute that noise may cause, above 0; it sets the threshold. A noise model, no promise for
    /// quick motion.
    pub false_alarms_per_min: f64,
    /// Frames per second, Hz; it turns the rate of alarms into one per frame.
    pub frame_rate_hz: f64,
    /// Whether the poses have orientations; else only positions are looked at.
    pub orientation: bool,
}

impl Default for HingeSettings {
    fn default() -> Self {
        Self { window: 30, false_alarms_per_min: 1.0, frame_rate_hz: 100.0, orientation: true }
    }
}

/// The hinge-fit statistic: squared coefficient of a change of velocity over its variance, summed over the channels,
/// the larger of a sudden and an eased change. Without unit, and independent of the frame of reference. Lag and reach
/// are both `N` frames.
///
/// Equations and limits: `docs/methods/change-points.md`. More than half a turn within `N` frames is beyond it.
#[derive(Clone, Debug, Plain)]
pub struct Hinge {
    settings: HingeSettings,
    threshold: f64,
    basis: Basis,
    correlation: Correlation,
    positions: Window<[f64; 3]>,
    orientations: Window<[f64; 4]>,
    /// Smallest change of a word that was seen, for positions (m) and quaternions: the step of the device's words.
    steps: [f64; 2],
    /// Mean correlation of residuals, of positions and of rotations, and of how many windows.
    seen: [f64; 2],
    windows: f64,
    #[state(skip)]
    channels: Vec<f64>,
}

impl Hinge {
    /// The statistic before its first pose. It takes some milliseconds, for the threshold is computed here.
    pub fn new(settings: HingeSettings) -> Self {
        let half = settings.window.max(5);
        let basis = Basis::new(half);
        let rate = settings.false_alarms_per_min / (60.0 * settings.frame_rate_hz);
        let channels = if settings.orientation { 6 } else { 3 };
        let (threshold, correlation) = Correlation::new(&basis, channels, rate);
        Self {
            settings: HingeSettings { window: half, ..settings },
            threshold,
            basis,
            correlation,
            positions: Window::new(2 * half + 1),
            orientations: Window::new(2 * half + 1),
            steps: [f64::INFINITY; 2],
            seen: [0.0; 2],
            windows: 0.0,
            channels: Vec::new(),
        }
    }

    /// Remembers a pose, and the smallest step of its words.
    fn take(&mut self, pose: &Isometry3<f64>) {
        let position: [f64; 3] = pose.translation.vector.into();
        let q = &pose.rotation;
        let quaternion = [q.w, q.i, q.j, q.k];
        if let Some(last) = self.positions.latest().last() {
            self.steps[0] = smallest_step(self.steps[0], last, &position);
        }
        if let Some(last) = self.orientations.latest().last() {
            self.steps[1] = smallest_step(self.steps[1], last, &quaternion);
        }
        self.positions.push(position);
        self.orientations.push(quaternion);
    }

    /// Six channels over the window, each from its middle.
    fn fill_channels(&mut self) -> Option<()> {
        let positions = self.positions.full()?;
        let orientations = self.orientations.full()?;
        let (width, half) = (positions.len(), positions.len() / 2);
        self.channels.resize(6 * width, 0.0);
        for c in 0..3 {
            let middle = positions[half][c];
            let channel = &mut self.channels[c * width..(c + 1) * width];
            channel.iter_mut().zip(positions).for_each(|(value, position)| *value = position[c] - middle);
        }
        if self.settings.orientation {
            let turned = orientations.iter().map(|q| (&q[..], 1.0));
            let from_mean = mean_rotation(turned, &orientations[half]).inverse();
            for (k, q) in orientations.iter().enumerate() {
                let q = UnitQuaternion::new_unchecked(Quaternion::new(q[0], q[1], q[2], q[3]));
                let w = so3::log(&(from_mean * q));
                for c in 0..3 {
                    self.channels[(3 + c) * width + k] = w[c];
                }
            }
        }
        Some(())
    }
}
impl Statistic for Hinge {
    fn push(&mut self, pose: &Isometry3<f64>) -> Option<Score> {
        self.take(pose);
        self.fill_channels()?;
        let width = self.basis.hinge.len();
        let groups = if self.settings.orientation { 2 } else { 1 };
        let (mut sharp, mut gentle) = (0.0, 0.0);
        let (mut hinge, mut eased, mut quartic) = (0.0, 0.0, 0.0);
        self.windows = (self.windows + 1.0).min(MEMORY_WINDOWS * width as f64);
        for group in 0..groups {
            let fits: [Fit; 3] = std::array::from_fn(|c| {
                let start = (3 * group + c) * width;
                Fit::of(&mut self.channels[start..start + width], &self.basis)
            });
            let mean = fits.iter().map(|fit| fit.correlation).sum::<f64>() / 3.0;
            self.seen[group] += (mean - self.seen[group]) / self.windows;
            // The rotation's step is twice the quaternion's.
            let step = self.steps[group] * [1.0, 2.0][group];
            let floor = if step.is_finite() { 0.25 * step * step } else { 0.0 };
            for fit in &fits {
                let variance = fit.variance + floor;
                if variance <= 0.0 {
                    continue;
                }
                let guard = GUARD_SIGMAS * (1.0 - fit.correlation * fit.correlation) / (width as f64).sqrt();
                let seen = self.seen[group].max(fit.correlation - guard);
                let white = variance * self.correlation.factor(seen);
                sharp += fit.hinge * fit.hinge / white;
                gentle += fit.eased * fit.eased / white;
                hinge += fit.hinge * fit.hinge / variance;
                eased += fit.eased * fit.eased / variance;
                quartic += fit.quartic * fit.quartic / variance;
            }
        }
        // A change is sharp or eased, whichever fits better; the two shapes are so alike that noise hardly gains.
        let value = f64::max(sharp, gentle);
        let accepted = value > self.threshold && f64::max(hinge, eased) >= quartic;
        Some(Score { value, threshold: self.threshold, accepted, corner: hinge >= eased })
    }

    fn lag_frames(&self) -> usize {
        self.settings.window
    }

    fn reach_frames(&self) -> usize {
        self.settings.window
    }
}

/// The smallest change of a word that is more than rounding.
fn smallest_step<const N: usize>(known: f64, last: &[f64; N], next: &[f64; N]) -> f64 {
    let steps = last.iter().zip(next).map(|(a, b)| (a - b).abs());
    steps.filter(|step| *step > 1e-12).fold(known, f64::min)
}

/// What one channel holds.
struct Fit {
    /// Coefficients of the orthonormal shapes, each beside the parabola.
    hinge: f64,
    eased: f64,
    quartic: f64,
    /// Variance of the residuals of parabola, hinge and easing.
    variance: f64,
    /// Their first autocorrelation.
    correlation: f64,
}

impl Fit {
    /// Fits; leaves the residuals in `channel`.
    fn of(channel: &mut [f64], basis: &Basis) -> Self {
        for shape in &basis.smooth {
            subtract(channel, shape, dot(channel, shape));
        }
        let hinge = dot(channel, &basis.hinge);
        let eased = dot(channel, &basis.eased);
        let quartic = dot(channel, &basis.quartic);
        subtract(channel, &basis.hinge, hinge);
        subtract(channel, &basis.easing, dot(channel, &basis.easing));
        let squares = dot(channel, channel);
        let beside = dot(&channel[1..], &channel[..channel.len() - 1]);
        Self {
            hinge,
            eased,
            quartic,
            variance: squares / (channel.len() - MODEL) as f64,
            correlation: if squares > 0.0 { beside / squares } else { 0.0 },
        }
    }
}

fn subtract(channel: &mut [f64], shape: &[f64], share: f64) {
    channel.iter_mut().zip(shape).for_each(|(value, shape)| *value -= share * shape);
}

#[cfg(test)]
#[path = "hinge_tests.rs"]
mod tests;
