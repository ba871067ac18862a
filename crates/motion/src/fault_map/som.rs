//! Self-organising maps, trained by the batch rule or by another [`Rule`].
//!
//! What comes in: rows of numbers, NaN where there is no value. What goes out: a grid of weights (rows x columns,
//! one row for a chain) and the winner of a row with its distance. A value that is missing neither counts nor learns.

use nalgebra::{DMatrix, DVector};
use posed_state::Plain;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Neighbours farther than so many sigmas learn less than a rounding error.
const REACH_SIGMAS: f64 = 6.0;
/// Stop when fewer winners than this share changed in an epoch.
const SETTLED_SHARE: f64 = 0.005;
/// Stop when the error fell by less than this share for so many epochs.
const SETTLED_ERROR: f64 = 0.001;
const SETTLED_EPOCHS: usize = 3;

/// When a shrinking neighbourhood has come down to one neuron, and where it ends.
const NARROWING: f64 = 0.5;
const NARROWEST: f64 = 0.2;

/// How rows move the weights of a self-organising map.
pub trait Rule {
    /// Takes a row and its winner; `done` is the share of the training that is over, from 0 to 1.
    fn take(&mut self, map: &mut Som, row: &[f64], winner: usize, kernel: &Kernel, done: f64);

    /// Ends a pass over the rows.
    fn end_pass(&mut self, map: &mut Som, kernel: &Kernel);
}

/// How wide the neighbourhood of a winner is during the training.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Width {
    /// One neuron; the chain may stay folded.
    Fixed,
    /// From a quarter of the map to one neuron, and in the second half of the training to a fifth of one, so that
    /// neurons end where rows are rather than between them and their neighbours.
    Shrink,
}

/// How to train. The default: at most 30 passes over all rows, shrinking width, early stop, seed 1, the figure's axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Training {
    /// Passes over the rows at most.
    pub epochs: usize,
    /// Width of the neighbourhood.
    pub width: Width,
    /// Rows per epoch at most, a random subset of them; 0 for all.
    pub subset: usize,
    /// End early when the map has settled: fewer than 0.5 % of the winners changed, or the error fell by less than 0.1
    /// % in each of three passes.
    pub stop: bool,
    /// Seed of the order of the rows, and of the subset.
    pub seed: u64,
    /// Look at positions in the figure's own axes rather than in those of the transmitter, and at what joints leave over.
    pub body: bool,
}

impl Default for Training {
    fn default() -> Self {
        Self { epochs: 30, width: Width::Shrink, subset: 0, stop: true, seed: 1, body: true }
    }
}

/// A self-organising map: cells on a rectangular grid, each with a weight. Kohonen's method, as in Miller et al. 2006.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct Som {
    /// Rows of the grid; 1 for a chain.
    pub rows: usize,
    /// Columns of the grid.
    pub columns: usize,
    /// Length of a weight and of a row.
    pub dimension: usize,
    /// Weights, `dimension` numbers a cell, row by row of the grid.
    pub weights: Vec<f64>,
}

/// The cell that is nearest to a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Winner {
    /// Index of the cell, row by row.
    pub cell: usize,
    /// Distance from its weight, in the unit of the rows; where values are missing, over the others and scaled to all.
    pub distance: f64,
}

/// Influence of a winner on a cell: `exp(-d^2 / (2 sigma^2))`, with `squared_cells` the squared distance in cells.
pub fn neighbourhood(squared_cells: f64, sigma: f64) -> f64 {
    libm::exp(-0.5 * squared_cells / (sigma * sigma))
}

impl Som {
    /// A map along the first principal axis (chain) or plane (grid) of the data, two standard deviations each way.
    /// `data`: rows of `dimension` numbers, NaN where missing; without rows all weights are zero.
    ///
    /// # Panics
    /// `dimension` is 0.
    pub fn along_principal_axes(rows: usize, columns: usize, dimension: usize, data: &[f64]) -> Self {
        let (mean, axes) = principal_axes(dimension, data);
        let mut weights = Vec::with_capacity(rows * columns * dimension);
        let position = |k: usize, n: usize| if n > 1 { 4.0 * k as f64 / (n - 1) as f64 - 2.0 } else { 0.0 };
        for row in 0..rows {
            for column in 0..columns {
                let cell = &mean + &axes[0] * position(column, columns) + &axes[1] * position(row, rows);
                weights.extend(cell.iter());
            }
        }
        Self { rows, columns, dimension, weights }
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.rows * self.columns
    }

    /// The cell nearest to a row (NaN where missing), of equal ones the first; `None` if no value is there.
    pub fn winner(&self, row: &[f64]) -> Option<Winner> {
        self.winner_from(row, 0)
    }

    /// As `winner`, found sooner where `guess` is near it; the answer is the same for any `guess`.
    pub fn winner_from(&self, row: &[f64], guess: usize) -> Option<Winner> {
        let there = row.iter().filter(|value| !value.is_nan()).count();
        if there == 0 {
            return None;
        }
        let bounded = if there < row.len() { bounded::<true> } else { bounded::<false> };
        let guess = if guess < self.cells() { guess } else { 0 };
        let start = guess * self.dimension;
        let mut limit = bounded(&self.weights[start..start + self.dimension], row, f64::INFINITY);
        let mut cell = guess;
        for (other, weight) in self.weights.chunks_exact(self.dimension).enumerate() {
            let squared = bounded(weight, row, limit);
            if squared < limit || (squared == limit && other < cell) {
                (cell, limit) = (other, squared);
            }
        }
        let scale = row.len() as f64 / there as f64;
        Some(Winner { cell, distance: (limit * scale).sqrt() })
    }

    /// Trains the map by the batch rule on rows of `dimension` numbers (NaN where missing); returns the passes that it
    /// took, 0 without rows.
    pub fn train(&mut self, data: &[f64], training: &Training) -> usize {
        self.train_by(&mut Batch::default(), data, training)
    }

    /// Trains the map by a rule on rows of `dimension` numbers (NaN where missing); returns the passes that it took, 0
    /// without rows. The same seed gives the same map.
    pub fn train_by(&mut self, rule: &mut impl Rule, data: &[f64], training: &Training) -> usize {
        let count = data.len() / self.dimension;
        if count == 0 {
            return 0;
        }
        let mut random = ChaCha8Rng::seed_from_u64(training.seed);
        let mut order: Vec<usize> = (0..count).collect();
        let rows = if training.subset == 0 { count } else { training.subset.min(count) };
        let mut winners = vec![usize::MAX; count];
        let mut errors: Vec<f64> = Vec::new();
        let widest = self.columns.max(self.rows) as f64 / 4.0;
        for epoch in 0..training.epochs {
            let progress = epoch as f64 / training.epochs as f64;
            let sigma = match training.width {
                Width::Fixed => 1.0,
                Width::Shrink if progress < NARROWING => {
                    libm::pow(widest, 1.0 - progress / NARROWING).max(1.0)
                }
                Width::Shrink => 1.0 - (progress - NARROWING) / (1.0 - NARROWING) * (1.0 - NARROWEST),
            };
            order.shuffle(&mut random);
            let order = &order[..rows];
            let (mut changed, mut error) = (0, 0.0);
            let kernel = Kernel::new(sigma);
            for (step, index) in order.iter().enumerate() {
                let row = &data[index * self.dimension..(index + 1) * self.dimension];
                let Some(winner) = self.winner_from(row, winners[*index]) else { continue };
                changed += usize::from(winners[*index] != winner.cell);
                winners[*index] = winner.cell;
                error += winner.distance;
                let done = (epoch * rows + step) as f64 / (training.epochs * rows) as f64;
                rule.take(self, row, winner.cell, &kernel, done);
            }
            rule.end_pass(self, &kernel);
            errors.push(error);
            let narrow = training.width == Width::Fixed || sigma < 0.5;
            if training.stop && narrow && settled(changed, rows, &errors) {
                return epoch + 1;
            }
        }
        // The generator's state is not part of the result.
        let _: u64 = random.random();
        training.epochs
    }
}

/// The neighbourhood at whole distances, computed once per width: that of a grid is the product of both directions.
#[derive(Clone, Debug)]
pub struct Kernel(Vec<f64>);

impl Kernel {
    /// The neighbourhood of a width of `sigma` cells (above 0), out to six times that width.
    pub fn new(sigma: f64) -> Self {
        let reach = (REACH_SIGMAS * sigma) as usize;
        Self((0..=reach).map(|d| neighbourhood((d * d) as f64, sigma)).collect())
    }

    /// `h` at 0, 1, 2, ... neurons; beyond the last one it is nothing.
    pub fn h(&self) -> &[f64] {
        &self.0
    }
}

fn settled(changed: usize, rows: usize, errors: &[f64]) -> bool {
    let quiet = (changed as f64) < SETTLED_SHARE * rows as f64;
    let flat = errors.len() > SETTLED_EPOCHS
        && errors.windows(2).rev().take(SETTLED_EPOCHS).all(|pair| pair[1] > (1.0 - SETTLED_ERROR) * pair[0]);
    quiet || flat
}

/// Squared distance, given up where it is beyond `limit`; of a row with `GAPS`, over the values that are there.
fn bounded<const GAPS: bool>(weight: &[f64], row: &[f64], limit: f64) -> f64 {
    let square = |w: f64, r: f64| if GAPS && r.is_nan() { 0.0 } else { (w - r) * (w - r) };
    let mut sum = 0.0;
    let (w4, w_rest) = weight.as_chunks::<4>();
    let (r4, r_rest) = row.as_chunks::<4>();
    for (w, r) in w4.iter().zip(r4) {
        let d: [f64; 4] = std::array::from_fn(|c| square(w[c], r[c]));
        sum += (d[0] + d[1]) + (d[2] + d[3]);
        if sum > limit {
            return sum;
        }
    }
    sum + w_rest.iter().zip(r_rest).map(|(w, r)| square(*w, *r)).sum::<f64>()
}

/// The batch rule: each weight becomes the mean of the rows in its neighbourhood.
#[derive(Clone, Debug, Default)]
pub(super) struct Batch {
    /// Of the rows of each winner, value by value.
    sums: Vec<f64>,
    counts: Vec<f64>,
}

impl Rule for Batch {
    fn take(&mut self, map: &mut Som, row: &[f64], winner: usize, _: &Kernel, _: f64) {
        self.sums.resize(map.weights.len(), 0.0);
        self.counts.resize(map.weights.len(), 0.0);
        let start = winner * row.len();
        for (c, value) in row.iter().enumerate().filter(|(_, value)| !value.is_nan()) {
            self.sums[start + c] += value;
            self.counts[start + c] += 1.0;
        }
    }

    fn end_pass(&mut self, map: &mut Som, Kernel(kernel): &Kernel) {
        if self.sums.is_empty() {
            return;
        }
        let reach = kernel.len() - 1;
        let n = map.dimension;
        for row in 0..map.rows {
            for column in 0..map.columns {
                let cell = row * map.columns + column;
                for c in 0..n {
                    let (mut sum, mut count) = (0.0, 0.0);
                    for i in row.saturating_sub(reach)..(row + reach + 1).min(map.rows) {
                        for j in column.saturating_sub(reach)..(column + reach + 1).min(map.columns) {
                            let h = kernel[i.abs_diff(row)] * kernel[j.abs_diff(column)];
                            let at = (i * map.columns + j) * n + c;
                            sum += h * self.sums[at];
                            count += h * self.counts[at];
                        }
                    }
                    // Far from all rows nothing is learnt.
                    if count > 1e-9 {
                        map.weights[cell * n + c] = sum / count;
                    }
                }
            }
        }
        self.sums.fill(0.0);
        self.counts.fill(0.0);
    }
}

/// Mean, and the first two principal axes with the length of their standard deviations.
fn principal_axes(dimension: usize, data: &[f64]) -> (DVector<f64>, [DVector<f64>; 2]) {
    let mut mean = DVector::zeros(dimension);
    let mut counts = vec![0.0f64; dimension];
    for row in data.chunks_exact(dimension) {
        for (c, value) in row.iter().enumerate().filter(|(_, value)| !value.is_nan()) {
            mean[c] += value;
            counts[c] += 1.0;
        }
    }
    for (value, count) in mean.iter_mut().zip(counts) {
        *value /= count.max(1.0);
    }
    let mut covariance = DMatrix::zeros(dimension, dimension);
    for row in data.chunks_exact(dimension) {
        let d = DVector::from_fn(dimension, |c, _| if row[c].is_nan() { 0.0 } else { row[c] - mean[c] });
        covariance.ger(1.0, &d, &d, 1.0);
    }
    covariance /= (data.len() / dimension).max(1) as f64;
    let eigen = covariance.symmetric_eigen();
    let mut order: Vec<usize> = (0..dimension).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let axis = |k: usize| match order.get(k) {
        Some(k) => {
            let axis = eigen.eigenvectors.column(*k) * eigen.eigenvalues[*k].max(0.0).sqrt();
            // The sign of an eigenvector is arbitrary: make it a rule.
            let largest = axis.iter().fold(0.0f64, |a, b| if b.abs() > a.abs() { *b } else { a });
            if largest < 0.0 { -axis } else { axis }
        }
        None => DVector::zeros(dimension),
    };
    (mean, [axis(0), axis(1)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_neighbourhood_has_the_published_values() {
        for (squared, value) in [(0.0, 1.0), (1.0, 0.6065), (4.0, 0.1353)] {
            assert!((neighbourhood(squared, 1.0) - value).abs() < 5e-5);
        }
    }

    fn curve() -> Vec<f64> {
        let point = |k: usize| {
            let t = k as f64 / 400.0 * 5.0;
            [libm::sin(t), libm::cos(t), 0.3 * t]
        };
        (0..400).flat_map(point).collect()
    }

    #[test]
    fn a_chain_comes_near_and_does_not_fold() {
        let data = curve();
        let mut map = Som::along_principal_axes(1, 41, 3, &data);
        map.train(&data, &Training { epochs: 60, stop: false, ..Training::default() });
        let winners: Vec<Winner> = data.chunks(3).map(|row| map.winner(row).unwrap()).collect();
        let error = winners.iter().map(|winner| winner.distance).sum::<f64>() / 400.0;
        assert!(error < 0.1, "{error}");
        let jump = winners.windows(2).map(|pair| pair[0].cell.abs_diff(pair[1].cell)).max().unwrap();
        assert!(jump <= 5, "{jump}");
    }

    #[test]
    fn training_stops_when_settled() {
        let data = curve();
        let mut map = Som::along_principal_axes(1, 41, 3, &data);
        let epochs = map.train(&data, &Training { epochs: 500, ..Training::default() });
        assert!(epochs < 500, "{epochs}");
    }

    #[test]
    fn a_missing_value_neither_counts_nor_learns() {
        let mut map = Som { rows: 1, columns: 2, dimension: 2, weights: vec![0.0, 5.0, 1.0, -5.0] };
        assert_eq!(map.winner(&[0.9, f64::NAN]).unwrap().cell, 1);
        assert!(map.winner(&[f64::NAN; 2]).is_none());
        map.train(&[0.5, f64::NAN], &Training { epochs: 1, ..Training::default() });
        assert_eq!(map.weights[3], -5.0);
    }
}
