//! Orientation: the same metal turns it, and the pole's sensors are fixed to each other.
//!
//! What comes in: a recording with orientations, the model of the positions. What goes out: a rotation vector as a
//! polynomial of the place, on top of what the metal says. What is asked of it: sensors keep their unknown but constant
//! orientations on the pole, and the pole's own axis lies along its corrected positions.

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::model::metal::Metal;
use super::model::polynomial::MAX_MONOMIALS;
use super::model::rotation::by_metal;
use super::model::{Model, Polynomial};
use super::pole::PoleRun;
use super::problem::line;
use posed_geometry::so3;

/// Highest degree that is tried, and rounds between mounting and polynomial.
const DEGREES: usize = 3;
const ROUNDS: usize = 3;
/// Frames that are enough.
const ENOUGH_FRAMES: usize = 400;
/// Held-out blocks.
const FOLDS: usize = 8;
/// A richer polynomial must win by this share.
const GAIN: f64 = 0.98;

/// One reading, relative to the pole.
struct Row {
    frame: usize,
    fold: usize,
    sensor: usize,
    z: Vector3<f64>,
    /// Measured orientation with the metal undone.
    q: UnitQuaternion<f64>,
}

/// The polynomial to add, chosen on held-out blocks; `None` where the metal (or nothing) does as well.
pub(crate) fn fit(run: &PoleRun, model: &Model, scale: &Polynomial) -> Option<Polynomial> {
    let evaluator = model.evaluator();
    let metal = Metal::new(&model.sources);
    let start = run.frames.first()?.t_s;
    let mut rows = Vec::new();
    let mut directions = Vec::new();
    // Neighbouring frames say much the same.
    let stride = (run.frames.len() / ENOUGH_FRAMES).max(1);
    for frame in run.frames.iter().step_by(stride) {
        let (mut points, mut offsets) = (Vec::new(), Vec::new());
        let first = rows.len();
        for (sensor, reading) in frame.readings.iter().enumerate() {
            let Some(reading) = reading else { continue };
            let Some(q) = reading.orientation else { continue };
            let z = reading.position_m;
            points.push(evaluator.correct(&z));
            offsets.push(run.offset_m(sensor));
            let undone = match metal.correct(&z) {
                Some(p) if !model.sources.is_empty() => by_metal(&metal, &z, &p),
                _ => UnitQuaternion::identity(),
            };
            let fold = ((frame.t_s - start) / 2.0) as usize % FOLDS;
            rows.push(Row { frame: directions.len(), fold, sensor, z, q: undone * q });
        }
        if points.len() < 3 {
            rows.truncate(first);
            continue;
        }
        directions.push(line(&points, &offsets).1);
    }
    if directions.len() < 50 {
        return None;
    }
    let mut best: Option<Polynomial> = None;
    let mut least = judge(&rows, &directions, run.sensors.len(), None)?.0;
    for degree in 0..=DEGREES {
        let zero = Polynomial::new(degree, &Vector3::from(scale.center_m), scale.scale_m);
        let Some((score, polynomial)) = judge(&rows, &directions, run.sensors.len(), Some(&zero)) else {
            break;
        };
        if score < GAIN * least {
            least = score;
            best = polynomial;
        }
    }
    best
}

/// Fits a polynomial by rounds and returns the held-out mean square.
fn judge(
    rows: &[Row],
    directions: &[Vector3<f64>],
    sensors: usize,
    zero: Option<&Polynomial>,
) -> Option<(f64, Option<Polynomial>)> {
    let mut polynomial = zero.cloned();
    let mut score = f64::INFINITY;
    for _ in 0..if zero.is_some() { ROUNDS } else { 1 } {
        let turned: Vec<UnitQuaternion<f64>> = rows
            .iter()
            .map(|row| match &polynomial {
                Some(polynomial) => so3::exp(&polynomial.at(&row.z)) * row.q,
                None => row.q,
            })
            .collect();
        let pole = Pole::new(rows, &turned, directions, sensors)?;
        let size = zero.map_or(0, |zero| 3 * zero.coefficients.len());
        let mut folds = vec![(DMatrix::<f64>::zeros(size, size), DVector::<f64>::zeros(size)); FOLDS];
        let mut each: Vec<(usize, DMatrix<f64>, DVector<f64>)> = Vec::new();
        let mut start = 0;
        while start < rows.len() {
            let mut end = start;
            while end < rows.len() && rows[end].frame == rows[start].frame {
                end += 1;
            }
            let (jacobian, residual) =
                pole.residual(&rows[start..end], &turned[start..end], directions, zero);
            let fold = rows[start].fold;
            folds[fold].0.gemm_tr(1.0, &jacobian, &jacobian, 1.0);
            folds[fold].1.gemv_tr(1.0, &jacobian, &residual, 1.0);
            each.push((fold, jacobian, residual));
            start = end;
        }
        let mut total = (DMatrix::<f64>::identity(size, size) * 1e-2, DVector::<f64>::zeros(size));
        for fold in &folds {
            total.0 += &fold.0;
            total.1 += &fold.1;
        }
        let solve =
            |matrix: &DMatrix<f64>, vector: &DVector<f64>| Some(matrix.clone().cholesky()?.solve(vector));
        let without: Option<Vec<DVector<f64>>> =
            folds.iter().map(|fold| solve(&(&total.0 - &fold.0), &(&total.1 - &fold.1))).collect();
        let without = without?;
        let (mut sum, mut count) = (0.0, 0.0);
        for (fold, jacobian, residual) in &each {
            let left = if size == 0 { residual.clone() } else { residual - jacobian * &without[*fold] };
            sum += left.norm_squared();
            count += left.len() as f64;
        }
        score = sum / count;
        if let Some(polynomial) = &mut polynomial {
            let step = solve(&total.0, &total.1)?;
            for (k, coefficient) in polynomial.coefficients.iter_mut().enumerate() {
                for axis in 0..3 {
                    coefficient[axis] += step[3 * k + axis];
                }
            }
        }
    }
    Some((score, polynomial))
}

/// How the sensors sit on the pole, as the turned orientations say.
struct Pole {
    /// Sensor to pole.
    mounts: Vec<UnitQuaternion<f64>>,
    /// Axis of the pole in its own frame.
    axis: Vector3<f64>,
}

impl Pole {
    fn new(
        rows: &[Row],
        turned: &[UnitQuaternion<f64>],
        directions: &[Vector3<f64>],
        sensors: usize,
    ) -> Option<Self> {
        // The pole's frame is that of the sensor seen most; mounts are chordal means.
        let mut counts = vec![0; sensors];
        rows.iter().for_each(|row| counts[row.sensor] += 1);
        let reference = (0..sensors).max_by_key(|k| (counts[*k], std::cmp::Reverse(*k)))?;
        let mut by_frame = vec![None; directions.len()];
        for (row, q) in rows.iter().zip(turned) {
            if row.sensor == reference {
                by_frame[row.frame] = Some(*q);
            }
        }
        let mut sums = vec![Matrix3::zeros(); sensors];
        let mut axis = Vector3::zeros();
        for (row, q) in rows.iter().zip(turned) {
            if let Some(pole) = by_frame[row.frame] {
                sums[row.sensor] += (pole.inverse() * q).to_rotation_matrix().matrix();
                axis += pole.inverse() * directions[row.frame];
            }
        }
        let mounts: Vec<_> = sums
            .iter()
            .map(|sum| {
                let svd = sum.svd(true, true);
                let rotation = svd.u? * svd.v_t?;
                Some(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation)))
            })
            .map(|mount| mount.unwrap_or_else(UnitQuaternion::identity))
            .collect();
        Some(Self { mounts, axis: axis.try_normalize(1e-9)? })
    }

    /// Residual of one frame and its derivative by the coefficients, so that `residual - jacobian x` is what stays.
    fn residual(
        &self,
        rows: &[Row],
        turned: &[UnitQuaternion<f64>],
        directions: &[Vector3<f64>],
        zero: Option<&Polynomial>,
    ) -> (DMatrix<f64>, DVector<f64>) {
        let n = rows.len();
        let size = zero.map_or(0, |zero| 3 * zero.coefficients.len());
        let poles: Vec<_> =
            rows.iter().zip(turned).map(|(row, q)| q * self.mounts[row.sensor].inverse()).collect();
        let logs: Vec<_> = poles.iter().map(|pole| so3::log(&(pole * poles[0].inverse()))).collect();
        let mean = logs.iter().sum::<Vector3<f64>>() / n as f64;
        let mut values = [0.0; MAX_MONOMIALS];
        let mut basis = DMatrix::<f64>::zeros(n, size / 3);
        if let Some(zero) = zero {
            for (i, row) in rows.iter().enumerate() {
                let count = zero.monomials(&row.z, &mut values);
                for k in 0..count {
                    basis[(i, k)] = values[k];
                }
            }
        }
        let means: Vec<f64> = (0..size / 3).map(|k| basis.column(k).mean()).collect();
        let mut jacobian = DMatrix::zeros(6 * n, size);
        let mut residual = DVector::zeros(6 * n);
        for i in 0..n {
            let along = poles[i] * self.axis;
            let cross = so3::hat(&along);
            let apart = logs[i] - mean;
            // A small rotation e moves the axis by e x axis.
            let off = along - directions[rows[i].frame];
            for axis in 0..3 {
                residual[6 * i + axis] = apart[axis];
                residual[6 * i + 3 + axis] = off[axis];
                for k in 0..size / 3 {
                    jacobian[(6 * i + axis, 3 * k + axis)] = means[k] - basis[(i, k)];
                    for by in 0..3 {
                        jacobian[(6 * i + 3 + axis, 3 * k + by)] = cross[(axis, by)] * basis[(i, k)];
                    }
                }
            }
        }
        (jacobian, residual)
    }
}
