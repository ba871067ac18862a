//! A walking figure that wears magnetic sensors, and faults put into any recording of positions, with their truth.
//!
//! What comes in: a seed, a body's height, a length of time. What goes out: poses in transmitter axes turned z up,
//! frame by frame, and what was done to each of them. For measuring detectors of faulty frames: several figures of one
//! stage are sessions and bodies of that stage.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Rotation3, UnitQuaternion, Vector3};

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
/// A position that is mirrored, or drawn aside gradually, by less than this is where it was, m.
const SHOWS_M: f64 = 0.05;
/// Skin moves over the bones by so much along and about each axis, rms, m and rad, and so often, Hz.
const SKIN_M: f64 = 6e-3;
const SKIN_RAD: f64 = 0.035;
const SKIN_HZ: f64 = 1.0;

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
    /// Drawn aside gradually, by up to 0.15 to 0.3 m and back again.
    Drifted,
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
    /// Its root mean square.
    const RMS: f64 = 0.59;

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

/// What sensors report, frame by frame; a figure's in the order of [`SENSORS`].
#[derive(Clone, Debug, PartialEq)]
pub struct Poses {
    /// Three numbers a sensor (x ahead of the transmitter, y left, z up), from the transmitter, m.
    pub positions_m: Vec<f64>,
    /// Four numbers a sensor: sensor to the same axes, a unit quaternion, scalar first. Empty where nobody knows any.
    pub orientations_wxyz: Vec<f64>,
}

impl Figure {
    /// Poses of all sensors of [`SENSORS`].
    ///
    /// Joints move by slow sines; each sensor sits some centimetres off the middle of its segment and is turned anyhow, anew for each seed, on skin that moves by
    /// 6 mm and 2 degrees about each axis. White noise grows with the fourth power of the range: 0.4 mm, and 0.12 mm more at 1 m, per axis. Metal and loss of
    /// range are not modelled.
    pub fn poses(&self) -> Poses {
        let mut random = Random::new(self.seed, Purpose::Signals(0));
        // Where: x, y, heading, crouching, lean; and each limb: shoulders' swing and lift, elbows, the stride.
        let place: Vec<Wander> =
            [0.05, 0.06, 0.05, 0.15, 0.12].map(|rate| Wander::new(&mut random, rate)).into();
        let limbs: Vec<Wander> = (0..6).map(|_| Wander::new(&mut random, 0.4)).collect();
        let (stride_hz, phase) = (0.7 + 0.3 * random.uniform(), TAU * random.uniform());
        // How each sensor sits on its segment in this session.
        let offsets_m: Vec<Vector3<f64>> = SENSORS.map(|_| vector(&mut random) * 0.015).into();
        let mounts: Vec<UnitQuaternion<f64>> =
            SENSORS.map(|_| UnitQuaternion::from_scaled_axis(vector(&mut random) * 2.0)).into();
        let skin: Vec<[Wander; 6]> =
            SENSORS.map(|_| std::array::from_fn(|_| Wander::new(&mut random, SKIN_HZ))).into();
        let mut poses = Poses {
            positions_m: Vec::with_capacity(3 * SENSORS.len() * self.frames),
            orientations_wxyz: Vec::with_capacity(4 * SENSORS.len() * self.frames),
        };
        for k in 0..self.frames {
            let t = k as f64 / self.rate_hz;
            let signal = |k: usize| place[k].at(t);
            let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 1.5 * signal(2));
            let stride = libm::sin(TAU * stride_hz * t + phase);
            let segments = segments(
                self.height_m,
                [0.25 + 0.25 * signal(3), 0.15 * signal(4)],
                stride * 0.45,
                &std::array::from_fn(|k| limbs[k].at(t)),
            );
            let root = Vector3::new(BEFORE_M + 0.35 * signal(0), 0.5 * signal(1), -TRANSMITTER_M);
            for (sensor, segment) in segments.iter().enumerate() {
                let moved = |first: usize, by: f64| {
                    Vector3::from_fn(|axis, _| by / Wander::RMS * skin[sensor][first + axis].at(t))
                };
                let offset = offsets_m[sensor] + moved(0, SKIN_M);
                let p = root + heading * (segment.translation.vector + segment.rotation * offset);
                // Noise grows with the fourth power of the distance.
                let sigma = 4e-4 + 1.2e-4 * p.norm().powi(4);
                let p = p + vector(&mut random) * sigma;
                poses.positions_m.extend(p.iter());
                let tilt = UnitQuaternion::from_scaled_axis(moved(3, SKIN_RAD));
                let q = heading * segment.rotation * tilt * mounts[sensor];
                poses.orientations_wxyz.extend([q.w, q.i, q.j, q.k]);
            }
        }
        poses
    }
}

/// Middles and rotations of the segments from the point on the floor where the figure stands, x forward; the order of [`SENSORS`].
fn segments(height: f64, [crouch, lean]: [f64; 2], stride: f64, limbs: &[f64; 6]) -> [Isometry3<f64>; 15] {
    // A segment hangs down, and is swung forward.
    let swung = |angle: f64| Rotation3::from_axis_angle(&Vector3::y_axis(), -angle);
    let hanging = |rotation: &Rotation3<f64>, by: f64| rotation * Vector3::new(0.0, 0.0, -by);
    let at = |p: Vector3<f64>, rotation: Rotation3<f64>| Isometry3::from_parts(p.into(), rotation.into());
    let (thigh, shank) = (0.245 * height, 0.246 * height);
    let knee = crouch.clamp(0.0, 0.8);
    let hip_z = 0.04 * height + thigh * libm::cos(knee) + shank * libm::cos(knee);
    let pelvis = Vector3::new(0.0, 0.0, hip_z);
    let trunk = swung(-lean);
    let up = trunk * Vector3::z();
    let neck = pelvis + up * 0.288 * height;
    let arm = |side: f64, swing: f64, lift: f64, bend: f64| {
        let shoulder = neck + Vector3::new(0.0, side * 0.129 * height, -0.02 * height);
        let sideways =
            Rotation3::from_axis_angle(&Vector3::x_axis(), side * (0.25 + 0.5 * (1.0 + lift)).min(1.5));
        let (upper, lower) = (sideways * swung(swing), sideways * swung(swing + 0.9 + 0.8 * bend));
        let elbow = shoulder + hanging(&upper, 0.186 * height);
        let wrist = elbow + hanging(&lower, 0.146 * height);
        [
            at(shoulder + hanging(&upper, 0.1 * height), upper),
            at(elbow + hanging(&lower, 0.08 * height), lower),
            at(wrist + hanging(&lower, 0.05 * height), lower),
        ]
    };
    let leg = |side: f64, swing: f64| {
        let hip = pelvis + Vector3::new(0.0, side * 0.095 * height, 0.0);
        let upper = swung(swing + knee);
        let lower = swung(swing - knee - 0.6 * (-swing).max(0.0));
        let knee_p = hip + hanging(&upper, thigh);
        let ankle = knee_p + hanging(&lower, shank);
        [
            at(hip + hanging(&upper, 0.5 * thigh), upper),
            at(knee_p + hanging(&lower, 0.5 * shank), lower),
            at(ankle + Vector3::x() * 0.08, Rotation3::identity()),
        ]
    };
    let right = arm(-1.0, 0.7 * limbs[0] - 0.5 * stride, limbs[1], limbs[2]);
    let left = arm(1.0, 0.7 * limbs[3] + 0.5 * stride, limbs[4], limbs[5]);
    let (leg_r, leg_l) = (leg(-1.0, stride), leg(1.0, -stride));
    let [torso, head] = [pelvis + up * 0.2 * height, neck + up * 0.12 * height].map(|p| at(p, trunk));
    let mut segments = [at(pelvis, Rotation3::identity()); 15];
    (segments[1], segments[2]) = (torso, head);
    for (first, limb) in [(3, right), (6, left), (9, leg_r), (12, leg_l)] {
        segments[first..first + 3].copy_from_slice(&limb);
    }
    segments
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
    /// One sensor is drawn aside gradually, and comes back as it went, over 1 to 6 s.
    Drift,
}

impl Fault {
    /// All kinds, in the order above.
    pub const ALL: [Self; 8] = [
        Self::InvertAll,
        Self::InvertOne,
        Self::InvertAllVertically,
        Self::InvertOneVertically,
        Self::Stick,
        Self::Jump,
        Self::Disturb,
        Self::Drift,
    ];

    /// Whether it shows in positions alone: nobody sees a drift there.
    pub fn shows_in_positions(self) -> bool {
        self != Self::Drift
    }
}

/// Puts faults of 0.5 to 3 s into poses, the kinds in turn, with clean stretches between them so that about
/// `share` of the frames (at least 0, below 1) have a faulty sensor. Returns what each sensor of each frame is, frame by frame.
///
/// `poses` holds those of `sensors` sensors and is changed in place; it may have no orientations. Orientations only stick: a mirror leaves them, and a pull
/// is taken to. `rate_hz`: frames per second. The same `seed` and input give the same faults; an empty `kinds` gives none.
///
/// # Panics
/// `sensors` is 0.
pub fn inject(
    poses: &mut Poses,
    sensors: usize,
    rate_hz: f64,
    seed: u64,
    share: f64,
    kinds: &[Fault],
) -> Vec<Truth> {
    let Poses { positions_m, orientations_wxyz } = poses;
    let mut random = Random::new(seed, Purpose::Faults(0));
    let frames = positions_m.len() / (3 * sensors);
    let mut truth = vec![Truth::Clean; frames * sensors];
    let clean_s = 1.75 * (1.0 - share) / share;
    let mut start = (rate_hz * clean_s * (0.5 + random.uniform())) as usize;
    for kind in kinds.iter().cycle() {
        let long = if *kind == Fault::Drift { 2.0 } else { 1.0 };
        let end = start.saturating_add((rate_hz * long * (0.5 + 2.5 * random.uniform())) as usize);
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
                        if !orientations_wxyz.is_empty() {
                            let to = 4 * (frame * sensors + sensor);
                            orientations_wxyz.copy_within(to - 4 * sensors..to - 4 * sensors + 4, to);
                        }
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
                    Fault::Drift => {
                        let share = (frame - start) as f64 / (end - start) as f64;
                        let by = (0.15 + 0.15 * far) * libm::sin(0.5 * TAU * share).powi(2);
                        (shifted(by), if by > SHOWS_M { Truth::Drifted } else { Truth::Clean })
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
        let still = Poses { positions_m: vec![1.0; 3 * 2 * 300], orientations_wxyz: Vec::new() };
        let mut poses = still.clone();
        let truth = inject(&mut poses, 2, 100.0, 1, 0.0, &Fault::ALL);
        assert!(truth.iter().all(|truth| *truth == Truth::Clean) && poses == still);
    }

    #[test]
    fn it_stands_upright_moves_steadily_and_repeats() {
        let positions = FIGURE.poses().positions_m;
        assert_eq!(positions, FIGURE.poses().positions_m);
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
        let clean = FIGURE.poses();
        let kinds: Vec<Fault> = Fault::ALL.into_iter().filter(|fault| fault.shows_in_positions()).collect();
        let mut bad = clean.clone();
        let truth = inject(&mut bad, SENSORS.len(), FIGURE.rate_hz, 3, 0.4, &kinds);
        for (k, what) in truth.iter().enumerate() {
            let (a, b) = (&clean.positions_m[3 * k..3 * k + 3], &bad.positions_m[3 * k..3 * k + 3]);
            match what {
                Truth::Clean => assert!(a[..2] == b[..2] && (a[2] - b[2]).abs() <= SHOWS_M),
                Truth::InvertedVertically => assert!(a[..2] == b[..2] && a[2] == -b[2]),
                Truth::Inverted => assert!(a.iter().zip(b).all(|(a, b)| *a == -b)),
                _ => assert_ne!(a, b),
            }
            let is_turned =
                clean.orientations_wxyz[4 * k..4 * k + 4] != bad.orientations_wxyz[4 * k..4 * k + 4];
            assert_eq!(is_turned, *what == Truth::Stuck, "{k}");
        }
        for what in [Truth::Inverted, Truth::InvertedVertically, Truth::Stuck, Truth::Jump, Truth::Disturbed]
        {
            assert!(truth.contains(&what), "{what:?}");
        }
        let share = truth.chunks(SENSORS.len()).filter(|row| row.iter().any(|t| *t != Truth::Clean)).count();
        assert!((0.25..0.55).contains(&(share as f64 / FIGURE.frames as f64)), "{share}");
    }

    #[test]
    fn a_drift_comes_and_goes_without_a_step() {
        let clean = FIGURE.poses();
        let mut bad = clean.clone();
        let truth = inject(&mut bad, SENSORS.len(), FIGURE.rate_hz, 3, 0.4, &[Fault::Drift]);
        assert!(truth.contains(&Truth::Drifted) && bad.orientations_wxyz == clean.orientations_wxyz);
        let off_m = |k: usize| {
            let p = |poses: &Poses| Vector3::from_column_slice(&poses.positions_m[3 * k..3 * k + 3]);
            (p(&bad) - p(&clean)).norm()
        };
        for (k, what) in truth.iter().enumerate() {
            assert_eq!(*what == Truth::Drifted, off_m(k) > SHOWS_M, "{k}");
            assert!(off_m(k) <= 0.3);
            if k >= SENSORS.len() {
                assert!((off_m(k) - off_m(k - SENSORS.len())).abs() < 0.02, "{k}");
            }
        }
    }
}
