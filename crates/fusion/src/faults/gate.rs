//! The predicted gate: how far a measurement may lie from what was predicted for it.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::MeasuredPose;
use crate::noise::TrackerNoise;
use posed_geometry::so3;

/// How much a predicted pose must differ from a repeated one to prove motion: sigmas, m, rad.
const MOVED_SIGMAS: f64 = 2.0;
const MOVED_M: f64 = 2e-4;
const MOVED_RAD: f64 = 1e-3;
/// Least distance of the two sides of a transmitter, where a tracker measures at all, m.
const APART_M: f64 = 0.2;
/// A position this many gates away has not come there by moving, nor by an error of the prediction.
const FAR_GATES: f64 = 3.0;
/// 99.9 % of chi-square with 6 and with 3 degrees of freedom.
const GATE_6: f64 = 22.5;
const GATE_3: f64 = 16.3;

/// What the filter expects of the next measurement, in the transmitter frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// Expected position, m.
    pub position_m: Vector3<f64>,
    /// Expected orientation, sensor to transmitter.
    pub orientation: UnitQuaternion<f64>,
    /// Covariance of the expected position, m^2.
    pub position_m2: Matrix3<f64>,
    /// Covariance of the expected orientation, rad^2, sensor axes.
    pub rotation_rad2: Matrix3<f64>,
    /// Factor on the noise model's position variance, as the filter has learnt it.
    pub position_noise_scale: f64,
    /// The same for the rotation.
    pub rotation_noise_scale: f64,
    /// What the field's map leaves of a measured position, per axis, m^2.
    pub position_doubt_m2: f64,
    /// An innovation longer than this is not believed on one record's word, m: after a gap the gate is wide,
    /// and a flipped bit may fall inside.
    pub reach_m: f64,
    /// The same for orientations, rad.
    pub reach_rad: f64,
}

/// Where a measurement lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gate {
    /// As expected.
    Inside,
    /// Not improbable, but only because little is expected: needs a second record to say the same.
    Loose,
    /// Improbable.
    Outside,
}

impl Prediction {
    /// Measured minus predicted position, m.
    pub fn position_innovation(&self, position_m: &Vector3<f64>) -> Vector3<f64> {
        position_m - self.position_m
    }

    /// Rotation from the predicted to the measured orientation, rad, sensor axes. Both signs of a quaternion
    /// are the same orientation.
    pub fn rotation_innovation(&self, orientation: &UnitQuaternion<f64>) -> Vector3<f64> {
        so3::log(&(self.orientation.inverse() * orientation))
    }

    /// Covariance of a position innovation, m^2.
    pub fn position_innovation_m2(&self, noise: &TrackerNoise, position_m: &Vector3<f64>) -> Matrix3<f64> {
        self.position_m2
            + noise.position_m2(position_m) * self.position_noise_scale
            + Matrix3::identity() * self.position_doubt_m2
    }

    /// Covariance of a rotation innovation, rad^2.
    pub fn rotation_innovation_rad2(&self, noise: &TrackerNoise, p_m: Option<&Vector3<f64>>) -> Matrix3<f64> {
        self.rotation_rad2 + noise.rotation_rad2(p_m) * self.rotation_noise_scale
    }

    /// Whether the sensor has moved away from a pose, for certain: if the device repeats that one, it should not.
    pub(super) fn has_left(&self, pose: &MeasuredPose, noise: &TrackerNoise) -> bool {
        let position = pose.position_m.is_some_and(|position| {
            let sigma = (noise.position_m2(&position).trace() / 3.0 * self.position_noise_scale).sqrt();
            self.position_innovation(&position).norm() > (MOVED_SIGMAS * sigma).max(MOVED_M)
        });
        let rotation = pose.orientation.is_some_and(|orientation| {
            let position_m = pose.position_m.as_ref();
            let sigma = (noise.rotation_rad2(position_m).trace() / 3.0 * self.rotation_noise_scale).sqrt();
            self.rotation_innovation(&orientation).norm() > (MOVED_SIGMAS * sigma).max(MOVED_RAD)
        });
        position || rotation
    }

    /// Whether one position is nearer to the prediction than another that is not next to it; false without positions.
    pub(super) fn prefers(&self, one: &MeasuredPose, other: &MeasuredPose, noise: &TrackerNoise) -> bool {
        let covariance = self.position_innovation_m2(noise, &self.position_m);
        let distance = |p: &Vector3<f64>| squared_distance(&covariance, &self.position_innovation(p));
        apart(one, other).is_some_and(|[one_m, other_m]| distance(&one_m) < distance(&other_m))
    }

    /// Whether a position that is not next to another one is not improbable either; false without positions.
    pub(super) fn holds_too(&self, one: &MeasuredPose, other: &MeasuredPose, noise: &TrackerNoise) -> bool {
        apart(one, other).is_some() && self.gate(one, noise) != Gate::Outside
    }

    /// Whether a position is so far from the prediction that the sensor must have been turned over: just outside the gate it may
    /// as well have been predicted wrongly, and near a plane of symmetry its mirror image would be inside.
    pub(super) fn is_far(&self, position_m: &Vector3<f64>, noise: &TrackerNoise) -> bool {
        let covariance = self.position_innovation_m2(noise, &self.position_m);
        let distance = squared_distance(&covariance, &self.position_innovation(position_m));
        distance > FAR_GATES * FAR_GATES * GATE_3
    }

    /// Tests a measurement against the prediction: chi-square of 6 degrees of freedom, or 3 where the format
    /// has only one half, and the reach.
    pub fn gate(&self, pose: &MeasuredPose, noise: &TrackerNoise) -> Gate {
        let mut distance = 0.0;
        let mut degrees = 0;
        let mut loose = false;
        if let Some(position) = &pose.position_m {
            let innovation = self.position_innovation(position);
            // The noise of the place that was predicted: a measurement must not widen its own gate.
            let covariance = self.position_innovation_m2(noise, &self.position_m);
            distance += squared_distance(&covariance, &innovation);
            degrees += 3;
            loose |= innovation.norm() > self.reach_m;
        }
        if let Some(orientation) = &pose.orientation {
            let innovation = self.rotation_innovation(orientation);
            let position_m = pose.position_m.map(|_| &self.position_m);
            distance += squared_distance(&self.rotation_innovation_rad2(noise, position_m), &innovation);
            degrees += 3;
            loose |= innovation.norm() > self.reach_rad;
        }
        let limit = if degrees == 6 { GATE_6 } else { GATE_3 };
        // Written so that a distance that is not a number is outside.
        match (distance <= limit, loose) {
            (true, false) => Gate::Inside,
            (true, true) => Gate::Loose,
            (false, _) => Gate::Outside,
        }
    }
}

/// Two positions that are not next to one another, m.
fn apart(one: &MeasuredPose, other: &MeasuredPose) -> Option<[Vector3<f64>; 2]> {
    let (one_m, other_m) = (one.position_m?, other.position_m?);
    ((one_m - other_m).norm() > APART_M).then_some([one_m, other_m])
}

/// `v' C^-1 v`; infinite where the covariance is not positive definite.
pub(crate) fn squared_distance(covariance: &Matrix3<f64>, v: &Vector3<f64>) -> f64 {
    covariance.cholesky().map_or(f64::INFINITY, |factor| v.dot(&factor.solve(v)))
}
