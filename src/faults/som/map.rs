//! Self-organising maps with the paper's rule and with the batch rule.
//!
//! What comes in: rows of numbers, NaN where there is no value. What goes out: a grid of weights (rows x columns,
//! one row for a chain) and the winner of a row with its distance. A value that is missing neither counts nor learns.

use nalgebra::{DMatrix, DVector};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Neighbours farther than so many sigmas learn less than a rounding error.
const REACH_SIGMAS: f64 = 6.0;
/// A smaller step is none: weights are of the order of one.
const NEGLIGIBLE: f64 = 1e-9;
/// Stop when fewer winners than this share changed in an epoch.
const SETTLED_SHARE: f64 = 0.005;
/// Stop when the error fell by less than this share for so many epochs.
const SETTLED_ERROR: f64 = 0.001;
const SETTLED_EPOCHS: usize = 3;

/// When a shrinking neighbourhood has come down to one neuron, and where it ends.
const NARROWING: f64 = 0.5;
const NARROWEST: f64 = 0.2;

/// How the weights are moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rule {
    /// One row after the other, in random order: Miller, McGlinchey and Chaperot (2006).
    Paper,
    /// All rows at once: each weight becomes the mean of the rows in its neighbourhood.
    Batch,
}

/// How wide the neighbourhood is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Width {
    /// One neuron, as published; the chain may stay folded.
    Fixed,
    /// From a quarter of the map to one neuron, and in the second half of the training to a fifth of one, so that
    /// neurons end where rows are rather than between them and their neighbours.
    Shrink,
}

/// How to train.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Training {
    /// How the weights are moved.
    pub rule: Rule,
    /// Passes over the rows at most.
    pub epochs: usize,
    /// Width of the neighbourhood.
    pub width: Width,
    /// Step at the start; falls linearly to zero.
    pub alpha: f64,
    /// Rows per epoch at most, a random subset of them; 0 for all.
    pub subset: usize,
    /// End early when the map has settled.
    pub stop: bool,
    /// Seed of the order.
    pub seed: u64,
    /// Look at positions in the figure's own axes rather than in the room's.
    pub body: bool,
}

impl Default for Training {
    fn default() -> Self {
        Self {
            rule: Rule::Batch,
            epochs: 30,
            width: Width::Shrink,
            alpha: 0.5,
            subset: 0,
            stop: true,
            seed: 1,
            body: true,
        }
    }
}

/// A rectangular map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Map {
    /// Rows of the grid; 1 for a chain.
    pub rows: usize,
    /// Columns of the grid.
    pub columns: usize,
    /// Length of a weight.
    pub dimension: usize,
    /// Weights, cell by cell, row by row.
    pub weights: Vec<f64>,
}

/// The cell that is nearest to a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Winner {
    /// Index of the cell, row by row.
    pub cell: usize,
    /// Distance from its weight, in the unit of the rows, over the values that are there.
    pub distance: f64,
}

/// Influence of a winner on a cell so many cells away: `exp(-d^2 / (2 sigma^2))`.
pub fn neighbourhood(squared_cells: f64, sigma: f64) -> f64 {
    (-0.5 * squared_cells / (sigma * sigma)).exp()
}

impl Map {
    /// A map along the first principal axis (chain) or plane (grid) of the data, two standard deviations each way.
    pub fn along_principal_axes(rows: usize, columns: usize, dimension: usize, data: &[f64]) -> Self {
        let (mean, axes) = principal_axes(dimension, data);
        let mut weights = Vec::with_capacity(rows * columns * dimension);
        let place = |k: usize, n: usize| if n > 1 { 4.0 * k as f64 / (n - 1) as f64 - 2.0 } else { 0.0 };
        for row in 0..rows {
            for column in 0..columns {
                let cell = &mean + &axes[0] * place(column, columns) + &axes[1] * place(row, rows);
                weights.extend(cell.iter());
            }
        }
        Self { rows, columns, dimension, weights }
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.rows * self.columns
    }

    /// The cell nearest to a row, of equal ones the first; `None` if no value is there.
    pub fn winner(&self, row: &[f64]) -> Option<Winner> {
        self.winner_from(row, 0)
    }

    /// The same winner, found sooner where `guess` is near it: other cells are given up as soon as they are farther.
    pub fn winner_from(&self, row: &[f64], guess: usize) -> Option<Winner> {
        let there = row.iter().filter(|value| !value.is_nan()).count();
        if there == 0 {
            return None;
        }
        if there < row.len() {
            let distances = self.weights.chunks_exact(self.dimension).map(|weight| partial(weight, row));
            let (cell, squared) = distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1))?;
            return Some(Winner { cell, distance: squared.sqrt() });
        }
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
        Some(Winner { cell, distance: limit.sqrt() })
    }

    /// Trains the map; returns the epochs that it took.
    pub fn train(&mut self, data: &[f64], training: &Training) -> usize {
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
                Width::Shrink if progress < NARROWING => widest.powf(1.0 - progress / NARROWING).max(1.0),
                Width::Shrink => 1.0 - (progress - NARROWING) / (1.0 - NARROWING) * (1.0 - NARROWEST),
            };
            order.shuffle(&mut random);
            let order = &order[..rows];
            let (mut changed, mut error) = (0, 0.0);
            let kernel = Kernel::new(sigma);
            let mut sums = Batch::new(self);
            for (step, index) in order.iter().enumerate() {
                let row = &data[index * self.dimension..(index + 1) * self.dimension];
                let Some(winner) = self.winner_from(row, winners[*index]) else { continue };
                changed += usize::from(winners[*index] != winner.cell);
                winners[*index] = winner.cell;
                error += winner.distance;
                match training.rule {
                    Rule::Paper => {
                        let done = (epoch * rows + step) as f64 / (training.epochs * rows) as f64;
                        self.update(row, winner.cell, training.alpha * (1.0 - done), &kernel);
                    }
                    Rule::Batch => sums.add(row, winner.cell),
                }
            }
            if training.rule == Rule::Batch {
                sums.apply(self, &kernel);
            }
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

    /// One step of the paper's rule: every neuron moves towards the row by `alpha h`.
    fn update(&mut self, row: &[f64], winner: usize, alpha: f64, kernel: &Kernel) {
        let complete = row.iter().all(|value| !value.is_nan());
        let reach = kernel.0.len() - 1;
        let (r, c) = (winner / self.columns, winner % self.columns);
        for i in r.saturating_sub(reach)..(r + reach + 1).min(self.rows) {
            let alpha = alpha * kernel.0[i.abs_diff(r)];
            for j in c.saturating_sub(reach)..(c + reach + 1).min(self.columns) {
                let step = alpha * kernel.0[j.abs_diff(c)];
                if step < NEGLIGIBLE {
                    continue;
                }
                let start = (i * self.columns + j) * self.dimension;
                for (weight, value) in self.weights[start..start + self.dimension].iter_mut().zip(row) {
                    if complete || !value.is_nan() {
                        *weight += step * (value - *weight);
                    }
                }
            }
        }
    }
}

/// The neighbourhood at whole distances, computed once per width: `h` of a grid is the product of both directions.
struct Kernel(Vec<f64>);

impl Kernel {
    fn new(sigma: f64) -> Self {
        let reach = (REACH_SIGMAS * sigma) as usize;
        Self((0..=reach).map(|d| neighbourhood((d * d) as f64, sigma)).collect())
    }
}

fn settled(changed: usize, rows: usize, errors: &[f64]) -> bool {
    let quiet = (changed as f64) < SETTLED_SHARE * rows as f64;
    let flat = errors.len() > SETTLED_EPOCHS
        && errors.windows(2).rev().take(SETTLED_EPOCHS).all(|pair| pair[1] > (1.0 - SETTLED_ERROR) * pair[0]);
    quiet || flat
}

/// Squared distance, given up where it is beyond `limit`.
fn bounded(weight: &[f64], row: &[f64], limit: f64) -> f64 {
    let mut sum = 0.0;
    let (w4, w_rest) = weight.as_chunks::<4>();
    let (r4, r_rest) = row.as_chunks::<4>();
    for (w, r) in w4.iter().zip(r4) {
        let d: [f64; 4] = std::array::from_fn(|c| (w[c] - r[c]) * (w[c] - r[c]));
        sum += (d[0] + d[1]) + (d[2] + d[3]);
        if sum > limit {
            return sum;
        }
    }
    sum + w_rest.iter().zip(r_rest).map(|(w, r)| (w - r) * (w - r)).sum::<f64>()
}

/// Squared distance over the values that are there, scaled to all.
fn partial(weight: &[f64], row: &[f64]) -> f64 {
    let (mut sum, mut there) = (0.0, 0.0);
    for (w, r) in weight.iter().zip(row).filter(|(_, r)| !r.is_nan()) {
        sum += (w - r) * (w - r);
        there += 1.0;
    }
    sum * row.len() as f64 / there
}

/// Sums of the batch rule: rows per winner first, then spread over the neighbourhood.
struct Batch {
    sums: Vec<f64>,
    counts: Vec<f64>,
}

impl Batch {
    fn new(map: &Map) -> Self {
        Self { sums: vec![0.0; map.weights.len()], counts: vec![0.0; map.weights.len()] }
    }

    fn add(&mut self, row: &[f64], winner: usize) {
        let start = winner * row.len();
        for (c, value) in row.iter().enumerate().filter(|(_, value)| !value.is_nan()) {
            self.sums[start + c] += value;
            self.counts[start + c] += 1.0;
        }
    }

    fn apply(&self, map: &mut Map, Kernel(kernel): &Kernel) {
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
    fn an_update_by_hand() {
        let mut map = Map { rows: 1, columns: 3, dimension: 3, weights: vec![0.0; 9] };
        map.weights[3..6].copy_from_slice(&[1.0, 1.0, 1.0]);
        map.update(&[2.0, 0.0, 1.0], 1, 0.5, &Kernel::new(1.0));
        let h = 0.5 * (-0.5f64).exp();
        let expected = [2.0 * h, 0.0, h, 1.5, 0.5, 1.0, 2.0 * h, 0.0, h];
        assert!(map.weights.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-15), "{:?}", map.weights);
    }

    #[test]
    fn the_neighbourhood_has_the_published_values() {
        for (squared, value) in [(0.0, 1.0), (1.0, 0.6065), (4.0, 0.1353)] {
            assert!((neighbourhood(squared, 1.0) - value).abs() < 5e-5);
        }
    }

    fn curve() -> Vec<f64> {
        let point = |k: usize| {
            let t = k as f64 / 400.0 * 5.0;
            [t.sin(), t.cos(), 0.3 * t]
        };
        (0..400).flat_map(point).collect()
    }

    #[test]
    fn a_chain_does_not_fold_and_both_rules_come_as_near() {
        let data = curve();
        let spread: f64 = 1.0;
        for rule in [Rule::Paper, Rule::Batch] {
            let mut map = Map::along_principal_axes(1, 41, 3, &data);
            let training = Training { rule, epochs: 60, stop: false, ..Training::default() };
            map.train(&data, &training);
            let winners: Vec<Winner> = data.chunks(3).map(|row| map.winner(row).unwrap()).collect();
            let error = winners.iter().map(|winner| winner.distance).sum::<f64>() / 400.0;
            assert!(error < 0.1 * spread, "{rule:?}: {error}");
            let jump = winners.windows(2).map(|pair| pair[0].cell.abs_diff(pair[1].cell)).max().unwrap();
            assert!(jump <= 5, "{rule:?} folds: {jump}");
        }
    }

    #[test]
    fn training_repeats_and_stops_when_settled() {
        let data = curve();
        let train = |seed| {
            let mut map = Map::along_principal_axes(1, 41, 3, &data);
            let training = Training { rule: Rule::Paper, epochs: 20, seed, ..Training::default() };
            map.train(&data, &training);
            map
        };
        assert_eq!(train(1), train(1));
        assert_ne!(train(1), train(2));
        let mut map = Map::along_principal_axes(1, 41, 3, &data);
        let epochs = map.train(&data, &Training { epochs: 500, ..Training::default() });
        assert!(epochs < 500, "{epochs}");
    }

    #[test]
    fn a_missing_value_neither_counts_nor_learns() {
        let mut map = Map { rows: 1, columns: 2, dimension: 2, weights: vec![0.0, 5.0, 1.0, -5.0] };
        assert_eq!(map.winner(&[0.9, f64::NAN]).unwrap().cell, 1);
        assert!(map.winner(&[f64::NAN; 2]).is_none());
        map.update(&[0.5, f64::NAN], 1, 1.0, &Kernel::new(1.0));
        assert_eq!(map.weights[3], -5.0);
    }
}
