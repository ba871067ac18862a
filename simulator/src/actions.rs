//! Labelled sequences of a person who walks, turns, picks and places: to learn segments from, and to compare networks on.
//!
//! What comes in: a seed. What goes out: 13 to 22 s of 19 joints at 72 Hz with one of ten labels per frame, in the form of
//! Cheema et al. 2019 (whose recordings are not published); every number here is our own. What it never does: repeat a
//! person: size, tempo, amplitudes, posture and sway are drawn anew for each sequence.
//!
//! A script draws activities; each sets targets for a few angles; the angles follow their targets like a damped spring, so that
//! one activity melts into the next. The label changes with the target.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::Vector3;

use crate::random::{Purpose, Random};
use crate::upper_body::{self, ANGLES, BEND, CROUCH, Carriage, LEAN, RAISE, SIGNS, TWIST, about, around};

/// Frames per second of every sequence.
pub const RATE_HZ: f64 = 72.0;
/// Names of the joints, in the order of [`Actions::frames`]; `l_` is the person's left, `r_` the right.
pub const JOINTS: [&str; 19] = [
    "hips",
    "spine",
    "chest",
    "neck",
    "head",
    "l_shoulder",
    "l_elbow",
    "l_wrist",
    "l_hand",
    "r_shoulder",
    "r_elbow",
    "r_wrist",
    "r_hand",
    "l_knee",
    "l_ankle",
    "l_toe",
    "r_knee",
    "r_ankle",
    "r_toe",
];
/// Names of the labels; [`Actions::labels`] holds indices of this list.
pub const LABELS: [&str; 10] = [
    "standing",
    "walking",
    "carrying",
    "turn left",
    "turn right",
    "pick left",
    "pick right",
    "place left",
    "place right",
    "idle gesture",
];

/// A labelled sequence of one person, [`RATE_HZ`] frames a second; `frames` and `labels` are of the same length.
#[derive(Clone, Debug, PartialEq)]
pub struct Actions {
    /// Positions of [`JOINTS`] frame by frame, room axes (z up), m; white noise of 2 mm per axis is in them.
    pub frames: Vec<[[f64; 3]; JOINTS.len()]>,
    /// Index in [`LABELS`] of each frame.
    pub labels: Vec<usize>,
}

/// What a person is like.
struct Person {
    scale: f64,
    tempo: f64,
    stride: f64,
    swing: f64,
    amplitude: f64,
    stiffness: f64,
    carriage: Carriage,
}

/// What is being done, for how long.
#[derive(Clone, Copy)]
struct Activity {
    label: usize,
    duration_s: f64,
    targets: [f64; ANGLES],
    /// Share of the walking speed, and angular velocity in rad/s.
    walk: f64,
    angular_velocity_rad_s: f64,
}

impl Actions {
    /// The sequence of a seed: 13 to 22 s; the same seed gives the same sequence.
    ///
    /// Joint angles follow their targets as damped springs do. There are no forces and no contact with the floor: feet slide.
    pub fn generate(seed: u64) -> Self {
        let mut random = Random::new(seed, Purpose::Actions);
        let person = Person::draw(&mut random);
        let length_s = 13.0 + 9.0 * random.uniform();
        let mut script = Script::default();
        let mut sequence = Self { frames: Vec::new(), labels: Vec::new() };
        let dt = 1.0 / RATE_HZ;
        let rest = person.carriage.rest;
        let mut angles = rest;
        let mut angular_velocities_rad_s = [0.0; ANGLES];
        let (mut position_m, mut heading) =
            ([3.0 * random.uniform(), 3.0 * random.uniform()], TAU * random.uniform());
        let (mut speed, mut turning, mut phase) = (0.0, 0.0, TAU * random.uniform());
        let mut swing = person.swing;
        let mut activity = script.next(&person, &mut random);
        let mut left_s = activity.duration_s;
        for frame in 0..(length_s * RATE_HZ) as usize {
            if left_s <= 0.0 {
                activity = script.next(&person, &mut random);
                left_s = activity.duration_s;
            }
            left_s -= dt;
            // A reach goes out and comes back within its activity.
            let done = 1.0 - (left_s / activity.duration_s).clamp(0.0, 1.0);
            let reach = if activity.label >= 5 { libm::pow(libm::sin(PI * done), 0.7) } else { 1.0 };
            for (index, angle) in angles.iter_mut().enumerate() {
                let target = rest[index] + reach * (activity.targets[index] - rest[index]);
                let pull = person.stiffness * person.stiffness * (target - *angle);
                angular_velocities_rad_s[index] +=
                    dt * (pull - 2.0 * person.stiffness * angular_velocities_rad_s[index]);
                *angle += dt * angular_velocities_rad_s[index];
            }
            speed += dt * 4.0 * (activity.walk * person.stride * person.tempo - speed);
            turning += dt * 5.0 * (activity.angular_velocity_rad_s - turning);
            heading += dt * turning;
            position_m[0] += dt * speed * libm::cos(heading);
            position_m[1] += dt * speed * libm::sin(heading);
            let moving = (speed / (person.stride * person.tempo)).max(turning.abs() / 2.5).min(1.0);
            phase += dt * PI * person.tempo * (0.3 + 0.7 * moving);
            let t_s = frame as f64 * dt;
            let swayed = person.carriage.swayed(angles, t_s);
            // Arms that carry hardly swing; they come to rest as fast as the rest of the figure.
            let free = if activity.label == 2 { 0.1 } else { person.swing };
            swing += dt * 5.0 * (free - swing);
            sequence.frames.push(person.joints(
                position_m,
                heading,
                swayed,
                phase,
                moving,
                swing,
                &mut random,
            ));
            sequence.labels.push(activity.label);
        }
        sequence
    }
}

impl Person {
    fn draw(random: &mut Random) -> Self {
        let carriage = Carriage::draw(random, 0.05);
        let mut around = |mean, spread| around(random, mean, spread);
        Self {
            scale: around(1.0, 0.1),
            tempo: around(1.9, 0.4),
            stride: around(0.65, 0.15),
            swing: around(0.45, 0.2),
            amplitude: around(1.0, 0.25),
            stiffness: around(9.0, 3.0),
            carriage,
        }
    }

    /// Positions of the joints.
    #[expect(clippy::too_many_arguments, reason = "the state of a walking figure")]
    fn joints(
        &self,
        position_m: [f64; 2],
        heading: f64,
        mut angles: [f64; ANGLES],
        phase: f64,
        moving: f64,
        swing: f64,
        random: &mut Random,
    ) -> [[f64; 3]; JOINTS.len()] {
        let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
        let size = self.scale;
        let (thigh, shank) = (0.43 * size, 0.43 * size);
        let body = about(z, heading);
        angles[TWIST] += 0.1 * moving * libm::sin(phase);
        for (side, sign) in SIGNS.into_iter().enumerate() {
            angles[RAISE[side]] += swing * moving * libm::sin(phase + sign * FRAC_PI_2);
        }
        let crouch = angles[CROUCH].max(0.0);
        let bob = 0.02 * moving * libm::cos(2.0 * phase);
        let hips = Vector3::new(
            position_m[0],
            position_m[1],
            (thigh + shank) * libm::cos(crouch) + 0.07 * size + bob,
        );
        let mut joints = [Vector3::zeros(); JOINTS.len()];
        upper_body::place(&mut joints, hips, body, &angles, size);
        for (side, sign) in SIGNS.into_iter().enumerate() {
            let step = 0.45 * moving * libm::sin(phase - sign * FRAC_PI_2);
            let lift = 0.6 * moving * libm::cos(phase - sign * FRAC_PI_2).max(0.0);
            let upper = body * about(y, -crouch - step - 0.5 * lift);
            let lower = upper * about(y, 2.0 * crouch + lift);
            let hip = hips + body * Vector3::new(0.0, 0.09 * size * sign, -0.05 * size);
            let first = 13 + 3 * side;
            joints[first] = hip - upper * z * thigh;
            joints[first + 1] = joints[first] - lower * z * shank;
            joints[first + 2] = joints[first + 1] + body * x * (0.17 * size);
        }
        upper_body::marked(joints, random)
    }
}

/// What comes after what.
#[derive(Default)]
struct Script {
    last: usize,
    /// The hand that holds something, if one does.
    held: Option<usize>,
    begun: bool,
}

impl Script {
    fn next(&mut self, person: &Person, random: &mut Random) -> Activity {
        let chance = random.uniform();
        let hand = usize::from(random.uniform() < 0.5);
        // Stand, go, turn, take, go, turn, put: with detours.
        let label = match self.last {
            _ if !self.begun => 0,
            0 if chance < 0.35 => 1 + usize::from(self.held.is_some()),
            0 if chance < 0.55 => 3 + hand,
            0 if chance < 0.65 && self.held.is_none() => 9,
            0 => self.held.map_or(5 + hand, |hand| 7 + hand),
            1 | 2 if chance < 0.4 => 3 + hand,
            1 | 2 if chance < 0.6 => self.held.map_or(5 + hand, |hand| 7 + hand),
            3 | 4 if chance < 0.5 => 1 + usize::from(self.held.is_some()),
            _ => 0,
        };
        self.begun = true;
        self.last = label;
        let mut within = |low: f64, high: f64| random.within(low, high);
        let slow = 1.9 / person.tempo;
        let mut activity = Activity {
            label,
            duration_s: 0.0,
            targets: person.carriage.rest,
            walk: 0.0,
            angular_velocity_rad_s: 0.0,
        };
        match label {
            0 => activity.duration_s = within(0.8, 2.2),
            1 | 2 => {
                activity.duration_s = within(1.2, 3.2);
                activity.walk = within(0.8, 1.1);
                if let Some(hand) = self.held {
                    activity.targets[BEND[hand]] = within(1.2, 1.7);
                    activity.targets[RAISE[hand]] = within(0.1, 0.4);
                }
            }
            3 | 4 => {
                activity.duration_s = within(0.8, 1.5) * slow;
                activity.angular_velocity_rad_s =
                    within(1.2, 2.2) * if label == 3 { 1.0 } else { -1.0 } / slow;
            }
            9 => {
                activity.duration_s = within(1.0, 2.0) * slow;
                let hand = usize::from(within(0.0, 1.0) < 0.5);
                activity.targets[BEND[hand]] = within(1.8, 2.3);
                activity.targets[RAISE[hand]] = within(0.6, 1.0) * person.amplitude;
            }
            _ => {
                let picks = label < 7;
                let hand = (label - 5) % 2;
                activity.duration_s = within(1.4, 2.4) * slow;
                // From the floor to a shelf; what is picked lies lower than what is placed, mostly.
                let low = if picks { within(0.2, 1.0) } else { within(0.0, 0.7) } * person.amplitude;
                activity.targets[LEAN] = 0.9 * low;
                activity.targets[CROUCH] = 0.6 * low;
                activity.targets[RAISE[hand]] = within(1.0, 1.7) * person.amplitude;
                activity.targets[BEND[hand]] = within(0.0, 0.3);
                activity.targets[TWIST] = within(-0.3, 0.3) + if hand == 0 { -0.2 } else { 0.2 };
                self.held = picks.then_some(hand);
            }
        }
        activity
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seventy_sequences_hold_every_label_and_no_leap() {
        let mut counts = [0_usize; LABELS.len()];
        for seed in 0..70 {
            let sequence = Actions::generate(seed);
            let length_s = sequence.frames.len() as f64 / RATE_HZ;
            assert!((12.9..22.1).contains(&length_s), "{length_s}");
            assert_eq!(sequence.frames.len(), sequence.labels.len());
            sequence.labels.iter().for_each(|label| counts[*label] += 1);
            upper_body::assert_no_leap(seed, &sequence.frames, -0.3, 2.4);
        }
        let all: usize = counts.iter().sum();
        assert!(counts.iter().all(|count| *count > all / 100), "{counts:?}");
        assert_eq!(Actions::generate(3), Actions::generate(3));
        assert_ne!(Actions::generate(3).frames[0], Actions::generate(4).frames[0]);
    }
}
