//! Key poses: the frames at which a rigid motion changes its velocity, live, with a stated delay.
//!
//! What comes in: one pose per frame, evenly spaced. What goes out: [`Event`]s: a change is *provisional* once
//! the statistic has turned, and *confirmed* when none of the following frames exceeds it, or else
//! *withdrawn*; of a [`Track`] with each confirmed one the [`Screw`] from the one before it; offline also a [`path`] through the key poses. What it never
//! does: depend on how the poses arrive, allocate per frame once warm.
//!
//! A [`Detector`] looks for peaks of a [`Statistic`]: of [`Hinge`] unless another one is given, as the published [`MeanDifference`]. It decides
//! after the statistic's own lag and the reach of a peak, with the hinge `2 N` frames late; nothing is decided within the lag of
//! either end.
//!
//! A sensor that moves along one axis and then along another, by the published statistic and by the default:
//!
//! ```
//! use nalgebra::Isometry3;
//! use posed_motion::keyframes::{Detector, Hinge, HingeSettings, MeanDifference, MeanDifferenceSettings};
//!
//! // 200 poses, 1 cm a frame; it turns the corner at frame 100.
//! let poses: Vec<_> = (0..200)
//!     .map(|k| Isometry3::translation(0.01 * f64::from(k.min(100)), 0.01 * f64::from(k.max(100) - 100), 0.0))
//!     .collect();
//! let published = Detector::new(MeanDifference::new(MeanDifferenceSettings::default()));
//! let by_hinge = Detector::new(Hinge::new(HingeSettings::default()));
//! assert_eq!((published.delay_frames(), by_hinge.delay_frames()), (78, 60));
//! let (keys, _) = published.run(&poses);
//! assert_eq!(keys.iter().map(|key| key.frame).collect::<Vec<_>>(), [100]);
//! let (keys, _) = by_hinge.run(&poses);
//! assert!(keys[0].corner && keys[0].frame == 100);
//! ```

mod basis;
mod hinge;
mod law;
mod mean_difference;
mod method;
mod path;
mod peaks;
mod screw;
mod smooth;
#[cfg(test)]
mod testing;
mod track;
mod window;

use nalgebra::Isometry3;
use posed_state::Plain;
use serde::{Deserialize, Serialize};

pub use hinge::{Hinge, HingeSettings};
pub use mean_difference::{MeanDifference, MeanDifferenceSettings};
pub use method::{Method, MethodSettings};
pub use path::{Deviation, Spline, Velocity, segment_ends};
pub use peaks::Score;
use peaks::{Peak, Peaks};
pub use screw::{Screw, ScrewPath};
pub use track::{BRIDGED_FRAMES, Segment, Track, TrackEvent, bridge};
pub use window::Window;

/// A value per frame whose peaks are the key poses; each value belongs to an earlier frame.
pub trait Statistic {
    /// Takes the next frame's pose (m; sensor to the frame of reference); gives the value at the frame `lag_frames`
    /// before it. `None` until the first window is full, or where the method has no value.
    fn push(&mut self, pose: &Isometry3<f64>) -> Option<Score>;
    /// Frames from the one that a value belongs to until the pose that completes it.
    fn lag_frames(&self) -> usize;
    /// Within so many frames on either side a peak exceeds all other values; at least 1.
    fn reach_frames(&self) -> usize;
}

/// A frame at which the velocity of a motion changes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyPose {
    /// The frame, counted from 0 at the first push.
    pub frame: u64,
    /// The statistic there, in its own unit; compare it with the threshold. Larger is clearer, not larger in metres.
    pub score: f64,
    /// Whether the velocity changes at once, within a frame or two, rather than eased.
    pub corner: bool,
    /// The frame whose pose decided it; never before `frame`.
    pub decided: u64,
}

/// What became known about a key pose with a frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Event {
    /// Probably a change: the statistic has dropped below 70 % of it. It is confirmed or withdrawn later.
    Provisional(KeyPose),
    /// A change, for good; it comes `Detector::delay_frames` after the change, earlier only at the end of the motion.
    Confirmed(KeyPose),
    /// A provisional one that was exceeded: a larger change is near.
    Withdrawn(KeyPose),
}

/// Value of the statistic at a frame, whether or not it is a peak.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trace {
    /// The frame, counted from 0 at the first push.
    pub frame: u64,
    /// What the method makes of it.
    pub score: Score,
}

/// Finds the key poses of one sensor, frame by frame, from poses that are evenly spaced and complete; `track::Track`
/// takes gaps.
///
/// Constant time and no allocation per frame once warm. With the hinge a change is confirmed `2 N` frames later (0.6 s
/// with N = 30 at 100 Hz). Method: `docs/methods/change-points.md`; rates of false alarms and misses:
/// `docs/keyframes.md`.
#[derive(Clone, Debug, Plain)]
pub struct Detector<S = Hinge> {
    statistic: S,
    peaks: Peaks,
    /// Poses taken.
    frames: u64,
    /// Frame of the first score.
    first: u64,
}

impl<S: Statistic> Detector<S> {
    /// A detector that has seen nothing.
    pub fn new(statistic: S) -> Self {
        Self { peaks: Peaks::new(statistic.reach_frames()), statistic, frames: 0, first: 0 }
    }

    /// Frames from a change to its confirmation: lag of the statistic and reach of a peak.
    pub fn delay_frames(&self) -> usize {
        self.statistic.lag_frames() + self.peaks.reach()
    }

    /// Takes the next frame's pose (m; sensor to the frame of reference); `event` hears what became known with it.
    /// Returns the statistic at an earlier frame; `None` until the first window is full.
    pub fn push(&mut self, pose: &Isometry3<f64>, event: &mut dyn FnMut(Event)) -> Option<Trace> {
        let score = self.statistic.push(pose);
        let decided = self.frames;
        self.frames += 1;
        let score = score?;
        let frame = decided - self.statistic.lag_frames() as u64;
        if self.first == 0 {
            self.first = frame;
        }
        let first = self.first;
        self.peaks.push(score, &mut |peak| event(Event::of(peak, first, decided)));
        Some(Trace { frame, score })
    }

    /// Ends the motion: a candidate that the statistic has begun to leave is confirmed although its future is missing.
    /// Frames nearer to the end than the lag are not judged.
    pub fn finish(&mut self, event: &mut dyn FnMut(Event)) {
        let (first, decided) = (self.first, self.frames.saturating_sub(1));
        self.peaks.finish(&mut |peak| event(Event::of(peak, first, decided)));
    }

    /// Takes a whole motion: confirmed key poses in order, and the statistic over time. Provisional and withdrawn ones
    /// are left out. The first and last frames within the lag are never key poses.
    pub fn run(mut self, poses: &[Isometry3<f64>]) -> (Vec<KeyPose>, Vec<Trace>) {
        let mut keys = Vec::new();
        let mut keep = |event| {
            if let Event::Confirmed(key) = event {
                keys.push(key);
            }
        };
        let trace = poses.iter().filter_map(|pose| self.push(pose, &mut keep)).collect();
        self.finish(&mut keep);
        (keys, trace)
    }
}

impl Event {
    fn of(peak: Peak, first: u64, decided: u64) -> Self {
        let key = |at: u64, score: Score| KeyPose {
            frame: first + at,
            score: score.value,
            corner: score.corner,
            decided,
        };
        match peak {
            Peak::Provisional { at, score } => Self::Provisional(key(at, score)),
            Peak::Confirmed { at, score } => Self::Confirmed(key(at, score)),
            Peak::Withdrawn { at, score } => Self::Withdrawn(key(at, score)),
        }
    }
}

#[cfg(test)]
mod tests;
