//! Joints whose sensor has failed.
//!
//! What comes in: observations, frame by frame. What goes out: the same without the joints that say the same to the last bit for half a
//! second. What it never does: take a joint for failed that merely rests: sensors have noise. A joint that lives and is elsewhere speaks
//! against a movement, one that has failed must not.

use posed_state::Plain;

use super::kinds::is_posture;

/// So long a joint says the same before it is left out, s.
const FAILED_S: f64 = 0.5;

/// The joints of an exercise, and for how long each has said the same.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Frozen {
    joints: Vec<usize>,
    /// Value and number of frames, in the order of `joints`.
    same: Vec<(f64, u32)>,
    limit_frames: u32,
}

impl Frozen {
    /// Of these channels; what is no angle of a joint may rest without noise.
    pub(super) fn new(channels: &[String], rate_hz: f64) -> Self {
        let joints: Vec<usize> =
            (0..channels.len()).filter(|channel| is_posture(&channels[*channel])).collect();
        Self {
            same: vec![(f64::NAN, 0); joints.len()],
            joints,
            limit_frames: ((FAILED_S * rate_hz).ceil() as u32).max(2),
        }
    }

    /// Takes an observation, values and then velocities, and leaves out of it what has failed.
    pub(super) fn leave_out(&mut self, observation: &mut [f64]) {
        let width = observation.len() / 2;
        for (joint, (value, frames)) in self.joints.iter().zip(&mut self.same) {
            let now = observation[*joint];
            *frames = if now == *value { frames.saturating_add(1) } else { 0 };
            *value = now;
            if *frames >= self.limit_frames {
                observation[*joint] = f64::NAN;
                observation[width + joint] = f64::NAN;
            }
        }
    }

    /// Forgets the past: the next frame follows a gap.
    pub(super) fn reset(&mut self) {
        self.same.fill((f64::NAN, 0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_joint_that_says_the_same_is_left_out_until_it_says_something_else() {
        let mut frozen = Frozen::new(&["elbow_r_flexion_deg", "watch_gx"].map(str::to_owned), 10.0);
        let mut seen = |elbow: f64| {
            let mut observation = [elbow, 0.0, 1.0, 0.0];
            frozen.leave_out(&mut observation);
            assert!(!observation[1].is_nan() && observation[0].is_nan() == observation[2].is_nan());
            !observation[0].is_nan()
        };
        assert!((0..20).all(|frame| seen(0.01 * f64::from(frame % 2))), "one that rests");
        assert_eq!(
            (0..7).map(|_| seen(30.0)).collect::<Vec<_>>(),
            [true, true, true, true, true, false, false]
        );
        assert!(seen(31.0));
    }
}
