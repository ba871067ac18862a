//! What is usual for one sensor: where it is, where it is beside another, and whether it moves when others do.
//!
//! What comes in: positions as the map sees them, and what the rules say of them. What goes out: how unusual a place is, and
//! the class of the nearest neuron. What it never does: look at other frames, but for the length of the last steps.

use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::som::{Batch, Rule, Som, Training};
use posed_fusion::faults::Class;

/// A neuron has a class if this share of its training frames has it: faults are rare for one sensor, so a few that look
/// clean must not name it.
const NEURON_SHARE: f64 = 0.9;
/// Sensors are never put on twice in the same way, m.
const MOUNTING_M: f64 = 0.05;
/// A neuron's spread counts as much as so many frames with that of its whole chain, and is never below this, m.
const PRIOR_FRAMES: f64 = 50.0;
const SMALLEST_SPREAD_M: f64 = 0.01;
/// Steps that are looked at: as many as make a stuck sensor.
const STEPS: usize = 4;
/// Steps are compared in logarithms, so that none at all has a place: in shares of the usual step.
const NO_STEP: f64 = 1e-4;
/// Rows that are enough to learn the steps of all sensors from.
const STEP_ROWS: usize = 40_000;

/// Places of a sensor: a chain of neurons, each with a class and how far clean positions are from it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub(super) struct PositionChain {
    pub(super) chain: Som,
    pub(super) classes: Vec<Class>,
    /// Root mean square, m.
    pub(super) spreads_m: Vec<f64>,
}

/// What a chain reports about a position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PositionMatch {
    pub(super) neuron: usize,
    pub(super) class: Class,
    pub(super) distance_m: f64,
    pub(super) spread_m: f64,
}

impl PositionMatch {
    /// How unusual it is: distance in spreads, after `mounting_m` of it.
    pub(super) fn ratio(&self, mounting_m: f64) -> f64 {
        (self.distance_m - mounting_m).max(0.0) / self.spread_m
    }
}

impl PositionChain {
    /// Learns from positions (three numbers a frame) and the sensor's class in each.
    pub(super) fn learn(
        neurons: usize,
        data: &[f64],
        classes: &[Class],
        rule: &mut impl Rule,
        training: &Training,
    ) -> Self {
        let mut chain = Som::along_principal_axes(1, neurons, 3, data);
        chain.train_by(rule, data, training);
        let mut counts = vec![[0u32; 4]; neurons];
        let mut squares = vec![(0.0, 0.0); neurons];
        for (p, class) in data.chunks_exact(3).zip(classes) {
            let Some(winner) = chain.winner(p) else { continue };
            counts[winner.cell][*class as usize] += 1;
            if *class == Class::Clean {
                squares[winner.cell].0 += winner.distance * winner.distance;
                squares[winner.cell].1 += 1.0;
            }
        }
        let (sum, count) = squares.iter().fold((0.0, 0.0), |all, one| (all.0 + one.0, all.1 + one.1));
        let usual = if count > 0.0 { sum / count } else { 0.0 };
        let spread = |(square, count): &(f64, f64)| {
            let mean = (square + PRIOR_FRAMES * usual) / (count + PRIOR_FRAMES);
            mean.sqrt().max(SMALLEST_SPREAD_M)
        };
        Self {
            spreads_m: squares.iter().map(spread).collect(),
            classes: counts.iter().map(|counts| super::majority(counts, NEURON_SHARE)).collect(),
            chain,
        }
    }

    /// The nearest neuron to a position; `None` where it is missing.
    pub(super) fn position(&self, p: &[f64]) -> Option<PositionMatch> {
        let winner = self.chain.winner(p)?;
        Some(PositionMatch {
            neuron: winner.cell,
            class: self.classes[winner.cell],
            distance_m: winner.distance,
            spread_m: self.spreads_m[winner.cell],
        })
    }

    pub(super) fn fits(&self) -> bool {
        let neurons = self.classes.len();
        let weights = &self.chain.weights;
        neurons > 0
            && self.chain.dimension == 3
            && weights.len() == 3 * neurons
            && self.spreads_m.len() == neurons
            && weights.iter().all(|value| value.is_finite())
            && self.spreads_m.iter().all(|spread| *spread > 0.0 && spread.is_finite())
    }
}

/// Where a sensor is beside the one from which its distance varies least.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub(super) struct Link {
    other: usize,
    #[serde(rename = "places")]
    positions: PositionChain,
}

impl Link {
    /// Learns from positions of both, frame by frame.
    pub(super) fn learn(
        (sensor, other): (usize, usize),
        frames: &[f64],
        sensors: usize,
        classes: &[Class],
        training: &Training,
    ) -> Self {
        let rows = frames.chunks_exact(3 * sensors);
        let data: Vec<f64> = rows.flat_map(|row| beside(row, sensor, other)).collect();
        let neurons = training_neurons(&data);
        Self {
            other,
            positions: PositionChain::learn(neurons, &data, classes, &mut Batch::default(), training),
        }
    }

    /// The nearest neuron to where a sensor is in a frame.
    pub(super) fn position(&self, frame: &[f64], sensor: usize) -> Option<PositionMatch> {
        self.positions.position(&beside(frame, sensor, self.other))
    }

    /// What two sensors that were put on anew may be off beside each other, m.
    pub(super) const MOUNTING_M: f64 = MOUNTING_M * std::f64::consts::SQRT_2;

    pub(super) fn fits(&self, sensors: usize) -> bool {
        self.other < sensors && self.positions.fits()
    }
}

impl PositionChain {
    /// What a sensor that was put on anew may be off, m.
    pub(super) const MOUNTING_M: f64 = MOUNTING_M;
}

/// As many as for positions, whatever the sizes of the map.
fn training_neurons(data: &[f64]) -> usize {
    (data.len() / 3).clamp(1, 41)
}

fn beside(frame: &[f64], sensor: usize, other: usize) -> [f64; 3] {
    std::array::from_fn(|c| frame[3 * sensor + c] - frame[3 * other + c])
}

/// How sensors move while others move: one chain for all of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub(super) struct Motion {
    /// Per sensor, longest usual step, m.
    usual_m: Vec<f64>,
    chain: Som,
    classes: Vec<Class>,
}

impl Motion {
    /// Learns from frames as they came and the classes of all sensors in them; `usual_m` are the sensors' usual steps.
    pub(super) fn learn(
        frames: &[f64],
        usual_m: Vec<f64>,
        classes: impl Fn(usize, usize) -> Class,
        training: &Training,
    ) -> Self {
        let sensors = usual_m.len();
        let mut steps = Steps::new(sensors);
        let (mut data, mut truth) = (Vec::new(), Vec::new());
        let stride = (frames.len() / 3).div_ceil(STEP_ROWS).max(1);
        for (k, frame) in frames.chunks_exact(3 * sensors).enumerate() {
            steps.push(frame, &usual_m);
            for sensor in (0..sensors).filter(|sensor| (k + sensor) % stride == 0) {
                data.extend(steps.of(sensor));
                truth.push(classes(k, sensor));
            }
        }
        let mut chain = Som::along_principal_axes(1, 41, 2, &data);
        chain.train(&data, training);
        let mut counts = vec![[0u32; 4]; 41];
        for (row, class) in data.chunks_exact(2).zip(&truth) {
            if let Some(winner) = chain.winner(row) {
                counts[winner.cell][*class as usize] += 1;
            }
        }
        let classes = counts.iter().map(|counts| super::majority(counts, NEURON_SHARE)).collect();
        Self { usual_m, chain, classes }
    }

    /// Takes a frame as it came.
    pub(super) fn follow(&self, steps: &mut Steps, frame: &[f64]) {
        steps.push(frame, &self.usual_m);
    }

    /// What such steps are; unknown while there are too few.
    pub(super) fn class(&self, steps: &Steps, sensor: usize) -> Class {
        let row = steps.of(sensor);
        if row[0].is_nan() || row[1].is_nan() {
            return Class::Unknown;
        }
        self.chain.winner(&row).map_or(Class::Unknown, |winner| self.classes[winner.cell])
    }

    pub(super) fn fits(&self, sensors: usize) -> bool {
        let weights = &self.chain.weights;
        self.usual_m.len() == sensors
            && self.chain.dimension == 2
            && !self.classes.is_empty()
            && weights.len() == 2 * self.classes.len()
            && weights.iter().all(|value| value.is_finite())
    }
}

/// The last few steps of all sensors.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Steps {
    last: Vec<f64>,
    /// In shares of the usual step; NaN where a position is missing.
    steps: Vec<[f64; STEPS]>,
    largest: Vec<f64>,
    sorted: Vec<f64>,
    at: usize,
}

impl Steps {
    pub(super) fn new(sensors: usize) -> Self {
        Self {
            last: vec![f64::NAN; 3 * sensors],
            steps: vec![[f64::NAN; STEPS]; sensors],
            largest: vec![f64::NAN; sensors],
            sorted: Vec::with_capacity(sensors),
            at: 0,
        }
    }

    fn push(&mut self, frame: &[f64], usual_m: &[f64]) {
        self.at = (self.at + 1) % STEPS;
        let pairs = frame.chunks_exact(3).zip(self.last.chunks_exact(3));
        for (sensor, (now, before)) in pairs.enumerate() {
            let square: f64 = now.iter().zip(before).map(|(a, b)| (a - b) * (a - b)).sum();
            let steps = &mut self.steps[sensor];
            steps[self.at] = square.sqrt() / usual_m[sensor].max(1e-6);
            // A step that is not known makes the largest unknown.
            self.largest[sensor] =
                steps.iter().fold(0.0, |a: f64, b| if b.is_nan() { f64::NAN } else { largest(a, *b) });
        }
        self.last.copy_from_slice(frame);
        self.sorted.clear();
        self.sorted.extend(self.largest.iter().filter(|value| !value.is_nan()));
        self.sorted.sort_unstable_by(f64::total_cmp);
    }

    /// Logarithms of a sensor's largest step and of the median of all.
    fn of(&self, sensor: usize) -> [f64; 2] {
        let median = self.sorted.get(self.sorted.len() / 2).copied().unwrap_or(f64::NAN);
        [self.largest[sensor], median].map(|share| libm::log(share + NO_STEP))
    }
}

fn largest(a: f64, b: f64) -> f64 {
    if a.is_nan() { a } else { a.max(b) }
}
