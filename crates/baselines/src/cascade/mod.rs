//! Calibration of a magnetic tracker by a cascade: filter, network, correct, filter again.
//!
//! R. Piperakis, S. Saito and M. Nakajima, "Automatic calibration of magnetic motion trackers using a Bayesian-neural
//! cascade" (about 2005; no DOI found).
//!
//! What comes in: a [`PoleRun`], a recording of a pole with sensors at measured distances. What goes out: a [`Cascade`],
//! whose [`DistortionNetwork`] takes measured positions to corrected ones. An iterated extended Kalman filter follows
//! the pole ([`Filter`]); the network `z -> z + f(z)` of x, y, z and their squares, five sigmoid and three linear
//! nodes, learns from measured to filtered positions, or from those at the nodes of a grid; the next round begins with readings that it
//! has corrected. Outliers are taken out first, as [`posed_field::solve`] does.
//!
//! What it calls an error of a millimetre is the distance between its network and its own filter: a filter that sees one
//! instant at a time takes along whatever moves the whole pole, so that an error of scale stays almost whole. `docs/field.md`
//! has the figures beside those of [`posed_field::solve`].
//!
//! Repaired here, where the paper errs or is silent:
//! - The quaternion step has the factor 2/|w| where 1/|w| is right; the direction is turned by the exponential map.
//! - A quaternion and three angular velocities, of which a pole shows neither its spin nor that velocity: ten error states
//!   instead of thirteen, and a smoother. [`Filter::Printed`] and [`Filter::Repaired`] are the thirteen.
//! - `z_i = t + i d ...` with `i` from 1 places `t` one spacing before the first sensor; it is the pole's middle.
//! - The paper lets the spacing be estimated from the readings, which hides every error of scale; it is given.

mod grid;
mod network;
mod pole;
mod pole_filter;
mod quaternion_filter;

use nalgebra::Vector3;
use posed_field::{FieldNoise, PoleRun, estimate_noise, reject};

pub use network::DistortionNetwork;
pub use pole::{Pole, Steps, Track};
pub use quaternion_filter::Turn;

/// What the distortion adds to the noise in the first round, and the share of it in each round after, m.
const FIRST_FLOOR_M: f64 = 0.02;
const SHRINK: f64 = 0.7;
/// Epochs of the network in each round.
const EPOCHS: usize = 10;

/// What follows the pole.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Filter {
    /// Thirteen states, forward, the quaternion's step as printed.
    Printed,
    /// Thirteen states, forward, the step put right.
    Repaired,
    /// Ten error states and a smoother.
    #[default]
    Reduced,
}

/// How to calibrate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// What follows the pole; ten states.
    pub filter: Filter,
    /// How often filter and network take turns, 0 counts as 1; 8.
    pub rounds: usize,
    /// Spacing of a grid on which the filtered positions are interpolated before training, m, above 0; none.
    pub grid_m: Option<f64>,
}

impl Default for Options {
    fn default() -> Self {
        Self { filter: Filter::default(), rounds: 8, grid_m: None }
    }
}

/// A cascade after some rounds: a correction of positions alone, without a statement of its uncertainty.
#[derive(Clone, Debug)]
pub struct Cascade {
    /// From measured to corrected positions, both in the transmitter frame, m.
    pub network: DistortionNetwork,
    /// Rms distance of network and filter after each round, 3-D, m: the figure of the paper, which is no error against ground
    /// truth.
    pub residuals_m: Vec<f64>,
    /// The recording without its outliers.
    pub run: PoleRun,
    /// The pole as the filter has it before anything is corrected, one for each frame of `run`.
    pub track: Track,
    /// Pairs that the network learnt from in the last round.
    pub pairs: usize,
}

/// Runs the cascade over a recording (transmitter frame, m; left unchanged), outliers taken out first. It has no randomness: the same
/// recording gives the same cascade. `None` where a recording has no usable frame, or no node of the grid has readings around it.
pub fn cascade(run: &PoleRun, options: &Options) -> Option<Cascade> {
    let mut run = run.clone();
    let noise = estimate_noise(&run);
    reject(&mut run, &noise);
    let mut first = None;
    let mut network: Option<DistortionNetwork> = None;
    let mut residuals_m = Vec::new();
    let mut learnt = 0;
    for round in 0..options.rounds.max(1) {
        let floor_m = libm::hypot(noise.floor_m, FIRST_FLOOR_M * SHRINK.powi(round as i32));
        let weighting = FieldNoise { floor_m, ..noise };
        let map = |z: &Vector3<f64>| network.as_ref().map_or(*z, |network| network.correct(z));
        let track = match options.filter {
            Filter::Printed => quaternion_filter::follow(&run, Turn::Printed, &weighting, map),
            Filter::Repaired => quaternion_filter::follow(&run, Turn::Repaired, &weighting, map),
            Filter::Reduced => pole_filter::smooth(&run, &weighting, map),
        };
        let mut pairs = pairs(&run, &track);
        if let Some(spacing_m) = options.grid_m {
            pairs = grid::on_grid(&pairs, spacing_m);
        }
        first.get_or_insert(track);
        learnt = pairs.len();
        let mut next = match network.take() {
            Some(network) => network,
            None => DistortionNetwork::new(&pairs)?,
        };
        residuals_m.push(next.train(&pairs, EPOCHS));
        network = Some(next);
    }
    Some(Cascade { network: network?, residuals_m, run, track: first?, pairs: learnt })
}

/// What was measured, and where the filter has it.
fn pairs(run: &PoleRun, track: &Track) -> Vec<(Vector3<f64>, Vector3<f64>)> {
    let mut pairs = Vec::new();
    for (frame, pole) in run.frames.iter().zip(&track.poles) {
        let Some(pole) = pole else { continue };
        for (sensor, reading) in frame.readings.iter().enumerate() {
            if let Some(reading) = reading {
                pairs.push((reading.position_m, pole.position_m(run.offset_m(sensor))));
            }
        }
    }
    pairs
}

#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests {
    use super::testing::{run, truth};
    use super::*;

    /// Rms error of the pole's middle, m, and the greatest in the last second.
    fn error_m(run: &PoleRun, track: &Track) -> (f64, f64) {
        let errors: Vec<f64> = run
            .frames
            .iter()
            .zip(&track.poles)
            .map(|(frame, pole)| (pole.unwrap().origin_m - truth(frame.t_s).0).norm())
            .collect();
        let square: f64 = errors.iter().map(|error| error * error).sum();
        let latest = errors[errors.len() - 30..].iter().copied().fold(0.0, f64::max);
        ((square / errors.len() as f64).sqrt(), latest)
    }

    #[test]
    fn exact_readings_are_followed_and_noise_is_smoothed() {
        let noise = FieldNoise { sigma_signal: 0.0, floor_m: 2e-3 };
        let [exact, noisy] = [0.0, 2e-3].map(|sigma_m| {
            let run = run(60.0, sigma_m);
            [
                error_m(&run, &pole_filter::smooth(&run, &noise, |z| *z)),
                error_m(&run, &quaternion_filter::follow(&run, Turn::Repaired, &noise, |z| *z)),
                error_m(&run, &quaternion_filter::follow(&run, Turn::Printed, &noise, |z| *z)),
            ]
        });
        assert!(exact[0].0 < 3e-4 && exact[1].0 < 1e-3, "{exact:?}");
        // Four sensors alone would leave sqrt(3) * 2 mm / 2 of the middle; t is the pole's end, and has no smoother.
        assert!(noisy[0].0 < 1.4e-3 && noisy[1].0 < 2.5e-3, "{noisy:?}");
        // What is printed turns too far; four readings a frame pull it back.
        assert!(noisy[2].0 > noisy[1].0 && noisy[2].1 < 0.02, "{noisy:?}");
    }

    #[test]
    fn an_error_of_scale_is_taken_along_by_every_filter_and_by_a_grid() {
        let mut run = run(60.0, 5e-4);
        for reading in run.frames.iter_mut().flat_map(|frame| frame.readings.iter_mut().flatten()) {
            reading.position_m *= 1.02;
        }
        for (filter, grid_m) in [
            (Filter::Printed, None),
            (Filter::Repaired, None),
            (Filter::Reduced, None),
            (Filter::Reduced, Some(0.1)),
        ] {
            let options = Options { filter, rounds: 1, grid_m };
            let cascade = cascade(&run, &options).unwrap();
            // A length between two places: 2 % too long before.
            let [a, b] = [Vector3::new(1.0, -0.2, 0.5), Vector3::new(1.4, 0.3, 0.8)];
            let far = |p: [Vector3<f64>; 2]| (p[0] - p[1]).norm();
            let scale = far([a, b].map(|p| cascade.network.correct(&(p * 1.02)))) / far([a, b]);
            assert!((1.003..1.02).contains(&scale), "{filter:?}: {scale}");
            assert!(cascade.residuals_m[0] < 0.02, "{filter:?}: {:?}", cascade.residuals_m);
            let steps_m = cascade.track.steps.mean_m();
            assert!(steps_m[0] > 1e-4 && steps_m[2] < 0.05 * steps_m[0], "{filter:?}: {steps_m:?}");
        }
    }
}
