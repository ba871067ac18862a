//! How somebody stands today against the lesson.
//!
//! What comes in: the angles of the joints, frame by frame, and where they rested in the lesson. What goes out: the angles as they would
//! be if today's rest were the lesson's: other people hang their arms otherwise, and the sensors of another day sit otherwise, by angles
//! that stay the same through the movement. What it never does: change while anything moves, or touch a velocity.

use posed_state::Plain;

use super::hmm::median;
use super::joint::Joint;
use super::kinds::is_posture;
use super::material::Material;

/// Time constants of the two means of a joint which agree where it rests, s.
const FAST_S: f64 = 0.3;
const SLOW_S: f64 = 1.0;
/// So near, degrees.
const RESTS_DEG: f64 = 3.0;
/// A lesson has at least so much rest, s.
const LEAST_S: f64 = 0.8;
/// What was measured so shortly before may already be movement, s.
const DOUBT_S: f64 = 0.3;
/// Who rests farther from the lesson with any joint, degrees, is in another posture: sitting, or leaning on a table.
const FAR_DEG: f64 = 25.0;

/// The joints among some channels, and whether all of them rest.
#[derive(Clone, Debug, PartialEq, Plain)]
struct Resting {
    joints: Vec<Joined>,
    /// Shares that a frame has in the fast and in the slow mean.
    shares: [f64; 2],
}

/// A joint with its two means.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
struct Joined {
    channel: usize,
    degrees: f64,
    fast: f64,
    slow: f64,
}

impl Resting {
    fn new(channels: &[String], rate_hz: f64) -> Self {
        let joint = |(channel, name): (usize, &String)| {
            let degrees = Joint::of(name).filter(|_| is_posture(name))?.degrees;
            Some(Joined { channel, degrees, fast: f64::NAN, slow: f64::NAN })
        };
        let share = |constant_s: f64| 1.0 - libm::exp(-1.0 / (constant_s * rate_hz));
        Self {
            joints: channels.iter().enumerate().filter_map(joint).collect(),
            shares: [share(FAST_S), share(SLOW_S)],
        }
    }

    /// Takes a frame; whether all joints rest, as far as they are seen.
    fn push(&mut self, values: &[f64]) -> bool {
        let mut rests = !self.joints.is_empty();
        for joint in &mut self.joints {
            let value = values[joint.channel];
            if value.is_finite() {
                for (mean, share) in [&mut joint.fast, &mut joint.slow].into_iter().zip(self.shares) {
                    *mean = if mean.is_nan() { value } else { *mean + share * (value - *mean) };
                }
            }
            let differ_deg = (joint.fast - joint.slow).abs() * joint.degrees;
            rests &= differ_deg < RESTS_DEG || differ_deg.is_nan();
        }
        rests
    }

    fn reset(&mut self) {
        for joint in &mut self.joints {
            (joint.fast, joint.slow) = (f64::NAN, f64::NAN);
        }
    }
}

/// Where the joints of a lesson rest, a value per channel (0 of what is no joint): the middle of what they were while all of them rested
/// and no repetition was going on, in the `idle` frames. Empty where the lesson has too little of it.
pub(super) fn rest_of(material: &Material, idle: &[usize]) -> Vec<f64> {
    let width = material.width();
    let mut resting = Resting::new(&material.channels, material.rate_hz);
    let rests: Vec<bool> = material.values.chunks_exact(width).map(|values| resting.push(values)).collect();
    let rest: Vec<usize> = idle.iter().copied().filter(|frame| rests[*frame]).collect();
    if (rest.len() as f64) < LEAST_S * material.rate_hz {
        return Vec::new();
    }
    let mut at_rest = vec![0.0; width];
    for joint in &resting.joints {
        let values = rest.iter().map(|frame| material.values[frame * width + joint.channel]);
        let Some(middle) = median(values.filter(|value| value.is_finite())) else { return Vec::new() };
        at_rest[joint.channel] = middle;
    }
    at_rest
}

/// Today's posture at rest against an exercise's.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Posture {
    resting: Resting,
    /// Of the lesson, per channel.
    rest: Vec<f64>,
    /// Rings of the fast means of the latest frames at rest, joint by joint, and how many frames they hold.
    means: Vec<f64>,
    frames: usize,
    next: usize,
    /// How far today's rest is from the lesson's, per joint.
    offsets: Vec<f64>,
}

impl Posture {
    /// For the channels of an exercise and where they rested in its lesson, as [`rest_of`] has it.
    pub(super) fn new(channels: &[String], rest: &[f64], rate_hz: f64) -> Self {
        // A lesson without rest has nothing that today's could be held against.
        let channels = if rest.is_empty() { &[][..] } else { channels };
        let resting = Resting::new(channels, rate_hz);
        let joints = resting.joints.len();
        let kept = (DOUBT_S * rate_hz).ceil() as usize + 1;
        Self {
            resting,
            rest: rest.to_vec(),
            means: vec![f64::NAN; kept * joints],
            frames: 0,
            next: 0,
            offsets: vec![0.0; joints],
        }
    }

    /// Takes a frame of the exercise's channels as it came.
    pub(super) fn push(&mut self, values: &[f64]) {
        let joints = self.resting.joints.len();
        if joints == 0 {
            return;
        }
        if !self.resting.push(values) {
            self.frames = 0;
            return;
        }
        let kept = self.means.len() / joints;
        let means = &mut self.means[self.next * joints..(self.next + 1) * joints];
        means.iter_mut().zip(&self.resting.joints).for_each(|(mean, joint)| *mean = joint.fast);
        self.next = (self.next + 1) % kept;
        self.frames = kept.min(self.frames + 1);
        if self.frames < kept {
            return;
        }
        let oldest = &self.means[self.next * joints..(self.next + 1) * joints];
        // Of one that was not seen yet nothing is known.
        let offset = |(joint, mean): (&Joined, &f64)| {
            if mean.is_nan() { 0.0 } else { mean - self.rest[joint.channel] }
        };
        let pairs = || self.resting.joints.iter().zip(oldest);
        if pairs().all(|pair| offset(pair).abs() * pair.0.degrees <= FAR_DEG) {
            self.offsets.iter_mut().zip(pairs()).for_each(|(held, pair)| *held = offset(pair));
        }
    }

    /// Takes off an observation, values and then velocities, what today's rest is from the lesson's.
    pub(super) fn take_off(&self, observation: &mut [f64]) {
        for (joint, offset) in self.resting.joints.iter().zip(&self.offsets) {
            observation[joint.channel] -= offset;
        }
    }

    /// Forgets the past: the next frame follows a gap, and may be of somebody else.
    pub(super) fn reset(&mut self) {
        self.resting.reset();
        self.frames = 0;
        self.offsets.fill(0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE_HZ: f64 = 25.0;

    fn posture() -> Posture {
        let channels = ["elbow_flexion_deg", "shoulder_flexion_deg"].map(str::to_owned);
        Posture::new(&channels, &[10.0, 5.0], RATE_HZ)
    }

    /// What is left of the values after so many seconds of them.
    fn after(posture: &mut Posture, seconds: f64, values: impl Fn(f64) -> [f64; 2]) -> [f64; 4] {
        let frames = (seconds * RATE_HZ) as u32;
        let mut left = [0.0; 4];
        for frame in 0..frames {
            let [elbow, shoulder] = values(f64::from(frame) / RATE_HZ);
            left = [elbow, shoulder, 7.0, 7.0];
            posture.push(&[elbow, shoulder]);
            posture.take_off(&mut left);
        }
        left
    }

    #[test]
    fn who_rests_elsewhere_is_taken_from_there_and_in_quite_another_posture_is_not() {
        let mut posture = posture();
        assert_eq!(after(&mut posture, 0.2, |_| [25.0, -5.0]), [25.0, -5.0, 7.0, 7.0], "too short");
        assert_eq!(after(&mut posture, 1.0, |_| [25.0, -5.0]), [10.0, 5.0, 7.0, 7.0]);
        // Sitting: what was known stays.
        assert_eq!(after(&mut posture, 10.0, |_| [90.0, -5.0]), [75.0, 5.0, 7.0, 7.0]);
        posture.reset();
        assert_eq!(after(&mut posture, 0.2, |_| [25.0, -5.0])[0], 25.0);
    }

    #[test]
    fn nothing_changes_while_a_joint_moves_and_its_first_moments_are_no_rest() {
        let mut posture = posture();
        after(&mut posture, 2.0, |_| [25.0, 5.0]);
        let sway = |t_s: f64| [25.0 + 40.0 * libm::sin(3.0 * t_s), 5.0];
        let left = after(&mut posture, 5.0, sway);
        let moved = sway(5.0 - 1.0 / RATE_HZ)[0];
        assert!((moved - left[0] - 15.0).abs() < 0.5, "{moved}, {left:?}");
    }
}
