//! Labels without an operator: what physics says about positions.
//!
//! What comes in: frames of positions. What goes out: a label and a cause per sensor. What is learnt from a
//! recording before that ([`super::learning`], no labels needed) is how far apart sensors can be, how they move, and
//! which is the clean side of the transmitter. What it never does: look at the future.
//!
//! A whole figure that flips keeps all its mutual distances, so those alone would never see it: flips are events.

use std::cell::Cell;

use posed_state::Plain;
use serde::{Deserialize, Serialize};

use posed_fusion::faults::{Cause, Class, Label, Mirror};

use super::frames::Frame;
use super::joints::{Hint, Joints, Limbs};
use super::memory::{Habit, Memory, Point};
use super::pairs::{Pairs, Size};
use super::side::goes_through;

/// What is known of a set of sensors: their usual steps and reach, and the distances of each pair.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct Rules {
    habits: Vec<Habit>,
    pairs: Pairs,
    /// None where the recording had no orientations.
    #[serde(default, skip_serializing_if = "Joints::is_empty")]
    joints: Joints,
}

/// State of the rules on one stream: hemisphere, jump and repetition of each sensor, size of this body, and how the sensors are worn.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct Labeller {
    sensors: Vec<Memory>,
    size: Size,
    limbs: Limbs,
}

impl Rules {
    pub(super) fn new(habits: Vec<Habit>, pairs: Pairs, joints: Joints) -> Self {
        Self { habits, pairs, joints }
    }

    /// Whether these are the rules of so many sensors.
    pub(super) fn fits(&self, sensors: usize) -> bool {
        self.habits.len() == sensors && self.pairs.fit(sensors) && self.joints.fit(sensors)
    }

    /// How many joints are known.
    pub(super) fn joints(&self) -> usize {
        self.joints.len()
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
        Labeller {
            sensors: vec![Memory::default(); sensors],
            size: Size::new(sensors, &self.pairs),
            limbs: self.joints.limbs(sensors),
        }
    }

    /// Labels the next frame into `labels`, one per sensor, without delay. The sensors of `frame` are in the order of the training. Frames
    /// are evenly spaced, at the rate of the training.
    ///
    /// # Panics
    /// `frame` holds fewer than three numbers a sensor for its position.
    pub fn label(&self, labeller: &mut Labeller, frame: Frame<'_>, labels: &mut [Label]) {
        self.label_beside(labeller, frame, &[], labels);
    }

    /// As [`Rules::label`]; `content` reports about which sensors the map found nothing unusual in the frame before, if any.
    pub(super) fn label_beside(
        &self,
        labeller: &mut Labeller,
        frame: Frame<'_>,
        content: &[bool],
        labels: &mut [Label],
    ) {
        let moving = labeller.sensors.iter().filter(|memory| memory.moved).count();
        let habits = self.habits.iter().zip(labeller.sensors.iter_mut().zip(labels.iter_mut()));
        for (sensor, (habit, (memory, label))) in habits.enumerate() {
            *label = match position(frame.positions_m, sensor) {
                Some(p) => {
                    let others_move = moving > usize::from(memory.moved);
                    memory.take(p, habit, others_move)
                }
                None => {
                    memory.miss();
                    Label::MISSING
                }
            };
        }
        self.flip_together(&mut labeller.sensors, labels);
        let Labeller { sensors: memories, size, limbs } = labeller;
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
        self.joints.follow(limbs, frame, |sensor| match believed(memories, labels, sensor) {
            Some(here) => Hint::Here(here),
            None if labels[sensor].get() == Label::MISSING => Hint::Missing,
            None => Hint::Wrong,
        });
        for (sensor, memory) in memories.iter_mut().enumerate() {
            if let (Some(place), Some(p)) = (limbs.place(sensor), position(frame.positions_m, sensor))
                && labels[sensor].get().cause != Some(Cause::Stuck)
            {
                labels[sensor].set(memory.settle(p, place));
            }
        }
        let position = |sensor: usize| memories[sensor].here();
        let here = |sensor| believed(memories, labels, sensor);
        self.pairs.check(size, position, here, |sensor| {
            // A joint that holds says more than a range.
            if limbs.place(sensor).is_none() {
                labels[sensor].set(Label::anomalous(Cause::Bone));
            }
        });
        for sensor in 0..memories.len() {
            if !self.pairs.is_empty()
                && limbs.place(sensor).is_none()
                && memories[sensor].is_away()
                && let Some(p) = memories[sensor].here()
            {
                let fits = self.pairs.allow(size, sensor, p, |other| believed(memories, labels, other));
                memories[sensor].judge(fits, content.get(sensor) == Some(&true));
            }
        }
    }
}

impl Rules {
    /// When the figure goes through the vertical mirror, its sensors near the plane, which hardly show it, go with the others.
    fn flip_together(&self, memories: &mut [Memory], labels: &mut [Label]) {
        let shown = memories.iter().zip(&self.habits).filter(|(memory, habit)| memory.shows(habit)).count();
        if goes_through(memories.iter().filter(|memory| memory.has_jumped_through()).count(), shown) {
            for ((memory, habit), label) in memories.iter_mut().zip(&self.habits).zip(labels) {
                if let Some(followed) = memory.follow_through(habit) {
                    *label = followed;
                }
            }
        }
    }
}

/// Where a sensor is, if nothing is known against it.
fn believed(memories: &[Memory], labels: &[Cell<Label>], sensor: usize) -> Option<Point> {
    let sound = matches!(labels[sensor].get().class, Class::Clean | Class::Inverted);
    memories[sensor].here().filter(|_| sound)
}

impl Labeller {
    /// Size of this body over that of the training's, 0.7 to 1.4; 1 until it is known.
    pub fn size(&self) -> f64 {
        self.size.value()
    }

    /// Per joint, what it leaves over in the latest frame.
    pub(super) fn shares(&self) -> &[f64] {
        self.limbs.shares()
    }
}

/// What a frame is: missing if all its sensors are, inverted if more than half of those present are, anomalous if any
/// other is not clean (with that one's cause), else clean.
pub fn frame_label(labels: &[Label]) -> Label {
    let count = |class: Class| labels.iter().filter(|label| label.class == class).count();
    let there = labels.len() - count(Class::Unknown);
    let worst = labels.iter().find(|label| !matches!(label.class, Class::Clean | Class::Unknown));
    match worst {
        _ if there == 0 => Label::MISSING,
        _ if 2 * count(Class::Inverted) > there => {
            let through = |mirror| labels.iter().filter(|label| label.mirror() == Some(mirror)).count();
            let vertical = through(Mirror::Vertical) > through(Mirror::Point);
            Label::inverted(if vertical { Mirror::Vertical } else { Mirror::Point })
        }
        Some(worst) => Label { class: Class::Anomalous, ..*worst },
        None => Label::CLEAN,
    }
}

pub(super) fn position(frame: &[f64], sensor: usize) -> Option<[f64; 3]> {
    let p = &frame[3 * sensor..3 * sensor + 3];
    p.iter().all(|value| value.is_finite()).then(|| [p[0], p[1], p[2]])
}
