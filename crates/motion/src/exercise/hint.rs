//! What deviates while a repetition happens: the same measure as in the feedback, of the state that is likeliest now.
//!
//! What comes in: per frame the likeliest state and the observation. What goes out: the channel that deviates
//! most, low-passed over 0.2 s, and whether the movement has for half a second been likelier to be something else. It is
//! provisional by nature: the path may still turn out another. What it never does: decide anything.

use posed_state::Plain;

use super::exercise::Exercise;
use super::feedback::{Remark, WORTH_A_WORD};

/// Time constant of the low pass, s.
const SMOOTH_S: f64 = 0.2;
/// So long below the background is an anomaly, s.
const ANOMALY_S: f64 = 0.5;

/// What deviates now, in the middle of a repetition.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Hint {
    /// Index of the exercise.
    pub exercise: usize,
    /// Index of the channel that deviates most.
    pub channel: usize,
    /// Its deviation, half the taught range of the largest channel of its kind being 1, low-passed.
    pub share: f64,
    /// The same in the channel's unit.
    pub deviation: f64,
    /// Where in the movement: 0 is the beginning, 1 the end.
    pub phase: f64,
    /// For half a second the movement has been likelier to be something else.
    pub anomaly: bool,
}

impl Hint {
    /// What to say of the channel; `None` where its deviation is not worth a word.
    pub fn remark(&self, exercise: &Exercise) -> Option<Remark> {
        let worth = self.share.abs() >= WORTH_A_WORD;
        if worth { Remark::deviation(exercise, self.channel, self.deviation, self.phase) } else { None }
    }
}

/// Follows one exercise.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Follower {
    rate_hz: f64,
    /// Low-passed deviation of each channel, as a share and in its own unit.
    smooth: Vec<[f64; 2]>,
    /// Frames for which the background has been likelier.
    below: f64,
    inside: bool,
}

impl Follower {
    pub(super) fn new(rate_hz: f64, channels: usize) -> Self {
        Self { rate_hz, smooth: vec![[0.0; 2]; channels], below: 0.0, inside: false }
    }

    /// The path is elsewhere.
    pub(super) fn leave(&mut self) {
        if self.inside {
            self.smooth.fill([0.0; 2]);
            self.below = 0.0;
            self.inside = false;
        }
    }

    /// The path is in `state` of the exercise, which is its `index`-th.
    pub(super) fn follow(
        &mut self,
        exercise: &Exercise,
        index: usize,
        state: usize,
        observation: &[f64],
        log_ratio: f64,
    ) -> Hint {
        self.inside = true;
        let weight = 1.0 - libm::exp(-1.0 / (SMOOTH_S * self.rate_hz));
        let gaussians = &exercise.movement.states;
        for (channel, smooth) in self.smooth.iter_mut().enumerate() {
            let off = observation[channel] - gaussians.mean[channel][state];
            if off.is_finite() {
                smooth[0] += weight * (off / exercise.movement.amplitude[channel] - smooth[0]);
                smooth[1] += weight * (off - smooth[1]);
            }
        }
        self.below = if log_ratio < 0.0 { self.below + 1.0 } else { 0.0 };
        let mut worst = 0;
        for (channel, smooth) in self.smooth.iter().enumerate() {
            if smooth[0].abs() > self.smooth[worst][0].abs() {
                worst = channel;
            }
        }
        let [share, deviation] = self.smooth.get(worst).copied().unwrap_or_default();
        Hint {
            exercise: index,
            channel: worst,
            share,
            deviation,
            phase: (state as f64 + 0.5) / exercise.states() as f64,
            anomaly: self.below >= ANOMALY_S * self.rate_hz,
        }
    }
}
