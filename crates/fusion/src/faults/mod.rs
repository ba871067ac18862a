//! What is wrong with single measurements, by physics, and the words for it.
//!
//! What comes in: a measured pose in the transmitter frame, and as explicit arguments what the previous frame
//! predicts for it and what the stage's fault map reports about it. What goes out: a [`Checked`] measurement, mirrored
//! back where the tracker chose the wrong side of its transmitter. What it never does: filter, correct, look at the future. This module alone
//! decides between p and -p and what is stuck; `fusion` only gates what is left.

mod debounce;
mod gate;
mod vocabulary;
mod words;

use nalgebra::{UnitQuaternion, Vector3};
use posed_state::Plain;

pub use debounce::Debounce;
pub(crate) use gate::squared_distance;
pub use gate::{Gate, Prediction};
pub use posed_geometry::repetition::{Evidence, Repeats, Repetition, Words};
pub use vocabulary::{Cause, Class, Finding, Label, Mirror, Repair, Verdict};
pub use words::ImuWords;

use crate::noise::TrackerNoise;

/// The fault map contradicts the prediction for so many records before it is believed.
const CONVINCED_RECORDS: u32 = 30;

/// A side is clearly the nearer one where its distance is below this part of the other's.
const CLEARLY: f64 = 1.0 / 3.0;

/// A measured pose of one sensor in the transmitter frame.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct MeasuredPose {
    /// Position, m.
    pub position_m: Option<Vector3<f64>>,
    /// Sensor to transmitter.
    pub orientation: Option<UnitQuaternion<f64>>,
}

/// A measurement with its label; repaired where [`Checked::repair`] says so.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Checked {
    /// The measurement, repaired.
    pub pose: MeasuredPose,
    /// What it is.
    pub label: Label,
    /// What was done about that.
    pub repair: Option<Repair>,
    /// It has no news, or false ones: no filter is to see it.
    pub withheld: bool,
}

impl Checked {
    /// Nothing is known against it.
    pub fn clean(pose: MeasuredPose) -> Self {
        Self { pose, label: Label::CLEAN, repair: None, withheld: false }
    }

    /// Clean as measured, or mirrored back.
    fn on_side(mirror: Option<Mirror>, measured: &MeasuredPose) -> Self {
        let Some(mirror) = mirror else { return Self::clean(*measured) };
        let pose = measured.mirrored(mirror);
        Self { pose, label: Label::inverted(mirror), repair: Some(Repair::Mirrored), withheld: false }
    }

    fn anomalous(pose: MeasuredPose, cause: Cause, withheld: bool) -> Self {
        Self { pose, label: Label::anomalous(cause), repair: None, withheld }
    }
}

impl MeasuredPose {
    /// Its mirror image.
    fn mirrored(&self, mirror: Mirror) -> Self {
        let position_m = self.position_m.map(|p| Vector3::from(mirror.apply(p.into())));
        Self { position_m, ..*self }
    }
}

/// The fault detector of one sensor.
#[derive(Clone, Debug, Default, Plain)]
pub struct Detector {
    repetition: Repetition<MeasuredPose>,
    /// How the latest measurement was repaired; kept while there is no prediction to judge by.
    mirror: Option<Mirror>,
    /// Where it was last inside its gate, repaired if need be, or known to be since, device axes, m.
    last_m: Option<Vector3<f64>>,
    /// Something else has just located it; and that identified the side on which the track began, which the fault map does not dispute then.
    located: bool,
    identified: bool,
    /// It has been inside its gate once.
    tracked: bool,
    /// Records in a row in which prediction and fault map disagreed about the side.
    disputed: u32,
    /// What the map calls anomalous has lasted longer than a prediction does: it is followed, though never as good.
    followed: bool,
}

impl Detector {
    /// A detector that goes on after a break in which nothing else is known any more: of the side on which the sensor was, and that
    /// it must change before it is believed, nothing is forgotten.
    pub fn after_break(&self) -> Self {
        let Self { mirror, last_m, tracked, .. } = *self;
        Self { mirror, last_m, tracked, ..Self::default() }
    }

    /// Something else knows where the sensor is, device axes, m: that says more of the side than where it was when it was lost.
    pub fn known_at(&mut self, position_m: Vector3<f64>) {
        self.last_m = Some(position_m);
        self.located = true;
    }

    /// Labels one measurement.
    ///
    /// `prediction` is the filter's, at the measurement's time; `None` while nothing is tracked.
    /// `others_move` states whether another sensor of the stage was moving in the previous frame; `by_map` is what the
    /// stage's fault map reports about the sensor in this frame, if there is one. The prediction determines the side of the
    /// transmitter; where there is none, what else knows the place ([`Self::known_at`]), and where nothing does, the map.
    pub fn check(
        &mut self,
        pose: &MeasuredPose,
        prediction: Option<&Prediction>,
        noise: &TrackerNoise,
        others_move: bool,
        by_map: Option<Label>,
    ) -> Checked {
        let side = by_map.and_then(|label| match label.class {
            Class::Inverted if pose.position_m.is_some() => Some(label.mirror()),
            Class::Clean => Some(None),
            _ => None,
        });
        if let (Some(side), None) = (side, prediction) {
            self.mirror = side;
        }
        let checked = self.by_prediction(pose, prediction, noise, others_move);
        if by_map.is_none_or(|label| label.class != Class::Anomalous) {
            self.followed = false;
        } else if checked.repair.is_none() && !checked.withheld {
            self.followed |= prediction.is_none();
            if !self.followed {
                // Why, the map reports once it has said it often enough.
                let label = Label { class: Class::Anomalous, cause: None };
                return Checked { label, repair: Some(Repair::Coasted), withheld: true, ..checked };
            }
        }
        self.settle(pose, checked, side.filter(|_| prediction.is_some()))
    }

    /// Prediction and map may disagree about the side: nothing is good then, until the map has it.
    fn settle(&mut self, pose: &MeasuredPose, checked: Checked, by_map: Option<Option<Mirror>>) -> Checked {
        let (Class::Clean | Class::Inverted, Some(by_map), false) =
            (checked.label.class, by_map, self.identified)
        else {
            return checked;
        };
        // Which mirror image, the prediction knows better.
        if by_map.is_some() == self.mirror.is_some() {
            self.disputed = 0;
            return checked;
        }
        self.disputed += 1;
        if self.disputed < CONVINCED_RECORDS {
            let label = Label { class: Class::Unknown, cause: Some(Cause::HemisphereInversion) };
            return Checked { label, repair: None, ..checked };
        }
        // What is tracked gives way once enough records agree on the other side.
        Checked::on_side(by_map, pose)
    }

    fn by_prediction(
        &mut self,
        pose: &MeasuredPose,
        prediction: Option<&Prediction>,
        noise: &TrackerNoise,
        others_move: bool,
    ) -> Checked {
        // A mirrored sensor repeats its mirrored words: hold the repetition against the same side.
        let seen = self.mirror.map_or(*pose, |mirror| pose.mirrored(mirror));
        let evidence = match prediction {
            Some(prediction) if prediction.has_left(&seen, noise) => Evidence::Certain,
            _ if others_move => Evidence::OthersMove,
            None if self.tracked => Evidence::Unseen,
            _ => Evidence::None,
        };
        match self.repetition.take(*pose, evidence) {
            Repeats::Stuck => return Checked::anomalous(seen, Cause::Stuck, true),
            // Not yet stuck, but not where it is predicted.
            Repeats::Suspect => return Checked::anomalous(seen, Cause::Gate, true),
            // A track is not begun with what may be the words of a device that stood still before.
            Repeats::Rests if prediction.is_none() && self.repetition.may_be_stuck() => {
                return Checked::anomalous(seen, Cause::Gate, true);
            }
            Repeats::Changed | Repeats::Rests => {}
        }
        let Some(prediction) = prediction else { return self.begin(pose) };
        if prediction.gate(pose, noise) != Gate::Outside {
            // Records that are seldom leave a prediction so wide that it holds both sides. It is a straight line then, where a limb
            // has long turned back: where the sensor was says more.
            let holds_both = prediction.holds_too(&pose.mirrored(Mirror::Point), pose, noise);
            return self.believe(if holds_both { self.nearer_side(pose).0 } else { None }, pose);
        }
        let mirrors = [Mirror::Point, Mirror::Vertical].into_iter();
        let is_far = pose.position_m.is_some_and(|position_m| prediction.is_far(&position_m, noise));
        for mirror in mirrors.filter(|_| is_far) {
            if prediction.gate(&pose.mirrored(mirror), noise) == Gate::Inside {
                return self.believe(Some(mirror), pose);
            }
        }
        // A track that such records replace goes on at the nearer side, if they are turned as it is.
        let mirrored = pose.mirrored(Mirror::Point);
        let is_turned = prediction.gate(&MeasuredPose { position_m: None, ..*pose }, noise) == Gate::Outside;
        let is_mirrored = !is_turned && prediction.prefers(&mirrored, pose, noise);
        let nearer = if is_mirrored { mirrored } else { *pose };
        Checked::anomalous(nearer, Cause::Gate, false)
    }

    fn believe(&mut self, mirror: Option<Mirror>, pose: &MeasuredPose) -> Checked {
        let checked = Checked::on_side(mirror, pose);
        self.mirror = mirror;
        self.tracked = true;
        self.last_m = checked.pose.position_m;
        checked
    }

    /// Labels a measurement with nothing to judge it by: of the two sides it is on the one nearer to where it was last. It may
    /// have left either, or been set right, while nobody looked.
    fn begin(&mut self, pose: &MeasuredPose) -> Checked {
        let (side, is_clear) = self.nearer_side(pose);
        self.mirror = side;
        self.identified = std::mem::take(&mut self.located) && is_clear;
        Checked::on_side(side, pose)
    }

    /// The side that is nearer to where it was last, and whether the other one is out of the question; the latest side where it never was.
    fn nearer_side(&self, pose: &MeasuredPose) -> (Option<Mirror>, bool) {
        let mirror = self.mirror.unwrap_or(Mirror::Point);
        let distance_m = |pose: &MeasuredPose| Some((pose.position_m? - self.last_m?).norm());
        let (Some(here_m), Some(there_m)) = (distance_m(pose), distance_m(&pose.mirrored(mirror))) else {
            return (self.mirror, false);
        };
        let (side, taken_m, other_m) =
            if here_m <= there_m { (None, here_m, there_m) } else { (Some(mirror), there_m, here_m) };
        (side, taken_m < CLEARLY * other_m)
    }
}

#[cfg(test)]
mod tests;
