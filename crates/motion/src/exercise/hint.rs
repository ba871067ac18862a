//! What deviates while a repetition happens: the same measure as in the feedback, of the state that is likeliest now.
//!
//! What comes in: per frame the likeliest state and the observation. What goes out: the channel that deviates
//! most, low-passed over 0.2 s, and whether the movement has for half a second been likelier to be something else. It is
//! provisional by nature: the path may still turn out another. What it never does: decide anything.

use posed_state::Plain;

use super::exercise::Exercise;
use super::feedback::{ON_THE_WAY, TURN, astray};
use super::hmm::range;
use super::joint::Spoken;
use super::remark::{DeviationKind, MovementPhase, Remark};
use super::turns::phase;

/// Time constant of the low pass, s.
const SMOOTH_S: f64 = 0.2;
/// The likeliest state of now is right to this share of the movement: the path may be in another tempo, and what follows shows it.
const PHASE_ERROR: f64 = 0.1;
/// So long below the background is an anomaly, s.
const ANOMALY_S: f64 = 0.5;

/// What deviates now, in the middle of a repetition.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Hint {
    /// Index of the exercise.
    pub exercise: usize,
    /// Index of the channel that deviates most.
    pub channel: usize,
    /// Its deviation, the least that is worth a word being 1, low-passed; 0 where nothing is said of it, and around its turning point,
    /// which is not over yet.
    pub worth: f64,
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
        let Self { channel, deviation, phase, .. } = *self;
        let turn_phase = exercise.turns.get(channel)?.phase(exercise.states());
        let kind = DeviationKind::on_the_way(deviation);
        let place = MovementPhase::of(phase, turn_phase);
        (self.worth >= 1.0).then_some(Remark::Deviation { channel, deviation, kind, place })
    }
}

/// Follows one exercise.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Follower {
    rate_hz: f64,
    /// Low-passed deviation of each channel, in its own unit.
    smooth: Vec<f64>,
    /// Frames for which the background has been likelier.
    below: f64,
    inside: bool,
}

impl Follower {
    pub(super) fn new(rate_hz: f64, channels: usize) -> Self {
        Self { rate_hz, smooth: vec![0.0; channels], below: 0.0, inside: false }
    }

    /// The path is elsewhere.
    pub(super) fn leave(&mut self) {
        if self.inside {
            self.smooth.fill(0.0);
            self.below = 0.0;
            self.inside = false;
        }
    }

    /// The path is in `state` of the exercise, which is its `index`-th.
    pub(super) fn follow(
        &mut self,
        (index, exercise): (usize, &Exercise),
        spoken: &[Option<Spoken>],
        state: usize,
        observation: &[f64],
        log_ratio: f64,
    ) -> Hint {
        self.inside = true;
        let weight = 1.0 - libm::exp(-1.0 / (SMOOTH_S * self.rate_hz));
        let gaussians = &exercise.movement.states;
        let states = exercise.states();
        let phase = phase(state, states);
        let (mut channel, mut worth) = (0, 0.0);
        for (at, smooth) in self.smooth.iter_mut().enumerate() {
            let off = beyond(observation[at], &gaussians.mean[at], state);
            if off.is_finite() {
                *smooth += weight * (off - *smooth);
            }
            let Some((spoken, turn)) = spoken[at].zip(exercise.turns.get(at)) else { continue };
            let turns = (phase - turn.phase(states)).abs() <= TURN;
            let defined = spoken.is_defined_in(observation, &gaussians.mean, state);
            if defined && !turns && ON_THE_WAY.contains(&phase) {
                let here = smooth.abs() / astray(exercise, &spoken, at, state);
                if here > worth {
                    (channel, worth) = (at, here);
                }
            }
        }
        self.below = if log_ratio < 0.0 { self.below + 1.0 } else { 0.0 };
        let deviation = self.smooth.get(channel).copied().unwrap_or_default();
        let anomaly = self.below >= ANOMALY_S * self.rate_hz;
        Hint { exercise: index, channel, worth, deviation, phase, anomaly }
    }
}

/// By how much a value is beyond the means of the states around `state`.
fn beyond(value: f64, means: &[f64], state: usize) -> f64 {
    let error = (PHASE_ERROR * means.len() as f64).round() as usize;
    let around = &means[state.saturating_sub(error)..(state + error + 1).min(means.len())];
    let (low, high) = range(around.iter().copied());
    value - value.max(low).min(high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_of_a_state_nearby_does_not_deviate() {
        let means: Vec<f64> = (0..30).map(|state| 10.0 * f64::from(state)).collect();
        let off = [180.0, 150.0, 119.0, 181.0, 100.0].map(|value| beyond(value, &means, 15));
        assert_eq!(off, [0.0, 0.0, -1.0, 1.0, -20.0]);
        assert_eq!((beyond(0.0, &means, 0), beyond(300.0, &means, 29)), (0.0, 10.0));
        assert!(beyond(f64::NAN, &means, 15).is_nan());
    }
}
