//! Labels without an operator: what physics says about positions.
//!
//! What comes in: frames of positions. What goes out: a label and a cause per sensor. What is learnt from a
//! recording before that ([`Rules::learn`], no labels needed) is which distances between sensors are rigid, how fast
//! the sensors move, and which is the clean side of the transmitter. What it never does: look at the future.
//!
//! A flip is an event: the position jumps, and its mirror image does not. Between flips a sensor keeps its side.
//! A whole figure that flips keeps all its mutual distances, so those alone would never see it.

use serde::{Deserialize, Serialize};

use super::frames::Frames;

/// A jump whose mirror image is so many times shorter is a flip.
const FLIP_RATIO: f64 = 0.3;
/// Jumps below this are motion, m.
const SMALLEST_JUMP_M: f64 = 0.1;
/// A bone's residual beyond so many robust sigmas is a fault.
const BONE_SIGMAS: f64 = 4.0;
/// Skin and noise, m: no bone is more rigid than this.
const BONE_FLOOR_M: f64 = 0.01;
/// A pair is a bone if its distance varies by less than this share of itself (robust sigma).
const BONE_SHARE: f64 = 0.08;
/// Steps beyond so many times the learnt limit are too fast.
const SPEED_FACTOR: f64 = 3.0;
/// Equal positions in a row that are frozen.
const FROZEN_FRAMES: u32 = 5;
/// A sensor that was missing for longer has no memory of its side.
const MEMORY_FRAMES: u32 = 30;

/// What is the matter with one sensor, or with a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
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
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
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
    sensors: usize,
    bones: Vec<Bone>,
    /// Longest usual step per frame of each sensor, m.
    step_m: Vec<f64>,
    /// Where each sensor is when it is clean, on average, m.
    home_m: Vec<[f64; 3]>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Bone {
    a: usize,
    b: usize,
    length_m: f64,
    sigma_m: f64,
}

/// Labels frames as they come.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Labeller {
    sensors: Vec<Memory>,
    bad: Vec<u32>,
    count: Vec<u32>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Memory {
    last: Option<[f64; 3]>,
    /// Position before a jump that no motion makes, turned to the clean side.
    trusted: Option<[f64; 3]>,
    missing: u32,
    inverted: bool,
    repeated: u32,
    moved: bool,
}

impl Rules {
    /// Learns from a recording without labels.
    pub fn learn(frames: &Frames) -> Self {
        let sensors = frames.sensors.len();
        let sides = sides(frames);
        let turned = |frame: usize, sensor: usize| {
            let p = position(frames.frame(frame), sensor)?;
            Some(if sides[frame * sensors + sensor] { mirror(p) } else { p })
        };
        let mut bones = Vec::new();
        for a in 0..sensors {
            for b in a + 1..sensors {
                let mut lengths: Vec<f64> =
                    (0..frames.len()).filter_map(|k| Some(distance(turned(k, a)?, turned(k, b)?))).collect();
                let length_m = median(&mut lengths);
                let mut off: Vec<f64> = lengths.iter().map(|length| (length - length_m).abs()).collect();
                // 1.4826 makes the median absolute deviation a standard deviation.
                let sigma_m = (1.4826 * median(&mut off)).max(BONE_FLOOR_M);
                if lengths.len() > 10 && sigma_m < (BONE_SHARE * length_m).max(1.5 * BONE_FLOOR_M) {
                    bones.push(Bone { a, b, length_m, sigma_m });
                }
            }
        }
        let step_m = (0..sensors)
            .map(|sensor| {
                let step = |k: usize| Some(distance(turned(k, sensor)?, turned(k - 1, sensor)?));
                let mut steps: Vec<f64> = (1..frames.len()).filter_map(step).collect();
                quantile(&mut steps, 0.95).max(0.3 * SMALLEST_JUMP_M)
            })
            .collect();
        let home_m = (0..sensors)
            .map(|sensor| {
                let axis = |c: usize| {
                    median(
                        &mut (0..frames.len())
                            .filter_map(|k| Some(turned(k, sensor)?[c]))
                            .collect::<Vec<_>>(),
                    )
                };
                [axis(0), axis(1), axis(2)]
            })
            .collect();
        Self { sensors, bones, step_m, home_m }
    }

    /// Whether these are the rules of so many sensors.
    pub(super) fn fits(&self, sensors: usize) -> bool {
        self.sensors == sensors
            && self.step_m.len() == sensors
            && self.home_m.len() == sensors
            && self.bones.iter().all(|bone| bone.a < sensors && bone.b < sensors)
    }

    /// A labeller that has seen nothing.
    pub fn labeller(&self) -> Labeller {
        Labeller {
            sensors: vec![Memory::default(); self.sensors],
            bad: vec![0; self.sensors],
            count: vec![0; self.sensors],
        }
    }

    /// Labels the next frame (three numbers a sensor, NaN where missing) into `labels`.
    pub fn label(&self, labeller: &mut Labeller, frame: &[f64], labels: &mut [(Class, Cause)]) {
        let moving = labeller.sensors.iter().filter(|memory| memory.moved).count();
        for (sensor, (memory, label)) in labeller.sensors.iter_mut().zip(labels.iter_mut()).enumerate() {
            *label = match position(frame, sensor) {
                Some(p) => {
                    let others_move = moving > usize::from(memory.moved);
                    memory.take(p, self.step_m[sensor], &self.home_m[sensor], others_move)
                }
                None => {
                    memory.missing += 1;
                    (Class::Unknown, Cause::Missing)
                }
            };
        }
        self.check_bones(labeller, labels);
    }

    /// A sensor most of whose bones are wrong is anomalous, the one with most of them first.
    fn check_bones(&self, labeller: &mut Labeller, labels: &mut [(Class, Cause)]) {
        let wrong = |bone: &Bone, memories: &[Memory]| {
            let (a, b) = (&memories[bone.a], &memories[bone.b]);
            let (Some(p), Some(q)) = (a.here(), b.here()) else { return None };
            Some((distance(p, q) - bone.length_m).abs() > BONE_SIGMAS * bone.sigma_m)
        };
        loop {
            labeller.bad.fill(0);
            labeller.count.fill(0);
            for bone in &self.bones {
                let judged = |sensor: usize| matches!(labels[sensor].0, Class::Clean | Class::Inverted);
                if !judged(bone.a) || !judged(bone.b) {
                    continue;
                }
                if let Some(wrong) = wrong(bone, &labeller.sensors) {
                    for sensor in [bone.a, bone.b] {
                        labeller.count[sensor] += 1;
                        labeller.bad[sensor] += u32::from(wrong);
                    }
                }
            }
            let share =
                |sensor: usize| f64::from(labeller.bad[sensor]) / f64::from(labeller.count[sensor].max(1));
            let worst = (0..self.sensors).max_by(|a, b| share(*a).total_cmp(&share(*b)));
            match worst.filter(|sensor| share(*sensor) > 0.5) {
                Some(sensor) => labels[sensor] = (Class::Anomalous, Cause::Bone),
                None => return,
            }
        }
    }
}

impl Memory {
    fn here(&self) -> Option<[f64; 3]> {
        let last = self.last.filter(|_| self.missing == 0)?;
        Some(if self.inverted { mirror(last) } else { last })
    }

    fn take(&mut self, p: [f64; 3], step_m: f64, home_m: &[f64; 3], others_move: bool) -> (Class, Cause) {
        let gap = self.missing;
        self.missing = 0;
        if gap > MEMORY_FRAMES {
            *self = Self::default();
        }
        let turned = |inverted: bool| if inverted { mirror(p) } else { p };
        let Some(last) = self.last.replace(p) else {
            // Nothing to compare with but where it usually is.
            self.inverted = distance(mirror(p), *home_m) < FLIP_RATIO * distance(p, *home_m);
            self.trusted = Some(turned(self.inverted));
            return if self.inverted { (Class::Inverted, Cause::Flip) } else { (Class::Clean, Cause::None) };
        };
        self.moved = p != last;
        if p == last && gap == 0 {
            self.repeated += 1;
            if self.repeated + 1 >= FROZEN_FRAMES && others_move {
                return (Class::Anomalous, Cause::Frozen);
            }
        } else {
            self.repeated = 0;
        }
        let trusted = self.trusted.unwrap_or(turned(self.inverted));
        let (plain, flipped) = (distance(p, trusted), distance(mirror(p), trusted));
        let reach = (f64::from(gap) + 1.0) * (SPEED_FACTOR * step_m).max(SMALLEST_JUMP_M);
        if plain.min(flipped) <= reach || flipped < FLIP_RATIO * plain || plain < FLIP_RATIO * flipped {
            // Close to the transmitter both images are near: it stays on its side.
            if (plain - flipped).abs() > reach.min(0.5 * plain.max(flipped)) {
                self.inverted = flipped < plain;
            }
            if plain.min(flipped) <= reach {
                self.trusted = Some(turned(self.inverted));
                let class = if self.inverted { Class::Inverted } else { Class::Clean };
                return (class, if self.inverted { Cause::Flip } else { Cause::None });
            }
        }
        // A jump: believed once it has stayed where it went.
        if distance(p, last) <= reach {
            self.trusted = Some(turned(self.inverted));
        }
        (Class::Anomalous, Cause::Jump)
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
                let (step, mirrored) = (distance(p, last), distance(mirror(p), last));
                inverted ^= step > SMALLEST_JUMP_M && mirrored < FLIP_RATIO * step;
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
            up += usize::from(high > low);
            down += usize::from(high < low);
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

fn mirror(p: [f64; 3]) -> [f64; 3] {
    p.map(|value| -value)
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2)).sqrt()
}

fn median(values: &mut [f64]) -> f64 {
    quantile(values, 0.5)
}

/// A quantile of some values; 0 of none.
pub(super) fn quantile(values: &mut [f64], share: f64) -> f64 {
    let at = ((values.len().saturating_sub(1)) as f64 * share) as usize;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(at, f64::total_cmp).1 }
}
