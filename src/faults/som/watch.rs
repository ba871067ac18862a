//! A network and its rules over a stream of frames.
//!
//! What comes in: frames. What goes out: a [`Verdict`] per frame. What it never does: look at the future, allocate.

use serde::{Deserialize, Serialize};

use super::Network;
use super::habits::{Link, Places, Steps};
use super::map::Winner;
use super::rules::{Cause, Class, Labeller, frame_class};

/// A label of the map counts once so many of the last five frames have it.
const DEBOUNCE: u32 = 3;
/// A map that is discontent with more than this share of so many frames has not seen these movements: rules decide.
const NOVELTY: f64 = 0.015;
const MEMORY_FRAMES: f64 = 1000.0;
/// The map is content with a sensor below this share of what is unusual.
const CONTENT: f64 = 0.5;
/// Least weight of a frame in how unusual a sensor is on average.
const WORN_WEIGHT: f64 = 0.002;
const RECENT: u8 = 0b1_1111;

/// Labels a stream of frames: rules and map together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Watch {
    labeller: Labeller,
    /// Positions as the map sees them, and the first layer's answer.
    seen: Vec<f64>,
    indices: Vec<f64>,
    by_rules: Vec<(Class, Cause)>,
    steps: Steps,
    /// Per sensor: the map found nothing unusual in the latest frame.
    content: Vec<bool>,
    /// Per sensor, how unusual its places are on average: how it is put on in this session.
    worn: Vec<f64>,
    frames: u32,
    labels: Vec<(Class, Cause)>,
    distances_m: Vec<f64>,
    /// Per sensor, one bit for each of the last five frames: the map calls it anomalous.
    recent: Vec<u8>,
    /// The same of the frame.
    recent_frame: u8,
    guess: usize,
    /// Share of the latest frames with which the rules are content and the map is not.
    alone: f64,
}

/// What is the matter with a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Verdict<'a> {
    /// Rules and map together.
    pub class: Class,
    /// Why.
    pub cause: Cause,
    /// What the rules say; the map's only part in it is how soon a sensor that jumped is believed again.
    pub by_rules: Class,
    /// What the map alone says.
    pub by_map: Class,
    /// The second layer's winner; `None` if no sensor is there.
    pub winner: Option<Winner>,
    /// Per sensor, rules and map together.
    pub sensors: &'a [(Class, Cause)],
    /// Per sensor: distance from the nearest place where it was in training, m; NaN where missing.
    pub distances_m: &'a [f64],
}

impl Watch {
    pub(super) fn new(network: &Network) -> Self {
        let sensors = network.sensors.len();
        let nothing = vec![(Class::Unknown, Cause::Missing); sensors];
        Self {
            labeller: network.rules.labeller(),
            seen: vec![f64::NAN; 3 * sensors],
            indices: vec![f64::NAN; sensors],
            by_rules: nothing.clone(),
            steps: Steps::new(sensors),
            content: vec![false; sensors],
            worn: vec![0.0; sensors],
            frames: 0,
            labels: nothing,
            distances_m: vec![f64::NAN; sensors],
            recent: vec![0; sensors],
            recent_frame: 0,
            guess: 0,
            alone: 1.5 * NOVELTY,
        }
    }

    /// Labels the next frame: three numbers a sensor, in the network's order, NaN where missing.
    pub fn push(&mut self, network: &Network, frame: &[f64]) -> Verdict<'_> {
        network.rules.label_beside(&mut self.labeller, frame, &self.content, &mut self.by_rules);
        network.motion.follow(&mut self.steps, frame);
        network.see(frame, self.labeller.size(), &mut self.seen);
        let mut strange = false;
        for sensor in 0..network.sensors.len() {
            let look = network.look(sensor, &self.seen, [Places::WORN_M, Link::WORN_M]);
            self.indices[sensor] = look.index;
            self.distances_m[sensor] = look.distance_m;
            let off = self.worn[sensor];
            // A sensor on a neuron of inverted frames, in a figure that is not, is wrong too.
            let bad = matches!(look.class, Class::Anomalous)
                || look.ratio - off > network.usual_ratio
                || network.motion.class(&self.steps, sensor) == Class::Anomalous;
            let content = look.ratio - off < CONTENT * network.usual_ratio;
            self.content[sensor] = !bad && content && look.class == Class::Clean;
            if self.by_rules[sensor].0 == Class::Clean {
                let weight = WORN_WEIGHT.max(1.0 / f64::from(self.frames + 1));
                self.worn[sensor] += weight * (look.ratio - self.worn[sensor]);
            }
            let recent = &mut self.recent[sensor];
            *recent = (*recent << 1 | u8::from(bad)) & RECENT;
            strange |= lasts(*recent);
        }
        self.frames = self.frames.saturating_add(1);
        let winner = network.map.winner_from(&self.indices, self.guess);
        self.guess = winner.map_or(0, |winner| winner.cell);
        let cell = winner.map_or(Class::Unknown, |winner| network.cells[winner.cell]);
        let far = winner.is_some_and(|winner| winner.distance > network.usual_distance);
        self.recent_frame = (self.recent_frame << 1 | u8::from(far)) & RECENT;
        let bad_frame = lasts(self.recent_frame);
        let by_map = match cell {
            Class::Inverted => Class::Inverted,
            _ if strange || bad_frame => Class::Anomalous,
            _ => Class::Clean,
        };
        self.labels.copy_from_slice(&self.by_rules);
        let (by_rules, cause) = frame_class(&self.by_rules);
        let alone = by_rules == Class::Clean && by_map == Class::Anomalous;
        self.alone += (f64::from(u8::from(alone)) - self.alone) / MEMORY_FRAMES;
        let (class, cause) = if alone && self.alone < NOVELTY {
            for (label, recent) in self.labels.iter_mut().zip(&self.recent) {
                if label.0 == Class::Clean && lasts(*recent) {
                    *label = (Class::Anomalous, Cause::Map);
                }
            }
            (Class::Anomalous, if strange { Cause::Map } else { Cause::Distance })
        } else {
            (by_rules, cause)
        };
        Verdict {
            class,
            cause,
            by_rules,
            by_map,
            winner,
            sensors: &self.labels,
            distances_m: &self.distances_m,
        }
    }

    /// Size of this body over that of the training's.
    pub fn size(&self) -> f64 {
        self.labeller.size()
    }
}

/// Whether the latest frame and enough of those before it are bad.
fn lasts(recent: u8) -> bool {
    recent & 1 == 1 && recent.count_ones() >= DEBOUNCE
}
