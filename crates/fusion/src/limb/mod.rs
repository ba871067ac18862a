//! One limb, arm or leg, as one filter over two IMUs.
//!
//! In: the motion of the segment that the limb hangs on (its [`Base`]), the samples of the upper and the lower
//! IMU without the biases of their gyros, and the time since the last ones. Out: joint angles, angular velocities, their covariance, and for each sensor whether
//! it was believed. It never clamps a state, never lets the magnetometer tilt a segment, and goes
//! on by prediction where a sample is missing.
//!
//! Source: Weber et al. (2011), with the full recursion of `chain.rs`. [`Arm`] and [`Leg`] hold shoulder and hip on SO(3); a [`Limb`] of [`Axes`] alone is that
//! paper's. All have 15 error states, a leg 12.
//!
//! It knows no bias of a gyro. Each sensor's own filter estimates that from gravity and from rest, which the errors of scale of a limb that swings do not
//! enter in step; a limb that estimated it, too, took those for a bias, and its heading left the trunk's.
//!
//! Order of the error states: upper joint 9 (rotation or angles, angular velocities, accelerations); lower joint 3 D.

mod chain;
mod covariance;
mod joint;
mod parameters;
mod slip;
#[cfg(test)]
mod tests;
mod update;
mod wide;

use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};
use posed_geometry::GRAVITY_M_S2;
use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::ahrs::ImuSample;
use chain::Motion;
use covariance::Covariance;
use joint::Joint;
pub use joint::{Axes, Ball, JointNoise};
use parameters::{Learning, PARAMETERS};
pub use update::{FieldReference, SensorReport};

/// Arm: ball joint and two axes (flexion, pronation).
pub type Arm = Limb<Ball, 2, 15>;
/// Leg, or any limb with a hinge below a ball joint.
pub type Leg = Limb<Ball, 1, 12>;

/// What a joint that hangs on something unknown is accelerated by, m/s².
const UNMEASURED_M_S2: f64 = 1.0;

/// The segment that a limb hangs on, in its own axes, with its origin where its IMU sits: at the time of the limb's samples.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Base {
    /// Segment to room.
    pub q_room_base: UnitQuaternion<f64>,
    /// Angular velocity without the gyro's bias, rad/s.
    pub angular_velocity_rad_s: Vector3<f64>,
    /// Angular acceleration, rad/s².
    pub accel_rad_s2: Vector3<f64>,
    /// Specific force at the origin, m/s²: gravity is in it.
    pub specific_force_m_s2: Vector3<f64>,
    /// Standard deviation of the angular velocity per axis, rad/s: joins the noise of the limb's gyros.
    pub angular_velocity_sigma_rad_s: f64,
    /// Standard deviation of the specific force at the joint per axis, m/s²: joins the noise of the limb's accelerometers.
    pub specific_force_sigma_m_s2: f64,
}

impl Base {
    /// No IMU above the limb: the base is the room, and the joint's own acceleration counts as noise of 1 m/s².
    pub fn room() -> Self {
        Self {
            q_room_base: UnitQuaternion::identity(),
            angular_velocity_rad_s: Vector3::zeros(),
            accel_rad_s2: Vector3::zeros(),
            specific_force_m_s2: Vector3::z() * GRAVITY_M_S2,
            angular_velocity_sigma_rad_s: 0.0,
            specific_force_sigma_m_s2: UNMEASURED_M_S2,
        }
    }

    /// Whether an IMU shows how it moves: else nothing is known of what the joint itself does.
    fn is_measured(&self) -> bool {
        self.specific_force_sigma_m_s2 < UNMEASURED_M_S2
    }
}

/// Lengths of a limb and where its sensors sit.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct LimbGeometry {
    /// Base's origin to the upper joint, base axes, m.
    pub base_to_joint_m: Vector3<f64>,
    /// Upper joint to the upper IMU, upper segment's axes, m.
    pub upper_imu_m: Vector3<f64>,
    /// Upper joint to the lower joint, upper segment's axes, m.
    pub upper_to_lower_m: Vector3<f64>,
    /// Lower joint to the lower IMU, lower segment's axes, m.
    pub lower_imu_m: Vector3<f64>,
    /// Upper sensor to upper segment: sensor-to-segment alignment.
    pub upper_mount: UnitQuaternion<f64>,
    /// Lower sensor to lower segment: sensor-to-segment alignment.
    pub lower_mount: UnitQuaternion<f64>,
    /// How well both are known, standard deviations about the segment's axes, rad: what a gyro shows across the joints by that is no movement of theirs. Where
    /// they are not exact, they and the lengths above are learnt from how the limb moves.
    pub mount_sigma_rad: [Vector3<f64>; 2],
}

/// What the filter assumes; standard deviations per axis. Effect of each: `docs/methods/limb.md`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct LimbNoise {
    /// How freely the joints move.
    pub joint: JointNoise,
    /// Noise of a gyro sample, rad/s.
    pub gyro_rad_s: f64,
    /// Noise of an accelerometer sample, m/s²; skin motion included.
    pub accel_m_s2: f64,
    /// Noise of an azimuth, rad.
    pub heading_rad: f64,
    /// How sharp an anatomical limit is, rad.
    pub limit_rad: f64,
    /// Range of the accelerometer, m/s²; an axis beyond 98 % of it is dropped.
    pub accel_range_m_s2: f64,
}

impl Default for LimbNoise {
    fn default() -> Self {
        Self {
            joint: JointNoise { jerk_rad_s3: 200.0, accel_tau_s: 0.3 },
            gyro_rad_s: 0.01,
            accel_m_s2: 0.3,
            heading_rad: 5_f64.to_radians(),
            limit_rad: 1_f64.to_radians(),
            accel_range_m_s2: 16.0 * GRAVITY_M_S2,
        }
    }
}

/// One limb's filter: `J` is the upper joint, D the axes of the lower one, N the number of error states (9 + 3 D). Model: Weber et al. (2011), eq. (1) and (2), corrected as `docs/methods/limb.md` lists;
/// accuracy: `docs/body.md`. Without delay.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct Limb<J, const D: usize, const N: usize> {
    geometry: LimbGeometry,
    noise: LimbNoise,
    /// Limits of the lower joint's angles, rad; the first row the least, the second the largest.
    limits: [SVector<f64, D>; 2],
    upper: J,
    lower: Axes<D>,
    p: Covariance<N>,
    /// How well the geometry is known; `None` where it is exact.
    learning: Option<Learning>,
    sensors: [update::Sensor; 2],
}

/// How uncertain a limb is: noise, and what its parameters leave open. Other systematic errors of the sensors and soft tissue are not in it
/// (`docs/methods/body.md`, Uncertainty).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LimbSpread {
    /// Covariance of the error of both joints' rotations, rad², 3 x 3: of the upper joint in the upper segment's axes, of the lower joint in the lower segment's,
    /// where it is zero across the joint's axes.
    pub rotations_rad2: [Matrix3<f64>; 2],
    /// Standard deviation of the upper and the lower segment about an axis, relative to the base, rad: of the upper joint root mean square over the three, of the
    /// lower joint about its first axis.
    pub sigma_rad: [f64; 2],
}

/// Which of the two IMUs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Which {
    Upper,
    Lower,
}

/// One epoch of samples, without the biases of the gyros; absent: none came, and the limb moves by prediction alone.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LimbSamples {
    /// Of the IMU above the lower joint.
    pub upper: Option<ImuSample>,
    /// Of the IMU below it.
    pub lower: Option<ImuSample>,
}

#[expect(private_bounds, reason = "the two kinds of joint are a closed set")]
impl<J: Joint<N>, const D: usize, const N: usize> Limb<J, D, N> {
    const LOWER: usize = 9;

    /// A limb in a given posture, of which each angle is known to `sigma_rad`; at rest, angular velocities known to 1 rad/s,
    /// accelerations to 10 rad/s². `limits_rad` holds the least and the largest angle of each axis of the lower joint; a limit
    /// that is passed is measured as the limit, the state is never clamped.
    pub fn new(
        geometry: LimbGeometry,
        noise: LimbNoise,
        upper: J,
        lower: Axes<D>,
        limits_rad: [SVector<f64, D>; 2],
        sigma_rad: f64,
    ) -> Self {
        const { assert!(N == 9 + 3 * D) };
        let mut sigmas = SVector::<f64, N>::zeros();
        for (at, k) in [(0, 3), (Self::LOWER, D)] {
            for i in 0..k {
                sigmas[at + i] = sigma_rad;
                sigmas[at + k + i] = 1.0;
                sigmas[at + 2 * k + i] = 10.0;
            }
        }
        // Of a forearm: two axes.
        let learning = Learning::of(&geometry, D == 2);
        Self {
            geometry,
            noise,
            limits: limits_rad,
            upper,
            lower,
            p: Covariance { depends: learning.is_some(), ..Covariance::from_sigmas(sigmas) },
            learning,
            sensors: [update::Sensor::default(); 2],
        }
    }

    /// Moves on by `dt_s`, s, above 0, and takes the samples of both IMUs; `field` is the field that the azimuth is compared
    /// with, `None` where none is trusted. A sample that is `None` or not finite is a step of prediction. The azimuth
    /// corrects the heading alone.
    ///
    /// Returns what became of the sample of the upper and of the lower IMU; a gated one does not stop the filter.
    pub fn push(
        &mut self,
        base: &Base,
        field: Option<&FieldReference>,
        samples: &LimbSamples,
        dt_s: f64,
    ) -> [SensorReport; 2] {
        self.predict(dt_s);
        let learns = self.learning.as_mut().is_some_and(|learning| learning.predict(&self.geometry, dt_s));
        let upper = self.observe(Which::Upper, base, field, samples.upper.as_ref(), learns, dt_s);
        let lower = self.observe(Which::Lower, base, field, samples.lower.as_ref(), learns, dt_s);
        if learns {
            self.decide();
        }
        self.keep_limits();
        [upper, lower]
    }

    /// Joint above: upper segment to base, or the angles of its axes, at the time of the last step.
    pub fn upper(&self) -> &J {
        &self.upper
    }

    /// Joint below: angles, rad, angular velocities and accelerations, at the time of the last step.
    pub fn lower(&self) -> &Axes<D> {
        &self.lower
    }

    /// Upper and lower segment to base, at the time of the last step; [`Self::spread`] has the covariances of their joints.
    pub fn orientations(&self) -> [UnitQuaternion<f64>; 2] {
        let mut motion = Motion::<N>::of_base(Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
        self.upper.rotate(&mut motion, 0);
        [motion.q_base_frame, motion.q_base_frame * self.lower.orientation()]
    }

    /// How uncertain it is, at the time of the last step.
    pub fn spread(&self) -> LimbSpread {
        let (upper_rad2, angles_rad2) = (self.covariance::<3>(0), self.covariance::<D>(Self::LOWER));
        let upper_rad = (upper_rad2.trace() / 3.0).max(0.0).sqrt();
        LimbSpread {
            rotations_rad2: [upper_rad2, self.lower.rotation_rad2(&angles_rad2)],
            sigma_rad: [upper_rad, libm::hypot(angles_rad2[(0, 0)].max(0.0).sqrt(), upper_rad)],
        }
    }

    /// Lengths, places and mountings, as far as the limb's movements have shown them, and how well the mountings are known.
    pub fn geometry(&self) -> &LimbGeometry {
        &self.geometry
    }

    /// A strap has slipped: how both sensors sit is found anew, until it shows which of them held. Where the geometry was given as exact nothing changes.
    pub fn loosen(&mut self) {
        if let Some(learning) = &mut self.learning {
            learning.loosen(&mut self.geometry);
            self.geometry.mount_sigma_rad = learning.mount_sigmas_rad();
        }
    }

    /// Whether a strap has slipped: what the limb's movements show is far likelier so.
    pub fn slipped(&self) -> bool {
        self.learning.as_ref().is_some_and(Learning::slipped)
    }

    /// The geometry to begin anew with where a strap has slipped: how the sensors sit as it was found, and that this is all but unknown.
    pub fn found_once(&self) -> LimbGeometry {
        let sigmas = self.learning.as_ref().map(Learning::anew);
        LimbGeometry { mount_sigma_rad: sigmas.unwrap_or(self.geometry.mount_sigma_rad), ..self.geometry }
    }

    /// Of a strap that has slipped it may show which one it was.
    fn decide(&mut self) {
        let Some(learning) = &mut self.learning else { return };
        let Some(moved) = learning.decide(&self.geometry) else { return };
        self.geometry.correct(&moved);
        self.geometry.mount_sigma_rad = learning.mount_sigmas_rad();
        self.correct(&(self.p.by_parameters.transpose() * moved));
    }

    /// Standard deviation of the upper segment's length, m; `None` where the geometry was given as exact.
    pub fn length_sigma_m(&self) -> Option<f64> {
        self.learning.as_ref().map(Learning::length_sigma_m)
    }

    /// Covariance of K states from `at` on, with what the parameters leave open.
    fn covariance<const K: usize>(&self, at: usize) -> SMatrix<f64, K, K> {
        let own = self.p.own.fixed_view::<K, K>(at, at);
        match &self.learning {
            Some(learning) => {
                own + learning.spread(&self.p.by_parameters.fixed_view::<PARAMETERS, K>(0, at).into_owned())
            }
            None => own.into_owned(),
        }
    }

    /// Takes all angular velocities of the joints as measured to be zero, to 0.2 deg/s: call it after a step at which all
    /// sensors of the limb rest. Holds the heading where no field is trusted.
    pub fn observe_rest(&mut self) {
        let sigma = 0.2_f64.to_radians();
        let angular_velocity_columns = [
            self.upper.angular_velocity_columns(0),
            Joint::<N>::angular_velocity_columns(&self.lower, Self::LOWER),
        ];
        for (k, range) in angular_velocity_columns.into_iter().enumerate() {
            for column in range {
                let angular_velocity_of = if k == 0 {
                    self.upper.angular_velocity_of(column, 0)
                } else {
                    Joint::<N>::angular_velocity_of(&self.lower, column, Self::LOWER)
                };
                self.observe_state(column, -angular_velocity_of, sigma * sigma);
            }
        }
    }

    fn predict(&mut self, dt_s: f64) {
        self.upper.predict(&mut self.p, &self.noise.joint, dt_s, 0);
        self.lower.predict(&mut self.p, &self.noise.joint, dt_s, Self::LOWER);
    }

    fn correct(&mut self, dx: &SVector<f64, N>) {
        self.upper.correct(dx, 0);
        self.lower.correct(dx, Self::LOWER);
    }

    /// A limit that is passed pulls the angle back as a measurement; the state is never clamped.
    fn keep_limits(&mut self) {
        for i in 0..D {
            let angle = self.lower.angle_rad[i];
            let limit = angle.clamp(self.limits[0][i], self.limits[1][i]);
            if limit != angle {
                self.observe_state(Self::LOWER + i, limit - angle, self.noise.limit_rad.powi(2));
            }
        }
    }
}

impl<const N: usize, const D: usize> Limb<Ball, D, N> {
    /// Upper segment to base, at the time of the last step.
    pub fn upper_orientation(&self) -> UnitQuaternion<f64> {
        self.upper.q
    }

    /// Turns the whole limb against its base, `rotation` in the base's axes: something else identifies its heading.
    pub fn turn(&mut self, rotation: &UnitQuaternion<f64>) {
        self.upper.q = rotation * self.upper.q;
    }
}
