//! A two-layer self-organising map that knows the faulty frames of a stage.
//!
//! After I. Miller, S. McGlinchey and B. Chaperot, "Anomaly detection in magnetic motion capture using a 2-layer
//! SOM network" (2006): a chain of 41 neurons per sensor turns its position into an index, and a map of 21 x 21 cells
//! turns all indices into one cell. Beyond the paper that map also receives what each joint between sensors leaves over ([`joints`]). What the paper leaves to an operator, the names of the cells, comes from
//! physics ([`rules`]). What comes in: frames of poses. What goes out: a label, a cause and a distance per sensor
//! and frame. What it never does: change a position, or judge a set of sensors it was not trained on.

mod body;
mod file;
mod frames;
mod habits;
mod hindsight;
mod joints;
mod learning;
mod memory;
mod pairs;
mod rules;
mod separation;
mod side;
mod som;
mod watch;

use posed_state::Plain;
use serde::{Deserialize, Serialize};

use body::Body;
use file::File;
pub use frames::{Frame, Frames};
use habits::{Link, Motion, PositionChain, PositionMatch};
use posed_fusion::faults::{Class, Label};
pub use rules::{Labeller, Rules, frame_label};
pub use separation::{Separation, separation};
use som::Batch;
pub use som::{Kernel, Rule, Som, Training, Width, Winner, neighbourhood};
pub use watch::{Judged, Watch};

/// A cell has a class if this share of its training frames has it.
const CLEAR_SHARE: f64 = 0.6;
/// Share of the training's clean frames whose distance from their cell is usual.
const USUAL_SHARE: f64 = 0.9995;
/// What is farther from its cell than that, so many times, was never seen.
const FARTHER: f64 = 1.25;

/// Sizes of the two layers; the default is the paper's 41 neurons and 21 x 21 cells (Miller et al. 2006).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Size {
    /// Neurons of each sensor's chain in the first layer.
    pub neurons: usize,
    /// Rows, and columns, of the second layer.
    pub side: usize,
}

impl Default for Size {
    fn default() -> Self {
        Self { neurons: 41, side: 21 }
    }
}

/// A trained two-layer self-organising map with its rules, as `FAULTS.json` holds it. It knows one set of sensors, one
/// frame rate and one place of the transmitter.
///
/// It classifies frames and never changes a position. Method: `docs/methods/fault-map.md`, after Miller et al. 2006;
/// rates of detection and false alarms: `docs/faults.md`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[serde(try_from = "File", into = "File")]
pub struct FaultMap {
    /// Names of the sensors that it knows, in the order of its frames.
    pub sensors: Vec<String>,
    /// The figure's axes, if positions are looked at in these.
    body: Option<Body>,
    /// Per sensor: where it is in these axes, and where it is beside another, if there is one.
    positions: Vec<PositionChain>,
    links: Vec<Option<Link>>,
    motion: Motion,
    /// The largest distance from a neuron, in its spreads, that any sensor has in a usual frame.
    usual_ratio: f64,
    map: Som,
    /// Class of each cell of the second layer, row by row.
    pub cells: Vec<Class>,
    /// Largest usual distance of a frame from its cell in the second layer, in shares of a first-layer chain.
    pub usual_distance: f64,
    rules: Rules,
    /// Passes that the training of the second layer took.
    pub epochs: usize,
    /// Which state of a stage's fault map this is; counted up when it is learnt anew or a cell is renamed.
    pub revision: u32,
}

/// Why a fault map cannot be trained or used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FaultMapError {
    /// The recording has other sensors.
    #[error("expected the sensors {expected}, found {found}; train a fault map for these sensors")]
    Sensors {
        /// Those of the fault map.
        expected: String,
        /// Those of the recording.
        found: String,
    },
    /// There is nothing to train on.
    #[error("expected at least {expected} frames with positions, found {found}")]
    Frames {
        /// So many are needed.
        expected: usize,
        /// So many are there.
        found: usize,
    },
    /// There is no such cell.
    #[error("expected a row below {rows} and a column below {columns}")]
    Cell {
        /// Rows of the map.
        rows: usize,
        /// Columns of the map.
        columns: usize,
    },
    /// The file does not hold together.
    #[error("not a fault map: {0}")]
    File(&'static str),
}

/// What is reported of a whole recording with hindsight.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Labels {
    /// One label per frame.
    pub frames: Vec<Label>,
    /// One label per frame and sensor, frame by frame.
    pub sensors: Vec<Label>,
}

impl FaultMap {
    /// Trains both layers on a recording by the batch rule, and names the cells by what the rules say of its frames;
    /// returns the rules' labels of the recording too.
    ///
    /// It needs no labels from an operator and gives the same map for the same recording and seed. Movements that the
    /// recording does not show cannot be judged later.
    ///
    /// # Errors
    /// There are fewer than ten frames, or no sensors.
    pub fn train(frames: &Frames, size: Size, training: &Training) -> Result<(Self, Labels), FaultMapError> {
        Self::train_by(&mut Batch::default(), frames, size, training, training)
    }

    /// As [`Self::train`], with a rule for the chains of positions and the second layer. The chains beside these, of
    /// distances between sensors and of steps, are trained by the batch rule as `beside` says.
    ///
    /// # Errors
    /// There are fewer than ten frames, or no sensors.
    pub fn train_by(
        rule: &mut impl Rule,
        frames: &Frames,
        size: Size,
        training: &Training,
        beside: &Training,
    ) -> Result<(Self, Labels), FaultMapError> {
        if frames.len() < 10 || frames.sensors.is_empty() {
            return Err(FaultMapError::Frames { expected: 10, found: frames.len() });
        }
        let sensors = frames.sensors.len();
        let (rules, labels, shares) = Rules::learn_with_shares(frames);
        // The published map sees positions alone.
        let shares = if training.body { shares } else { Vec::new() };
        let joints = shares.len() / frames.len();
        let mut fault_map = Self {
            sensors: frames.sensors.clone(),
            body: training.body.then(|| Body::learn(frames, &labels.sensors)).flatten(),
            positions: Vec::new(),
            links: Vec::new(),
            motion: Motion::learn(
                &frames.positions_m,
                rules.usual_steps_m(),
                |k, sensor| labels.sensors[k * sensors + sensor].class,
                beside,
            ),
            usual_ratio: 0.0,
            map: Som { rows: 0, columns: 0, dimension: 0, weights: Vec::new() },
            cells: Vec::new(),
            usual_distance: 0.0,
            rules,
            epochs: 0,
            revision: 0,
        };
        let mut seen = frames.clone();
        for k in 0..frames.len() {
            fault_map.see(frames.positions(k), 1.0, seen.positions_mut(k));
        }
        for sensor in 0..sensors {
            let classes: Vec<Class> =
                labels.sensors.iter().skip(sensor).step_by(sensors).map(|label| label.class).collect();
            let positions =
                PositionChain::learn(size.neurons, &seen.sensor(sensor), &classes, rule, training);
            fault_map.positions.push(positions);
            let link = |other| Link::learn((sensor, other), &seen.positions_m, sensors, &classes, beside);
            fault_map.links.push(fault_map.rules.nearest(sensor).map(link));
        }
        // How unusual each sensor is on average, and then how much more than that the worst one is.
        let mut inputs = Vec::with_capacity(frames.len() * (sensors + joints));
        let mut ratios = vec![0.0; frames.len() * sensors];
        let mut means = vec![(0.0, 0.0f64); sensors];
        for k in 0..frames.len() {
            for (sensor, mean) in means.iter_mut().enumerate() {
                let look = fault_map.look(sensor, seen.positions(k), [0.0; 2]);
                let at = k * sensors + sensor;
                inputs.push(look.index);
                ratios[at] = look.ratio;
                if labels.sensors[at].class == Class::Clean {
                    *mean = (mean.0 + look.ratio, mean.1 + 1.0);
                }
            }
            inputs.extend(&shares[k * joints..(k + 1) * joints]);
        }
        let clean = (0..frames.len()).filter(|k| labels.frames[*k].class == Class::Clean);
        let more = |k: usize| {
            let row = ratios[k * sensors..(k + 1) * sensors].iter().zip(&means);
            row.map(|(ratio, (sum, count))| ratio - sum / count.max(1.0)).fold(0.0, f64::max)
        };
        let mut ratios: Vec<f64> = clean.map(more).collect();
        fault_map.usual_ratio = pairs::quantile(&mut ratios, USUAL_SHARE);
        let is_strange = |k: usize| {
            (0..sensors).any(|sensor| fault_map.is_strange(sensor, seen.positions(k)))
                || shares[k * joints..(k + 1) * joints].iter().any(|share| joints::is_strange(*share))
        };
        let strange: Vec<bool> = (0..frames.len()).map(is_strange).collect();
        fault_map.map = Som::along_principal_axes(size.side, size.side, sensors + joints, &inputs);
        fault_map.epochs = fault_map.map.train_by(rule, &inputs, training);
        fault_map.name_cells(&inputs, &labels.frames, &strange);
        Ok((fault_map, labels))
    }

    /// Positions as the map sees them.
    fn see(&self, frame: &[f64], size: f64, seen: &mut [f64]) {
        match &self.body {
            Some(body) => body.align(frame, size, seen),
            None => seen.copy_from_slice(frame),
        }
    }

    /// What the first layer reports about a sensor in a frame as the map sees it; `mounting_m` is what sensors that were put on
    /// anew may be off, in the figure's axes and beside each other.
    fn look(&self, sensor: usize, seen: &[f64], mounting_m: [f64; 2]) -> Look {
        let positions = &self.positions[sensor];
        let position = positions.position(&seen[3 * sensor..3 * sensor + 3]);
        let link = self.links[sensor].as_ref().and_then(|link| link.position(seen, sensor));
        let ratio = |position: Option<PositionMatch>, mounting_m| {
            position.map_or(0.0, |position| position.ratio(mounting_m))
        };
        let Some(at) = position else {
            return Look { index: f64::NAN, class: Class::Unknown, distance_m: f64::NAN, ratio: 0.0 };
        };
        Look {
            index: at.neuron as f64 / positions.classes.len() as f64,
            class: at.class,
            distance_m: at.distance_m,
            ratio: ratio(position, mounting_m[0]).max(ratio(link, mounting_m[1])),
        }
    }

    /// Whether the first layer finds a sensor where it never was, or only when something was wrong.
    fn is_strange(&self, sensor: usize, seen: &[f64]) -> bool {
        let look = self.look(sensor, seen, [PositionChain::MOUNTING_M, Link::MOUNTING_M]);
        look.class == Class::Anomalous || look.ratio > self.usual_ratio
    }

    /// Each cell takes the class of the clear majority of its frames; an unused one that of the nearest used
    /// one, if that is as near as neighbours are.
    fn name_cells(&mut self, inputs: &[f64], labels: &[Label], strange: &[bool]) {
        let dimension = self.map.dimension;
        let mut counts = vec![[0u32; 4]; self.map.cells()];
        let mut distances = Vec::new();
        for ((row, label), strange) in inputs.chunks_exact(dimension).zip(labels).zip(strange) {
            // A fault that the first layer does not show would name the posture in which it happened.
            if label.class == Class::Anomalous && !strange {
                continue;
            }
            let Some(winner) = self.map.winner(row) else { continue };
            counts[winner.cell][label.class as usize] += 1;
            if label.class == Class::Clean {
                distances.push(winner.distance);
            }
        }
        self.usual_distance = FARTHER * pairs::quantile(&mut distances, USUAL_SHARE);
        let used: Vec<usize> =
            (0..counts.len()).filter(|cell| counts[*cell].iter().sum::<u32>() > 0).collect();
        let weight = |cell: usize| &self.map.weights[cell * dimension..(cell + 1) * dimension];
        let apart = |a: usize, b: usize| {
            weight(a).iter().zip(weight(b)).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
        };
        let mut beside: Vec<f64> = (1..counts.len()).map(|cell| apart(cell - 1, cell)).collect();
        let usual = pairs::quantile(&mut beside, 0.5);
        let name = |cell: usize| {
            if counts[cell].iter().sum::<u32>() > 0 {
                return majority(&counts[cell], CLEAR_SHARE);
            }
            let nearest = used.iter().min_by(|a, b| apart(cell, **a).total_cmp(&apart(cell, **b)));
            match nearest {
                Some(nearest) if apart(cell, *nearest) <= usual => majority(&counts[*nearest], CLEAR_SHARE),
                _ => Class::Unknown,
            }
        };
        self.cells = (0..counts.len()).map(name).collect();
    }

    /// Rows and columns of the second layer.
    pub fn size(&self) -> (usize, usize) {
        (self.map.rows, self.map.columns)
    }

    /// Gives a cell of the second layer another class; rows and columns count from 0.
    ///
    /// # Errors
    /// There is no such cell; the map stays as it was.
    pub fn name_cell(&mut self, row: usize, column: usize, class: Class) -> Result<(), FaultMapError> {
        let (rows, columns) = self.size();
        if row >= rows || column >= columns {
            return Err(FaultMapError::Cell { rows, columns });
        }
        self.cells[row * columns + column] = class;
        Ok(())
    }

    /// Whether a watch of `self` can go on with `other`: they differ in nothing but classes of cells, epochs and
    /// revision.
    pub fn is_renamed(&self, other: &Self) -> bool {
        let Self { sensors, body, positions, links, motion, usual_ratio, map, usual_distance, rules, .. } =
            self;
        *sensors == other.sensors
            && *body == other.body
            && *positions == other.positions
            && *links == other.links
            && *motion == other.motion
            && *usual_ratio == other.usual_ratio
            && *map == other.map
            && *usual_distance == other.usual_distance
            && *rules == other.rules
    }

    /// Whether these are its sensors, in any order.
    ///
    /// # Errors
    /// A name is missing, or there are more; the error names both lists.
    pub fn check_sensors(&self, sensors: &[&str]) -> Result<(), FaultMapError> {
        let same = sensors.len() == self.sensors.len()
            && self.sensors.iter().all(|own| sensors.contains(&own.as_str()));
        let error = || FaultMapError::Sensors { expected: self.sensors.join(","), found: sensors.join(",") };
        if same { Ok(()) } else { Err(error()) }
    }

    /// A recording with its sensors in the order of this fault map.
    ///
    /// # Errors
    /// They are not the sensors of this fault map; the error names both lists.
    pub fn adapt(&self, frames: &Frames) -> Result<Frames, FaultMapError> {
        frames.in_order_of(&self.sensors).ok_or_else(|| FaultMapError::Sensors {
            expected: self.sensors.join(","),
            found: frames.sensors.join(","),
        })
    }

    /// Its rules, which judge without the self-organising map.
    pub fn rules(&self) -> &Rules {
        &self.rules
    }

    /// A watch over a stream of this fault map's sensors that has seen nothing.
    pub fn watch(&self) -> Watch {
        Watch::new(self)
    }
}

/// What the first layer reports about a sensor.
#[derive(Clone, Copy, Debug)]
struct Look {
    /// What the second layer receives: the winning neuron, as a share of the chain.
    index: f64,
    class: Class,
    /// From the winner, m.
    distance_m: f64,
    /// How unusual its place is, in the figure's axes or beside another sensor, in spreads.
    ratio: f64,
}

/// The class of the clear majority.
fn majority(counts: &[u32; 4], share: f64) -> Class {
    let total: u32 = counts.iter().sum();
    let classes = [Class::Clean, Class::Inverted, Class::Anomalous];
    let best = classes.into_iter().max_by_key(|class| counts[*class as usize]);
    best.filter(|class| total > 0 && f64::from(counts[*class as usize]) >= share * f64::from(total))
        .unwrap_or(Class::Unknown)
}

#[cfg(test)]
mod tests;
