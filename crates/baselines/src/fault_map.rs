//! Two-layer self-organising map for faulty frames, trained row by row.
//!
//! I. Miller, S. McGlinchey and B. Chaperot, "Anomaly detection in magnetic motion capture using a 2-layer SOM network"
//! (2006; no DOI found).
//!
//! What comes in: frames of positions, one per sensor. What goes out: a [`FaultMap`] whose chain of 41 neurons per sensor
//! turns a position into an index, and whose map of 21 x 21 cells turns all indices into one cell: the same network
//! that [`FaultMap::train`] makes, by another rule of learning. For each row `n`, in random order, with the winner `c`,
//! every neuron moves towards it,
//!
//! ```text
//! s_j  <-  s_j + alpha h(j, c) (n - s_j),   h = exp(-d(j, c)^2 / (2 sigma^2)),   alpha = alpha_0 (1 - t / T)
//! ```
//! with `d` counted in neurons (in rows and columns of the map), `sigma = 1` and `T` the updates of 100 passes:
//! [`published`].
//!
//! Repaired or chosen here, where the paper errs or is silent:
//! - `alpha_0` (0.5) and the initial weights are not printed. From random ones a chain often stays folded, so it starts
//!   along the first principal axis; [`Width::Shrink`] unfolds what is left.
//! - Eq. (9) prints `c_M` as the last index of a frame; it is the number of sensors, not of neurons.
//! - Indices are divided by the number of neurons, so that distances in the second layer do not grow with it.
//! - A position that is missing neither counts nor learns.
//! - Cells are named by physics where the paper asks an operator. What its network does not have (chains of distances
//!   between sensors and of steps) is trained by the batch rule.

use posed_motion::fault_map::Frames;
use posed_motion::fault_map::{FaultMap, FaultMapError, Labels, Size};
use posed_motion::fault_map::{Kernel, Rule, Som, Training, Width};

/// A smaller step is none: weights are of the order of one.
const NEGLIGIBLE: f64 = 1e-9;

/// The paper's rule of learning, one row after the other: every neuron moves towards it, the winner most.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowByRow {
    /// Step at the start, as a share of the way, from 0 to 1; falls linearly to zero over the training. 0.5 by default.
    pub alpha: f64,
}

impl Default for RowByRow {
    fn default() -> Self {
        Self { alpha: 0.5 }
    }
}

impl Rule for RowByRow {
    fn take(&mut self, map: &mut Som, row: &[f64], winner: usize, kernel: &Kernel, done: f64) {
        let alpha = self.alpha * (1.0 - done);
        let complete = row.iter().all(|value| !value.is_nan());
        let h = kernel.h();
        let reach = h.len() - 1;
        let (r, c) = (winner / map.columns, winner % map.columns);
        for i in r.saturating_sub(reach)..(r + reach + 1).min(map.rows) {
            let alpha = alpha * h[i.abs_diff(r)];
            for j in c.saturating_sub(reach)..(c + reach + 1).min(map.columns) {
                let step = alpha * h[j.abs_diff(c)];
                if step < NEGLIGIBLE {
                    continue;
                }
                let start = (i * map.columns + j) * map.dimension;
                for (weight, value) in map.weights[start..start + map.dimension].iter_mut().zip(row) {
                    if complete || !value.is_nan() {
                        *weight += step * (value - *weight);
                    }
                }
            }
        }
    }

    fn end_pass(&mut self, _: &mut Som, _: &Kernel) {}
}

/// The paper's training: 100 passes over all rows, a neighbourhood of one neuron, positions as they are.
pub fn published() -> Training {
    Training { epochs: 100, width: Width::Fixed, subset: 0, stop: false, body: false, ..Training::default() }
}

/// Trains a fault map row by row on frames of positions (m), and names the frames; `training` is [`published`] or a change of it.
/// The same frames, size and seed give the same map. Chains that the paper does not have take from `training` the seed alone.
///
/// # Errors
/// There are fewer than ten frames, or no sensors.
pub fn train(frames: &Frames, size: Size, training: &Training) -> Result<(FaultMap, Labels), FaultMapError> {
    let beside = Training { seed: training.seed, ..Training::default() };
    FaultMap::train_by(&mut RowByRow::default(), frames, size, training, &beside)
}

#[cfg(test)]
mod tests {
    use super::*;
    use posed_motion::fault_map::Winner;

    #[test]
    fn an_update_by_hand() {
        let mut map = Som { rows: 1, columns: 3, dimension: 3, weights: vec![0.0; 9] };
        map.weights[3..6].copy_from_slice(&[1.0, 1.0, 1.0]);
        RowByRow::default().take(&mut map, &[2.0, 0.0, 1.0], 1, &Kernel::new(1.0), 0.0);
        let h = 0.5 * libm::exp(-0.5f64);
        let expected = [2.0 * h, 0.0, h, 1.5, 0.5, 1.0, 2.0 * h, 0.0, h];
        assert!(map.weights.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-15), "{:?}", map.weights);
    }

    #[test]
    fn a_step_falls_to_nothing_and_a_missing_value_does_not_learn() {
        let mut map = Som { rows: 1, columns: 2, dimension: 2, weights: vec![0.0, 5.0, 1.0, -5.0] };
        let before = map.clone();
        RowByRow::default().take(&mut map, &[0.5, 2.0], 1, &Kernel::new(1.0), 1.0);
        assert_eq!(map, before);
        RowByRow { alpha: 1.0 }.take(&mut map, &[0.5, f64::NAN], 1, &Kernel::new(1.0), 0.0);
        assert_eq!((map.weights[2], map.weights[3]), (0.5, -5.0));
    }

    fn curve() -> Vec<f64> {
        let point = |k: usize| {
            let t = k as f64 / 400.0 * 5.0;
            [libm::sin(t), libm::cos(t), 0.3 * t]
        };
        (0..400).flat_map(point).collect()
    }

    fn trained(training: &Training) -> Som {
        let data = curve();
        let mut map = Som::along_principal_axes(1, 41, 3, &data);
        map.train_by(&mut RowByRow::default(), &data, training);
        map
    }

    #[test]
    fn a_chain_comes_near_and_does_not_fold() {
        let map = trained(&Training { epochs: 60, width: Width::Shrink, ..published() });
        let winners: Vec<Winner> = curve().chunks(3).map(|row| map.winner(row).unwrap()).collect();
        let error = winners.iter().map(|winner| winner.distance).sum::<f64>() / 400.0;
        assert!(error < 0.1, "{error}");
        let jump = winners.windows(2).map(|pair| pair[0].cell.abs_diff(pair[1].cell)).max().unwrap();
        assert!(jump <= 5, "{jump}");
    }

    #[test]
    fn training_repeats_with_its_seed() {
        let train = |seed| trained(&Training { epochs: 20, seed, ..published() });
        assert_eq!(train(1), train(1));
        assert_ne!(train(1), train(2));
    }

    #[test]
    fn a_network_is_trained_by_either_rule_and_named_alike() {
        let coordinate = |k: usize, sensor: usize, axis: usize| {
            let (t, s) = (k as f64 / 30.0, sensor as f64);
            0.3 * libm::sin(0.7 * t + axis as f64) + 0.5 * s + 1.0
        };
        let frames = Frames {
            sensors: (0..3).map(|sensor| format!("s{sensor}")).collect(),
            t_s: (0..200).map(|k| k as f64 / 30.0).collect(),
            positions_m: (0..200)
                .flat_map(|k| (0..3).flat_map(move |s| (0..3).map(move |axis| coordinate(k, s, axis))))
                .collect(),
            ..Frames::default()
        };
        let size = Size { neurons: 11, side: 5 };
        let (ours, labels) = train(&frames, size, &published()).unwrap();
        let (theirs, others) = FaultMap::train(&frames, size, &Training::default()).unwrap();
        assert_eq!(labels, others);
        assert_eq!((ours.epochs, ours.size()), (100, theirs.size()));
        assert_ne!(ours, theirs);
        assert!(train(&Frames::default(), size, &published()).is_err());
    }
}
