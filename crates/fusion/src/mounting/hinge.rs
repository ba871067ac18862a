//! The axis of a hinge, in the axes of the two sensors beside it.
//!
//! In: angular velocities and specific forces of both sensors, sampled together. Out: the axis in both, with the same sign.
//!
//! Seel, Raisch & Schauer, "IMU-based joint angle measurement for gait analysis" (2014): across the axis both
//! sensors turn equally fast, `|w1 x j1| = |w2 x j2|`. Beside it, along the axis both feel the same specific force,
//! `j1 a1 = j2 a2`, up to the levers' accelerations (Olsson, Kok, Seel & Halvorsen 2020): that settles the sign
//! and helps where one of the segments hardly turns.

use nalgebra::{Matrix3x2, Matrix4, Vector2, Vector3, Vector4};
use serde::{Deserialize, Serialize};

use super::Refused;
use posed_geometry::GRAVITY_M_S2;

/// A sample says this much about an angular velocity, rad/s, and a specific force, m/s²: skin motion, not sensor noise.
const GYRO_SIGMA: f64 = 0.1;
const ACCEL_SIGMA: f64 = 0.5;
/// Part of an angular velocity by which skin and straps may falsify it.
const GYRO_SHARE: f64 = 0.05;
/// Distance between the sensors along the axis and across, m: what turning does to their specific forces.
const LEVER_M: f64 = 0.3;
/// Fewest samples.
const MIN_SAMPLES: usize = 50;
/// Smallest curvature per sample: an axis known to `1 / sqrt(curvature * samples)` rad if samples were independent.
const MIN_CURVATURE: f64 = 0.02;
/// Most samples that are looked at.
const MAX_SAMPLES: usize = 4000;

/// A hinge's axis in both sensors. The sign of the pair is a convention of whoever made it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HingeAxes {
    /// Unit axis in the first sensor.
    pub first: Vector3<f64>,
    /// The same axis, with the same sign, in the second sensor.
    pub second: Vector3<f64>,
    /// Root mean square of `|w1 x j1| - |w2 x j2|`, rad/s: skin, straps and other axes of the joint.
    pub angular_velocity_residual_rad_s: f64,
    /// Smallest curvature of the cost per sample, 1/rad²: independent samples would show the axis to
    /// `1 / sqrt(excitation * samples)` rad. Larger is better shown; at least 0.02.
    pub excitation: f64,
}

/// One epoch: angular velocities, rad/s, and specific forces, m/s², of both sensors.
type Pair = ([Vector3<f64>; 2], [Vector3<f64>; 2]);

/// Finds the axis; `samples` gives angular velocities, rad/s, and specific forces, m/s², of both sensors at one time, each in
/// its own axes: `([w1, w2], [a1, a2])`. All must be finite; more than 4000 are thinned. Seel et al. (2014) and Olsson et al.
/// (2020), weighted as in `docs/methods/mounting.md`; accuracy: `docs/body.md`. A movement about the hinge alone, in step,
/// may give axes that are wrong together. The largest component of the first axis is positive.
///
/// # Errors
/// [`Refused::TooShort`] below 50 samples, [`Refused::Excitation`] where the movement does not show the axis.
pub fn hinge_axes(samples: &[Pair]) -> Result<HingeAxes, Refused> {
    if samples.len() < MIN_SAMPLES {
        return Err(Refused::TooShort { found: samples.len(), needed: MIN_SAMPLES });
    }
    let step = samples.len().div_ceil(MAX_SAMPLES);
    let samples: Vec<Pair> = samples.iter().step_by(step).copied().collect();
    // Both signs of the second axis from each of two directions: a start in every basin.
    let mut best: Option<(f64, [Vector3<f64>; 2], Matrix4<f64>)> = None;
    for start in [Vector3::new(1.0, 0.2, 0.1), Vector3::new(-0.1, 0.3, 1.0), Vector3::new(0.1, 1.0, -0.2)] {
        for sign in [1.0, -1.0] {
            let found = descend(&samples, [start.normalize(), start.normalize() * sign]);
            if best.as_ref().is_none_or(|best| found.0 < best.0) {
                best = Some(found);
            }
        }
    }
    let Some((_, [first, second], information)) = best else {
        return Err(Refused::TooShort { found: 0, needed: MIN_SAMPLES });
    };
    let excitation = information.symmetric_eigenvalues().min() / samples.len() as f64;
    if excitation.is_nan() || excitation < MIN_CURVATURE {
        return Err(Refused::Excitation { found: excitation, needed: MIN_CURVATURE });
    }
    let sum: f64 =
        samples.iter().map(|(w, _)| (w[0].cross(&first).norm() - w[1].cross(&second).norm()).powi(2)).sum();
    let angular_velocity_residual_rad_s = (sum / samples.len() as f64).sqrt();
    // The sign of the pair: the component that is largest in the first sensor is positive.
    let sign = first[first.iamax()].signum();
    Ok(HingeAxes { first: first * sign, second: second * sign, angular_velocity_residual_rad_s, excitation })
}

/// Levenberg-Marquardt on two unit spheres; returns cost, axes and the information at the end.
fn descend(samples: &[Pair], start: [Vector3<f64>; 2]) -> (f64, [Vector3<f64>; 2], Matrix4<f64>) {
    let mut axes = start;
    let (mut cost, mut gradient, mut information) = linearise(samples, &axes);
    let mut damping = 1e-3;
    for _ in 0..60 {
        let damped = information + Matrix4::from_diagonal(&information.diagonal()) * damping;
        let Some(step) = damped.cholesky().map(|c| -c.solve(&gradient)) else { break };
        let moved = [
            retract(&axes[0], &Vector2::new(step[0], step[1])),
            retract(&axes[1], &Vector2::new(step[2], step[3])),
        ];
        let next = linearise(samples, &moved);
        if next.0 < cost {
            axes = moved;
            let done = cost - next.0 < 1e-12 * cost;
            (cost, gradient, information) = next;
            damping *= 0.3;
            if done {
                break;
            }
        } else {
            damping *= 10.0;
            if damping > 1e8 {
                break;
            }
        }
    }
    (cost, axes, information)
}

fn linearise(samples: &[Pair], axes: &[Vector3<f64>; 2]) -> (f64, Vector4<f64>, Matrix4<f64>) {
    let bases = [tangent(&axes[0]), tangent(&axes[1])];
    let mut cost = 0.0;
    let mut gradient = Vector4::zeros();
    let mut information = Matrix4::zeros();
    let mut add = |residual: f64, rows: [Vector3<f64>; 2]| {
        let (a, b) = (bases[0].transpose() * rows[0], bases[1].transpose() * rows[1]);
        let row = Vector4::new(a.x, a.y, b.x, b.y);
        // Huber: beyond three sigma a residual counts linearly.
        let weight = (3.0 / residual.abs()).min(1.0);
        cost += if weight < 1.0 { 6.0 * residual.abs() - 9.0 } else { residual * residual };
        gradient += row * (weight * residual);
        information += row * row.transpose() * weight;
    };
    for (w, a) in samples {
        let across = [w[0].cross(&axes[0]), w[1].cross(&axes[1])];
        let norms = [across[0].norm().max(1e-9), across[1].norm().max(1e-9)];
        let fastest = w[0].norm_squared().max(w[1].norm_squared());
        let sigma = libm::hypot(GYRO_SIGMA, GYRO_SHARE * fastest.sqrt());
        let rows =
            [across[0].cross(&w[0]) / (norms[0] * sigma), across[1].cross(&w[1]) / (-norms[1] * sigma)];
        add((norms[0] - norms[1]) / sigma, rows);
        // Where gravity is all, the specific forces along the axis are equal; levers and blows make it uncertain.
        let blow = a.iter().map(|a| (a.norm() - GRAVITY_M_S2).abs()).fold(0.0, f64::max);
        let sigma = libm::hypot(libm::hypot(ACCEL_SIGMA, LEVER_M * fastest), blow);
        let difference = a[0].dot(&axes[0]) - a[1].dot(&axes[1]);
        add(difference / sigma, [a[0] / sigma, -a[1] / sigma]);
    }
    (cost, gradient, information)
}

/// Two unit vectors across `axis`.
fn tangent(axis: &Vector3<f64>) -> Matrix3x2<f64> {
    let mut other = Vector3::zeros();
    other[axis.iamin()] = 1.0;
    let first = axis.cross(&other).normalize();
    Matrix3x2::from_columns(&[first, axis.cross(&first)])
}

fn retract(axis: &Vector3<f64>, step: &Vector2<f64>) -> Vector3<f64> {
    (axis + tangent(axis) * step).normalize()
}
