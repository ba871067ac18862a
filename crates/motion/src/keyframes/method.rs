//! Which statistic key poses are looked for by, as an operator chooses it.

use nalgebra::Isometry3;
use posed_state::Plain;

use super::{Hinge, HingeSettings, MeanDifference, MeanDifferenceSettings, Score, Statistic};

/// Settings of the statistic that is wished.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub enum MethodSettings {
    /// A hinge fitted beside a parabola: the default.
    Hinge(HingeSettings),
    /// The difference of means in se(3) of Merckel and Nishida (2010).
    MeanDifference(MeanDifferenceSettings),
}

impl MethodSettings {
    /// For another rate of frames, Hz.
    pub fn at(self, frame_rate_hz: f64) -> Self {
        match self {
            Self::Hinge(settings) => Self::Hinge(HingeSettings { frame_rate_hz, ..settings }),
            Self::MeanDifference(_) => self,
        }
    }
}

/// A statistic that was chosen at run time.
#[derive(Clone, Debug, Plain)]
pub enum Method {
    /// A hinge fitted beside a parabola.
    Hinge(Hinge),
    /// The difference of means in se(3).
    MeanDifference(MeanDifference),
}

impl Method {
    /// The statistic before its first pose.
    pub fn new(settings: MethodSettings) -> Self {
        match settings {
            MethodSettings::Hinge(settings) => Self::Hinge(Hinge::new(settings)),
            MethodSettings::MeanDifference(settings) => Self::MeanDifference(MeanDifference::new(settings)),
        }
    }
}

impl Statistic for Method {
    fn push(&mut self, pose: &Isometry3<f64>) -> Option<Score> {
        match self {
            Self::Hinge(statistic) => statistic.push(pose),
            Self::MeanDifference(statistic) => statistic.push(pose),
        }
    }

    fn lag_frames(&self) -> usize {
        match self {
            Self::Hinge(statistic) => statistic.lag_frames(),
            Self::MeanDifference(statistic) => statistic.lag_frames(),
        }
    }

    fn reach_frames(&self) -> usize {
        match self {
            Self::Hinge(statistic) => statistic.reach_frames(),
            Self::MeanDifference(statistic) => statistic.reach_frames(),
        }
    }
}
