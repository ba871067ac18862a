//! Where a joint's centre is, relative to the sensors beside it.
//!
//! In: angular velocities, angular accelerations and specific forces of both sensors. Out: the vectors from the joint to each
//! sensor, in sensor axes. Seel, Raisch & Schauer (2014): moved to the joint, both specific forces are equally long,
//! `|a1 - G(w1, dw1) o1| = |a2 - G(w2, dw2) o2|` with `G o = dw x o + w x (w x o)`. On a hinge the place along the
//! axis does not show; the least of them is taken.

use nalgebra::{Matrix6, Vector3, Vector6};
use serde::{Deserialize, Serialize};

use super::Refused;
use posed_geometry::so3::lever;

const MIN_SAMPLES: usize = 100;
/// A sample's specific force is good to this, m/s².
const ACCEL_SIGMA: f64 = 0.5;
/// The prior that keeps what does not show small: sensors sit within this of the joint, m.
const PRIOR_M: f64 = 0.5;
/// The second weakest direction must be known at least so well per sample, 1/m² (the weakest is the hinge's axis).
const MIN_CURVATURE: f64 = 1.0;

/// A joint's centre, relative to the sensors beside it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointPosition {
    /// From the joint to the first sensor, its axes, m.
    pub first_m: Vector3<f64>,
    /// From the joint to the second sensor, its axes, m.
    pub second_m: Vector3<f64>,
    /// Root mean square of the difference of the specific forces' lengths at the joint, m/s².
    pub residual_m_s2: f64,
    /// Curvature per sample of the second weakest direction, 1/m²: on a hinge the weakest is its axis, which does not show.
    /// At least 1.
    pub excitation: f64,
}

/// One sensor at one time, its own axes: angular velocity, rad/s; angular acceleration, rad/s²; specific force, m/s².
pub type Motion = (Vector3<f64>, Vector3<f64>, Vector3<f64>);

/// Finds the joint's centre from both sensors' motion, sampled at the same times; all must be finite. Seel et al. (2014) by
/// Gauss-Newton, with a prior of 0.5 m that keeps small what does not show; `docs/methods/mounting.md`.
///
/// # Errors
/// [`Refused::TooShort`] below 100 samples, [`Refused::Excitation`] where the movement is too little.
pub fn joint_position(samples: &[[Motion; 2]]) -> Result<JointPosition, Refused> {
    if samples.len() < MIN_SAMPLES {
        return Err(Refused::TooShort { found: samples.len(), needed: MIN_SAMPLES });
    }
    let mut o = Vector6::zeros();
    let mut information = Matrix6::zeros();
    let prior = Matrix6::identity() / (PRIOR_M * PRIOR_M);
    for _ in 0..30 {
        let (_, gradient, curvature) = linearise(samples, &o);
        information = curvature;
        let Some(step) = (curvature + prior).cholesky().map(|c| c.solve(&(gradient + prior * o))) else {
            break;
        };
        o -= step;
        if step.norm() < 1e-9 {
            break;
        }
    }
    let mut curvatures: Vec<f64> = information.symmetric_eigenvalues().iter().copied().collect();
    curvatures.sort_by(f64::total_cmp);
    // A hinge hides the place along its axis in both sensors at once: one direction.
    let excitation = curvatures[1] / samples.len() as f64;
    if excitation.is_nan() || excitation < MIN_CURVATURE {
        return Err(Refused::Excitation { found: excitation, needed: MIN_CURVATURE });
    }
    let (sum, _, _) = linearise(samples, &o);
    Ok(JointPosition {
        first_m: o.fixed_rows::<3>(0).into(),
        second_m: o.fixed_rows::<3>(3).into(),
        residual_m_s2: (sum / samples.len() as f64).sqrt() * ACCEL_SIGMA,
        excitation,
    })
}

fn linearise(samples: &[[Motion; 2]], o: &Vector6<f64>) -> (f64, Vector6<f64>, Matrix6<f64>) {
    let mut cost = 0.0;
    let mut gradient = Vector6::zeros();
    let mut information = Matrix6::zeros();
    for pair in samples {
        let mut norms = [0.0; 2];
        let mut row = Vector6::zeros();
        for (i, (w, dw, a)) in pair.iter().enumerate() {
            let g = lever(w, dw);
            let at_joint = a - g * o.fixed_rows::<3>(3 * i);
            norms[i] = at_joint.norm().max(1e-9);
            let sign = if i == 0 { -1.0 } else { 1.0 };
            row.fixed_rows_mut::<3>(3 * i).copy_from(&(g.transpose() * at_joint * (sign / norms[i])));
        }
        let residual = (norms[0] - norms[1]) / ACCEL_SIGMA;
        row /= ACCEL_SIGMA;
        let weight = (3.0 / residual.abs()).min(1.0);
        cost += residual * residual;
        gradient += row * (weight * residual);
        information += row * row.transpose() * weight;
    }
    (cost, gradient, information)
}
