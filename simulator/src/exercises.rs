//! People who exercise: joint angles over time with the true repetitions, for measuring counters.
//!
//! What comes in: a person, an exercise, a seed. What goes out: sets of repetitions, and everything that is none: walking,
//! drinking, half and aborted repetitions, joints in the wrong phase. It has no bodies and no sensors: the angles
//! are those that an estimate of the body would give, with its noise, its offsets and its crosstalk.
//!
//! How people differ: tempo, range of movement, holds, steadiness, fatigue, noise, and how the sensors sit: offsets of
//! some degrees and a share of each angle that leaks into others, partly anew on each day.

use std::f64::consts::TAU;

use crate::ease::minimum_jerk;
use crate::random::{Purpose, Random};

/// Samples per second of every recording.
pub const RATE_HZ: f64 = 100.0;
/// Names of the angles of a sample, degrees, in their order; all of the right side.
pub const ANGLES: [&str; 7] = [
    "shoulder_flexion_deg",
    "shoulder_abduction_deg",
    "elbow_flexion_deg",
    "elbow_pronation_deg",
    "hip_flexion_deg",
    "knee_flexion_deg",
    "trunk_flexion_deg",
];
const WIDTH: usize = ANGLES.len();

/// Angles while somebody stands, degrees.
const STANDING: [f64; WIDTH] = [4.0, 6.0, 12.0, 0.0, 4.0, 5.0, 3.0];

/// An exercise that a person can repeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exercise {
    /// The elbow bends with a weight, palm up.
    Curl,
    /// Standing, the hands on a wall.
    WallPushUp,
    /// Hips and knees bend, the arms go forward.
    Squat,
    /// The straight arm to the side.
    ShoulderRaise,
    /// One thigh to the horizontal.
    KneeLift,
}

impl Exercise {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::Curl, Self::WallPushUp, Self::Squat, Self::ShoulderRaise, Self::KneeLift];

    /// Its name in plain words, in lower case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Curl => "curl",
            Self::WallPushUp => "wall push-up",
            Self::Squat => "squat",
            Self::ShoulderRaise => "shoulder raise",
            Self::KneeLift => "knee lift",
        }
    }

    /// Angles between repetitions, degrees.
    fn low(self) -> [f64; WIDTH] {
        match self {
            Self::WallPushUp => [85.0, 12.0, 15.0, 60.0, 4.0, 5.0, 4.0],
            _ => STANDING,
        }
    }

    /// What is added to them at the turning point, degrees.
    fn reach(self) -> [f64; WIDTH] {
        match self {
            Self::Curl => [10.0, 2.0, 118.0, -35.0, 0.0, 0.0, -2.0],
            Self::WallPushUp => [-28.0, 24.0, 85.0, 0.0, 2.0, 1.0, 6.0],
            Self::Squat => [62.0, 3.0, 2.0, 0.0, 82.0, 92.0, 30.0],
            Self::ShoulderRaise => [12.0, 86.0, 8.0, 0.0, 0.0, 0.0, -2.0],
            Self::KneeLift => [-8.0, 2.0, 4.0, 0.0, 84.0, 90.0, 4.0],
        }
    }

    /// Duration of a repetition at an ordinary pace, s.
    fn duration_s(self) -> f64 {
        match self {
            Self::Curl => 2.6,
            Self::WallPushUp => 2.8,
            Self::Squat => 3.2,
            Self::ShoulderRaise => 2.8,
            Self::KneeLift => 2.2,
        }
    }

    /// Indices in [`ANGLES`] of the angles that take part by 40 degrees and more.
    pub fn main_angles(self) -> impl Iterator<Item = usize> {
        self.reach().into_iter().enumerate().filter(|(_, reach)| reach.abs() >= 40.0).map(|(angle, _)| angle)
    }
}

/// Somebody: tempo, range of movement, unsteadiness, fatigue, and how this person's sensors always sit.
#[derive(Clone, Debug)]
pub struct Person {
    seed: u64,
    tempo: f64,
    range: f64,
    /// Share of a repetition spent going out, held, and coming back.
    shares: [f64; 3],
    pause_s: f64,
    /// Standard deviations from repetition to repetition, as shares.
    uneven: [f64; 2],
    fatigue: f64,
    noise_deg: f64,
    tremor_deg: f64,
    /// Where this person's range of each joint differs.
    habit: [f64; WIDTH],
    offset_deg: [f64; WIDTH],
    leak: [[f64; WIDTH]; WIDTH],
}

impl Person {
    /// The `seed`-th person: the same seed gives the same person.
    pub fn new(seed: u64) -> Self {
        let mut random = Random::new(seed, Purpose::Signals(40));
        let mut between = |low: f64, high: f64| random.within(low, high);
        let (out, hold) = (between(0.36, 0.48), between(0.0, 0.12));
        Self {
            seed,
            tempo: between(0.7, 1.45),
            range: between(0.8, 1.1),
            shares: [out, hold, 1.0 - out - hold],
            pause_s: between(0.0, 0.6),
            uneven: [between(0.04, 0.11), between(0.02, 0.06)],
            fatigue: between(0.0, 0.2),
            noise_deg: between(0.3, 1.8),
            tremor_deg: between(0.1, 0.8),
            habit: std::array::from_fn(|_| between(0.9, 1.1)),
            offset_deg: std::array::from_fn(|_| between(-8.0, 8.0)),
            leak: std::array::from_fn(|row| {
                std::array::from_fn(|column| if row == column { 1.0 } else { between(-0.08, 0.08) })
            }),
        }
    }
}

/// What somebody does for a while, as an estimate of the body would show it, with the true repetitions.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    /// Angles, degrees: the seven of [`ANGLES`] for each sample, one sample after the other at [`RATE_HZ`]; noise, offsets and
    /// crosstalk are in them.
    pub angles_deg: Vec<f64>,
    /// Begin and end of every true repetition, s after the first sample.
    pub repetitions: Vec<[f64; 2]>,
}

/// How a repetition differs from how this person mostly does it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Variant {
    /// Not at all.
    Right,
    /// One angle falls short of its turning point by so many degrees.
    Short {
        /// Index of the angle in [`ANGLES`].
        angle: usize,
        /// How far it falls short, degrees.
        by_deg: f64,
    },
    /// All angles go this share of their way, from 0 to 1.
    Partly(f64),
    /// The largest angle goes one way, all others the opposite one.
    WrongPhase,
    /// The trunk leans back by so many degrees at the turning point.
    Leans(f64),
}

/// A person on one day: makes a recording piece by piece. Each call appends to the recording; all is seeded by person and day.
#[derive(Debug)]
pub struct Day {
    person: Person,
    random: Random,
    /// How the sensors sit today, on top of how they always do.
    offset_deg: [f64; WIDTH],
    drift_phase: [f64; WIDTH],
    now_deg: [f64; WIDTH],
    tremor: [f64; WIDTH],
    recording: Recording,
}

impl Day {
    /// The `day`-th day of a person, who stands: the same person and day give the same recording. Days below 1000 share no noise
    /// with those of other persons.
    pub fn new(person: &Person, day: u64) -> Self {
        let mut random = Random::new(person.seed.wrapping_mul(1000).wrapping_add(day), Purpose::Signals(41));
        Self {
            offset_deg: std::array::from_fn(|angle| person.offset_deg[angle] + 3.0 * random.normal()),
            drift_phase: std::array::from_fn(|_| TAU * random.uniform()),
            now_deg: STANDING,
            tremor: [0.0; WIDTH],
            person: person.clone(),
            random,
            recording: Recording::default(),
        }
    }

    /// Ends the day and gives its recording.
    pub fn finish(self) -> Recording {
        self.recording
    }

    /// Length of the recording so far, s.
    pub fn t_s(&self) -> f64 {
        (self.recording.angles_deg.len() / WIDTH) as f64 / RATE_HZ
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.random.within(low, high)
    }

    /// One sample of the true angles as it would be estimated.
    fn sample(&mut self, angles: [f64; WIDTH]) {
        let t_s = self.t_s();
        for row in 0..WIDTH {
            let leaked: f64 = (0..WIDTH).map(|column| self.person.leak[row][column] * angles[column]).sum();
            let drift = 1.5 * libm::sin(TAU * t_s / 47.0 + self.drift_phase[row]);
            // Unsteady hands: noise with a memory of a tenth of a second.
            self.tremor[row] = 0.9 * self.tremor[row] + 0.44 * self.person.tremor_deg * self.random.normal();
            let noise = self.person.noise_deg * self.random.normal();
            let value = leaked + self.offset_deg[row] + drift + self.tremor[row] + noise;
            self.recording.angles_deg.push(value);
        }
        self.now_deg = angles;
    }

    /// Smoothly to other angles.
    fn go(&mut self, to: [f64; WIDTH], seconds: f64) {
        let (from, samples) = (self.now_deg, (seconds * RATE_HZ).round().max(1.0) as usize);
        for sample in 1..=samples {
            let way = minimum_jerk(sample as f64 / samples as f64);
            self.sample(std::array::from_fn(|angle| from[angle] + (to[angle] - from[angle]) * way));
        }
    }

    /// Stays in the present position for `seconds`, with a slight sway.
    pub fn rest(&mut self, seconds: f64) {
        let (at, phase) = (self.now_deg, self.between(0.0, TAU));
        for sample in 0..(seconds * RATE_HZ) as usize {
            let sway = 1.2 * (libm::sin(TAU * 0.3 * sample as f64 / RATE_HZ + phase) - libm::sin(phase));
            self.sample(std::array::from_fn(|angle| {
                at[angle] + sway * if angle % 2 == 0 { 1.0 } else { -0.5 }
            }));
        }
        self.now_deg = at;
    }

    /// Takes up the position in which an exercise begins, within 1.2 s.
    pub fn prepare(&mut self, exercise: Exercise) {
        self.go(exercise.low(), 1.2);
    }

    /// Goes to standing, within 1.2 s.
    pub fn stand(&mut self) {
        self.go(STANDING, 1.2);
    }

    /// A repetition and the pause after it, `tired` from 0 to 1: a tired person is slower and goes less far.
    ///
    /// [`Variant::Right`], [`Variant::Short`] and [`Variant::Leans`] are noted as true repetitions, the others are not.
    pub fn repetition(&mut self, exercise: Exercise, variant: Variant, tired: f64) {
        let person = self.person.clone();
        let slower = 1.0 + person.fatigue * tired;
        let seconds = exercise.duration_s()
            * person.tempo
            * slower
            * (1.0 + person.uneven[0] * self.random.normal()).clamp(0.7, 1.4);
        let size = person.range
            * (1.0 - 0.3 * person.fatigue * tired)
            * (1.0 + person.uneven[1] * self.random.normal()).clamp(0.8, 1.2);
        let (low, reach) = (exercise.low(), exercise.reach());
        let largest = (0..WIDTH).max_by(|a, b| reach[*a].abs().total_cmp(&reach[*b].abs())).unwrap_or(0);
        let top: [f64; WIDTH] = std::array::from_fn(|angle| {
            let whole = reach[angle] * size * person.habit[angle];
            let way = match variant {
                Variant::Partly(share) => whole * share,
                Variant::WrongPhase if angle != largest => -whole,
                Variant::Short { angle: short, by_deg } if angle == short => whole - whole.signum() * by_deg,
                Variant::Leans(by_deg) if ANGLES[angle] == "trunk_flexion_deg" => whole - by_deg,
                _ => whole,
            };
            low[angle] + way
        });
        let start_s = self.t_s();
        self.go(top, seconds * person.shares[0]);
        self.rest(seconds * person.shares[1]);
        self.go(low, seconds * person.shares[2]);
        if matches!(variant, Variant::Right | Variant::Short { .. } | Variant::Leans(_)) {
            let end_s = self.t_s();
            self.recording.repetitions.push([start_s, end_s]);
        }
        let pause_s = person.pause_s * self.between(0.5, 1.5);
        self.rest(pause_s);
    }

    /// A set of so many repetitions of one variant, with growing fatigue: waits, takes position, repeats, stands again, waits.
    pub fn set(&mut self, exercise: Exercise, repetitions: usize, variant: Variant) {
        let wait_s = self.between(1.5, 4.0);
        self.rest(wait_s);
        self.prepare(exercise);
        let wait_s = self.between(0.3, 1.5);
        self.rest(wait_s);
        for index in 0..repetitions {
            self.repetition(exercise, variant, index as f64 / repetitions as f64);
        }
        self.rest(0.5);
        self.stand();
        let wait_s = self.between(1.5, 4.0);
        self.rest(wait_s);
    }

    /// Walks for `seconds`, then stands; no repetition is noted.
    pub fn walk(&mut self, seconds: f64) {
        let cadence_hz = self.between(0.8, 1.05);
        let size = self.between(0.8, 1.2);
        let step = |angles: [f64; WIDTH], phase: f64, size: f64| {
            let swing = libm::sin(TAU * phase);
            let knee = 0.5 - 0.5 * libm::cos(TAU * (phase - 0.1));
            let mut walking = angles;
            walking[0] += 18.0 * size * -swing;
            walking[2] += 12.0 * size * (0.5 - 0.5 * swing);
            walking[4] += 24.0 * size * swing;
            walking[5] += 52.0 * size * knee.powi(3) + 8.0;
            walking[6] += 2.0 * libm::sin(2.0 * TAU * phase);
            walking
        };
        self.go(step(STANDING, 0.0, size), 0.6);
        for sample in 0..(seconds * RATE_HZ) as usize {
            self.sample(step(STANDING, cadence_hz * sample as f64 / RATE_HZ, size));
        }
        self.stand();
    }

    /// Takes a sip: the forearm as in a curl, the arm forward, a long hold; no repetition is noted.
    pub fn drink(&mut self) {
        let (up_s, hold_s, down_s) = (self.between(0.9, 1.6), self.between(1.0, 3.0), self.between(0.8, 1.6));
        // The palm stays as it hung, or turns.
        let pronation = self.between(-45.0, 45.0);
        self.stand();
        self.go([42.0, 18.0, 118.0, pronation, 4.0, 5.0, 0.0], up_s);
        self.rest(hold_s);
        self.go(STANDING, down_s);
    }

    /// Waves: the bent arm goes up to the side and comes down again, some times.
    pub fn wave(&mut self) {
        let elbow = self.between(75.0, 110.0);
        self.go([10.0, 12.0, elbow, 20.0, 4.0, 5.0, 3.0], 0.8);
        for _ in 0..3 + self.between(0.0, 5.0) as usize {
            let (up, seconds) = (self.between(60.0, 95.0), self.between(0.5, 1.4));
            self.go([14.0, up, elbow + 8.0, 10.0, 4.0, 5.0, 2.0], seconds);
            self.go([10.0, 20.0, elbow, 20.0, 4.0, 5.0, 3.0], seconds);
        }
        self.stand();
    }

    /// At least so many seconds of movement that is no repetition of anything: the last piece is finished.
    pub fn other(&mut self, seconds: f64) {
        let end_s = self.t_s() + seconds;
        while self.t_s() < end_s {
            let what = self.between(0.0, 7.0) as usize;
            let exercise = Exercise::ALL[self.between(0.0, 4.999) as usize];
            match what {
                0 => {
                    let seconds = self.between(5.0, 20.0);
                    self.walk(seconds);
                }
                1 => self.drink(),
                2 => {
                    let seconds = self.between(2.0, 6.0);
                    self.rest(seconds);
                }
                6 => self.wave(),
                kind => {
                    self.prepare(exercise);
                    let times = 1 + self.between(0.0, 5.0) as usize;
                    for _ in 0..times {
                        let variant = match kind {
                            // A single joint has no phase to others.
                            5 if exercise.main_angles().count() < 2 => Variant::Partly(0.5),
                            3 => Variant::Partly(0.5),
                            4 => Variant::Partly(self.between(0.15, 0.45)),
                            _ => Variant::WrongPhase,
                        };
                        self.repetition(exercise, variant, 0.0);
                    }
                    self.stand();
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_has_its_repetitions_where_the_main_angle_turns() {
        for exercise in Exercise::ALL {
            let person = Person::new(3);
            let mut day = Day::new(&person, 1);
            day.set(exercise, 6, Variant::Right);
            let recording = day.finish();
            assert_eq!(recording.repetitions.len(), 6);
            let angle = exercise.main_angles().next().unwrap();
            let at = |t_s: f64| recording.angles_deg[(t_s * RATE_HZ) as usize * WIDTH + angle];
            for [start, end] in recording.repetitions {
                let (low, top) = (at(start), at(start + 0.5 * (end - start)));
                assert!((top - low).abs() > 0.5 * exercise.reach()[angle].abs(), "{exercise:?}: {low} {top}");
            }
        }
    }

    #[test]
    fn the_same_day_repeats_and_days_differ() {
        let recording = |day| {
            let mut day = Day::new(&Person::new(1), day);
            day.other(20.0);
            day.finish().angles_deg
        };
        assert_eq!(recording(1), recording(1));
        assert_ne!(recording(1), recording(2));
    }

    #[test]
    fn a_deficit_is_as_large_as_stated_and_in_one_angle() {
        let person = Person { uneven: [0.0; 2], ..Person::new(2) };
        let top = |variant| {
            let mut day = Day::new(&person, 1);
            day.prepare(Exercise::Squat);
            day.repetition(Exercise::Squat, variant, 0.0);
            let recording = day.finish();
            let [start, end] = recording.repetitions[0];
            let row = ((start + (person.shares[0] + 0.02) * (end - start)) * RATE_HZ) as usize * WIDTH;
            recording.angles_deg[row + 5]
        };
        let off = top(Variant::Right) - top(Variant::Short { angle: 5, by_deg: 20.0 });
        assert!((off - 20.0).abs() < 8.0 * person.noise_deg.max(0.5), "{off}");
    }
}
