//! The published calibration, reproduced: filter, network, correct, filter again.
//!
//! Piperakis, Saito and Nakajima (about 2005): an iterated extended Kalman filter follows the pole, a small network
//! learns from measured to filtered positions, and rounds of the two refine each other. It is here to be compared
//! with, not to be used: what it calls an error of a millimetre is the distance between its network and its own filter,
//! and a filter that sees one instant at a time takes along whatever moves the whole pole.

mod network;
mod pole_filter;

use nalgebra::Vector3;

pub use network::Network;
pub use pole_filter::{PoleFilter, PoleState, smooth};

use super::estimate;
use super::noise::FieldNoise;
use super::outliers::reject;
use super::pole::PoleRun;

/// What the distortion adds to the noise in the first round, and the share of it in each round after, m.
const FIRST_FLOOR_M: f64 = 0.02;
const SHRINK: f64 = 0.7;
/// Epochs of the network in each round.
const EPOCHS: usize = 10;

/// A cascade after some rounds.
#[derive(Clone, Debug)]
pub struct Cascade {
    /// From measured to corrected positions.
    pub network: Network,
    /// Rms distance of network and filter after each round, 3-D, m: the figure of the paper.
    pub residuals_m: Vec<f64>,
}

/// Runs the cascade, outliers taken out first; `None` where a recording has no usable frame.
pub fn cascade(run: &PoleRun, rounds: usize) -> Option<Cascade> {
    let mut run = run.clone();
    let noise = estimate::noise(&run);
    reject(&mut run, &noise);
    let run = &run;
    let mut network: Option<Network> = None;
    let mut residuals_m = Vec::new();
    for round in 0..rounds.max(1) {
        let floor_m = noise.floor_m.hypot(FIRST_FLOOR_M * SHRINK.powi(round as i32));
        let weighting = FieldNoise { floor_m, ..noise };
        let map = |z: &Vector3<f64>| network.as_ref().map_or(*z, |network| network.correct(z));
        let states = smooth(run, &weighting, map);
        let mut pairs = Vec::new();
        for (frame, state) in run.frames.iter().zip(&states) {
            let Some(state) = state else { continue };
            for (sensor, reading) in frame.readings.iter().enumerate() {
                if let Some(reading) = reading {
                    pairs.push((reading.position_m, state.place(run.offset_m(sensor))));
                }
            }
        }
        let mut next = match network.take() {
            Some(network) => network,
            None => Network::new(&pairs)?,
        };
        residuals_m.push(next.train(&pairs, EPOCHS));
        network = Some(next);
    }
    network.map(|network| Cascade { network, residuals_m })
}
