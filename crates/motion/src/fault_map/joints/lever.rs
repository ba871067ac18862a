//! The two lever arms of a joint, found while their sensors turn.
//!
//! What comes in: poses of both sensors, in frames in which both are where they say. What goes out: what their difference should be, and how well that is
//! known. A Kalman filter of six states, constant but for a strap that creeps.

use nalgebra::{Matrix3, Matrix3x6, Matrix6, Vector3, Vector6};
use posed_state::Plain;

use super::{Pose, STUBBORN_FRAMES};

/// Nobody knows anything of a lever arm but that it is about so long, m.
pub(super) const UNKNOWN_M: f64 = 0.3;
/// Skin moves slowly: so many frames say as much as one of them.
pub(super) const FRAMES_PER_WORD: f64 = 20.0;
/// A strap creeps so far in a frame, m.
const CREEP_M: f64 = 2e-5;
/// What is left over is not learnt from beyond so many spreads.
const GATE: f64 = 4.0;

#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub(super) struct Lever {
    /// From either sensor to the joint, in the sensor's own axes, m.
    arms: Vector6<f64>,
    covariance: Matrix6<f64>,
    /// Frames in which it was not believed, less those in which it was.
    doubts: u32,
}

impl Lever {
    pub(super) fn unknown() -> Self {
        Self { arms: Vector6::zeros(), covariance: Matrix6::identity() * (UNKNOWN_M * UNKNOWN_M), doubts: 0 }
    }

    /// Arms that are known.
    pub(super) fn known(arms: Vector6<f64>) -> Self {
        Self { arms, covariance: Matrix6::zeros(), doubts: 0 }
    }

    /// What is to be added to the difference of positions, a less b, m; nothing is left over then.
    pub(super) fn offset(&self, a: &Pose, b: &Pose) -> Vector3<f64> {
        a.rotation * self.arms.fixed_rows::<3>(0) - b.rotation * self.arms.fixed_rows::<3>(3)
    }

    /// How well that is known: its covariance, m².
    pub(super) fn spread(&self, a: &Pose, b: &Pose) -> Matrix3<f64> {
        let h = turned(a, b);
        h * self.covariance * h.transpose()
    }

    /// Takes a frame in which both are where they say.
    pub(super) fn learn(&mut self, a: &Pose, b: &Pose, variance_m2: f64) {
        let h = turned(a, b);
        let left_over = left_over(a, b, &self.arms);
        let gain = self.covariance * h.transpose();
        let spread = h * gain;
        let Some(usual) = (spread + Matrix3::identity() * variance_m2).try_inverse() else { return };
        if left_over.dot(&(usual * left_over)) > 3.0 * GATE * GATE {
            return self.doubt();
        }
        self.doubts = self.doubts.saturating_sub(1);
        let word = spread + Matrix3::identity() * (FRAMES_PER_WORD * variance_m2);
        let Some(inverse) = word.try_inverse() else { return };
        let gain = gain * inverse;
        self.arms -= gain * left_over;
        let rest = self.covariance - gain * h * self.covariance;
        self.covariance = (rest + rest.transpose()) * 0.5 + Matrix6::identity() * (CREEP_M * CREEP_M);
    }

    /// Takes a frame that it does not explain, and in which nothing else is wrong: after many of them it begins anew.
    pub(super) fn doubt(&mut self) {
        self.doubts += 1;
        if self.doubts >= STUBBORN_FRAMES {
            *self = Self::unknown();
        }
    }
}

/// What these lever arms leave over, m.
pub(super) fn left_over(a: &Pose, b: &Pose, arms: &Vector6<f64>) -> Vector3<f64> {
    a.position - b.position + turned(a, b) * arms
}

/// `[R_a, -R_b]`.
pub(super) fn turned(a: &Pose, b: &Pose) -> Matrix3x6<f64> {
    let mut h = Matrix3x6::zeros();
    h.fixed_columns_mut::<3>(0).copy_from(&a.rotation);
    h.fixed_columns_mut::<3>(3).copy_from(&-b.rotation);
    h
}
