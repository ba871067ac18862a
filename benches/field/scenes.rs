//! Simulated scenes: metal, a pole moved among it, and the truth.

use std::f64::consts::TAU;

use nalgebra::{Unit, UnitQuaternion, Vector3};
use posed_simulator::magnetic::{Environment, Floor, Sphere, signal_matrix, solve};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

pub(crate) const SENSORS: usize = 6;
pub(crate) const SPACING_M: f64 = 0.3;
const FRAMES: usize = 1800;
const RATE_HZ: f64 = 30.0;

/// One scene of the table.
pub(crate) struct Scene {
    pub(crate) name: &'static str,
    pub(crate) environment: Environment,
    /// Noise of each of the nine signals, 1/m^3.
    pub(crate) sigma_signal: f64,
    /// A device that reports this multiple of the truth, with this white noise per axis (m), and knows no metal.
    pub(crate) scale: Option<(f64, f64)>,
    /// Beyond this the device repeats its last words, m.
    pub(crate) max_range_m: f64,
}

/// One reading beside its truth.
#[derive(Clone, Copy)]
pub(crate) struct Sample {
    pub(crate) z: Vector3<f64>,
    pub(crate) q: UnitQuaternion<f64>,
    pub(crate) p: Vector3<f64>,
    pub(crate) truth: UnitQuaternion<f64>,
    /// The device repeated itself.
    pub(crate) stuck: bool,
}

/// A minute of the pole, and readings beside its paths.
pub(crate) struct Run {
    pub(crate) t_s: Vec<f64>,
    pub(crate) frames: Vec<[Sample; SENSORS]>,
    /// Noise-free readings off the paths.
    pub(crate) tests: Vec<Sample>,
    /// The same places with noise.
    pub(crate) noisy: Vec<Sample>,
}

fn sphere(x: f64, y: f64, z: f64, radius_m: f64, response: f64) -> Sphere {
    Sphere { center_m: Vector3::new(x, y, z), radius_m, response }
}

fn floor(distance_m: f64, strength: f64) -> Option<Floor> {
    Some(Floor { normal: Vector3::z_axis(), distance_m, strength })
}

/// The four scenes of the specification and six harder ones.
pub(crate) fn scenes() -> Vec<Scene> {
    let scene = |name, floor, spheres, sigma_signal| Scene {
        name,
        environment: Environment { spheres, floor },
        sigma_signal,
        scale: None,
        max_range_m: f64::INFINITY,
    };
    let mut table = Vec::new();
    // Top 1.2 m by 0.6 m at 0.0 m, four legs to -0.7 m, beside the volume; bars answer as rows of small spheres.
    for i in 0..7 {
        for j in 0..4 {
            table.push(sphere(1.1 + 0.2 * i as f64, 1.75 + 0.2 * j as f64, 0.0, 0.05, 2.0));
        }
    }
    for (x, y) in [(1.1, 1.75), (2.3, 1.75), (1.1, 2.35), (2.3, 2.35)] {
        table.extend((1..7).map(|k| sphere(x, y, -0.1 * f64::from(k), 0.045, 2.0)));
    }
    let mut grid = Vec::new();
    for i in 0..13 {
        for j in 0..15 {
            // Bars of a 0.25 m mesh, seen as a sphere at each crossing.
            grid.push(sphere(0.25 * i as f64 - 0.25, 0.25 * j as f64 - 1.75, -0.75, 0.06, 2.0));
        }
    }
    let many = vec![
        sphere(2.4, 1.4, 0.2, 0.16, -1.0),
        sphere(1.0, -1.6, 1.4, 0.14, 2.0),
        sphere(2.7, -1.2, 0.5, 0.18, 2.0),
        sphere(0.2, 1.6, 0.9, 0.15, -1.0),
        sphere(1.6, 0.4, 2.4, 0.20, 2.0),
    ];
    let mut pillar: Vec<Sphere> =
        (0..12).map(|k| sphere(2.9, 0.2, -0.4 + 0.2 * f64::from(k), 0.09, 2.0)).collect();
    pillar.push(sphere(0.8, -1.5, 0.2, 0.12, -1.0));
    vec![
        Scene {
            name: "scale 1.02",
            environment: Environment::default(),
            sigma_signal: 0.0,
            scale: Some((1.02, 5e-4)),
            max_range_m: f64::INFINITY,
        },
        scene("floor + aluminium sphere", floor(0.3, 0.05), vec![sphere(2.2, 1.3, 0.3, 0.15, -1.0)], 2e-4),
        scene("floor, low transmitter", floor(0.5, 0.02), vec![], 1e-4),
        scene(
            "floor + 2 steel objects",
            floor(0.5, 0.05),
            vec![sphere(2.5, 1.5, 0.3, 0.20, 2.0), sphere(1.2, -1.5, 1.5, 0.15, 2.0)],
            1e-4,
        ),
        scene("steel table with legs", floor(0.7, 0.03), table, 1e-4),
        scene("rebar grid in the floor", None, grid, 1e-4),
        scene("conductors and irons", floor(0.6, 0.04), many, 1e-4),
        Scene {
            max_range_m: 2.1,
            ..scene(
                "range limit with dropouts",
                floor(0.5, 0.04),
                vec![sphere(2.3, 1.2, 0.2, 0.15, 2.0)],
                1.5e-4,
            )
        },
        scene("steel pillar + conductor", floor(0.8, 0.06), pillar, 1e-4),
        Scene {
            environment: Environment {
                spheres: vec![sphere(1.9, -1.4, 0.0, 0.15, 2.0)],
                floor: Some(Floor {
                    normal: Unit::new_normalize(Vector3::new(-1.0, 0.1, 0.05)),
                    distance_m: 3.2,
                    strength: 0.3,
                }),
            },
            ..scene("steel wall behind", None, vec![], 1e-4)
        },
    ]
}

/// A smooth curve of four harmonics over 0 to 1.
fn curve(random: &mut ChaCha8Rng, base_hz: f64) -> Vec<f64> {
    let parts: Vec<(f64, f64)> =
        (0..4).map(|_| (0.3 + random.random::<f64>(), TAU * random.random::<f64>())).collect();
    let values: Vec<f64> = (0..FRAMES)
        .map(|k| {
            let t = k as f64 / RATE_HZ;
            let part = |h: usize| {
                let (amplitude, phase) = parts[h];
                amplitude / (h + 1) as f64 * libm::sin(TAU * base_hz * (h + 1) as f64 * t + phase)
            };
            (0..4).map(part).sum()
        })
        .collect();
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    values.into_iter().map(|v| (v - low) / (high - low)).collect()
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * libm::log(1.0 - random.random::<f64>())).sqrt();
    radius * libm::cos(TAU * random.random::<f64>())
}

impl Scene {
    /// What the device reports; `None` out of range.
    fn measure(
        &self,
        p: &Vector3<f64>,
        q: &UnitQuaternion<f64>,
        noise: Option<&mut ChaCha8Rng>,
    ) -> Option<(Vector3<f64>, UnitQuaternion<f64>)> {
        let reading = self.solve_anywhere(p, q, noise);
        if p.norm() > self.max_range_m { None } else { reading }
    }

    fn solve_anywhere(
        &self,
        p: &Vector3<f64>,
        q: &UnitQuaternion<f64>,
        noise: Option<&mut ChaCha8Rng>,
    ) -> Option<(Vector3<f64>, UnitQuaternion<f64>)> {
        if let Some((scale, sigma_m)) = self.scale {
            let mut z = p * scale;
            if let Some(random) = noise {
                z += Vector3::from_fn(|_, _| sigma_m * normal(random));
            }
            return Some((z, *q));
        }
        let mut signals = signal_matrix(&self.environment.field(p), q);
        if let Some(random) = noise {
            signals.apply(|s| *s += self.sigma_signal * normal(random));
        }
        let solution = solve(&signals, &Vector3::x())?;
        // The hemisphere is known: beyond the plane the simulator's device would mirror.
        let side = if solution.position_m.dot(p) < 0.0 { -1.0 } else { 1.0 };
        Some((solution.position_m * side, solution.orientation))
    }

    /// Position that an upright sensor at `p` reads; `None` out of range.
    pub(crate) fn position(&self, p: &Vector3<f64>, noise: Option<&mut ChaCha8Rng>) -> Option<Vector3<f64>> {
        self.measure(p, &UnitQuaternion::identity(), noise).map(|(z, _)| z)
    }

    /// Readings of a sensor that stands still.
    pub(crate) fn dwell(&self, p: &Vector3<f64>, count: usize, seed: u64) -> Vec<Vector3<f64>> {
        let mut random = ChaCha8Rng::seed_from_u64(1_000_000 + seed);
        (0..count).filter_map(|_| self.position(p, Some(&mut random))).collect()
    }

    /// Waves the pole for a minute.
    pub(crate) fn run(&self, seed: u64) -> Run {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let [x, y, z] = [0.06, 0.08, 0.1].map(|base_hz| curve(&mut random, base_hz));
        let elevation = curve(&mut random, 0.15);
        let azimuth = curve(&mut random, 0.09);
        let spin = curve(&mut random, 0.07);
        let mounts: Vec<UnitQuaternion<f64>> =
            (0..SENSORS).map(|_| UnitQuaternion::new(Vector3::from_fn(|_, _| normal(&mut random)))).collect();
        let mut last: [Option<(Vector3<f64>, UnitQuaternion<f64>)>; SENSORS] = [None; SENSORS];
        let mut frames = Vec::new();
        let mut t_s = Vec::new();
        for k in 0..FRAMES {
            let centre = Vector3::new(1.1 + 0.9 * x[k], -0.7 + 1.4 * y[k], 0.4 + 0.8 * z[k]);
            let rotation = UnitQuaternion::from_euler_angles(0.0, 0.0, TAU * azimuth[k])
                * UnitQuaternion::from_euler_angles(0.0, 1.4 - 2.8 * elevation[k], 0.0)
                * UnitQuaternion::from_euler_angles(TAU * spin[k], 0.0, 0.0);
            let direction = rotation * Vector3::x();
            let frame = std::array::from_fn(|i| {
                let p = centre + direction * ((i as f64 - 2.5) * SPACING_M);
                let truth = rotation * mounts[i];
                let measured = self.measure(&p, &truth, Some(&mut random));
                // A sensor that starts out of range repeats what it read at the start.
                let beyond = self.solve_anywhere(&p, &truth, None);
                let (z, q) = measured.or(last[i]).or(beyond).unwrap_or((p, truth));
                last[i] = Some((z, q));
                Sample { z, q, p, truth, stuck: measured.is_none() }
            });
            frames.push(frame);
            t_s.push(k as f64 / RATE_HZ);
        }
        let (mut tests, mut noisy) = (Vec::new(), Vec::new());
        while tests.len() < 1500 {
            let frame: &[Sample; SENSORS] = &frames[random.random_range(0..frames.len())];
            let on = frame[random.random_range(0..SENSORS)];
            let p = on.p + Vector3::from_fn(|_, _| 0.05 * normal(&mut random));
            let truth = on.truth;
            let Some((z, q)) = self.measure(&p, &truth, None) else { continue };
            let Some((zn, qn)) = self.measure(&p, &truth, Some(&mut random)) else { continue };
            tests.push(Sample { z, q, p, truth, stuck: false });
            noisy.push(Sample { z: zn, q: qn, p, truth, stuck: false });
        }
        Run { t_s, frames, tests, noisy }
    }
}
