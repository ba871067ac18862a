//! A simulated person among metal: what six magnetic sensors on trunk and arms read, and the truth.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Rotation3, Unit, UnitQuaternion, Vector3};
use posed_field::{Bone, Joint, Limbs, PoleReading, PoleRun, rigid};
use posed_simulator::body::{Activity, Build, Script};
use posed_simulator::magnetic::{Environment, Floor, Sphere, signal_matrix, solve};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The segments that wear sensors, by their place in the simulator's arrays.
pub(crate) const BODY_SENSORS: [(&str, usize); 6] =
    [("torso", 0), ("pelvis", 1), ("upper_arm_r", 2), ("forearm_r", 3), ("upper_arm_l", 6), ("forearm_l", 7)];
/// Joints: the sensors on both sides, child first, and the segment whose origin the joint is; the spine's is the pelvis'.
const JOINTS: [(usize, usize, usize); 5] = [(0, 1, 1), (2, 0, 2), (3, 2, 3), (4, 0, 6), (5, 4, 7)];
const RATE_HZ: f64 = 30.0;
/// Noise of the signals, 1/m^3, and how far skin moves the sensors, m.
const SIGMA_SIGNAL: f64 = 1e-4;
const SKIN_M: f64 = 0.002;

/// A sensor at one time.
pub(crate) struct Reading {
    pub(crate) z: Vector3<f64>,
    pub(crate) q: UnitQuaternion<f64>,
    pub(crate) p: Vector3<f64>,
}

/// A person's session.
pub(crate) struct Session {
    pub(crate) height_m: f64,
    pub(crate) build: Build,
    /// By instant and sensor.
    pub(crate) frames: Vec<[Reading; BODY_SENSORS.len()]>,
    /// From each sensor of [`JOINTS`] to the joint, sensor axes, m: what a perfect fitter of straps would know.
    pub(crate) ways: [[Vector3<f64>; 2]; JOINTS.len()],
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * libm::log(1.0 - random.random::<f64>())).sqrt();
    radius * libm::cos(TAU * random.random::<f64>())
}

impl Session {
    /// The `seed`-th person, who first stands still for so many seconds, arms hanging: height, seats of the sensors, way about the stage and metal
    /// are its own.
    pub(crate) fn new(seed: u64, seconds: f64, standing_s: f64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut draw = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        let height_m = draw(1.55, 1.95);
        let build = Build::of_height(height_m);
        let side = if draw(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
        let environment = Environment {
            spheres: vec![Sphere {
                // Out of arm's reach.
                center_m: Vector3::new(draw(1.9, 2.3), side * draw(1.2, 1.5), draw(-0.2, 0.5)),
                radius_m: draw(0.12, 0.18),
                response: 2.0,
            }],
            // The transmitter stands 0.9 m above the floor.
            floor: Some(Floor {
                normal: Unit::new_unchecked(Vector3::z()),
                distance_m: 0.9,
                strength: draw(0.05, 0.1),
            }),
        };
        let mut vector = |sigma: f64| Vector3::from_fn(|_, _| sigma * normal(&mut random));
        let mounts: Vec<UnitQuaternion<f64>> =
            BODY_SENSORS.map(|_| UnitQuaternion::new(vector(1.0))).to_vec();
        let lengths = [0.0, 0.0, build.upper_arm_m, build.forearm_m, build.upper_arm_m, build.forearm_m];
        let seats: Vec<Vector3<f64>> =
            lengths.iter().map(|length| Vector3::new(0.0, -0.5 * length, 0.0) + vector(0.03)).collect();
        let phases = vector(3.0);
        let script = Script { activity: Activity::Reaching, calibration: false, facing: 0.0, mistake: None };
        let place = |t_s: f64| {
            let mut posture = script.at(t_s, &build);
            let wander = |axis: usize, period_s: f64| libm::sin(TAU * t_s.max(0.0) / period_s + phases[axis]);
            posture.pelvis_m += Vector3::new(1.15 + 0.25 * wander(0, 17.0), 0.35 * wander(1, 23.0), -0.9);
            posture.pelvis[0] += 1.2 * wander(2, 31.0);
            posture.place(&build)
        };
        let rotation = |axes: Matrix3<f64>| {
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
        };
        let standing = place(0.0);
        let ways = JOINTS.map(|(child, parent, origin)| {
            [child, parent].map(|sensor| {
                let segment = &standing[BODY_SENSORS[sensor].1];
                let joint = segment.axes.transpose() * (standing[origin].origin_m - segment.origin_m);
                mounts[sensor].inverse() * (joint - seats[sensor])
            })
        });
        let frames = (0..(seconds * RATE_HZ) as usize).map(|frame| {
            let body = place(frame as f64 / RATE_HZ - standing_s);
            std::array::from_fn(|sensor| {
                let segment = &body[BODY_SENSORS[sensor].1];
                let skin = Vector3::from_fn(|axis, _| {
                    let t_s = frame as f64 / RATE_HZ;
                    SKIN_M * libm::sin(TAU * t_s * (0.7 + 0.2 * axis as f64) + sensor as f64)
                });
                let p = segment.origin_m + segment.axes * (seats[sensor] + skin);
                let q = rotation(segment.axes) * mounts[sensor];
                let mut signals = signal_matrix(&environment.field(&p), &q);
                signals.apply(|s| *s += SIGMA_SIGNAL * normal(&mut random));
                let solution = solve(&signals, &Vector3::x()).expect("a pose");
                Reading { z: solution.position_m, q: solution.orientation, p }
            })
        });
        let frames = frames.collect();
        Self { height_m, build, frames, ways }
    }

    /// The first `frames` instants as the solver gets them.
    pub(crate) fn run(&self, frames: usize) -> PoleRun {
        let rows = self.frames.iter().take(frames).enumerate().flat_map(|(frame, sensors)| {
            sensors.iter().enumerate().map(move |(sensor, reading)| {
                let measured = PoleReading { position_m: reading.z, orientation: Some(reading.q) };
                (frame as f64 / RATE_HZ, sensor, measured)
            })
        });
        let names = BODY_SENSORS.map(|(name, _)| name.to_owned()).to_vec();
        PoleRun::grouped(names, 1.0, rows).expect("a session")
    }

    /// Joints and bones; one bone is measured, the right upper arm.
    pub(crate) fn limbs(&self) -> Limbs {
        let joint = |(child, parent, _): (usize, usize, usize)| Joint {
            name: format!("{} to {}", BODY_SENSORS[parent].0, BODY_SENSORS[child].0),
            sensors: [child, parent],
            ways: [None, None],
            range: None,
        };
        let bone = |sensor: usize, joints: [usize; 2], length_m: Option<f64>| Bone {
            name: BODY_SENSORS[sensor].0.into(),
            sensor,
            joints,
            length_m,
            sigma_m: 5e-4,
        };
        Limbs {
            joints: JOINTS.map(joint).to_vec(),
            bones: vec![bone(2, [1, 2], Some(self.build.upper_arm_m)), bone(4, [3, 4], None)],
        }
    }

    /// Rms distance of positions from the truth after rigid alignment, m.
    pub(crate) fn aligned_m(
        &self,
        frames: std::ops::Range<usize>,
        position: impl Fn(&Reading) -> Vector3<f64>,
    ) -> f64 {
        let readings = self.frames[frames].iter().flatten();
        let pairs: Vec<_> = readings.map(|reading| (position(reading), reading.p)).collect();
        let motion = rigid(&pairs);
        let off = |(a, b): &(Vector3<f64>, Vector3<f64>)| {
            (motion.rotation * a + motion.translation.vector - b).norm_squared()
        };
        f64::sqrt(pairs.iter().map(off).sum::<f64>() / pairs.len() as f64)
    }

    /// Rms of how far both upper arms are from their length, each from the trunk's sensor to the forearm's, m.
    pub(crate) fn bones_m(
        &self,
        frames: std::ops::Range<usize>,
        pose: impl Fn(&Reading) -> (Vector3<f64>, UnitQuaternion<f64>),
    ) -> f64 {
        let (mut square, mut count) = (0.0, 0.0);
        for frame in &self.frames[frames] {
            for (shoulder, elbow) in [(1, 2), (3, 4)] {
                let end = |joint: usize, side: usize| {
                    let (child, parent, _) = JOINTS[joint];
                    let (p, q) = pose(&frame[[child, parent][side]]);
                    p + q * self.ways[joint][side]
                };
                let length = (end(shoulder, 1) - end(elbow, 0)).norm();
                square += (length - self.build.upper_arm_m).powi(2);
                count += 1.0;
            }
        }
        f64::sqrt(square / count)
    }
}
