//! The `[keyframes]` table: where key poses are looked for, live, and how.

use posed_motion::keyframes::{HingeSettings, MeanDifferenceSettings, MethodSettings};
use serde::{Deserialize, Serialize};

/// Key poses, live: the frames at which a sensor's motion changes its velocity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Keyframes {
    /// Sensors that are watched, by name; absent: all.
    pub sensors: Option<Vec<String>>,
    /// `hinge`: a hinge fitted beside a parabola, with a stated rate of false alarms. `paper`: the difference of means in se(3) of Merckel and Nishida (2010).
    #[serde(default)]
    pub method: KeyframesMethod,
    /// Frames on either side of a change that are looked at, N; a change is confirmed twice as many later, with smoothing 18 more.
    #[serde(default = "default_window")]
    #[schemars(range(min = 5, max = 500))]
    pub window_frames: u16,
    /// False alarms per minute and sensor that noise may cause (hinge).
    #[serde(default = "default_rate")]
    #[schemars(range(min = 0.001, max = 60.0))]
    pub false_alarms_per_min: f64,
    /// On either side a change exceeds all others within so many frames, the paper's n; absent: `window_frames` (paper).
    #[schemars(range(min = 1, max = 500))]
    pub neighbourhood_frames: Option<u16>,
    /// What turning by one radian counts as against moving, m (paper).
    #[serde(default = "default_lever")]
    #[schemars(range(min = 0.001, max = 10.0))]
    pub metres_per_radian: f64,
    /// By what share of the mean motion before it a change must exceed it, the paper's x (paper).
    #[serde(default = "default_acceptance")]
    #[schemars(range(min = 0.001, max = 10.0))]
    pub acceptance: f64,
    /// Whether the motion and the statistic are smoothed, which costs 18 frames of delay (paper).
    #[serde(default = "default_smooth")]
    pub smooth: bool,
}

/// How key poses are looked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum KeyframesMethod {
    /// A hinge fitted beside a parabola.
    #[default]
    Hinge,
    /// Merckel and Nishida (2010).
    Paper,
}

impl Keyframes {
    /// Keys that one of the methods alone reads.
    pub(crate) const KEYS: [(&str, KeyframesMethod); 5] = [
        ("false_alarms_per_min", KeyframesMethod::Hinge),
        ("neighbourhood_frames", KeyframesMethod::Paper),
        ("metres_per_radian", KeyframesMethod::Paper),
        ("acceptance", KeyframesMethod::Paper),
        ("smooth", KeyframesMethod::Paper),
    ];

    /// What the detector of each sensor is made with, at a rate of frames in Hz; its poses have orientations.
    pub fn settings(&self, frame_rate_hz: f64) -> MethodSettings {
        let window = usize::from(self.window_frames);
        match self.method {
            KeyframesMethod::Hinge => MethodSettings::Hinge(HingeSettings {
                window,
                false_alarms_per_min: self.false_alarms_per_min,
                frame_rate_hz,
                orientation: true,
            }),
            KeyframesMethod::Paper => MethodSettings::MeanDifference(MeanDifferenceSettings {
                window,
                neighbourhood: self.neighbourhood_frames.map_or(window, usize::from),
                metres_per_radian: self.metres_per_radian,
                acceptance: self.acceptance,
                smooth: self.smooth,
            }),
        }
    }
}

impl Default for Keyframes {
    fn default() -> Self {
        Self {
            sensors: None,
            method: KeyframesMethod::default(),
            window_frames: default_window(),
            false_alarms_per_min: default_rate(),
            neighbourhood_frames: None,
            metres_per_radian: default_lever(),
            acceptance: default_acceptance(),
            smooth: default_smooth(),
        }
    }
}

fn default_window() -> u16 {
    30
}

fn default_rate() -> f64 {
    1.0
}

fn default_lever() -> f64 {
    MeanDifferenceSettings::default().metres_per_radian
}

fn default_acceptance() -> f64 {
    MeanDifferenceSettings::default().acceptance
}

fn default_smooth() -> bool {
    true
}
