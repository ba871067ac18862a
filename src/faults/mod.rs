//! Labels and repairs of single measurements, by physics.
//!
//! What comes in: a measured pose in the transmitter frame, and as explicit arguments what the previous frame
//! predicts for it and what the stage's map of faults says of it. What goes out: a [`Checked`] measurement, mirrored
//! back where the tracker chose the wrong side of its transmitter. What it never does: filter, correct, look at the future. This module alone
//! decides between p and -p and what is stuck; `fusion` only gates what is left.

mod gate;
mod repetition;
pub mod som;

use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

pub(crate) use gate::squared_distance;
pub use gate::{Gate, Prediction};
use repetition::Repetition;
use som::rules::Class;

use crate::noise::TrackerNoise;

/// The map of faults contradicts the prediction for so many records before it is believed.
const CONVINCED_RECORDS: u32 = 30;

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
    /// Bad by the map of faults; withheld, so that the prediction bridges it.
    Withheld,
    /// As predicted, but on the other side of the transmitter by the map of faults.
    Disputed,
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
    /// Records in a row in which prediction and map of faults disagreed about the side.
    disputed: u32,
    /// What the map calls anomalous has lasted longer than a prediction does: it is followed, though never as good.
    followed: bool,
}

impl Detector {
    /// Labels one measurement.
    ///
    /// `prediction` is the filter's, at the measurement's time; `None` while nothing is tracked.
    /// `others_move` says whether another sensor of the stage was moving in the previous frame; `by_map` is what the
    /// stage's map of faults says of the sensor in this frame, if there is one. The prediction tells the side of the
    /// transmitter, and where there is none, the map.
    pub fn check(
        &mut self,
        pose: &MeasuredPose,
        prediction: Option<&Prediction>,
        noise: &TrackerNoise,
        others_move: bool,
        by_map: Option<Class>,
    ) -> Checked {
        let side = match by_map {
            Some(Class::Inverted) if pose.position_m.is_some() => Some(Some(Mirror::Point)),
            Some(Class::Clean) => Some(None),
            _ => None,
        };
        if let (Some(side), None) = (side, prediction) {
            self.mirror = side;
        }
        let checked = self.by_prediction(pose, prediction, noise, others_move);
        if by_map != Some(Class::Anomalous) {
            self.followed = false;
        } else if checked.label == Label::Clean || checked.label == Label::Outlier {
            self.followed |= prediction.is_none();
            if !self.followed {
                return Checked { label: Label::Withheld, ..checked };
            }
        }
        self.settle(pose, checked, side.filter(|_| prediction.is_some()))
    }

    /// Prediction and map may disagree about the side: nothing is good then, until the map has it.
    fn settle(&mut self, pose: &MeasuredPose, checked: Checked, by_map: Option<Option<Mirror>>) -> Checked {
        let (Label::Clean | Label::Mirrored, Some(by_map)) = (checked.label, by_map) else {
            return checked;
        };
        if by_map == self.mirror || self.mirror == Some(Mirror::Vertical) {
            self.disputed = 0;
            return checked;
        }
        self.disputed += 1;
        if self.disputed < CONVINCED_RECORDS {
            return Checked { label: Label::Disputed, ..checked };
        }
        // What is tracked gives way once enough records agree on the other side.
        match by_map {
            Some(mirror) => Checked { pose: mirror.apply(pose), label: Label::Mirrored },
            None => Checked { pose: *pose, label: Label::Clean },
        }
    }

    fn by_prediction(
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
