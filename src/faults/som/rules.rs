//! Labels without an operator: what physics says about positions.
//!
//! What comes in: frames of positions. What goes out: a label and a cause per sensor. What is learnt from a
//! recording before that ([`Rules::learn`], no labels needed) is how far apart sensors can be, how they move, and
//! which is the clean side of the transmitter. What it never does: look at the future.
//!
//! A whole figure that flips keeps all its mutual distances, so those alone would never see it: flips are events.

use std::cell::Cell;

use serde::{Deserialize, Serialize};

use super::frames::Frames;
use super::memory::{Habit, Memory, Point, distance, turned};
use super::pairs::{Pairs, Size};

/// In a recording, a step whose mirror image is so many times shorter is a flip; shorter steps are motion, m.
const FLIP_RATIO: f64 = 0.3;
const SMALLEST_FLIP_M: f64 = 0.1;
/// A deviation from a steady motion is a jump beyond so many times the largest usual one, or the usual one, and
/// never below this, m.
const JUMP_LARGEST: f64 = 1.5;
const JUMP_USUAL: f64 = 4.0;
const SMALLEST_JUMP_M: f64 = 0.04;

/// Heads are so far above feet, at least, where names tell which side is clean, m.
const UPRIGHT_M: f64 = 0.1;

/// Shares of the distances that are taken for faults, at first and then, at either end.
const RANGES_LEAVE_OUT: [f64; 2] = [0.02, 0.003];

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
    /// Learns from a recording without labels.
    pub fn learn(frames: &Frames) -> Self {
        let sensors = frames.sensors.len();
        let sides = sides(frames);
        let here = |frame: usize, sensor: usize| {
            Some(turned(position(frames.frame(frame), sensor)?, sides[frame * sensors + sensor]))
        };
        let habits = (0..sensors).map(|sensor| habit(frames.len(), |frame| here(frame, sensor))).collect();
        let mut rules = Self { habits, pairs: Pairs::default() };
        // Ranges are learnt from what is left once all that jumps, flips and freezes is gone, and then once more
        // without what is outside of these.
        let mut labels = vec![(Class::Unknown, Cause::Missing); sensors];
        let mut places: Vec<Option<Point>> = Vec::with_capacity(frames.len() * sensors);
        for outside in RANGES_LEAVE_OUT {
            let mut labeller = rules.labeller();
            places.clear();
            for k in 0..frames.len() {
                rules.label(&mut labeller, frames.frame(k), &mut labels);
                let cells = Cell::from_mut(&mut labels[..]).as_slice_of_cells();
                places.extend((0..sensors).map(|sensor| believed(&labeller.sensors, cells, sensor)));
            }
            let place = |k: usize, sensor: usize| places[k * sensors + sensor];
            rules.pairs = Pairs::learn(sensors, frames.len(), outside, place);
        }
        rules
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
    /// Where each sensor is, on the clean side.
    pub(super) fn places(&self) -> Vec<Option<Point>> {
        self.sensors.iter().map(Memory::here).collect()
    }

    /// Size of this body over that of the training's, as far as it is known.
    pub fn size(&self) -> f64 {
        self.size.value()
    }
}

/// How a sensor moves, from a recording of it on its clean side.
fn habit(frames: usize, here: impl Fn(usize) -> Option<Point>) -> Habit {
    let mut steps: Vec<f64> = (1..frames).filter_map(|k| Some(distance(here(k)?, here(k - 1)?))).collect();
    let bend = |k: usize| {
        let (a, b, c) = (here(k - 2)?, here(k - 1)?, here(k)?);
        Some(distance(c, std::array::from_fn(|axis| 2.0 * b[axis] - a[axis])))
    };
    let mut bends: Vec<f64> = (2..frames).filter_map(bend).collect();
    let largest = JUMP_LARGEST * quantile(&mut bends, 0.995);
    let usual = JUMP_USUAL * quantile(&mut bends, 0.95);
    let axis = |c: usize| median(&mut (0..frames).filter_map(|k| Some(here(k)?[c])).collect::<Vec<_>>());
    Habit {
        jump_m: largest.min(usual).max(SMALLEST_JUMP_M),
        step_m: quantile(&mut steps, 0.95),
        home_m: [axis(0), axis(1), axis(2)],
    }
}

/// Which positions of a recording are on the wrong side: a sensor's side changes with each flip, and the side on
/// which it is longer is the clean one. The figure's own upward axis decides where the names tell it.
fn sides(frames: &Frames) -> Vec<bool> {
    let sensors = frames.sensors.len();
    let mut sides = vec![false; frames.len() * sensors];
    for sensor in 0..sensors {
        let mut last: Option<[f64; 3]> = None;
        let (mut inverted, mut count, mut total) = (false, 0usize, 0usize);
        for k in 0..frames.len() {
            let Some(p) = position(frames.frame(k), sensor) else { continue };
            if let Some(last) = last {
                let (step, mirrored) = (distance(p, last), distance(turned(p, true), last));
                inverted ^= step > SMALLEST_FLIP_M && mirrored < FLIP_RATIO * step;
            }
            last = Some(p);
            sides[k * sensors + sensor] = inverted;
            count += usize::from(inverted);
            total += 1;
        }
        if 2 * count > total {
            (0..frames.len()).for_each(|k| sides[k * sensors + sensor] ^= true);
        }
    }
    if upside_down(frames, &sides) {
        sides.iter_mut().for_each(|side| *side = !*side);
    }
    sides
}

/// Whether heads are below feet in most frames, where sensors are named after segments.
fn upside_down(frames: &Frames, sides: &[bool]) -> bool {
    let named = |words: &[&str]| -> Vec<usize> {
        let is = |name: &String| words.iter().any(|word| name.to_lowercase().contains(word));
        (0..frames.sensors.len()).filter(|sensor| is(&frames.sensors[*sensor])).collect()
    };
    let (high, low) =
        (named(&["head", "torso", "thorax"]), named(&["pelvis", "root", "foot", "shank", "toes"]));
    let sensors = frames.sensors.len();
    let mean = |k: usize, group: &[usize]| {
        let z = |sensor: &usize| {
            let p = position(frames.frame(k), *sensor)?;
            Some(if sides[k * sensors + sensor] { -p[2] } else { p[2] })
        };
        let heights: Vec<f64> = group.iter().filter_map(z).collect();
        (!heights.is_empty()).then(|| heights.iter().sum::<f64>() / heights.len() as f64)
    };
    let (mut up, mut down) = (0, 0);
    for k in 0..frames.len() {
        if let (Some(high), Some(low)) = (mean(k, &high), mean(k, &low)) {
            up += usize::from(high - low > UPRIGHT_M);
            down += usize::from(low - high > UPRIGHT_M);
        }
    }
    down > up
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

fn position(frame: &[f64], sensor: usize) -> Option<[f64; 3]> {
    let p = &frame[3 * sensor..3 * sensor + 3];
    p.iter().all(|value| value.is_finite()).then(|| [p[0], p[1], p[2]])
}

fn median(values: &mut [f64]) -> f64 {
    quantile(values, 0.5)
}

/// A quantile of some values; 0 of none.
pub(super) fn quantile(values: &mut [f64], share: f64) -> f64 {
    let at = ((values.len().saturating_sub(1)) as f64 * share) as usize;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(at, f64::total_cmp).1 }
}
