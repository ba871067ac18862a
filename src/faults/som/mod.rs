//! A two-layer self-organising map that knows the bad frames of a stage.
//!
//! After I. Miller, S. McGlinchey and B. Chaperot, "Anomaly detection in magnetic motion capture using a 2-layer
//! SOM network" (2006): a chain of 41 neurons per sensor turns its position into an index, and a map of 21 x 21 cells
//! turns all indices into one cell. What the paper leaves to an operator, the names of the cells, comes from
//! physics ([`rules`]). What comes in: frames of positions. What goes out: a label, a cause and a distance per sensor
//! and frame. What it never does: change a position, or judge a set of sensors it was not trained on.

pub mod frames;
pub mod map;
pub mod picture;
pub mod rules;
pub mod study;

use serde::{Deserialize, Serialize};

use frames::Frames;
use map::{Map, Training, Winner};
use rules::{Cause, Class, Labeller, Rules, frame_class};

/// A cell has a class if this share of its training frames has it.
const CLEAR_SHARE: f64 = 0.6;
/// Share of the training's clean frames whose distance from their cell is usual.
const USUAL_SHARE: f64 = 0.995;
/// A label of the map is published once so many of the last five frames have it.
const DEBOUNCE: u32 = 3;

/// Sizes of the two layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Size {
    /// Neurons per sensor.
    pub neurons: usize,
    /// Rows and columns of the second layer.
    pub side: usize,
}

impl Default for Size {
    fn default() -> Self {
        Self { neurons: 41, side: 21 }
    }
}

/// The first layer: a chain per sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Layer1 {
    /// Sensor, neuron, coordinate; m.
    weights: Vec<Vec<[f64; 3]>>,
}

/// The second layer: a map of winners' indices.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Layer2 {
    /// Row, column, sensor; index over the number of neurons.
    weights: Vec<Vec<Vec<f64>>>,
}

/// A trained network, as `FAULTS.json` holds it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "File", into = "File")]
pub struct Network {
    /// The sensors that it knows, in order.
    pub sensors: Vec<String>,
    chains: Vec<Map>,
    map: Map,
    /// Class of each cell, row by row.
    pub cells: Vec<Class>,
    /// Largest usual distance from a cell.
    pub usual_distance: f64,
    rules: Rules,
    /// Passes of the second layer's training.
    pub epochs: usize,
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    format: String,
    sensors: Vec<String>,
    layer1: Layer1,
    layer2: Layer2,
    /// Row by row; may be edited by hand.
    cells: Vec<Vec<Class>>,
    usual_distance: f64,
    epochs: usize,
    rules: Rules,
}

const FORMAT: &str = "posed faults 1";

/// Why a network cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NetworkError {
    /// The recording has other sensors.
    #[error("expected the sensors {expected}, found {found}; train a network for these sensors")]
    Sensors {
        /// Those of the network.
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
    /// The file does not hold together.
    #[error("not a network: {0}")]
    File(&'static str),
}

/// What the rules say of a whole recording: per frame, and per frame and sensor.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Labels {
    /// Frame by frame.
    pub frames: Vec<(Class, Cause)>,
    /// Frame by frame, sensor by sensor.
    pub sensors: Vec<(Class, Cause)>,
}

impl Network {
    /// Trains both layers on a recording, and names the cells by what the rules say of its frames.
    ///
    /// # Errors
    /// There are fewer than ten frames.
    pub fn train(frames: &Frames, size: Size, training: &Training) -> Result<(Self, Labels), NetworkError> {
        if frames.len() < 10 || frames.sensors.is_empty() {
            return Err(NetworkError::Frames { expected: 10, found: frames.len() });
        }
        let rules = Rules::learn(frames);
        let labels = label_all(&rules, frames);
        let chains: Vec<Map> = (0..frames.sensors.len())
            .map(|sensor| {
                let data = frames.sensor(sensor);
                let mut chain = Map::along_principal_axes(1, size.neurons, 3, &data);
                chain.train(&data, training);
                chain
            })
            .collect();
        let mut network = Self {
            sensors: frames.sensors.clone(),
            chains,
            map: Map { rows: 0, columns: 0, dimension: 0, weights: Vec::new() },
            cells: Vec::new(),
            usual_distance: 0.0,
            rules,
            epochs: 0,
        };
        let mut indices = vec![0.0; frames.len() * frames.sensors.len()];
        for (k, row) in indices.chunks_exact_mut(frames.sensors.len()).enumerate() {
            network.indices(frames.frame(k), row);
        }
        network.map = Map::along_principal_axes(size.side, size.side, frames.sensors.len(), &indices);
        network.epochs = network.map.train(&indices, training);
        network.name_cells(&indices, &labels.frames);
        Ok((network, labels))
    }

    /// First layer: index of each sensor's winner over the number of neurons, NaN where it is missing.
    fn indices(&self, frame: &[f64], row: &mut [f64]) {
        for (sensor, (chain, index)) in self.chains.iter().zip(row).enumerate() {
            let winner = chain.winner(&frame[3 * sensor..3 * sensor + 3]);
            *index = winner.map_or(f64::NAN, |winner| winner.cell as f64 / chain.columns as f64);
        }
    }

    /// Each cell takes the class of the clear majority of its frames; an unused one that of the nearest used
    /// one, if that is as near as neighbours are.
    fn name_cells(&mut self, indices: &[f64], classes: &[(Class, Cause)]) {
        let dimension = self.map.dimension;
        let mut counts = vec![[0u32; 4]; self.map.cells()];
        let mut distances = Vec::new();
        for (row, (class, _)) in indices.chunks_exact(dimension).zip(classes) {
            let Some(winner) = self.map.winner(row) else { continue };
            counts[winner.cell][*class as usize] += 1;
            if *class == Class::Clean {
                distances.push(winner.distance);
            }
        }
        self.usual_distance = rules::quantile(&mut distances, USUAL_SHARE);
        let majority = |counts: &[u32; 4]| {
            let total: u32 = counts.iter().sum();
            let classes = [Class::Clean, Class::Inverted, Class::Anomalous];
            let best = classes.into_iter().max_by_key(|class| counts[*class as usize]);
            best.filter(|class| f64::from(counts[*class as usize]) >= CLEAR_SHARE * f64::from(total))
                .unwrap_or(Class::Unknown)
        };
        let used: Vec<usize> =
            (0..counts.len()).filter(|cell| counts[*cell].iter().sum::<u32>() > 0).collect();
        let weight = |cell: usize| &self.map.weights[cell * dimension..(cell + 1) * dimension];
        let apart = |a: usize, b: usize| {
            weight(a).iter().zip(weight(b)).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
        };
        let mut beside: Vec<f64> = (1..counts.len()).map(|cell| apart(cell - 1, cell)).collect();
        let usual = rules::quantile(&mut beside, 0.5);
        let name = |cell: usize| {
            if counts[cell].iter().sum::<u32>() > 0 {
                return majority(&counts[cell]);
            }
            let nearest = used.iter().min_by(|a, b| apart(cell, **a).total_cmp(&apart(cell, **b)));
            match nearest {
                Some(nearest) if apart(cell, *nearest) <= usual => majority(&counts[*nearest]),
                _ => Class::Unknown,
            }
        };
        self.cells = (0..counts.len()).map(name).collect();
    }

    /// Rows and columns of the second layer.
    pub fn size(&self) -> (usize, usize) {
        (self.map.rows, self.map.columns)
    }

    /// Takes a recording's sensors in the network's order.
    ///
    /// # Errors
    /// They are not the network's.
    pub fn adapt(&self, frames: &Frames) -> Result<Frames, NetworkError> {
        frames.in_order_of(&self.sensors).ok_or_else(|| NetworkError::Sensors {
            expected: self.sensors.join(","),
            found: frames.sensors.join(","),
        })
    }

    /// A watch over a stream of this network's sensors.
    pub fn watch(&self) -> Watch {
        let sensors = self.sensors.len();
        Watch {
            labeller: self.rules.labeller(),
            indices: vec![0.0; sensors],
            labels: vec![(Class::Unknown, Cause::Missing); sensors],
            recent: [Class::Clean; 5],
            next: 0,
        }
    }
}

/// What the rules say of a whole recording.
pub fn label_all(rules: &Rules, frames: &Frames) -> Labels {
    let mut labeller = rules.labeller();
    let mut labels = Labels::default();
    let mut row = vec![(Class::Unknown, Cause::Missing); frames.sensors.len()];
    for k in 0..frames.len() {
        rules.label(&mut labeller, frames.frame(k), &mut row);
        labels.frames.push(frame_class(&row));
        labels.sensors.extend_from_slice(&row);
    }
    labels
}

/// Labels a stream of frames: rules and map together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Watch {
    labeller: Labeller,
    indices: Vec<f64>,
    labels: Vec<(Class, Cause)>,
    recent: [Class; 5],
    next: usize,
}

/// What is the matter with a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Verdict<'a> {
    /// Rules and map together.
    pub class: Class,
    /// Why.
    pub cause: Cause,
    /// What the rules alone say.
    pub by_rules: Class,
    /// What the map alone says, undebounced.
    pub by_map: Class,
    /// The second layer's winner; `None` if no sensor is there.
    pub winner: Option<Winner>,
    /// Per sensor, by the rules.
    pub sensors: &'a [(Class, Cause)],
}

impl Watch {
    /// Labels the next frame: three numbers a sensor, in the network's order, NaN where missing.
    pub fn push(&mut self, network: &Network, frame: &[f64]) -> Verdict<'_> {
        network.rules.label(&mut self.labeller, frame, &mut self.labels);
        network.indices(frame, &mut self.indices);
        let winner = network.map.winner(&self.indices);
        let by_map = winner.map_or(Class::Unknown, |winner| network.cells[winner.cell]);
        self.recent[self.next] = by_map;
        self.next = (self.next + 1) % self.recent.len();
        let votes = |class: Class| self.recent.iter().filter(|recent| **recent == class).count() as u32;
        let (class, cause) = frame_class(&self.labels);
        let far = winner.is_some_and(|winner| winner.distance > 2.0 * network.usual_distance);
        let (together, why) = match class {
            Class::Clean if votes(Class::Anomalous) >= DEBOUNCE => (Class::Anomalous, Cause::Map),
            Class::Clean if far && votes(Class::Clean) < DEBOUNCE => (Class::Anomalous, Cause::Distance),
            class => (class, cause),
        };
        Verdict { class: together, cause: why, by_rules: class, by_map, winner, sensors: &self.labels }
    }
}

impl From<Network> for File {
    fn from(network: Network) -> Self {
        let chain = |chain: &Map| chain.weights.chunks_exact(3).map(|w| [w[0], w[1], w[2]]).collect();
        let cells: Vec<Vec<f64>> =
            network.map.weights.chunks_exact(network.map.dimension).map(<[f64]>::to_vec).collect();
        Self {
            format: FORMAT.to_owned(),
            layer1: Layer1 { weights: network.chains.iter().map(chain).collect() },
            layer2: Layer2 { weights: cells.chunks(network.map.columns).map(<[_]>::to_vec).collect() },
            cells: network.cells.chunks(network.map.columns).map(<[_]>::to_vec).collect(),
            sensors: network.sensors,
            usual_distance: network.usual_distance,
            epochs: network.epochs,
            rules: network.rules,
        }
    }
}

impl TryFrom<File> for Network {
    type Error = NetworkError;

    fn try_from(file: File) -> Result<Self, NetworkError> {
        let wrong = |what| Err(NetworkError::File(what));
        let sensors = file.sensors.len();
        if file.format != FORMAT {
            return wrong("its `format` is not `posed faults 1`");
        }
        if sensors == 0 || file.layer1.weights.len() != sensors {
            return wrong("layer1 should have one chain per sensor");
        }
        if file.layer1.weights.iter().any(Vec::is_empty) {
            return wrong("layer1 has a chain without neurons");
        }
        let (rows, columns) = (file.layer2.weights.len(), file.layer2.weights.first().map_or(0, Vec::len));
        let cells: Vec<&Vec<f64>> = file.layer2.weights.iter().flatten().collect();
        if cells.is_empty() || cells.len() != rows * columns || cells.iter().any(|cell| cell.len() != sensors)
        {
            return wrong("layer2 should be a full grid of one number per sensor");
        }
        let classes: Vec<Class> = file.cells.into_iter().flatten().collect();
        if classes.len() != rows * columns {
            return wrong("there should be one class per cell");
        }
        if !file.rules.fits(sensors) {
            return wrong("the rules are of other sensors");
        }
        let chain = |weights: &Vec<[f64; 3]>| Map {
            rows: 1,
            columns: weights.len(),
            dimension: 3,
            weights: weights.iter().flatten().copied().collect(),
        };
        Ok(Self {
            chains: file.layer1.weights.iter().map(chain).collect(),
            map: Map {
                rows,
                columns,
                dimension: sensors,
                weights: cells.into_iter().flatten().copied().collect(),
            },
            cells: classes,
            sensors: file.sensors,
            usual_distance: file.usual_distance,
            rules: file.rules,
            epochs: file.epochs,
        })
    }
}

#[cfg(test)]
mod tests;
