//! A walking figure that wears magnetic sensors, and faults put into any recording of positions, with their truth.
//!
//! What comes in: a seed, a body's height, a length of time. What goes out: positions in transmitter axes turned z up,
//! frame by frame, and what was done to each of them. For measuring detectors of faulty frames: several figures of one
//! stage are sessions and bodies of that stage.

use std::f64::consts::TAU;

use nalgebra::{Rotation3, Vector3};

use crate::random::{Purpose, Random};

/// The figure's sensors, by the segments that they sit on, in the order of all rows here.
pub const SENSORS: [&str; 15] = [
    "pelvis",
    "torso",
    "head",
    "upper_arm_r",
    "forearm_r",
    "hand_r",
    "upper_arm_l",
    "forearm_l",
    "hand_l",
    "thigh_r",
    "shank_r",
    "foot_r",
    "thigh_l",
    "shank_l",
    "foot_l",
];

/// The transmitter's height above the floor, and how far before it the figure walks about, m.
const TRANSMITTER_M: f64 = 1.0;
const BEFORE_M: f64 = 1.7;
/// A position that is mirrored by less than this is where it was, m.
const SHOWS_M: f64 = 0.05;

/// What was done to a sensor's position in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Truth {
    /// Nothing.
    Clean,
    /// Mirrored through the transmitter.
    Inverted,
    /// Mirrored in the vertical axis alone.
    InvertedVertically,
    /// The position of the frame before the fault, again and again.
    Stuck,
    /// Somewhere else, 0.3 to 0.9 m away.
    Jump,
    /// Drawn aside by 0.15 to 0.3 m, unsteadily, as by metal.
    Disturbed,
}

/// A session of one person who walks about before the transmitter; the transmitter is 1 m above the floor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figure {
    /// Which session: the same figure gives the same positions.
    pub seed: u64,
    /// How tall the person is, m.
    pub height_m: f64,
    /// Frames per second, above 0.
    pub rate_hz: f64,
    /// How many frames.
    pub frames: usize,
}

/// A slow random signal of about unit size: three sines.
struct Wander([(f64, f64); 3]);

impl Wander {
    fn new(random: &mut Random, rate_hz: f64) -> Self {
        Self(
            [0.6, 1.0, 1.7].map(|factor| {
                (TAU * rate_hz * factor * (0.8 + 0.4 * random.uniform()), TAU * random.uniform())
            }),
        )
    }

    fn at(&self, t: f64) -> f64 {
        let [a, b, c] = &self.0;
        let sine = |(rate, phase): &(f64, f64)| libm::sin(rate * t + phase);
        0.6 * sine(a) + 0.5 * sine(b) + 0.3 * sine(c)
    }
}

impl Figure {
    /// Positions of all sensors of [`SENSORS`], three numbers each (x ahead of the transmitter, y left, z up), frame by frame; m,
    /// from the transmitter.
    ///
    /// Joints move by slow sines; each sensor sits some centimetres off the middle of its segment, anew for each seed. White
    /// noise grows with the fourth power of the range: 0.4 mm, and 0.12 mm more at 1 m, per axis. Metal and loss of range are not
    /// modelled.
    pub fn positions_m(&self) -> Vec<f64> {
        let mut random = Random::new(self.seed, Purpose::Signals(0));
        // Where: x, y, heading, crouching, lean; and each limb: shoulders' swing and lift, elbows, the stride.
        let place: Vec<Wander> =
            [0.05, 0.06, 0.05, 0.15, 0.12].map(|rate| Wander::new(&mut random, rate)).into();
        let limbs: Vec<Wander> = (0..6).map(|_| Wander::new(&mut random, 0.4)).collect();
        let (stride_hz, phase) = (0.7 + 0.3 * random.uniform(), TAU * random.uniform());
        // How each sensor sits on its segment in this session.
        let offsets_m: Vec<Vector3<f64>> = SENSORS.map(|_| vector(&mut random) * 0.015).into();
        let mut positions = Vec::with_capacity(3 * SENSORS.len() * self.frames);
        for k in 0..self.frames {
            let t = k as f64 / self.rate_hz;
            let signal = |k: usize| place[k].at(t);
            let heading = Rotation3::from_axis_angle(&Vector3::z_axis(), 1.5 * signal(2));
            let stride = libm::sin(TAU * stride_hz * t + phase);
            let joints = joints(
                self.height_m,
                [0.25 + 0.25 * signal(3), 0.15 * signal(4)],
                stride * 0.45,
                &std::array::from_fn(|k| limbs[k].at(t)),
            );
            let root = Vector3::new(BEFORE_M + 0.35 * signal(0), 0.5 * signal(1), -TRANSMITTER_M);
            for (joint, offset_m) in joints.iter().zip(&offsets_m) {
                let p = root + heading * (joint + offset_m);
                // Noise grows with the fourth power of the distance.
                let sigma = 4e-4 + 1.2e-4 * p.norm().powi(4);
                let p = p + vector(&mut random) * sigma;
                positions.extend(p.iter());
            }
        }
        positions
    }
}

/// Middles of the segments above the point on the floor where the figure stands, x forward; the order of [`SENSORS`].
fn joints(height: f64, [crouch, lean]: [f64; 2], stride: f64, limbs: &[f64; 6]) -> [Vector3<f64>; 15] {
    let down = |angle: f64| Vector3::new(libm::sin(angle), 0.0, -libm::cos(angle));
    let (thigh, shank) = (0.245 * height, 0.246 * height);
    let knee = crouch.clamp(0.0, 0.8);
    let hip_z = 0.04 * height + thigh * libm::cos(knee) + shank * libm::cos(knee);
    let pelvis = Vector3::new(0.0, 0.0, hip_z);
    let up = Vector3::new(libm::sin(lean), 0.0, libm::cos(lean));
    let neck = pelvis + up * 0.288 * height;
    let arm = |side: f64, swing: f64, lift: f64, bend: f64| {
        let shoulder = neck + Vector3::new(0.0, side * 0.129 * height, -0.02 * height);
        let sideways =
            Rotation3::from_axis_angle(&Vector3::x_axis(), side * (0.25 + 0.5 * (1.0 + lift)).min(1.5));
        let (upper, lower) = (sideways * down(swing), sideways * down(swing + 0.9 + 0.8 * bend));
        let elbow = shoulder + upper * 0.186 * height;
        let wrist = elbow + lower * 0.146 * height;
        [shoulder + upper * 0.1 * height, elbow + lower * 0.08 * height, wrist + lower * 0.05 * height]
    };
    let leg = |side: f64, swing: f64| {
        let hip = pelvis + Vector3::new(0.0, side * 0.095 * height, 0.0);
        let forward = swing + knee;
        let back = swing - knee - 0.6 * (-swing).max(0.0);
        let knee_p = hip + down(forward) * thigh;
        let ankle = knee_p + down(back) * shank;
        [hip + down(forward) * 0.5 * thigh, knee_p + down(back) * 0.5 * shank, ankle + Vector3::x() * 0.08]
    };
    let right = arm(-1.0, 0.7 * limbs[0] - 0.5 * stride, limbs[1], limbs[2]);
    let left = arm(1.0, 0.7 * limbs[3] + 0.5 * stride, limbs[4], limbs[5]);
    let (leg_r, leg_l) = (leg(-1.0, stride), leg(1.0, -stride));
    [
        pelvis,
        pelvis + up * 0.2 * height,
        neck + up * 0.12 * height,
        right[0],
        right[1],
        right[2],
        left[0],
        left[1],
        left[2],
        leg_r[0],
        leg_r[1],
        leg_r[2],
        leg_l[0],
        leg_l[1],
        leg_l[2],
    ]
}

fn vector(random: &mut Random) -> Vector3<f64> {
    Vector3::new(random.normal(), random.normal(), random.normal())
}

/// What [`inject`] may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// All sensors on the wrong side of the transmitter.
    InvertAll,
    /// One sensor on the wrong side of the transmitter.
    InvertOne,
    /// All sensors mirrored in the vertical axis.
    InvertAllVertically,
    /// One sensor mirrored in it.
    InvertOneVertically,
    /// One sensor repeats its position.
    Stick,
    /// One sensor is somewhere else, 0.3 to 0.9 m away, and stays so far off.
    Jump,
    /// One or two sensors are drawn aside, unsteadily.
    Disturb,
}

impl Fault {
    /// All kinds, in the order above.
    pub const ALL: [Self; 7] = [
        Self::InvertAll,
        Self::InvertOne,
        Self::InvertAllVertically,
        Self::InvertOneVertically,
        Self::Stick,
        Self::Jump,
        Self::Disturb,
    ];
}

/// Puts faults of 0.5 to 3 s into positions, the kinds in turn, with clean stretches between them so that about
/// `share` of the frames (at least 0, below 1) have a faulty sensor. Returns what each sensor of each frame is, frame by frame.
///
/// `positions_m` holds three numbers for each of `sensors` sensors, frame by frame, from the transmitter, m; it is changed in
/// place. `rate_hz`: frames per second. The same `seed` and input give the same faults; an empty `kinds` gives none.
///
/// # Panics
/// `sensors` is 0.
pub fn inject(
    positions_m: &mut [f64],
    sensors: usize,
    rate_hz: f64,
    seed: u64,
    share: f64,
    kinds: &[Fault],
) -> Vec<Truth> {
    let mut random = Random::new(seed, Purpose::Faults(0));
    let frames = positions_m.len() / (3 * sensors);
    let mut truth = vec![Truth::Clean; frames * sensors];
    let clean_s = 1.75 * (1.0 - share) / share;
    let mut start = (rate_hz * clean_s * (0.5 + random.uniform())) as usize;
    for kind in kinds.iter().cycle() {
        let end = start.saturating_add((rate_hz * (0.5 + 2.5 * random.uniform())) as usize);
        if end >= frames || start == 0 {
            break;
        }
        let mut hit = vec![random.integer(0, sensors as u64 - 1) as usize];
        match kind {
            Fault::InvertAll | Fault::InvertAllVertically => hit = (0..sensors).collect(),
            Fault::Disturb if random.uniform() < 0.5 => hit.push((hit[0] + 1) % sensors),
            _ => {}
        }
        for sensor in hit {
            let whither = vector(&mut random).normalize();
            let far = random.uniform();
            let pull = Wander::new(&mut random, 0.5);
            for frame in start..end {
                let at = 3 * (frame * sensors + sensor);
                let p = Vector3::new(positions_m[at], positions_m[at + 1], positions_m[at + 2]);
                let shifted = |by: f64| p + whither * by;
                let (bad, what) = match kind {
                    Fault::InvertAll | Fault::InvertOne => (-p, Truth::Inverted),
                    Fault::InvertAllVertically | Fault::InvertOneVertically => {
                        // Beside the plane nothing happens.
                        let shows = 2.0 * p.z.abs() > SHOWS_M;
                        let what = if shows { Truth::InvertedVertically } else { Truth::Clean };
                        (Vector3::new(p.x, p.y, -p.z), what)
                    }
                    Fault::Stick => {
                        let last = at - 3 * sensors;
                        let last = &positions_m[last..last + 3];
                        (Vector3::new(last[0], last[1], last[2]), Truth::Stuck)
                    }
                    Fault::Jump => (shifted(0.3 + 0.6 * far), Truth::Jump),
                    Fault::Disturb => {
                        let t = frame as f64 / rate_hz;
                        let by = 0.15 + 0.1 * far + 0.05 * pull.at(t);
                        (shifted(by) + vector(&mut random) * 0.01, Truth::Disturbed)
                    }
                };
                positions_m[at..at + 3].copy_from_slice(bad.as_slice());
                truth[frame * sensors + sensor] = what;
            }
        }
        start = end + 1 + (rate_hz * clean_s * (0.5 + random.uniform())) as usize;
    }
    truth
}

#[cfg(test)]
mod tests {
    use super::*;

    const FIGURE: Figure = Figure { seed: 1, height_m: 1.75, rate_hz: 60.0, frames: 3600 };

    #[test]
    fn a_share_of_nothing_changes_nothing() {
        let mut positions_m = vec![1.0; 3 * 2 * 300];
        let truth = inject(&mut positions_m, 2, 100.0, 1, 0.0, &Fault::ALL);
        assert!(truth.iter().all(|truth| *truth == Truth::Clean) && positions_m.iter().all(|p| *p == 1.0));
    }

    #[test]
    fn it_stands_upright_moves_steadily_and_repeats() {
        let positions = FIGURE.positions_m();
        assert_eq!(positions, FIGURE.positions_m());
        let p = |frame: usize, sensor: usize| {
            let at = 3 * (frame * SENSORS.len() + sensor);
            Vector3::from_column_slice(&positions[at..at + 3])
        };
        for frame in 1..FIGURE.frames {
            assert!(p(frame, 2).z > p(frame, 0).z && p(frame, 0).z > p(frame, 11).z);
            for (sensor, name) in SENSORS.iter().enumerate() {
                let step = (p(frame, sensor) - p(frame - 1, sensor)).norm();
                assert!(step < 0.15 && p(frame, sensor).x > 0.2, "{frame} {name}: {step}");
            }
        }
        // Thigh and pelvis keep their distance within the swing of the leg, as bones do.
        let lengths: Vec<f64> = (0..FIGURE.frames).map(|k| (p(k, 0) - p(k, 9)).norm()).collect();
        let (low, high) = lengths.iter().fold((9.0f64, 0.0f64), |(a, b), l| (a.min(*l), b.max(*l)));
        assert!(low > 0.15 && high < 0.4, "{low} {high}");
    }

    #[test]
    fn faults_are_where_the_truth_says_and_nowhere_else() {
        let clean = FIGURE.positions_m();
        let mut bad = clean.clone();
        let truth = inject(&mut bad, SENSORS.len(), FIGURE.rate_hz, 3, 0.4, &Fault::ALL);
        for (k, what) in truth.iter().enumerate() {
            let (a, b) = (&clean[3 * k..3 * k + 3], &bad[3 * k..3 * k + 3]);
            match what {
                Truth::Clean => assert!(a[..2] == b[..2] && (a[2] - b[2]).abs() <= SHOWS_M),
                Truth::InvertedVertically => assert!(a[..2] == b[..2] && a[2] == -b[2]),
                Truth::Inverted => assert!(a.iter().zip(b).all(|(a, b)| *a == -b)),
                _ => assert_ne!(a, b),
            }
        }
        for what in [Truth::Inverted, Truth::InvertedVertically, Truth::Stuck, Truth::Jump, Truth::Disturbed]
        {
            assert!(truth.contains(&what), "{what:?}");
        }
        let share = truth.chunks(SENSORS.len()).filter(|row| row.iter().any(|t| *t != Truth::Clean)).count();
        assert!((0.25..0.55).contains(&(share as f64 / FIGURE.frames as f64)), "{share}");
    }
}
