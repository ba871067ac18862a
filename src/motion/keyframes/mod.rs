//! Key poses: the frames at which a rigid motion changes its velocity, live, with a stated delay.
//!
//! What comes in: one pose per frame, evenly spaced. What goes out: [`Event`]s: a change is *provisional* once
//! the statistic has turned, and *confirmed* when none of the following frames exceeds it, or else
//! *withdrawn*; offline also a [`path`] through the key poses. What it never does: depend on how the poses
//! arrive, allocate per frame once warm.
//!
//! Two statistics: [`Method::Hinge`] (the default) and [`Method::Paper`] (Merckel and Nishida, 2010). Both
//! decide `2 N` frames late, the smoothed paper's method `2 N + 18`; neither within `N` frames (`N + 18`) of the
//! ends.

mod basis;
mod hinge;
mod law;
mod paper;
pub mod path;
mod peaks;
pub mod picture;
pub mod track;
mod window;

use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use hinge::Hinge;
pub use hinge::HingeSettings;
use paper::Paper;
pub use paper::PaperSettings;
pub use peaks::Score;
use peaks::{Peak, Peaks};

/// How changes are found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Method {
    /// A hinge fitted beside a parabola, with a threshold that is a rate of false alarms.
    Hinge(HingeSettings),
    /// Weighted means in se(3), as published.
    Paper(PaperSettings),
}

impl Method {
    fn window(&self) -> usize {
        match self {
            Self::Hinge(settings) => settings.window,
            Self::Paper(settings) => settings.window,
        }
    }
}

/// A frame at which the motion changes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyPose {
    /// The frame, counted from 0 at the first push.
    pub frame: u64,
    /// The statistic there.
    pub score: f64,
    /// Whether the velocity changes at once, within a frame or two.
    pub corner: bool,
    /// The frame whose pose decided it.
    pub decided: u64,
}

/// What became known with a frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Event {
    /// Probably a change; will be confirmed or withdrawn.
    Provisional(KeyPose),
    /// A change, for good.
    Confirmed(KeyPose),
    /// Said too early: a larger change is near.
    Withdrawn(KeyPose),
}

/// Value of the statistic at a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trace {
    /// The frame, counted from 0 at the first push.
    pub frame: u64,
    /// What the method makes of it.
    pub score: Score,
}

/// Finds the key poses of one sensor, frame by frame.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Detector {
    statistic: Statistic,
    peaks: Peaks,
    /// Poses taken.
    frames: u64,
    /// Frame of the first score.
    first: u64,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
enum Statistic {
    Hinge(Box<Hinge>),
    Paper(Box<Paper>),
}

impl Detector {
    /// Makes a detector; some milliseconds for the hinge fit, whose threshold is computed here.
    pub fn new(method: Method) -> Self {
        let statistic = match method {
            Method::Hinge(settings) => Statistic::Hinge(Box::new(Hinge::new(settings))),
            Method::Paper(settings) => Statistic::Paper(Box::new(Paper::new(settings))),
        };
        Self { statistic, peaks: Peaks::new(method.window()), frames: 0, first: 0 }
    }

    /// Value that a score must exceed; the paper's method has none, its limit depends on the motion.
    pub fn threshold(&self) -> Option<f64> {
        match &self.statistic {
            Statistic::Hinge(hinge) => Some(hinge.threshold()),
            Statistic::Paper(_) => None,
        }
    }

    /// Frames from a change to its confirmation.
    pub fn delay_frames(&self) -> usize {
        self.lag() + self.peaks.reach()
    }

    /// Takes the next frame's pose; gives the statistic at an earlier frame, once there is one.
    pub fn push(&mut self, pose: &Isometry3<f64>, event: &mut impl FnMut(Event)) -> Option<Trace> {
        let score = match &mut self.statistic {
            Statistic::Hinge(hinge) => hinge.push(pose),
            Statistic::Paper(paper) => paper.push(pose),
        };
        let decided = self.frames;
        self.frames += 1;
        let score = score?;
        let frame = decided - self.lag() as u64;
        if self.first == 0 {
            self.first = frame;
        }
        let first = self.first;
        self.peaks.push(score, &mut |peak| event(Event::of(peak, first, decided)));
        Some(Trace { frame, score })
    }

    /// Ends the motion: decides what can be decided without its future.
    pub fn finish(&mut self, event: &mut impl FnMut(Event)) {
        let (first, decided) = (self.first, self.frames.saturating_sub(1));
        self.peaks.finish(&mut |peak| event(Event::of(peak, first, decided)));
    }

    /// Takes a whole motion: confirmed key poses in order, and the statistic over time.
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

    fn lag(&self) -> usize {
        match &self.statistic {
            Statistic::Hinge(hinge) => hinge.lag(),
            Statistic::Paper(paper) => paper.lag(),
        }
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

/// Key poses of a whole motion: the confirmed ones, in order.
pub fn detect(method: Method, poses: &[Isometry3<f64>]) -> Vec<KeyPose> {
    detect_with_trace(method, poses).0
}

/// Key poses of a whole motion and the statistic over time.
pub fn detect_with_trace(method: Method, poses: &[Isometry3<f64>]) -> (Vec<KeyPose>, Vec<Trace>) {
    Detector::new(method).run(poses)
}

#[cfg(test)]
mod tests;
