//! Labels without an operator: what physics says about positions.
//!
//! What comes in: frames of positions. What goes out: a label and a cause per sensor. What is learnt from a
//! recording before that ([`super::learning`], no labels needed) is how far apart sensors can be, how they move, and
//! which is the clean side of the transmitter. What it never does: look at the future.
//!
//! A whole figure that flips keeps all its mutual distances, so those alone would never see it: flips are events.

use std::cell::Cell;

use serde::{Deserialize, Serialize};

use super::memory::{Habit, Memory, Point};
use super::pairs::{Pairs, Size};

/// What is the matter with one sensor, or with a frame.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, schemars::JsonSchema,
)]
#[schemars(rename = "FaultClass")]
#[serde(rename_all = "lowercase")]
pub enum Class {
    /// Nothing is known against it.
    Clean,
    /// On the wrong side of the transmitter.
    Inverted,
    /// Wrong in another way.
    Anomalous,
    /// Cannot be told.
    Unknown,
}

/// Why.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[schemars(rename = "LabelCause")]
#[serde(rename_all = "lowercase")]
pub enum Cause {
    /// Nothing is the matter.
    None,
    /// The position flipped through the transmitter.
    Flip,
    /// The same words again while others move.
    Frozen,
    /// A jump that no motion makes.
    Jump,
    /// A rigid distance to another sensor is wrong.
    Bone,
    /// The map knows such frames as bad.
    Map,
    /// Far from all that was seen in training.
    Distance,
    /// The sensor is not in the frame.
    Missing,
}

impl Class {
    /// The word for it in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Clean => "clean",
            Self::Inverted => "inverted",
            Self::Anomalous => "anomalous",
            Self::Unknown => "unknown",
        }
    }
}

impl Cause {
    /// The word for it in files; empty for none.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "",
            Self::Flip => "flip",
            Self::Frozen => "frozen",
            Self::Jump => "jump",
            Self::Bone => "bone",
            Self::Map => "map",
            Self::Distance => "distance",
            Self::Missing => "missing",
        }
    }
}

/// What is known of a set of sensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rules {
    habits: Vec<Habit>,
    pairs: Pairs,
}

/// Labels frames as they come.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Labeller {
    sensors: Vec<Memory>,
    size: Size,
}

impl Rules {
    pub(super) fn new(habits: Vec<Habit>, pairs: Pairs) -> Self {
        Self { habits, pairs }
    }

    /// Whether these are the rules of so many sensors.
    pub(super) fn fits(&self, sensors: usize) -> bool {
        self.habits.len() == sensors && self.pairs.fit(sensors)
    }

    /// The sensor from which the distance of this one varies least.
    pub(super) fn nearest(&self, sensor: usize) -> Option<usize> {
        self.pairs.nearest(sensor)
    }

    /// Longest usual step of each sensor, m a frame.
    pub(super) fn usual_steps_m(&self) -> Vec<f64> {
        self.habits.iter().map(|habit| habit.step_m).collect()
    }

    /// A labeller that has seen nothing.
    pub fn labeller(&self) -> Labeller {
        let sensors = self.habits.len();
        Labeller { sensors: vec![Memory::default(); sensors], size: Size::new(sensors, &self.pairs) }
    }

    /// Labels the next frame (three numbers a sensor, NaN where missing) into `labels`.
    pub fn label(&self, labeller: &mut Labeller, frame: &[f64], labels: &mut [(Class, Cause)]) {
        self.label_beside(labeller, frame, &[], labels);
    }

    /// As [`Rules::label`]; `content` says of which sensors the map found nothing unusual in the frame before, if any.
    pub(super) fn label_beside(
        &self,
        labeller: &mut Labeller,
        frame: &[f64],
        content: &[bool],
        labels: &mut [(Class, Cause)],
    ) {
        let moving = labeller.sensors.iter().filter(|memory| memory.moved).count();
        let habits = self.habits.iter().zip(labeller.sensors.iter_mut().zip(labels.iter_mut()));
        for (sensor, (habit, (memory, label))) in habits.enumerate() {
            *label = match position(frame, sensor) {
                Some(p) => {
                    let others_move = moving > usize::from(memory.moved);
                    memory.take(p, habit, others_move)
                }
                None => {
                    memory.miss();
                    (Class::Unknown, Cause::Missing)
                }
            };
        }
        let Labeller { sensors: memories, size } = labeller;
        let labels = Cell::from_mut(labels).as_slice_of_cells();
        for sensor in 0..memories.len() {
            let (Some(now), Some(before)) = (memories[sensor].here(), memories[sensor].left()) else {
                continue;
            };
            let here = |other| believed(memories, labels, other);
            let strangeness = |p| self.pairs.strangeness(size, sensor, p, here);
            // A jump to where the others would rather have it is a return from where it got to unseen.
            if strangeness(now) < strangeness(before) {
                labels[sensor].set(memories[sensor].believe());
            }
        }
        let place = |sensor: usize| memories[sensor].here();
        let here = |sensor| believed(memories, labels, sensor);
        self.pairs.check(size, place, here, |sensor| labels[sensor].set((Class::Anomalous, Cause::Bone)));
        for sensor in 0..memories.len() {
            if !self.pairs.is_empty()
                && memories[sensor].is_away()
                && let Some(p) = memories[sensor].here()
            {
                let fits = self.pairs.allow(size, sensor, p, |other| believed(memories, labels, other));
                memories[sensor].judge(fits, content.get(sensor) == Some(&true));
            }
        }
    }
}

/// Where a sensor is, if nothing is known against it.
fn believed(memories: &[Memory], labels: &[Cell<(Class, Cause)>], sensor: usize) -> Option<Point> {
    let sound = matches!(labels[sensor].get().0, Class::Clean | Class::Inverted);
    memories[sensor].here().filter(|_| sound)
}

impl Labeller {
    /// Size of this body over that of the training's, as far as it is known.
    pub fn size(&self) -> f64 {
        self.size.value()
    }
}

/// What a frame is: inverted if most of its sensors are, anomalous if any is not clean.
pub fn frame_class(labels: &[(Class, Cause)]) -> (Class, Cause) {
    let count = |class: Class| labels.iter().filter(|label| label.0 == class).count();
    let there = labels.len() - count(Class::Unknown);
    let worst = labels.iter().find(|label| !matches!(label.0, Class::Clean | Class::Unknown));
    match worst {
        _ if there == 0 => (Class::Unknown, Cause::Missing),
        _ if 2 * count(Class::Inverted) > there => (Class::Inverted, Cause::Flip),
        Some(worst) => (Class::Anomalous, worst.1),
        None => (Class::Clean, Cause::None),
    }
}

pub(super) fn position(frame: &[f64], sensor: usize) -> Option<[f64; 3]> {
    let p = &frame[3 * sensor..3 * sensor + 3];
    p.iter().all(|value| value.is_finite()).then(|| [p[0], p[1], p[2]])
}

/// A quantile of some values; 0 of none.
pub(super) fn quantile(values: &mut [f64], share: f64) -> f64 {
    let at = ((values.len().saturating_sub(1)) as f64 * share) as usize;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(at, f64::total_cmp).1 }
}
