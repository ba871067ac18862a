//! The sensors that the person wears: what each measures, with a unit's errors.

use std::sync::Arc;

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use posed_geometry::GRAVITY_M_S2;

use super::kinematics::{Build, Placement, SEGMENT_NAMES, SEGMENTS, quaternion};
use super::script::Script;
use super::strap::Strap;
use super::take::Take;
use crate::random::{Purpose, Random};

/// Steps of the differences that make angular velocities and specific forces, s.
const STEP_S: f64 = 1e-3;
/// Norm and dip of the simulated earth field: uT, rad.
const FIELD_UT: f64 = 48.0;
const DIP_RAD: f64 = 1.13;

/// Errors of one class of units: standard deviations per axis, from which each unit's biases, gains and noise are drawn.
///
/// Biases and gains are constant. Random walks, saturation, quantisation, delays and lost samples are not modelled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorErrors {
    /// White noise of a gyro sample, rad/s.
    pub gyro_noise_rad_s: f64,
    /// Bias of a gyro, rad/s.
    pub gyro_bias_rad_s: f64,
    /// White noise of an accelerometer sample, m/s².
    pub accel_noise_m_s2: f64,
    /// Bias of an accelerometer, m/s².
    pub accel_bias_m_s2: f64,
    /// Scale and cross-axis errors of gyro and accelerometer, each element of the gain matrix, fraction.
    pub scale: f64,
    /// White noise of a magnetometer sample, uT.
    pub mag_noise_ut: f64,
    /// Field attached to the sensor (hard iron), uT.
    pub mag_bias_ut: f64,
    /// How far the sensor plays on the skin per acceleration, m per m/s²; 0: rigid. The play turns the sensor as `skin_rad_m`
    /// says; its own displacement is not in the samples.
    pub skin_m: f64,
    /// Standard deviation of how far the sensor turns with the play, rad per m, about each segment axis for each direction.
    pub skin_rad_m: f64,
    /// How far the straps wander: each turns its sensor slowly, within a minute or two, by this about each segment axis, root mean square over time, rad.
    pub strap_rad: f64,
}

impl SensorErrors {
    /// No errors at all: samples of an ideal unit that is worn rigidly.
    pub const NONE: Self = Self {
        gyro_noise_rad_s: 0.0,
        gyro_bias_rad_s: 0.0,
        accel_noise_m_s2: 0.0,
        accel_bias_m_s2: 0.0,
        scale: 0.0,
        mag_noise_ut: 0.0,
        mag_bias_ut: 0.0,
        skin_m: 0.0,
        skin_rad_m: 0.0,
        strap_rad: 0.0,
    };

    /// A unit of MPU class at 100 Hz after its intrinsics were calibrated, rigidly worn: 0.01 deg/s and 300 ug per root
    /// hertz at Nyquist, and what a calibration leaves.
    pub fn calibrated() -> Self {
        Self {
            gyro_noise_rad_s: 0.07_f64.to_radians(),
            gyro_bias_rad_s: 0.1_f64.to_radians(),
            accel_noise_m_s2: 0.021,
            accel_bias_m_s2: 0.03,
            scale: 0.003,
            mag_noise_ut: 0.6,
            mag_bias_ut: 0.5,
            ..Self::NONE
        }
    }

    /// The same unit as it comes from the shelf.
    pub fn uncalibrated() -> Self {
        Self {
            gyro_bias_rad_s: 2.0_f64.to_radians(),
            accel_bias_m_s2: 0.4,
            scale: 0.02,
            mag_bias_ut: 3.0,
            ..Self::calibrated()
        }
    }
}

/// A span in which the magnetic field of the room differs from the earth's, for all sensors alike; spans that overlap add up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disturbance {
    /// Its begin, s of the script.
    pub start_s: f64,
    /// Its end, s of the script, excluded.
    pub end_s: f64,
    /// By how much the field's azimuth turns, rad, counter-clockwise from above.
    pub azimuth_rad: f64,
    /// Factor on the field's norm, which is 48 uT.
    pub norm: f64,
    /// Added to the field's dip, rad, which is 1.13 rad downwards.
    pub dip_rad: f64,
}

/// Who wears what: the input of [`Wearer::new`].
#[derive(Clone, Debug, PartialEq)]
pub struct WearerSpec {
    /// What the person does.
    pub script: Script,
    /// Lengths of the body, m.
    pub build: Build,
    /// Errors of all sensors.
    pub errors: SensorErrors,
    /// Whether the sensors have magnetometers; without, [`Sample::mag_ut`] is absent.
    pub magnetometer: bool,
    /// Disturbances of the room's magnetic field; empty: the earth's field alone (x east, y north, z up).
    pub disturbances: Vec<Disturbance>,
    /// Samples per second of every sensor, above 0.
    pub rate_hz: f64,
    /// How far the person is from the ideal pose and movement, standard deviation per joint angle, rad; constant over time; 0:
    /// not at all.
    pub clumsiness_rad: f64,
    /// Seed of mountings, errors and clumsiness: the same specification gives the same samples.
    pub seed: u64,
}

/// How long a strap takes to slip, s.
const SLIP_S: f64 = 0.3;

/// What one sensor measures at one time, in its own axes, with its errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Angular velocity, rad/s.
    pub gyro_rad_s: Vector3<f64>,
    /// Specific force, m/s² (+g on the axis that points up, at rest).
    pub accel_m_s2: Vector3<f64>,
    /// Magnetic field, uT; absent without a magnetometer.
    pub mag_ut: Option<Vector3<f64>>,
}

/// Ground truth of one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// Time of the script, s.
    pub t_s: f64,
    /// Where the segments are in the room, in the order of [`SEGMENT_NAMES`].
    pub body: [Placement; SEGMENTS],
}

/// One unit's drawn errors and where it sits.
#[derive(Clone, Debug)]
struct Unit {
    mount: UnitQuaternion<f64>,
    /// When its strap began to slip, s, and by which rotation vector, segment axes, rad.
    slip: Option<(f64, Vector3<f64>)>,
    offset_m: Vector3<f64>,
    gyro: (Matrix3<f64>, Vector3<f64>),
    accel: (Matrix3<f64>, Vector3<f64>),
    magnet: Vector3<f64>,
    skin: Matrix3<f64>,
    strap: Strap,
    noise: Random,
}

/// The person with a sensor on each of [`SEGMENT_NAMES`]; gives samples frame by frame. Seeded, without clock.
///
/// Angular velocity and specific force are differences of the exact poses over 1 ms; the magnetic field is the same in the whole
/// room.
#[derive(Clone, Debug)]
pub struct Wearer {
    spec: WearerSpec,
    /// Recorded people whom the person follows, and since when, s of the script.
    take: Option<(Arc<Take>, f64)>,
    units: Vec<Unit>,
    frame: u64,
}

impl Wearer {
    /// Draws mountings and errors; the first frame is at 0 s.
    ///
    /// A sensor sits in any orientation, 2 cm (standard deviation per axis) from the middle of a limb's segment, of the head or of a hand, from 7 cm ahead of the
    /// ankle, or from the origin of torso and pelvis.
    pub fn new(spec: WearerSpec) -> Self {
        let build = spec.build;
        let unit = |index: usize| {
            let mut random = Random::new(spec.seed, Purpose::Wearer(index));
            let mut vector = |sigma: f64| Vector3::from_fn(|_, _| sigma * random.normal());
            let e = &spec.errors;
            let length_m = match SEGMENT_NAMES[index].trim_end_matches("_r").trim_end_matches("_l") {
                "upper_arm" => build.upper_arm_m,
                "forearm" => build.forearm_m,
                "thigh" => build.thigh_m,
                "shank" => build.shank_m,
                // Half way to the top of the head, on the back of the hand, and on the instep.
                "head" => -build.head_m,
                "hand" => build.hand_m,
                _ => 0.0,
            };
            // Half way from the root to the arm's joint.
            let aside_m = match SEGMENT_NAMES[index] {
                "shoulder_r" => 0.25 * build.shoulder_width_m,
                "shoulder_l" => -0.25 * build.shoulder_width_m,
                _ => 0.0,
            };
            let forward_m = if SEGMENT_NAMES[index].starts_with("foot") { 0.07 } else { 0.0 };
            let matrix = |a: Vector3<f64>, b: Vector3<f64>, c: Vector3<f64>| {
                Matrix3::identity() + Matrix3::from_columns(&[a, b, c])
            };
            Unit {
                mount: UnitQuaternion::from_scaled_axis(vector(1.0)),
                slip: None,
                offset_m: Vector3::new(forward_m, -0.5 * length_m, aside_m) + vector(0.02),
                gyro: (matrix(vector(e.scale), vector(e.scale), vector(e.scale)), vector(e.gyro_bias_rad_s)),
                accel: (matrix(vector(e.scale), vector(e.scale), vector(e.scale)), vector(e.accel_bias_m_s2)),
                magnet: vector(e.mag_bias_ut),
                skin: Matrix3::from_columns(&[vector(1.0), vector(1.0), vector(1.0)]) * e.skin_rad_m,
                strap: Strap::draw(e.strap_rad, &mut Random::new(spec.seed, Purpose::Strap(index))),
                noise: random,
            }
        };
        let units = (0..SEGMENT_NAMES.len()).map(unit).collect();
        Self { spec, take: None, units, frame: 0 }
    }

    /// Samples per second of every sensor.
    pub fn rate_hz(&self) -> f64 {
        self.spec.rate_hz
    }

    /// True mounting of the sensor on a segment (index in [`SEGMENT_NAMES`]): sensor to segment, and its place in segment axes,
    /// m; as it was put on, without what its strap wanders.
    ///
    /// # Panics
    /// There is no such segment.
    pub fn mounting(&self, segment: usize) -> (UnitQuaternion<f64>, Vector3<f64>) {
        (self.units[segment].mount, self.units[segment].offset_m)
    }

    /// From now on, in 0.3 s, turns the sensor on a segment (index in [`SEGMENT_NAMES`]) by a rotation vector in segment axes, rad: a strap that slips, as its
    /// gyro shows. [`Self::mounting`] is the new one at once. Its place stays.
    ///
    /// # Panics
    /// There is no such segment.
    pub fn slip(&mut self, segment: usize, rotation_vector_rad: Vector3<f64>) {
        let unit = &mut self.units[segment];
        unit.mount = UnitQuaternion::from_scaled_axis(rotation_vector_rad) * unit.mount;
        unit.slip = Some((self.frame as f64 / self.spec.rate_hz, rotation_vector_rad));
    }

    /// From now on the person, who should stand in an N-pose, follows recorded people in place of the script, faces as the script does at first, and is as
    /// `clumsiness_rad` says no longer. The lengths of the body are those of the specification: [`Take::build`] are the recorded ones.
    pub fn follow(&mut self, take: Arc<Take>) {
        self.take = Some((take, self.frame as f64 / self.spec.rate_hz));
    }

    /// The next frame, `1 / rate_hz` after the last: the sample of each segment's sensor, in the order of [`SEGMENT_NAMES`], and
    /// the ground truth of the same time.
    pub fn step(&mut self) -> ([Sample; SEGMENTS], Truth) {
        let t_s = self.frame as f64 / self.spec.rate_hz;
        self.frame += 1;
        let spec = &self.spec;
        let place = |t_s: f64| {
            let (mut posture, clumsiness) = match &self.take {
                Some((take, from_s)) => {
                    (take.facing(spec.script.facing, t_s - from_s), 1.0 - take.share(t_s - from_s))
                }
                None => (spec.script.at(t_s, &spec.build), 1.0),
            };
            clumsy(&mut posture, clumsiness * spec.clumsiness_rad, spec.seed);
            posture.place(&spec.build)
        };
        let times = [-2.0, -1.0, 0.0, 1.0, 2.0].map(|k| place(t_s + k * STEP_S));
        let field = field(&spec.disturbances, t_s);
        let errors = spec.errors;
        let magnetometer = spec.magnetometer;
        let samples = std::array::from_fn(|index| {
            let unit = &mut self.units[index];
            let points = times.each_ref().map(|body| body[index].origin_m + body[index].axes * unit.offset_m);
            let bend = (points[1] + points[3]) * 16.0 - points[0] - points[4] - points[2] * 30.0;
            let accel = bend / (12.0 * STEP_S * STEP_S);
            // By way of the quaternion: a matrix' angle is the arc cosine of its trace, which rounding takes over one.
            let rotation_vector_rad = |a: usize, b: usize| {
                let rotation = times[a][index].axes.transpose() * times[b][index].axes;
                quaternion(rotation).scaled_axis()
            };
            let angular_velocity_rad_s =
                (rotation_vector_rad(1, 3) * 8.0 - rotation_vector_rad(0, 4)) / (12.0 * STEP_S);
            let axes = times[2][index].axes;
            // Skin: an over-damped play that follows the acceleration and turns the sensor with it.
            let play = axes.transpose() * accel * -errors.skin_m;
            let (slipped, slips_rad_s) = unit.slipping(t_s);
            let strap = |dt_s: f64| unit.strap.turned_rad(t_s + dt_s);
            let slips_rad_s = slips_rad_s + (strap(STEP_S) - strap(-STEP_S)) / (2.0 * STEP_S);
            let mount = UnitQuaternion::from_scaled_axis(unit.skin * play + strap(0.0)) * slipped;
            let back = mount.inverse();
            let angular_velocity_rad_s = angular_velocity_rad_s + slips_rad_s;
            let mut noise = |sigma: f64| Vector3::from_fn(|_, _| sigma * unit.noise.normal());
            let specific_force_m_s2 = axes.transpose() * (accel + Vector3::z() * GRAVITY_M_S2);
            Sample {
                gyro_rad_s: unit.gyro.0 * (back * angular_velocity_rad_s)
                    + unit.gyro.1
                    + noise(errors.gyro_noise_rad_s),
                accel_m_s2: unit.accel.0 * (back * specific_force_m_s2)
                    + unit.accel.1
                    + noise(errors.accel_noise_m_s2),
                mag_ut: magnetometer
                    .then(|| back * (axes.transpose() * field) + unit.magnet + noise(errors.mag_noise_ut)),
            }
        });
        (samples, Truth { t_s, body: times[2] })
    }
}

impl Unit {
    /// How it sits at a time, and the angular velocity at which its strap slips, segment axes, rad/s: evenly sped up and slowed down.
    fn slipping(&self, t_s: f64) -> (UnitQuaternion<f64>, Vector3<f64>) {
        let Some((from_s, rotation_vector_rad)) = self.slip else { return (self.mount, Vector3::zeros()) };
        let part = ((t_s - from_s) / SLIP_S).clamp(0.0, 1.0);
        let turned = 0.5 * (1.0 - libm::cos(std::f64::consts::PI * part));
        let rate = 0.5 * std::f64::consts::PI / SLIP_S * libm::sin(std::f64::consts::PI * part);
        let left = UnitQuaternion::from_scaled_axis(rotation_vector_rad * (turned - 1.0));
        (left * self.mount, rotation_vector_rad * rate)
    }
}

/// The room's field, uT: x east, y north, z up.
fn field(disturbances: &[Disturbance], t_s: f64) -> Vector3<f64> {
    let (mut azimuth, mut norm, mut dip) = (0.0, FIELD_UT, DIP_RAD);
    for disturbance in disturbances.iter().filter(|d| (d.start_s..d.end_s).contains(&t_s)) {
        azimuth += disturbance.azimuth_rad;
        norm *= disturbance.norm;
        dip += disturbance.dip_rad;
    }
    Vector3::new(-libm::sin(azimuth) * libm::cos(dip), libm::cos(azimuth) * libm::cos(dip), -libm::sin(dip))
        * norm
}

/// A person's standing straight is not the table's: constant departures of every joint.
fn clumsy(posture: &mut super::Posture, sigma: f64, seed: u64) {
    if sigma == 0.0 {
        return;
    }
    let mut random = Random::new(seed, Purpose::Wearer(100));
    let mut add = |angle: &mut f64| *angle += sigma * random.normal();
    posture.spine.iter_mut().for_each(&mut add);
    for side in 0..2 {
        posture.shoulder_lean[side].iter_mut().for_each(&mut add);
        posture.hip[side].iter_mut().for_each(&mut add);
        add(&mut posture.elbow[side][0]);
        add(&mut posture.knee[side]);
    }
    posture.neck.iter_mut().for_each(&mut add);
    posture.wrist.iter_mut().flatten().for_each(&mut add);
    posture.ankle.iter_mut().flatten().for_each(&mut add);
    posture.girdle.iter_mut().flatten().for_each(&mut add);
}
