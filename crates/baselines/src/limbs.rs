//! Limbs as chains of single axes, without gyro biases.
//!
//! M. Weber, G. Bleser, G. Hendeby, A. Reiss and D. Stricker, "Unsupervised model generation for motion monitoring" (2011; no
//! DOI found).
//!
//! What comes in: samples of ten IMUs with magnetometers at one time, with the time since the ones before. What goes out:
//! the orientations of their segments. Torso and pelvis follow their own orientation filters; each limb is one extended
//! Kalman filter over two IMUs ([`EulerArm`], [`EulerLeg`]), with the state
//!
//! ```text
//! x = [theta, dtheta/dt, d2theta/dt2],  theta: three angles of shoulder or hip, and two of the elbow or one of the knee
//! ```
//! and 7 measurements an IMU: angular velocities, specific forces and an azimuth. It is the filter of [`posed_fusion::limb`] with
//! other joints; two of the three axes fall together where an arm or a leg points sideways, and there it goes astray.
//!
//! Repaired or chosen here, where the paper errs or is silent:
//! - Eq. (1b), the place of the lower IMU, must read `R_TG' R_UT' (d_e + R_LU' d_l)`; the printed `R_TG' R_LU'` is off by
//!   as much as an arm's length.
//! - The trunk's rotation and the acceleration of shoulder and hip are missing; together they count like a tilt of some
//!   degrees in a moderate sway.
//! - An azimuth in the tilted frame of the sensor has no meaning; it is taken in the room, of north as the sensor's own
//!   orientation filter finds it, and never tilts.
//! - The order of the angles is not printed: about z, x, y, which is flexion first. Noise values, gates and joint limits
//!   are those of the live filter.

use nalgebra::{SVector, UnitQuaternion, Vector3};
use posed_fusion::ahrs::{Ahrs, ImuSample};
use posed_fusion::body::{BodyParams, BodySamples, BodySegment, Limb, SEGMENTS, SensorMount, Skeleton};
use posed_fusion::body::{elbow, joint_angles, knee};
use posed_fusion::limb::{Axes, Base, FieldReference, LimbGeometry, LimbNoise, LimbSamples};

/// Shoulder of three axes, elbow of two: 15 states, no gyro biases.
pub type EulerArm = posed_fusion::limb::Limb<Axes<3>, 2, 15>;
/// Hip of three axes, knee of one: 12 states, no gyro biases.
pub type EulerLeg = posed_fusion::limb::Limb<Axes<3>, 1, 12>;

/// Uncertainty of each angle at the start, rad.
const START_SIGMA_RAD: f64 = 0.2;
/// A trunk that turns more slowly rests, rad/s.
const REST_RAD_S: f64 = 0.05;
/// North, as [`Sensor::north`] gives it.
const NORTH: FieldReference =
    FieldReference { azimuth_rad: std::f64::consts::FRAC_PI_2, norm: 1.0, dip_rad: 0.0 };

/// A body of Euler limbs: orientation filters on torso and pelvis, an [`EulerArm`] or [`EulerLeg`] on each limb. Causal, without
/// delay.
///
/// It goes astray where an arm or a leg points sideways; beside the live filter: `docs/body.md`.
#[derive(Clone, Debug)]
pub struct EulerBody {
    sensors: [Option<Sensor>; SEGMENTS],
    limbs: [EulerLimb; 4],
    /// Last angular velocity of torso and pelvis, segment axes, for their angular acceleration.
    last_angular_velocities_rad_s: [Option<Vector3<f64>>; 2],
    orientations: [Option<UnitQuaternion<f64>>; SEGMENTS],
}

/// One sensor: how it sits, and its own orientation.
#[derive(Clone, Debug)]
struct Sensor {
    mount: SensorMount,
    ahrs: Ahrs,
    started: bool,
    magnetometer: bool,
}

#[derive(Clone, Debug)]
struct EulerLimb {
    limb: Limb,
    geometry: LimbGeometry,
    noise: LimbNoise,
    /// Biases of both gyros that a rest has proven, rad/s.
    offsets_rad_s: [Vector3<f64>; 2],
    filter: Filter,
}

#[derive(Clone, Debug)]
enum Filter {
    Waiting,
    Arm(Box<EulerArm>),
    Leg(Box<EulerLeg>),
}

impl EulerBody {
    /// A body that has seen nothing, of these lengths; `mounts` says how each sensor sits, by [`BodySegment::index`], `None`
    /// where none is worn.
    pub fn new(skeleton: &Skeleton, mounts: &[Option<SensorMount>; SEGMENTS], params: &BodyParams) -> Self {
        let sensor = |mount: SensorMount| {
            let ahrs = Ahrs::new(params.ahrs.clone());
            Sensor { mount, ahrs, started: false, magnetometer: false }
        };
        let limb = |limb| EulerLimb {
            limb,
            geometry: LimbGeometry::of(limb, skeleton, mounts),
            noise: params.limb,
            offsets_rad_s: [Vector3::zeros(); 2],
            filter: Filter::Waiting,
        };
        Self {
            sensors: mounts.map(|mount| mount.map(sensor)),
            limbs: Limb::ALL.map(limb),
            last_angular_velocities_rad_s: [None; 2],
            orientations: [None; SEGMENTS],
        }
    }

    /// Takes the samples of one time (sensor axes), `dt_s` seconds, above 0, after the ones before; segments to room (z up), by
    /// [`BodySegment::index`]. A limb begins, and is shown, once both of its sensors and its trunk's have had a sample; `None`
    /// before. A sample that is missing later is a step of prediction for a limb, and rest for torso and pelvis.
    pub fn push(&mut self, samples: &BodySamples, dt_s: f64) -> &[Option<UnitQuaternion<f64>>; SEGMENTS] {
        for (sensor, sample) in self.sensors.iter_mut().zip(samples) {
            if let (Some(sensor), Some(sample)) = (sensor, sample) {
                sensor.push(sample, dt_s);
            }
        }
        let bases = [BodySegment::Torso, BodySegment::Pelvis].map(|trunk| self.base(trunk, samples, dt_s));
        for trunk in [BodySegment::Torso, BodySegment::Pelvis] {
            self.orientations[trunk.index()] = bases[trunk.index()].map(|base| base.q_room_base);
        }
        for limb in &mut self.limbs {
            let [trunk, upper, lower] = limb.limb.segments();
            let Some(base) = &bases[trunk.index()] else { continue };
            let (Some(above), Some(below)) = (&self.sensors[upper.index()], &self.sensors[lower.index()])
            else {
                continue;
            };
            let pair = [samples[upper.index()], samples[lower.index()]];
            limb.push(base, [above, below], pair, dt_s);
            let relative = limb.orientations();
            for (k, segment) in [upper, lower].into_iter().enumerate() {
                self.orientations[segment.index()] = relative.map(|relative| base.q_room_base * relative[k]);
            }
        }
        &self.orientations
    }

    /// Motion of torso or pelvis, which its limbs hang on; at rest where a sample is missing.
    fn base(&mut self, trunk: BodySegment, samples: &BodySamples, dt_s: f64) -> Option<Base> {
        let sensor = self.sensors[trunk.index()].as_ref()?;
        let q_room_base = sensor.orientation()?;
        let known = Base {
            q_room_base,
            angular_velocity_sigma_rad_s: 0.01,
            specific_force_sigma_m_s2: 0.2,
            ..Base::room()
        };
        let last = &mut self.last_angular_velocities_rad_s[trunk.index()];
        let Some(sample) = samples[trunk.index()] else {
            *last = None;
            return Some(Base {
                specific_force_m_s2: q_room_base.inverse() * known.specific_force_m_s2,
                ..known
            });
        };
        let mount = &sensor.mount.q_segment_sensor;
        let angular_velocity_rad_s = mount * (sample.gyro_rad_s - sensor.ahrs.bias_rad_s());
        let accel_rad_s2 = last.map_or_else(Vector3::zeros, |last| (angular_velocity_rad_s - last) / dt_s);
        *last = Some(angular_velocity_rad_s);
        Some(Base {
            angular_velocity_rad_s,
            accel_rad_s2,
            specific_force_m_s2: mount * sample.accel_m_s2,
            ..known
        })
    }
}

impl Sensor {
    fn push(&mut self, sample: &ImuSample, dt_s: f64) {
        self.started = true;
        self.magnetometer |= sample.mag.is_some();
        self.ahrs.push(sample, dt_s);
    }

    /// BodySegment to room by this sensor alone.
    fn orientation(&self) -> Option<UnitQuaternion<f64>> {
        self.started.then(|| self.ahrs.orientation() * self.mount.q_segment_sensor.inverse())
    }

    /// What a magnetometer in the sensor would say, sensor axes.
    fn north(&self) -> Option<Vector3<f64>> {
        self.magnetometer.then(|| self.ahrs.orientation().inverse() * Vector3::y())
    }
}

impl EulerLimb {
    fn push(&mut self, base: &Base, sensors: [&Sensor; 2], samples: [Option<ImuSample>; 2], dt_s: f64) {
        let offsets_rad_s = sensors.map(|sensor| sensor.ahrs.offset_rad_s());
        if offsets_rad_s != self.offsets_rad_s {
            self.offsets_rad_s = offsets_rad_s;
            self.filter = Filter::Waiting;
        }
        if matches!(self.filter, Filter::Waiting) {
            self.begin(base, sensors);
            return;
        }
        let with_north = |which: usize| {
            samples[which].map(|sample| ImuSample {
                gyro_rad_s: sample.gyro_rad_s - offsets_rad_s[which],
                mag: sensors[which].north(),
                ..sample
            })
        };
        let samples = LimbSamples { upper: with_north(0), lower: with_north(1) };
        let rests = sensors.iter().all(|sensor| sensor.ahrs.at_rest())
            && base.angular_velocity_rad_s.norm() < REST_RAD_S;
        match &mut self.filter {
            Filter::Waiting => {}
            Filter::Arm(arm) => {
                arm.push(base, Some(&NORTH), &samples, dt_s);
                if rests {
                    arm.observe_rest();
                }
            }
            Filter::Leg(leg) => {
                leg.push(base, Some(&NORTH), &samples, dt_s);
                if rests {
                    leg.observe_rest();
                }
            }
        }
    }

    /// Begins in the posture that both sensors' own orientations show.
    fn begin(&mut self, base: &Base, sensors: [&Sensor; 2]) {
        let [Some(upper), Some(lower)] = sensors.map(Sensor::orientation) else { return };
        let [_, _, segment] = self.limb.segments();
        let side = segment.side();
        // A thigh's sequence, flexion first, serves an arm that hangs as well.
        let thigh = if side < 0.0 { BodySegment::ThighL } else { BodySegment::ThighR };
        let [z, x, y, ..] = joint_angles(thigh, &(base.q_room_base.inverse() * upper));
        let mut axes = Axes::new([Vector3::z(), Vector3::x() * side, Vector3::y() * side]);
        axes.angle_rad = SVector::<f64, 3>::new(z, x, y);
        let rotation = upper.inverse() * lower;
        let (geometry, noise) = (self.geometry, self.noise);
        self.filter = match self.limb {
            Limb::ArmR | Limb::ArmL => {
                let (elbow, limits) = elbow(segment, &rotation);
                let arm = EulerArm::new(geometry, noise, axes, elbow, limits, START_SIGMA_RAD);
                Filter::Arm(Box::new(arm))
            }
            Limb::LegR | Limb::LegL => {
                let (knee, limits) = knee(segment, &rotation);
                let leg = EulerLeg::new(geometry, noise, axes, knee, limits, START_SIGMA_RAD);
                Filter::Leg(Box::new(leg))
            }
        };
    }

    /// Upper and lower segment to trunk.
    fn orientations(&self) -> Option<[UnitQuaternion<f64>; 2]> {
        match &self.filter {
            Filter::Waiting => None,
            Filter::Arm(arm) => Some(arm.orientations()),
            Filter::Leg(leg) => Some(leg.orientations()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posed_fusion::body::{BodyFilter, angles};
    use posed_simulator::body::{Activity, Build, Sample, Script, SensorErrors, Wearer, WearerSpec};

    const HEIGHT_M: f64 = 1.8;

    fn wearer(activity: Activity) -> Wearer {
        Wearer::new(WearerSpec {
            script: Script { activity, calibration: false, facing: 0.6, mistake: None },
            build: Build::of_height(HEIGHT_M),
            errors: SensorErrors::calibrated(),
            magnetometer: true,
            disturbances: Vec::new(),
            rate_hz: 100.0,
            clumsiness_rad: 0.0,
            seed: 7,
        })
    }

    /// What all sensors measure, for the filters.
    fn worn(samples: [Sample; SEGMENTS]) -> BodySamples {
        samples.map(|s| Some(ImuSample { gyro_rad_s: s.gyro_rad_s, accel_m_s2: s.accel_m_s2, mag: s.mag_ut }))
    }

    #[test]
    fn a_walk_is_followed_nearly_as_well_as_by_the_live_filter() {
        let mut wearer = wearer(Activity::Walking);
        let mounts = BodySegment::ALL.map(|segment| {
            let (q_segment_sensor, offset_m) = wearer.mounting(segment.index());
            Some(SensorMount::exact(q_segment_sensor, offset_m))
        });
        let (skeleton, params) = (Skeleton::from_height(HEIGHT_M), BodyParams::default());
        let mut euler = EulerBody::new(&skeleton, &mounts, &params);
        let mut live = BodyFilter::new(&skeleton, &mounts, &params);
        let knee = posed_fusion::body::ANGLE_NAMES.iter().position(|name| *name == "knee_r_flexion").unwrap();
        let (mut squares, mut count) = ([0.0; 2], 0.0);
        for k in 0..1200 {
            let (samples, at) = wearer.step();
            let samples = worn(samples);
            let found = [*euler.push(&samples, 0.01), live.push(&samples, 0.01).orientations];
            if k < 500 {
                continue;
            }
            let truth = at.body.map(|placement| Some(UnitQuaternion::from_matrix(&placement.axes)));
            let truth = angles(&truth)[knee].unwrap();
            for (square, found) in squares.iter_mut().zip(found) {
                *square += (angles(&found)[knee].unwrap() - truth).powi(2);
            }
            count += 1.0;
        }
        let [euler, live] = squares.map(|square| f64::sqrt(square / count).to_degrees());
        assert!(euler < 3.0 && live < 3.0, "{euler} {live}");
    }

    #[test]
    fn a_limb_is_not_shown_before_its_sensors_and_its_trunk_are() {
        let mounts = BodySegment::ALL.map(|_| {
            let (q_segment_sensor, offset_m) = (UnitQuaternion::identity(), Vector3::zeros());
            Some(SensorMount::exact(q_segment_sensor, offset_m))
        });
        let mut body = EulerBody::new(&Skeleton::from_height(HEIGHT_M), &mounts, &BodyParams::default());
        let (samples, _) = wearer(Activity::Curls).step();
        let mut samples = worn(samples);
        samples[BodySegment::Pelvis.index()] = None;
        samples[BodySegment::ForearmL.index()] = None;
        for _ in 0..3 {
            body.push(&samples, 0.01);
        }
        let shown = body.push(&samples, 0.01).map(|q| q.is_some());
        let expected = BodySegment::ALL.map(|segment| {
            matches!(segment, BodySegment::Torso | BodySegment::UpperArmR | BodySegment::ForearmR)
        });
        assert_eq!(shown, expected);
    }
}
