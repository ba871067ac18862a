//! A fault map as `FAULTS.json` holds it, and whether such a file holds together.

use serde::{Deserialize, Serialize};

use super::body::Body;
use super::habits::{Link, Motion, PositionChain};
use super::rules::Rules;
use super::som::Som;
use super::{FaultMap, FaultMapError};
use posed_fusion::faults::Class;

const FORMAT: &str = "posed faults 4";

/// The first layer: a chain per sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Layer1 {
    /// Sensor, neuron, coordinate; m.
    weights: Vec<Vec<[f64; 3]>>,
}

/// The second layer: a map of winners' indices and of what joints leave over.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Layer2 {
    /// Row, column, sensor (index over the number of neurons) and then joint (share); none of joints in maps as published and in files of before these were inputs.
    weights: Vec<Vec<Vec<f64>>>,
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    format: String,
    sensors: Vec<String>,
    layer1: Layer1,
    layer2: Layer2,
    /// Row by row; may be edited by hand.
    cells: Vec<Vec<Class>>,
    /// Per sensor, neuron by neuron; the spreads in m.
    neurons: Vec<Vec<Class>>,
    spreads_m: Vec<Vec<f64>>,
    usual_distance: f64,
    usual_ratio: f64,
    links: Vec<Option<Link>>,
    motion: Motion,
    epochs: usize,
    #[serde(default)]
    revision: u32,
    /// Absent: positions are taken as they are.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    body: Option<Body>,
    rules: Rules,
}

impl From<FaultMap> for File {
    fn from(fault_map: FaultMap) -> Self {
        let chain = |positions: &PositionChain| {
            positions.chain.weights.chunks_exact(3).map(|w| [w[0], w[1], w[2]]).collect()
        };
        let cells: Vec<Vec<f64>> =
            fault_map.map.weights.chunks_exact(fault_map.map.dimension).map(<[f64]>::to_vec).collect();
        Self {
            format: FORMAT.to_owned(),
            layer1: Layer1 { weights: fault_map.positions.iter().map(chain).collect() },
            layer2: Layer2 { weights: cells.chunks(fault_map.map.columns).map(<[_]>::to_vec).collect() },
            cells: fault_map.cells.chunks(fault_map.map.columns).map(<[_]>::to_vec).collect(),
            sensors: fault_map.sensors,
            neurons: fault_map.positions.iter().map(|positions| positions.classes.clone()).collect(),
            spreads_m: fault_map.positions.into_iter().map(|positions| positions.spreads_m).collect(),
            usual_distance: fault_map.usual_distance,
            usual_ratio: fault_map.usual_ratio,
            links: fault_map.links,
            motion: fault_map.motion,
            epochs: fault_map.epochs,
            revision: fault_map.revision,
            body: fault_map.body,
            rules: fault_map.rules,
        }
    }
}

impl TryFrom<File> for FaultMap {
    type Error = FaultMapError;

    fn try_from(file: File) -> Result<Self, FaultMapError> {
        let wrong = |what| Err(FaultMapError::File(what));
        let sensors = file.sensors.len();
        if file.format != FORMAT {
            return wrong("its `format` is not `posed faults 4`; train it again");
        }
        if sensors == 0 || file.layer1.weights.len() != sensors {
            return wrong("layer1 should have one chain per sensor");
        }
        if file.layer1.weights.iter().any(Vec::is_empty) {
            return wrong("layer1 has a chain without neurons");
        }
        let (rows, columns) = (file.layer2.weights.len(), file.layer2.weights.first().map_or(0, Vec::len));
        let cells: Vec<&Vec<f64>> = file.layer2.weights.iter().flatten().collect();
        let dimension = cells.first().map_or(0, |cell| cell.len());
        let inputs = [sensors, sensors + file.rules.joints()];
        if !inputs.contains(&dimension)
            || cells.len() != rows * columns
            || cells.iter().any(|cell| cell.len() != dimension)
        {
            return wrong("layer2 should be a full grid of one number per sensor and joint");
        }
        let classes: Vec<Class> = file.cells.into_iter().flatten().collect();
        if classes.len() != rows * columns {
            return wrong("there should be one class per cell");
        }
        if !file.rules.fits(sensors) || file.body.as_ref().is_some_and(|body| !body.fits(sensors)) {
            return wrong("the rules are of other sensors");
        }
        if file.neurons.len() != sensors || file.spreads_m.len() != sensors {
            return wrong("there should be classes and spreads of the neurons of each sensor");
        }
        let chain = |weights: &[[f64; 3]]| Som {
            rows: 1,
            columns: weights.len(),
            dimension: 3,
            weights: weights.iter().flatten().copied().collect(),
        };
        let neurons = file.neurons.into_iter().zip(file.spreads_m);
        let positions: Vec<PositionChain> = file
            .layer1
            .weights
            .iter()
            .zip(neurons)
            .map(|(weights, (classes, spreads_m))| PositionChain {
                chain: chain(weights),
                classes,
                spreads_m,
            })
            .collect();
        let links = file.links.iter().flatten().all(|link| link.fits(sensors));
        if !positions.iter().all(PositionChain::fits) || file.links.len() != sensors || !links {
            return wrong("there should be a class, a spread and finite weights for each neuron");
        }
        if !file.motion.fits(sensors) {
            return wrong("the motion is that of other sensors");
        }
        let distances = [&file.usual_distance, &file.usual_ratio];
        if !cells.iter().copied().flatten().chain(distances).all(|value| value.is_finite()) {
            return wrong("all weights and distances should be finite");
        }
        Ok(Self {
            positions,
            links: file.links,
            motion: file.motion,
            usual_ratio: file.usual_ratio,
            map: Som { rows, columns, dimension, weights: cells.into_iter().flatten().copied().collect() },
            cells: classes,
            sensors: file.sensors,
            usual_distance: file.usual_distance,
            body: file.body,
            rules: file.rules,
            epochs: file.epochs,
            revision: file.revision,
        })
    }
}
