//! What a map is fitted to: frames of a pole, or readings whose true place is known.
//!
//! A frame of a pole knows nothing but that its sensors stand in a row at known distances. Its five unknown numbers
//! (place and direction) are fitted to the corrected readings, and what remains is its residual; so no pose is needed,
//! and a residual carries exactly what the pole can see: straightness, spacing and length. The same holds for two
//! sensors on either side of a joint of a body: the joint's place is unknown, but both must put it there.

use nalgebra::{DMatrix, DVector, Matrix3, SMatrix, SVector, Vector3};
use posed_geometry::parallel::*;

use super::model::metal::{Metal, SOURCE_PARAMETERS};
use super::model::rotation::by_metal;
use super::model::{Evaluator, Model};
use super::noise::FieldNoise;

/// Most sensors on one pole.
pub const MAX_SENSORS: usize = 24;
/// Residuals above this many standard deviations count linearly only (Huber).
const HUBER: f64 = 3.0;
/// A held-out residual counts as this many standard deviations at most: beside metal two places can give the same
/// reading, and a handful of those must not decide between models.
const BOUND: f64 = 8.0;
/// Rows that are gathered before they are multiplied out.
const CHUNK_ROWS: usize = 768;
/// Step of the differences by which a way to a joint turns with a source, m and its strength.
const STEP: f64 = 1e-5;

/// One group of readings that are judged together.
#[derive(Clone, Debug)]
struct Group {
    start: usize,
    end: usize,
    fold: usize,
    kind: Kind,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    /// Sensors in a row.
    Pole,
    /// One reading at a known place.
    Known(Vector3<f64>),
    /// Two sensors on segments that meet in a joint, and from each its way to the joint, turned as the sensor was
    /// measured, m. The model's metal turns it on.
    Joint([Vector3<f64>; 2]),
}

impl Kind {
    /// Numbers that a group finds for itself.
    fn own(self) -> usize {
        match self {
            Self::Pole => 5,
            Self::Known(_) => 0,
            Self::Joint(_) => 3,
        }
    }
}

/// Readings, how they hang together, and how much each is worth.
#[derive(Clone, Debug)]
pub(crate) struct Problem {
    pub(crate) z: Vec<Vector3<f64>>,
    /// Place along the pole from its middle, m.
    offsets: Vec<f64>,
    whiteners: Vec<Matrix3<f64>>,
    groups: Vec<Group>,
    pub(crate) folds: usize,
}

/// A normal equation and what it came from.
#[derive(Clone, Debug)]
pub(crate) struct Normal {
    pub(crate) matrix: DMatrix<f64>,
    pub(crate) gradient: DVector<f64>,
    /// Sum of the Huber losses of the whitened residuals.
    pub(crate) cost: f64,
    /// The same of losses that no residual can drive beyond a bound: for comparing models.
    pub(crate) bounded: f64,
    /// Numbers that the residuals hold.
    pub(crate) freedoms: f64,
    /// Sum of the squared residuals, m^2, and how many readings they are of.
    pub(crate) square_m2: f64,
    pub(crate) readings: f64,
}

impl Normal {
    fn zero(parameters: usize) -> Self {
        Self {
            matrix: DMatrix::zeros(parameters, parameters),
            gradient: DVector::zeros(parameters),
            cost: 0.0,
            bounded: 0.0,
            freedoms: 0.0,
            square_m2: 0.0,
            readings: 0.0,
        }
    }

    /// Adds another one.
    pub(crate) fn add(&mut self, other: &Self) {
        self.matrix += &other.matrix;
        self.gradient += &other.gradient;
        self.cost += other.cost;
        self.bounded += other.bounded;
        self.freedoms += other.freedoms;
        self.square_m2 += other.square_m2;
        self.readings += other.readings;
    }
}

impl Problem {
    pub(crate) fn new(folds: usize) -> Self {
        Self { z: Vec::new(), offsets: Vec::new(), whiteners: Vec::new(), groups: Vec::new(), folds }
    }

    /// Adds a frame of a pole: each reading with its place along the pole, m from the middle.
    pub(crate) fn push_pole(&mut self, fold: usize, readings: &[(Vector3<f64>, f64)], noise: &FieldNoise) {
        if readings.len() < 3 || readings.len() > MAX_SENSORS {
            return;
        }
        let start = self.z.len();
        for (z, offset) in readings {
            self.z.push(*z);
            self.offsets.push(*offset);
            self.whiteners.push(noise.whitener(z));
        }
        self.groups.push(Group { start, end: self.z.len(), fold: fold % self.folds, kind: Kind::Pole });
    }

    /// Adds a reading at a known place.
    pub(crate) fn push_known(
        &mut self,
        fold: usize,
        z: Vector3<f64>,
        position_m: Vector3<f64>,
        noise: &FieldNoise,
    ) {
        let start = self.z.len();
        self.z.push(z);
        self.offsets.push(0.0);
        self.whiteners.push(noise.whitener(&z));
        self.groups.push(Group {
            start,
            end: start + 1,
            fold: fold % self.folds,
            kind: Kind::Known(position_m),
        });
    }

    /// Adds both sensors at a joint: each reading with its way to the joint, turned as the sensor was measured, m.
    pub(crate) fn push_joint(
        &mut self,
        fold: usize,
        readings: [(Vector3<f64>, Vector3<f64>); 2],
        noise: &FieldNoise,
    ) {
        let start = self.z.len();
        for (z, _) in &readings {
            self.z.push(*z);
            self.offsets.push(0.0);
            self.whiteners.push(noise.whitener(z));
        }
        let kind = Kind::Joint(readings.map(|(_, way)| way));
        self.groups.push(Group { start, end: start + 2, fold: fold % self.folds, kind });
    }

    /// The same readings with another noise.
    pub(crate) fn with_noise(&self, noise: &FieldNoise) -> Self {
        Self { whiteners: self.z.iter().map(|z| noise.whitener(z)).collect(), ..self.clone() }
    }

    /// One group of each `stride`, not always the same one of them: joints come in turns.
    pub(crate) fn thinned(&self, stride: usize) -> Self {
        let mut thin = Self::new(self.folds);
        for (index, chunk) in self.groups.chunks(stride.max(1)).enumerate() {
            let group = &chunk[index % chunk.len()];
            let start = thin.z.len();
            thin.z.extend(&self.z[group.start..group.end]);
            thin.offsets.extend(&self.offsets[group.start..group.end]);
            thin.whiteners.extend(&self.whiteners[group.start..group.end]);
            thin.groups.push(Group { start, end: thin.z.len(), ..*group });
        }
        thin
    }

    /// Number of groups.
    pub(crate) fn groups(&self) -> usize {
        self.groups.len()
    }

    /// Normal equations of each fold, without the prior.
    pub(crate) fn normals(&self, model: &Model) -> Vec<Normal> {
        let evaluator = model.evaluator();
        (0..self.folds)
            .into_par_iter()
            .map(|fold| self.normal_of(&evaluator, model.parameters(), fold))
            .collect()
    }

    fn normal_of(&self, evaluator: &Evaluator<'_>, parameters: usize, fold: usize) -> Normal {
        let mut normal = Normal::zero(parameters);
        // Transposed: one column per residual.
        let mut rows = DMatrix::zeros(parameters, CHUNK_ROWS);
        let mut residuals = DVector::zeros(CHUNK_ROWS);
        let mut filled = 0;
        let mut derivatives = vec![0.0; 3 * parameters];
        let mut scratch = Scratch::default();
        let joints = self.groups.iter().any(|group| matches!(group.kind, Kind::Joint(_)));
        let sources = if joints { evaluator.sources() } else { 0 };
        let moved: Vec<Metal> =
            (0..SOURCE_PARAMETERS * sources).map(|parameter| evaluator.moved(parameter, STEP)).collect();
        for group in self.groups.iter().filter(|group| group.fold == fold) {
            let count = group.end - group.start;
            if filled + 3 * count > CHUNK_ROWS {
                flush(&mut normal, &rows, &residuals, filled);
                filled = 0;
            }
            for (k, index) in (group.start..group.end).enumerate() {
                derivatives.fill(0.0);
                let z = &self.z[index];
                scratch.y[k] = evaluator.with_derivatives(z, &mut derivatives);
                if let Kind::Joint(ways) = &group.kind {
                    scratch.shift[k] = turned(evaluator.metal(), z, &scratch.y[k], &ways[k]);
                    for (change, metal) in derivatives.chunks_exact_mut(3).zip(&moved) {
                        let y = scratch.y[k] + Vector3::from_column_slice(change) * STEP;
                        let by_rotation = (turned(Some(metal), z, &y, &ways[k]) - scratch.shift[k]) / STEP;
                        change
                            .iter_mut()
                            .zip(by_rotation.iter())
                            .for_each(|(change, by_rotation)| *change += by_rotation);
                    }
                }
                for parameter in 0..parameters {
                    for axis in 0..3 {
                        rows[(parameter, filled + 3 * k + axis)] = derivatives[3 * parameter + axis];
                    }
                }
            }
            self.residual(group, &mut scratch);
            scratch.tally(count, group, &mut normal);
            for k in 0..count {
                whiten_columns(&mut rows, filled + 3 * k, &scratch.whitener[k]);
                for axis in 0..3 {
                    residuals[filled + 3 * k + axis] = scratch.residual[3 * k + axis];
                }
            }
            project(&mut rows, filled, 3 * count, &scratch.pose, group.kind.own());
            filled += 3 * count;
        }
        flush(&mut normal, &rows, &residuals, filled);
        normal
    }

    /// Costs of one fold without derivatives.
    pub(crate) fn cost_of(&self, model: &Model, fold: usize) -> Normal {
        let evaluator = model.evaluator();
        let mut normal = Normal::zero(0);
        let mut scratch = Scratch::default();
        for group in self.groups.iter().filter(|group| group.fold == fold) {
            self.correct(&evaluator, group, &mut scratch);
            self.residual(group, &mut scratch);
            scratch.tally(group.end - group.start, group, &mut normal);
        }
        normal
    }

    /// Of each reading of a fold: what was read, the square of its residual (m^2), and the share of its noise that a
    /// residual still holds.
    pub(crate) fn squares_of(&self, model: &Model, fold: usize) -> Vec<(Vector3<f64>, f64, f64)> {
        let evaluator = model.evaluator();
        let mut scratch = Scratch::default();
        let mut squares = Vec::new();
        for group in self.groups.iter().filter(|group| group.fold == fold) {
            let count = group.end - group.start;
            self.correct(&evaluator, group, &mut scratch);
            self.residual(group, &mut scratch);
            let freedom = 1.0 - group.kind.own() as f64 / (3.0 * count as f64);
            squares.extend(
                (0..count).map(|k| (self.z[group.start + k], scratch.difference[k].norm_squared(), freedom)),
            );
        }
        squares
    }

    /// Says for each group: index of its first reading, its whitened residual, its whiteners (with robust weights),
    /// and an orthonormal basis of what its own pose explains.
    pub(crate) fn each_residual(&self, model: &Model, mut each: impl FnMut(usize, usize, &Scratch)) {
        let evaluator = model.evaluator();
        let mut scratch = Scratch::default();
        for group in &self.groups {
            scratch.shift = [Vector3::zeros(); 2];
            self.correct(&evaluator, group, &mut scratch);
            self.residual(group, &mut scratch);
            for column in group.kind.own()..5 {
                scratch.pose.column_mut(column).fill(0.0);
            }
            each(group.start, group.end - group.start, &scratch);
        }
    }

    /// Corrects the readings of a group, and turns the ways to a joint.
    fn correct(&self, evaluator: &Evaluator<'_>, group: &Group, scratch: &mut Scratch) {
        for (k, index) in (group.start..group.end).enumerate() {
            let z = &self.z[index];
            scratch.y[k] = evaluator.correct(z);
            if let Kind::Joint(ways) = &group.kind {
                scratch.shift[k] = turned(evaluator.metal(), z, &scratch.y[k], &ways[k]);
            }
        }
    }

    fn residual(&self, group: &Group, scratch: &mut Scratch) {
        let whiteners = &self.whiteners[group.start..group.end];
        match group.kind {
            Kind::Known(position_m) => {
                let difference = scratch.y[0] - position_m;
                let weight = huber_weight((whiteners[0] * difference).norm());
                scratch.difference[0] = difference;
                scratch.loss = huber_loss((whiteners[0] * difference).norm());
                scratch.bounded = bounded_loss((whiteners[0] * difference).norm());
                scratch.whitener[0] = whiteners[0] * weight.sqrt();
                let residual = scratch.whitener[0] * difference;
                scratch.residual.fixed_rows_mut::<3>(0).copy_from(&residual);
            }
            Kind::Pole => scratch.fit_pole(whiteners, &self.offsets[group.start..group.end]),
            Kind::Joint(_) => scratch.fit_joint(whiteners),
        }
    }
}

/// A vector that was turned as a sensor was measured, turned as it was: the metal undone.
fn turned(metal: Option<&Metal>, z: &Vector3<f64>, y: &Vector3<f64>, way: &Vector3<f64>) -> Vector3<f64> {
    metal.map_or(*way, |metal| by_metal(metal, z, y) * way)
}

/// Rotates and scales three columns by a symmetric 3x3 matrix.
fn whiten_columns(rows: &mut DMatrix<f64>, column: usize, whitener: &Matrix3<f64>) {
    for parameter in 0..rows.nrows() {
        let v = Vector3::new(
            rows[(parameter, column)],
            rows[(parameter, column + 1)],
            rows[(parameter, column + 2)],
        );
        let v = whitener * v;
        for axis in 0..3 {
            rows[(parameter, column + axis)] = v[axis];
        }
    }
}

/// Takes out of `count` columns from `start` on what the first `own` columns of the pose can explain.
fn project(rows: &mut DMatrix<f64>, start: usize, count: usize, pose: &PoseBasis, own: usize) {
    for basis in 0..own {
        let q = pose.column(basis);
        for parameter in 0..rows.nrows() {
            let mut dot = 0.0;
            for k in 0..count {
                dot += rows[(parameter, start + k)] * q[k];
            }
            for k in 0..count {
                rows[(parameter, start + k)] -= dot * q[k];
            }
        }
    }
}

fn flush(normal: &mut Normal, rows: &DMatrix<f64>, residuals: &DVector<f64>, filled: usize) {
    if filled == 0 || rows.nrows() == 0 {
        return;
    }
    let rows = rows.columns(0, filled);
    normal.matrix.gemm(1.0, &rows, &rows.transpose(), 1.0);
    normal.gradient.gemv(1.0, &rows, &residuals.rows(0, filled), 1.0);
}

fn huber_weight(size: f64) -> f64 {
    if size > HUBER { HUBER / size } else { 1.0 }
}

fn huber_loss(size: f64) -> f64 {
    if size > HUBER { HUBER * (2.0 * size - HUBER) } else { size * size }
}

fn bounded_loss(size: f64) -> f64 {
    huber_loss(size.min(BOUND))
}

type PoseBasis = SMatrix<f64, { 3 * MAX_SENSORS }, 5>;

/// Working space for one group.
#[derive(Clone, Debug)]
pub(crate) struct Scratch {
    pub(crate) y: [Vector3<f64>; MAX_SENSORS],
    /// From both sensors to their joint, m; zero without one.
    pub(crate) shift: [Vector3<f64>; 2],
    /// Reading minus pole, m.
    difference: [Vector3<f64>; MAX_SENSORS],
    /// Whiteners with the robust weights in them.
    pub(crate) whitener: [Matrix3<f64>; MAX_SENSORS],
    /// Whitened residual, three numbers per sensor.
    pub(crate) residual: SVector<f64, { 3 * MAX_SENSORS }>,
    /// Orthonormal basis of what the pose of the pole can explain, whitened.
    pub(crate) pose: PoseBasis,
    loss: f64,
    bounded: f64,
}

impl Default for Scratch {
    fn default() -> Self {
        Self {
            y: [Vector3::zeros(); MAX_SENSORS],
            shift: [Vector3::zeros(); 2],
            difference: [Vector3::zeros(); MAX_SENSORS],
            whitener: [Matrix3::identity(); MAX_SENSORS],
            residual: SVector::zeros(),
            pose: SMatrix::zeros(),
            loss: 0.0,
            bounded: 0.0,
        }
    }
}

impl Scratch {
    /// Fits place and direction of the pole to the corrected readings, robustly, by Gauss-Newton.
    fn fit_pole(&mut self, whiteners: &[Matrix3<f64>], offsets: &[f64]) {
        let count = offsets.len();
        let (mut middle, mut along) = line(&self.y[..count], offsets);
        for round in 0..4 {
            let side = side_basis(&along);
            (self.loss, self.bounded) = (0.0, 0.0);
            for k in 0..count {
                self.difference[k] = self.y[k] - middle - along * offsets[k];
                let size = (whiteners[k] * self.difference[k]).norm();
                self.loss += huber_loss(size);
                self.bounded += bounded_loss(size);
                self.whitener[k] = whiteners[k] * huber_weight(size).sqrt();
                let w = &self.whitener[k];
                self.residual.fixed_rows_mut::<3>(3 * k).copy_from(&(w * self.difference[k]));
                self.pose.fixed_view_mut::<3, 3>(3 * k, 0).copy_from(w);
                self.pose.fixed_view_mut::<3, 2>(3 * k, 3).copy_from(&(w * side * offsets[k]));
            }
            let used = 3 * count;
            let step = orthonormalise(&mut self.pose, used, 5, &self.residual);
            let Some(step) = step else { return };
            if round == 3 {
                self.leave(used, 5);
                return;
            }
            middle += step.fixed_rows::<3>(0);
            along += side * step.fixed_rows::<2>(3);
            along /= along.norm();
        }
    }

    /// Finds the joint between its two sensors. How far they are apart counts, robustly, not the half of each.
    fn fit_joint(&mut self, whiteners: &[Matrix3<f64>]) {
        let ends = [0, 1].map(|k| self.y[k] + self.shift[k]);
        let middle = (ends[0] + ends[1]) / 2.0;
        for k in 0..2 {
            self.difference[k] = ends[k] - middle;
            self.whitener[k] = whiteners[k];
            self.residual.fixed_rows_mut::<3>(3 * k).copy_from(&(whiteners[k] * self.difference[k]));
            self.pose.fixed_view_mut::<3, 3>(3 * k, 0).copy_from(&whiteners[k]);
        }
        if orthonormalise(&mut self.pose, 6, 3, &self.residual).is_some() {
            self.leave(6, 3);
        }
        let size = self.residual.fixed_rows::<6>(0).norm();
        (self.loss, self.bounded) = (huber_loss(size), bounded_loss(size));
        let weight = huber_weight(size).sqrt();
        for k in 0..2 {
            self.whitener[k] *= weight;
            for axis in 0..3 {
                self.residual[3 * k + axis] *= weight;
            }
        }
    }

    /// Leaves in the residual what the pose cannot explain.
    fn leave(&mut self, used: usize, own: usize) {
        for basis in 0..own {
            let dot: f64 = (0..used).map(|k| self.pose[(k, basis)] * self.residual[k]).sum();
            for k in 0..used {
                self.residual[k] -= dot * self.pose[(k, basis)];
            }
        }
    }

    fn tally(&self, count: usize, group: &Group, normal: &mut Normal) {
        normal.cost += self.loss;
        normal.bounded += self.bounded;
        normal.freedoms += (3 * count - group.kind.own()) as f64;
        normal.square_m2 += self.difference[..count].iter().map(Vector3::norm_squared).sum::<f64>();
        normal.readings += count as f64;
    }
}

/// Fits a straight row of points by least squares, all points alike: where offset 0 is, m, and its unit direction
/// towards larger offsets. `points` and `offsets` (m, along the row) are as many. The direction is x where the points
/// do not show one; without points the numbers are not finite.
pub fn line(points: &[Vector3<f64>], offsets: &[f64]) -> (Vector3<f64>, Vector3<f64>) {
    let count = points.len() as f64;
    let mean = points.iter().sum::<Vector3<f64>>() / count;
    let mean_offset = offsets.iter().sum::<f64>() / count;
    let mut along = Vector3::zeros();
    for (point, offset) in points.iter().zip(offsets) {
        along += (point - mean) * (offset - mean_offset);
    }
    let along = along.try_normalize(1e-12).unwrap_or_else(Vector3::x);
    (mean - along * mean_offset, along)
}

/// Two unit vectors across the unit vector `along` and across each other, as columns. Which two is fixed, but jumps
/// where `along.x` passes 0.6.
pub fn side_basis(along: &Vector3<f64>) -> SMatrix<f64, 3, 2> {
    let helper = if along.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    let first = along.cross(&helper).normalize();
    SMatrix::<f64, 3, 2>::from_columns(&[first, along.cross(&first)])
}

/// Gram-Schmidt of the first `own` columns in place; returns the least-squares solution of `pose x = residual`, or `None` if it has none.
fn orthonormalise(
    pose: &mut PoseBasis,
    used: usize,
    own: usize,
    residual: &SVector<f64, { 3 * MAX_SENSORS }>,
) -> Option<SVector<f64, 5>> {
    // Columns that are not there stand for nothing.
    let mut triangle = SMatrix::<f64, 5, 5>::identity();
    let mut projected = SVector::<f64, 5>::zeros();
    for column in 0..own {
        for earlier in 0..column {
            let dot: f64 = (0..used).map(|k| pose[(k, column)] * pose[(k, earlier)]).sum();
            triangle[(earlier, column)] = dot;
            for k in 0..used {
                pose[(k, column)] -= dot * pose[(k, earlier)];
            }
        }
        let norm = (0..used).map(|k| pose[(k, column)] * pose[(k, column)]).sum::<f64>().sqrt();
        if !norm.is_normal() {
            return None;
        }
        triangle[(column, column)] = norm;
        for k in 0..used {
            pose[(k, column)] /= norm;
        }
        projected[column] = (0..used).map(|k| pose[(k, column)] * residual[k]).sum();
    }
    triangle.solve_upper_triangular(&projected)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Kind as SourceKind, Source};

    /// What the gradient of the cost says is what the cost does, of joints whose ways turn with the metal.
    #[test]
    fn the_gradient_of_joints_is_a_difference() {
        let sources = vec![
            Source { kind: SourceKind::Plane, position_m: [0.1, -0.05, -1.2], strength: 0.06 },
            Source { kind: SourceKind::Object, position_m: [2.2, 1.3, 0.3], strength: 0.004 },
        ];
        let model = Model { sources, ..Model::default() };
        let noise = FieldNoise { sigma_signal: 1e-4, floor_m: 0.01 };
        let mut problem = Problem::new(1);
        for k in 0..20 {
            let t = f64::from(k);
            let z =
                Vector3::new(1.2 + 0.3 * libm::sin(t), 0.4 * libm::cos(t), 0.3 + 0.2 * libm::sin(0.7 * t));
            let ways = [Vector3::new(0.1, -0.2, 0.1), Vector3::new(-0.1, 0.1 * libm::sin(t), 0.2)];
            problem.push_joint(0, [(z, ways[0]), (z + Vector3::new(0.2, 0.1, -0.1), ways[1])], &noise);
        }
        let values = model.values();
        let gradient = &problem.normals(&model)[0].gradient;
        for k in 0..values.len() {
            let at = |sign: f64| {
                let mut moved = values.clone();
                moved[k] += sign * 1e-5;
                problem.cost_of(&model.with_values(&moved), 0).cost
            };
            let difference = (at(1.0) - at(-1.0)) / 2e-5;
            let expected = 2.0 * gradient[k];
            assert!(
                (difference - expected).abs() < 2e-3 * (1.0 + expected.abs()),
                "{k}: {difference} {expected}"
            );
        }
    }
}
