//! Labelled sequences of a person who steps, turns, reaches and takes back: the ten motion primitives of Cheema et al. 2019, Table 1.
//!
//! What comes in: a seed. What goes out: 13 to 22 s of 19 joints at 72 Hz with one of ten labels per frame, in about the table's
//! proportions. Their recordings are not published; every number here is our own. What it never does: let a foot slide that
//! stands, or repeat a person: size, tempo, steps, reach, posture and sway are drawn anew for each sequence.
//!
//! Where a label begins and ends: a step with the frames in which its foot is off the floor. It *begins* where the person has
//! stood, and *ends* beside the other foot. A *reach* goes on until the hand turns back, which is when it *retrieves*. A *turn* is a
//! step on the spot with either foot. All else is *standing*, now and then in a T-pose.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{Vector2, Vector3};

use crate::actions::JOINTS;
pub use crate::actions::RATE_HZ;
use crate::random::{Purpose, Random};
use crate::upper_body::{
    self, ANGLES, BEND, CROUCH, Carriage, LEAN, RAISE, SIGNS, SPREAD, TWIST, about, around,
};

/// Names of the labels; [`Primitives::labels`] holds indices of this list.
pub const LABELS: [&str; 10] = [
    "standing",
    "begin left step",
    "begin right step",
    "left step",
    "right step",
    "end left step",
    "end right step",
    "reach",
    "retrieve",
    "turn",
];

/// A labelled sequence of one person, [`RATE_HZ`] frames a second; `frames` and `labels` are of the same length.
#[derive(Clone, Debug, PartialEq)]
pub struct Primitives {
    /// Positions of [`JOINTS`] frame by frame, room axes (z up), m; white noise of 2 mm per axis is in them.
    pub frames: Vec<[[f64; 3]; JOINTS.len()]>,
    /// Index in [`LABELS`] of each frame.
    pub labels: Vec<usize>,
}

const LEFT: usize = 0;
const RIGHT: usize = 1;

/// Half the distance of the feet, and lengths of the leg, of a person of scale 1, m.
const HALF_STANCE_M: f64 = 0.09;
const THIGH_M: f64 = 0.43;
const SHANK_M: f64 = 0.43;
const ANKLE_M: f64 = 0.07;
/// A leg is never quite straight.
const STRAIGHTEST: f64 = 0.99;
/// How fast the pelvis follows the feet, as a damped spring does, rad/s.
const FOLLOWING: f64 = 9.0;

/// What a person is like.
struct Person {
    scale: f64,
    /// Durations are multiplied by it.
    slowness: f64,
    step_m: f64,
    lift_m: f64,
    swing: f64,
    amplitude: f64,
    carriage: Carriage,
}

/// Where a foot stands: its point of the line between the feet, and the direction of its toes.
#[derive(Clone, Copy)]
struct Foot {
    line_m: Vector2<f64>,
    heading: f64,
    height_m: f64,
}

/// One stretch of one label.
struct Stretch {
    label: usize,
    duration_s: f64,
    act: Act,
}

/// What is done in it.
#[derive(Clone, Copy)]
enum Act {
    Stand { arms: bool },
    Step { foot: usize, to: Foot },
    Turn { first: usize, by: f64 },
    Reach { targets: [f64; ANGLES] },
    Retrieve { targets: [f64; ANGLES] },
}

impl Primitives {
    /// The sequence of a seed: 13 to 22 s; the same seed gives the same sequence.
    pub fn generate(seed: u64) -> Self {
        let mut random = Random::new(seed, Purpose::Primitives);
        let person = Person::draw(&mut random);
        let frames = ((13.0 + 9.0 * random.uniform()) * RATE_HZ) as usize;
        let mut figure = Figure::new(&person, &mut random);
        let mut script = Script::default();
        let mut sequence = Self { frames: Vec::new(), labels: Vec::new() };
        while sequence.frames.len() < frames {
            let stretch = script.next(&person, &figure, &mut random);
            let begun = figure.clone();
            let count = (stretch.duration_s * RATE_HZ).round().max(1.0) as usize;
            for frame in 1..=count.min(frames - sequence.frames.len()) {
                let done = frame as f64 / count as f64;
                let angles = figure.act(&person, &begun, stretch.act, done);
                let t_s = sequence.frames.len() as f64 / RATE_HZ;
                sequence.frames.push(figure.joints(&person, angles, t_s, &mut random));
                sequence.labels.push(stretch.label);
            }
        }
        sequence
    }
}

impl Person {
    fn draw(random: &mut Random) -> Self {
        let carriage = Carriage::draw(random, 0.08);
        let mut around = |mean, spread| around(random, mean, spread);
        Self {
            scale: around(1.0, 0.1),
            slowness: around(1.0, 0.2),
            step_m: around(0.55, 0.12),
            lift_m: around(0.09, 0.03),
            swing: around(0.35, 0.15),
            amplitude: around(1.0, 0.25),
            carriage,
        }
    }

    /// The angles with a share of the way to others.
    fn towards(&self, targets: [f64; ANGLES], share: f64) -> [f64; ANGLES] {
        let rest = self.carriage.rest;
        std::array::from_fn(|index| rest[index] + share * (targets[index] - rest[index]))
    }
}

/// The person in the room.
#[derive(Clone)]
struct Figure {
    feet: [Foot; 2],
    heading: f64,
    pelvis_m: Vector2<f64>,
    pelvis_velocity_m_s: Vector2<f64>,
    height_m: f64,
}

/// From 0 to 1, at rest at both ends.
fn smooth(share: f64) -> f64 {
    let u = share.clamp(0.0, 1.0);
    u * u * u * (10.0 + u * (6.0 * u - 15.0))
}

fn forward(heading: f64) -> Vector2<f64> {
    let (sin, cos) = libm::sincos(heading);
    Vector2::new(cos, sin)
}

impl Figure {
    fn new(person: &Person, random: &mut Random) -> Self {
        let heading = TAU * random.uniform();
        let line_m = Vector2::new(3.0 * random.uniform(), 3.0 * random.uniform());
        let foot = Foot { line_m, heading, height_m: 0.0 };
        let height_m = (THIGH_M + SHANK_M) * person.scale;
        Self { feet: [foot; 2], heading, pelvis_m: line_m, pelvis_velocity_m_s: Vector2::zeros(), height_m }
    }

    /// Goes on to a share `done` of what began as `begun`; the angles then.
    fn act(&mut self, person: &Person, begun: &Self, act: Act, done: f64) -> [f64; ANGLES] {
        // A foot that has arrived stands.
        for foot in &mut self.feet {
            foot.height_m = 0.0;
        }
        match act {
            Act::Stand { arms } => {
                let mut targets = person.carriage.rest;
                SPREAD.iter().for_each(|&angle| targets[angle] = FRAC_PI_2);
                BEND.iter().for_each(|&angle| targets[angle] = 0.05);
                let share = if arms { smooth(4.0 * done) * smooth(4.0 * (1.0 - done)) } else { 0.0 };
                person.towards(targets, share)
            }
            Act::Step { foot, to } => {
                self.carry(person, begun, foot, to, done);
                self.heading = begun.heading + smooth(done) * (to.heading - begun.heading);
                person.carriage.rest
            }
            Act::Turn { first, by } => {
                self.heading = begun.heading + smooth(done) * by;
                let to = Foot { heading: begun.heading + by, ..begun.feet[first] };
                if done < 0.5 {
                    self.carry(person, begun, first, to, 2.0 * done);
                } else {
                    self.feet[first] = to;
                    self.carry(person, begun, 1 - first, to, 2.0 * done - 1.0);
                }
                person.carriage.rest
            }
            Act::Reach { targets } => person.towards(targets, smooth(done)),
            Act::Retrieve { targets } => person.towards(targets, 1.0 - smooth(done)),
        }
    }

    /// A foot on its way.
    fn carry(&mut self, person: &Person, begun: &Self, foot: usize, to: Foot, done: f64) {
        let (from, share) = (begun.feet[foot], smooth(done));
        let up = libm::sin(PI * done);
        self.feet[foot] = Foot {
            line_m: from.line_m + share * (to.line_m - from.line_m),
            heading: from.heading + share * (to.heading - from.heading),
            height_m: person.lift_m * up * up,
        };
    }

    /// Positions of the joints a frame later.
    fn joints(
        &mut self,
        person: &Person,
        mut angles: [f64; ANGLES],
        t_s: f64,
        random: &mut Random,
    ) -> [[f64; 3]; JOINTS.len()] {
        let dt = 1.0 / RATE_HZ;
        let size = person.scale;
        // The pelvis follows the feet, and leans a little to the one that stands.
        let [left, right] = self.feet;
        let higher = left.height_m - right.height_m;
        let aside = forward(self.heading + FRAC_PI_2) * (0.3 * higher.clamp(-0.1, 0.1));
        let middle = 0.5 * (left.line_m + right.line_m) - aside;
        self.pelvis_velocity_m_s += dt
            * (FOLLOWING * FOLLOWING * (middle - self.pelvis_m) - 2.0 * FOLLOWING * self.pelvis_velocity_m_s);
        self.pelvis_m += dt * self.pelvis_velocity_m_s;
        // Arms hang and swing against the legs.
        let ahead = (left.line_m - right.line_m).dot(&forward(self.heading)) / person.step_m;
        for side in [LEFT, RIGHT] {
            angles[RAISE[side]] -= person.swing * SIGNS[side] * ahead;
        }
        angles[TWIST] += 0.08 * ahead;
        let angles = person.carriage.swayed(angles, t_s);
        let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
        let body = about(z, self.heading);
        let (thigh, shank) = (THIGH_M * size, SHANK_M * size);
        let ankles: [Vector3<f64>; 2] = std::array::from_fn(|side| {
            let Foot { line_m, heading, height_m } = self.feet[side];
            let place = line_m + forward(heading + FRAC_PI_2) * (HALF_STANCE_M * size * SIGNS[side]);
            Vector3::new(place.x, place.y, ANKLE_M * size + height_m)
        });
        let side_hip =
            |side: usize| body * Vector3::new(0.0, HALF_STANCE_M * size * SIGNS[side], -0.05 * size);
        // As high as posture and both legs allow; what is more is followed softly.
        let wanted = [LEFT, RIGHT].into_iter().fold(
            (thigh + shank) * libm::cos(angles[CROUCH].max(0.0)) + ANKLE_M * size,
            |height, side| {
                let flat = (ankles[side].xy() - self.pelvis_m - side_hip(side).xy()).norm();
                let reach = STRAIGHTEST * (thigh + shank);
                height.min(ankles[side].z + (reach * reach - flat * flat).max(0.01).sqrt() + 0.05 * size)
            },
        );
        self.height_m = wanted.min(self.height_m + dt * FOLLOWING * (wanted - self.height_m));
        let hips = Vector3::new(self.pelvis_m.x, self.pelvis_m.y, self.height_m);
        let mut joints = [Vector3::zeros(); JOINTS.len()];
        upper_body::place(&mut joints, hips, body, &angles, size);
        for side in [LEFT, RIGHT] {
            let foot = self.feet[side];
            let first = 13 + 3 * side;
            joints[first] = knee(hips + side_hip(side), ankles[side], thigh, shank, body * x);
            joints[first + 1] = ankles[side];
            // Toes hang while the foot is in the air.
            let toes = about(z, foot.heading) * about(y, (4.0 * foot.height_m).min(0.5));
            joints[first + 2] = ankles[side] + toes * Vector3::new(0.17 * size, 0.0, -0.04 * size);
        }
        upper_body::marked(joints, random)
    }
}

/// Where the knee is between hip and ankle: in front.
fn knee(hip: Vector3<f64>, ankle: Vector3<f64>, thigh: f64, shank: f64, front: Vector3<f64>) -> Vector3<f64> {
    let way = ankle - hip;
    let length = way.norm().clamp(1e-3, thigh + shank);
    let along = way / way.norm().max(1e-3);
    let share = (thigh * thigh - shank * shank + length * length) / (2.0 * length);
    let out = (front - along * front.dot(&along)).normalize();
    hip + along * share + out * (thigh * thigh - share * share).max(0.0).sqrt()
}

/// What comes after what.
#[derive(Default)]
struct Script {
    /// Steps of a walk that are left, the foot of the next one, and how the way bends per step, rad.
    walk: Option<(u32, usize, f64)>,
    reached: Option<[f64; ANGLES]>,
    stood: bool,
}

impl Script {
    fn next(&mut self, person: &Person, figure: &Figure, random: &mut Random) -> Stretch {
        let slow = person.slowness;
        if let Some((left, foot, bend)) = self.walk {
            return self.step(person, figure, (left, foot, bend), random);
        }
        if let Some(targets) = self.reached.take() {
            let duration_s = slow * random.within(0.54, 0.82);
            return Stretch { label: 8, duration_s, act: Act::Retrieve { targets } };
        }
        if !self.stood {
            self.stood = true;
            let arms = random.uniform() < 0.1;
            let duration_s = if arms { random.within(1.5, 2.5) } else { random.within(0.4, 1.2) };
            return Stretch { label: 0, duration_s, act: Act::Stand { arms } };
        }
        self.stood = false;
        let chance = random.uniform();
        if chance < 0.48 {
            // Most begin with the right foot. Short walks: two or three steps between the first and the last.
            let foot = if random.uniform() < 0.75 { RIGHT } else { LEFT };
            let more = random.uniform();
            let steps = if more < 0.36 {
                1
            } else if more < 0.84 {
                2
            } else if more < 0.96 {
                3
            } else {
                4
            };
            let bend = random.within(-0.2, 0.2);
            self.walk = Some((steps, 1 - foot, bend));
            let to = ahead(figure, foot, person.step_m, 0.5 * bend);
            let duration_s = slow * random.within(0.54, 0.66);
            return Stretch { label: 1 + foot, duration_s, act: Act::Step { foot, to } };
        }
        if chance < 0.81 {
            let hand = if random.uniform() < 0.5 { LEFT } else { RIGHT };
            let low = random.within(0.0, 0.9) * person.amplitude;
            let mut targets = person.carriage.rest;
            targets[LEAN] = person.carriage.rest[LEAN] + 0.8 * low;
            targets[CROUCH] = person.carriage.rest[CROUCH] + 0.5 * low;
            targets[RAISE[hand]] = random.within(0.9, 1.7) * person.amplitude;
            targets[BEND[hand]] = random.within(0.0, 0.3);
            targets[TWIST] = random.within(-0.3, 0.3) - 0.2 * SIGNS[hand];
            self.reached = Some(targets);
            let duration_s = slow * random.within(0.85, 1.25);
            return Stretch { label: 7, duration_s, act: Act::Reach { targets } };
        }
        let first = if random.uniform() < 0.5 { LEFT } else { RIGHT };
        let by = SIGNS[first] * random.within(0.6, 1.9);
        let duration_s = slow * random.within(1.0, 1.4);
        Stretch { label: 9, duration_s, act: Act::Turn { first, by } }
    }

    /// The next step of a walk, or its last.
    fn step(
        &mut self,
        person: &Person,
        figure: &Figure,
        (left, foot, bend): (u32, usize, f64),
        random: &mut Random,
    ) -> Stretch {
        if left == 0 {
            self.walk = None;
            let to = figure.feet[1 - foot];
            let duration_s = person.slowness * random.within(0.6, 0.72);
            return Stretch { label: 5 + foot, duration_s, act: Act::Step { foot, to } };
        }
        self.walk = Some((left - 1, 1 - foot, bend));
        let to = ahead(figure, foot, person.step_m, bend);
        let duration_s = person.slowness * random.within(0.55, 0.66);
        Stretch { label: 3 + foot, duration_s, act: Act::Step { foot, to } }
    }
}

/// Where a foot goes that steps past the other one, on a way that bends.
fn ahead(figure: &Figure, foot: usize, step_m: f64, bend: f64) -> Foot {
    let other = figure.feet[1 - foot];
    let heading = other.heading + bend;
    Foot { line_m: other.line_m + step_m * forward(heading), heading, height_m: 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames of each label in Table 1.
    const PUBLISHED: [f64; LABELS.len()] =
        [29990.0, 2173.0, 6509.0, 8958.0, 7201.0, 4763.0, 4797.0, 10659.0, 6813.0, 6630.0];

    #[test]
    fn labels_come_in_the_published_proportions_and_in_an_order_that_can_be() {
        let mut counts = [0.0; LABELS.len()];
        for seed in 0..200 {
            let Primitives { frames, labels } = Primitives::generate(seed);
            assert!((12.9..22.1).contains(&(frames.len() as f64 / RATE_HZ)));
            assert_eq!(frames.len(), labels.len());
            labels.iter().for_each(|label| counts[*label] += 1.0);
            for (label, next) in labels.iter().zip(&labels[1..]).filter(|(label, next)| label != next) {
                let feet = |label: usize| (label - 1) % 2;
                let can_be = match (label, next) {
                    (1..=4, 3..=6) => feet(*label) != feet(*next),
                    (7, 8) | (5 | 6 | 8 | 9, 0) | (0, 1 | 2 | 7 | 9) => true,
                    _ => false,
                };
                assert!(can_be, "{seed}: {} after {}", LABELS[*next], LABELS[*label]);
            }
        }
        let (all, published): (f64, f64) = (counts.iter().sum(), PUBLISHED.iter().sum());
        for (label, (count, wanted)) in counts.iter().zip(PUBLISHED).enumerate() {
            let (share, wanted) = (100.0 * count / all, 100.0 * wanted / published);
            assert!((share - wanted).abs() < 1.5, "{}: {share:.1} % of {wanted:.1}", LABELS[label]);
        }
        assert_eq!(Primitives::generate(3), Primitives::generate(3));
        assert_ne!(Primitives::generate(3).frames[0], Primitives::generate(4).frames[0]);
    }

    #[test]
    fn feet_that_stand_do_not_slide_and_nothing_leaps_or_stretches() {
        let ankles = [14, 17];
        for seed in 0..70 {
            let Primitives { frames, labels } = Primitives::generate(seed);
            upper_body::assert_no_leap(seed, &frames, -0.05, 2.4);
            for (pair, label) in frames.windows(2).zip(&labels[1..]) {
                // Eight standard deviations of the difference of two noisy positions.
                let stands = |side: usize| match label {
                    0 | 7 | 8 => true,
                    9 => false,
                    _ => (label - 1) % 2 != side,
                };
                for side in [LEFT, RIGHT] {
                    let moved = Vector3::from(pair[0][ankles[side]]) - Vector3::from(pair[1][ankles[side]]);
                    assert!(!stands(side) || moved.amax() < 0.023, "{seed}: {moved:?} in {}", LABELS[*label]);
                }
            }
            let person = Person::draw(&mut Random::new(seed, Purpose::Primitives));
            for frame in &frames {
                for [knee, ankle] in [[13, 14], [16, 17]] {
                    let shank = (Vector3::from(frame[knee]) - Vector3::from(frame[ankle])).norm();
                    assert!((shank - SHANK_M * person.scale).abs() < 0.02, "{seed}: shank {shank}");
                }
            }
        }
    }
}
