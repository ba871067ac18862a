//! The `[keyframes]` table: where key poses are looked for, live, and how.

use posed_motion::keyframes::{HingeSettings, MeanDifferenceSettings, MethodSettings};
use serde::{Deserialize, Serialize};

/// Key poses, live: the frames at which a sensor's motion changes its velocity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Keyframes {
    /// Sensors that are watched, by name; absent: all.
    pub sensors: Option<Vec<String>>,
    /// `hinge`: a hinge fitted beside a parabola, with a stated rate of false alarms. `paper`: the difference of means in se(3) of Merckel and Nishida (2010).
    pub method: KeyframesMethod,
    /// Frames on either side of a change that are looked at, N; a change is confirmed twice as many later, with smoothing 18 more.
    #[schemars(range(min = 5, max = 500))]
    pub window_frames: u16,
    /// False alarms per minute and sensor that noise may cause (hinge).
    #[schemars(range(min = 0.001, max = 60.0))]
    pub false_alarms_per_min: f64,
    /// On either side a change exceeds all others within so many frames, the paper's n; absent: `window_frames` (paper).
    #[schemars(range(min = 1, max = 500))]
    pub neighbourhood_frames: Option<u16>,
    /// What turning by one radian counts as against moving, m (paper).
    #[schemars(range(min = 0.001, max = 10.0))]
    pub metres_per_radian: f64,
    /// By what share of the mean motion before it a change must exceed it, the paper's x (paper).
    #[schemars(range(min = 0.001, max = 10.0))]
    pub acceptance: f64,
    /// Whether the motion and the statistic are smoothed, which costs 18 frames of delay (paper).
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

    /// What the detector of a sensor is made with, at a rate of frames in Hz; `orientation`: whether its poses have one.
    pub fn settings(&self, frame_rate_hz: f64, orientation: bool) -> MethodSettings {
        let window = usize::from(self.window_frames);
        match self.method {
            KeyframesMethod::Hinge => MethodSettings::Hinge(HingeSettings {
                window,
                false_alarms_per_min: self.false_alarms_per_min,
                frame_rate_hz,
                orientation,
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
        let MeanDifferenceSettings { metres_per_radian, acceptance, smooth, .. } =
            MeanDifferenceSettings::default();
        Self {
            sensors: None,
            method: KeyframesMethod::default(),
            window_frames: 30,
            false_alarms_per_min: 1.0,
            neighbourhood_frames: None,
            metres_per_radian,
            acceptance,
            smooth,
        }
    }
}
