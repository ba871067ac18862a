//! Labels and repairs of single measurements, by physics.
//!
//! What comes in: a measured pose in the transmitter frame, and as an explicit argument what the previous
//! frame predicts for it. What goes out: a [`Checked`] measurement, mirrored back where the tracker chose the
//! wrong side of its transmitter. What it never does: filter, correct, look at the future. This module alone
//! decides between p and -p and what is stuck; `fusion` only gates what is left.

mod gate;
mod repetition;
pub mod som;

use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

pub(crate) use gate::squared_distance;
pub use gate::{Gate, Prediction};
use repetition::Repetition;

use crate::noise::TrackerNoise;

/// A measured pose of one sensor in the transmitter frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredPose {
    /// Position, m.
    pub position_m: Option<Vector3<f64>>,
    /// Sensor to transmitter.
    pub orientation: Option<UnitQuaternion<f64>>,
}

/// What is wrong with a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Label {
    /// Nothing is known against it.
    Clean,
    /// Mirrored, and mirrored back.
    Mirrored,
    /// The same words as before, where they should have changed; not yet often enough to be called stuck.
    Repeated,
    /// The same words again and again.
    Stuck,
    /// Outside the predicted gate, and no mirror image is inside.
    Outlier,
}

/// A measurement with its label; repaired where the label is [`Label::Mirrored`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Checked {
    /// The measurement, repaired.
    pub pose: MeasuredPose,
    /// What is wrong with it.
    pub label: Label,
}

/// The ways in which a tracker mirrors a position; the orientation stays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Mirror {
    /// p to -p: the field of a dipole is the same there.
    Point,
    /// z to -z: some set-ups mirror the vertical axis only.
    Vertical,
}

impl Mirror {
    fn apply(self, pose: &MeasuredPose) -> MeasuredPose {
        let position_m = pose.position_m.map(|p| match self {
            Self::Point => -p,
            Self::Vertical => Vector3::new(p.x, p.y, -p.z),
        });
        MeasuredPose { position_m, ..*pose }
    }
}

/// The fault detector of one sensor.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Detector {
    repetition: Repetition,
    /// How the latest measurement was repaired; kept while there is no prediction to judge by.
    mirror: Option<Mirror>,
}

impl Detector {
    /// Labels one measurement.
    ///
    /// `prediction` is the filter's, at the measurement's time; `None` while nothing is tracked.
    /// `others_move` says whether another sensor of the stage was moving in the previous frame.
    pub fn check(
        &mut self,
        pose: &MeasuredPose,
        prediction: Option<&Prediction>,
        noise: &TrackerNoise,
        others_move: bool,
    ) -> Checked {
        // A mirrored sensor repeats its mirrored words: hold the repetition against the same side.
        let seen = self.mirror.map_or(*pose, |mirror| mirror.apply(pose));
        if let Some(label) = self.repetition.check(pose, &seen, prediction, noise, others_move) {
            return Checked { pose: seen, label };
        }
        let Some(prediction) = prediction else {
            // Nothing to judge by: it is still on the side where it was last seen.
            let label = if self.mirror.is_some() { Label::Mirrored } else { Label::Clean };
            return Checked { pose: seen, label };
        };
        if prediction.gate(pose, noise) != Gate::Outside {
            self.mirror = None;
            return Checked { pose: *pose, label: Label::Clean };
        }
        for mirror in [Mirror::Point, Mirror::Vertical] {
            let repaired = mirror.apply(pose);
            if pose.position_m.is_some() && prediction.gate(&repaired, noise) == Gate::Inside {
                self.mirror = Some(mirror);
                return Checked { pose: repaired, label: Label::Mirrored };
            }
        }
        Checked { pose: *pose, label: Label::Outlier }
    }
}

#[cfg(test)]
mod tests;
