//! A fault map and its rules over a stream of frames.
//!
//! What comes in: frames. What goes out: a [`Judged`] per frame. What it never does: look at the future, or allocate for a frame.

use posed_state::Plain;

use super::FaultMap;
use super::frames::{Frame, Frames};
use super::habits::{Link, PositionChain, Steps};
use super::joints::is_strange;
use super::rules::{Labeller, frame_label};
use super::som::Winner;
use posed_fusion::faults::{Cause, Class, Debounce, Label};

/// A map that is discontent with more than this share of so many frames has not seen these movements: rules decide.
const NOVELTY: f64 = 0.015;
const MEMORY_FRAMES: f64 = 1000.0;
/// The map is content with a sensor below this share of what is unusual.
const CONTENT: f64 = 0.5;
/// After a gap of so many frames nothing is remembered of where sensors were.
const LONGEST_GAP: usize = 100;
/// Least weight of a frame in how unusual a sensor is on average.
const MEAN_WEIGHT: f64 = 0.002;

/// Labels a stream of frames: rules and self-organising map together, one frame at a time, without delay beyond 3 of 5
/// frames.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct Watch {
    labeller: Labeller,
    /// Positions as the map sees them, and what the second layer receives.
    seen: Vec<f64>,
    inputs: Vec<f64>,
    by_rules: Vec<Label>,
    steps: Steps,
    /// Per sensor: the map found nothing unusual in the latest frame.
    content: Vec<bool>,
    /// Per sensor, how unusual its places are on average: how it is put on in this session.
    mean_ratio: Vec<f64>,
    frames: u32,
    labels: Vec<Label>,
    distances_m: Vec<f64>,
    /// Per sensor: the map calls it anomalous.
    recent: Vec<Debounce>,
    /// Per joint: it leaves over more than it ever does.
    recent_joints: Vec<Debounce>,
    /// The same of the frame.
    recent_frame: Debounce,
    guess: usize,
    /// Share of the latest frames with which the rules are content and the map is not.
    alone: f64,
}

/// What a frame and each of its sensors are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judged<'a> {
    /// Rules and map together, for the frame.
    pub label: Label,
    /// What the rules say; the map's only part in it is how soon a sensor that jumped is believed again.
    pub by_rules: Class,
    /// What the map alone says, of this frame with the four before it.
    pub by_map: Class,
    /// The winner of the second layer; `None` if no sensor is there.
    pub winner: Option<Winner>,
    /// Rules and map together, one label per sensor in the fault map's order.
    pub sensors: &'a [Label],
    /// Per sensor: distance from the nearest position of training, in the axes that the map looks at, m; NaN where
    /// missing.
    pub distances_m: &'a [f64],
}

impl Watch {
    pub(super) fn new(fault_map: &FaultMap) -> Self {
        let sensors = fault_map.sensors.len();
        let nothing = vec![Label::MISSING; sensors];
        Self {
            labeller: fault_map.rules.labeller(),
            seen: vec![f64::NAN; 3 * sensors],
            inputs: vec![f64::NAN; fault_map.map.dimension],
            by_rules: nothing.clone(),
            steps: Steps::new(sensors),
            content: vec![false; sensors],
            mean_ratio: vec![0.0; sensors],
            frames: 0,
            labels: nothing,
            distances_m: vec![f64::NAN; sensors],
            recent: vec![Debounce::default(); sensors],
            recent_joints: vec![Debounce::default(); fault_map.map.dimension - sensors],
            recent_frame: Debounce::default(),
            guess: 0,
            alone: 1.5 * NOVELTY,
        }
    }

    /// Labels a whole recording, and gives each of its frames to `take` with its number. Frames that are not there, by their times, are
    /// missing ones: what moved meanwhile did not jump.
    pub fn follow(&mut self, fault_map: &FaultMap, frames: &Frames, mut take: impl FnMut(usize, Judged<'_>)) {
        let nothing = vec![f64::NAN; 3 * fault_map.sensors.len()];
        let interval_s = frames.interval_s();
        for k in 0..frames.len() {
            for _ in 0..frames.missing_before(k, interval_s).min(LONGEST_GAP) {
                self.push(fault_map, Frame { positions_m: &nothing, orientations_wxyz: &[] });
            }
            take(k, self.push(fault_map, frames.frame(k)));
        }
    }

    /// Labels the next frame, its sensors in the fault map's order. `fault_map` is the one that made this watch, or one with other classes of
    /// cells (`FaultMap::is_renamed`).
    ///
    /// The rules answer in the same frame; the map is heard once 3 of the latest 5 frames agree, and after some 400
    /// frames in which it found little. Rates of detection: `docs/faults.md`.
    ///
    /// # Panics
    /// `frame` holds fewer than three numbers a sensor for its position.
    pub fn push(&mut self, fault_map: &FaultMap, frame: Frame<'_>) -> Judged<'_> {
        fault_map.rules.label_beside(&mut self.labeller, frame, &self.content, &mut self.by_rules);
        fault_map.motion.follow(&mut self.steps, frame.positions_m);
        fault_map.see(frame.positions_m, self.labeller.size(), &mut self.seen);
        let mut strange = false;
        for sensor in 0..fault_map.sensors.len() {
            let look = fault_map.look(sensor, &self.seen, [PositionChain::MOUNTING_M, Link::MOUNTING_M]);
            self.inputs[sensor] = look.index;
            self.distances_m[sensor] = look.distance_m;
            let off = self.mean_ratio[sensor];
            // A sensor on a neuron of inverted frames, in a figure that is not, is wrong too.
            let bad = matches!(look.class, Class::Anomalous)
                || look.ratio - off > fault_map.usual_ratio
                || fault_map.motion.class(&self.steps, sensor) == Class::Anomalous;
            let content = look.ratio - off < CONTENT * fault_map.usual_ratio;
            self.content[sensor] = !bad && content && look.class == Class::Clean;
            if self.by_rules[sensor].class == Class::Clean {
                let weight = MEAN_WEIGHT.max(1.0 / f64::from(self.frames + 1));
                self.mean_ratio[sensor] += weight * (look.ratio - self.mean_ratio[sensor]);
            }
            self.recent[sensor].push(bad);
            strange |= self.recent[sensor].still_lasts();
        }
        // A map as published, or of before there were joints, has no inputs of them.
        let inputs = self.inputs[fault_map.sensors.len()..].iter_mut().zip(self.labeller.shares());
        for ((input, share), recent) in inputs.zip(&mut self.recent_joints) {
            *input = *share;
            recent.push(is_strange(*share));
            strange |= recent.still_lasts();
        }
        self.frames = self.frames.saturating_add(1);
        let winner = fault_map.map.winner_from(&self.inputs, self.guess);
        self.guess = winner.map_or(0, |winner| winner.cell);
        let cell = winner.map_or(Class::Unknown, |winner| fault_map.cells[winner.cell]);
        let far = winner.is_some_and(|winner| winner.distance > fault_map.usual_distance);
        self.recent_frame.push(far);
        let bad_frame = self.recent_frame.still_lasts();
        let by_map = match cell {
            Class::Inverted => Class::Inverted,
            _ if strange || bad_frame => Class::Anomalous,
            _ => Class::Clean,
        };
        self.labels.copy_from_slice(&self.by_rules);
        let by_rules = frame_label(&self.by_rules);
        let alone = by_rules.class == Class::Clean && by_map == Class::Anomalous;
        self.alone += (f64::from(u8::from(alone)) - self.alone) / MEMORY_FRAMES;
        let label = if alone && self.alone < NOVELTY {
            for (label, recent) in self.labels.iter_mut().zip(&self.recent) {
                if label.class == Class::Clean && recent.still_lasts() {
                    *label = Label::anomalous(Cause::Map);
                }
            }
            Label::anomalous(if strange { Cause::Map } else { Cause::Distance })
        } else {
            by_rules
        };
        Judged {
            label,
            by_rules: by_rules.class,
            by_map,
            winner,
            sensors: &self.labels,
            distances_m: &self.distances_m,
        }
    }

    /// Size of this body over that of the training's, 0.7 to 1.4; 1 until it is known.
    pub fn size(&self) -> f64 {
        self.labeller.size()
    }
}
