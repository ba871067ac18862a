//! Calibration of a magnetic tracker by a cascade: filter, network, correct, filter again.
//!
//! R. Piperakis, S. Saito and M. Nakajima, "Automatic calibration of magnetic motion trackers using a Bayesian-neural
//! cascade" (about 2005; no DOI found).
//!
//! What comes in: a [`PoleRun`], a recording of a pole with sensors at measured distances. What goes out: a [`Cascade`],
//! whose [`DistortionNetwork`] takes measured positions to corrected ones. An iterated extended Kalman filter and smoother follow
//! the pole ([`PoleFilter`]); the network `z -> z + f(z)` of x, y, z and their squares, five sigmoid and three linear
//! nodes, learns from measured to filtered positions; the next round begins with readings that it has corrected. Outliers
//! are taken out first, as [`posed_field::solve`] does.
//!
//! What it calls an error of a millimetre is the distance between its network and its own filter: a filter that sees one
//! instant at a time takes along whatever moves the whole pole, so that an error of scale stays almost whole. `docs/field.md`
//! has the figures beside those of [`posed_field::solve`].
//!
//! Repaired here, where the paper errs or is silent:
//! - The quaternion step has the factor 2/|w| where 1/|w| is right; the direction is turned by the exponential map.
//! - A quaternion and three angular velocities, of which a pole shows neither its spin nor that velocity: ten error states
//!   instead of thirteen.
//! - `z_i = t + i d ...` with `i` from 1 places `t` one spacing before the first sensor; it is the pole's middle.
//! - The paper lets the spacing be estimated from the readings, which hides every error of scale; it is given.

mod network;
mod pole_filter;

use nalgebra::Vector3;
use posed_field::{FieldNoise, PoleRun, estimate_noise, reject};

pub use network::DistortionNetwork;
pub use pole_filter::{PoleFilter, PoleState, smooth};

/// What the distortion adds to the noise in the first round, and the share of it in each round after, m.
const FIRST_FLOOR_M: f64 = 0.02;
const SHRINK: f64 = 0.7;
/// Epochs of the network in each round.
const EPOCHS: usize = 10;

/// A cascade after some rounds: a correction of positions alone, without a statement of its uncertainty.
#[derive(Clone, Debug)]
pub struct Cascade {
    /// From measured to corrected positions, both in the transmitter frame, m.
    pub network: DistortionNetwork,
    /// Rms distance of network and filter after each round, 3-D, m: the figure of the paper, which is no error against ground
    /// truth.
    pub residuals_m: Vec<f64>,
}

/// Runs the cascade over a recording (transmitter frame, m; left unchanged), outliers taken out first. `iterations`: rounds, 0
/// counts as 1. It has no randomness: the same recording gives the same cascade. `None` where a recording has no usable frame.
pub fn cascade(run: &PoleRun, iterations: usize) -> Option<Cascade> {
    let mut run = run.clone();
    let noise = estimate_noise(&run);
    reject(&mut run, &noise);
    let run = &run;
    let mut network: Option<DistortionNetwork> = None;
    let mut residuals_m = Vec::new();
    for round in 0..iterations.max(1) {
        let floor_m = libm::hypot(noise.floor_m, FIRST_FLOOR_M * SHRINK.powi(round as i32));
        let weighting = FieldNoise { floor_m, ..noise };
        let map = |z: &Vector3<f64>| network.as_ref().map_or(*z, |network| network.correct(z));
        let states = smooth(run, &weighting, map);
        let mut pairs = Vec::new();
        for (frame, state) in run.frames.iter().zip(&states) {
            let Some(state) = state else { continue };
            for (sensor, reading) in frame.readings.iter().enumerate() {
                if let Some(reading) = reading {
                    pairs.push((reading.position_m, state.position_m(run.offset_m(sensor))));
                }
            }
        }
        let mut next = match network.take() {
            Some(network) => network,
            None => DistortionNetwork::new(&pairs)?,
        };
        residuals_m.push(next.train(&pairs, EPOCHS));
        network = Some(next);
    }
    network.map(|network| Cascade { network, residuals_m })
}
