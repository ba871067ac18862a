//! How far each channel goes: its turning point, and its way there.
//!
//! What comes in: the course of a repetition, or of the states. What goes out: the state in which a channel is farthest from its ends,
//! and its way from the nearer one. The ends of a repetition are cut where the path says, a set begins and ends elsewhere than its
//! repetitions, and sensors sit otherwise each day: a way is free of all that, an angle is not.

use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::hmm::Movement;

/// The turning point of a channel, as it was taught.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Turn {
    /// The state in which the channel is farthest from its ends, from 0.
    pub state: u32,
    /// Mean way from the nearer end to the turning point, in the channel's unit; negative where it falls.
    pub way: f64,
    /// Standard deviation of the way from repetition to repetition, of a joint beside the other joints' ways.
    pub sd: f64,
}

impl Turn {
    /// The turning point of a channel of a movement, with the way that the states' means go there.
    pub(super) fn of_means(movement: &Movement, channel: usize) -> Self {
        let mean = &movement.states.mean[channel];
        let (first, last) = (mean.first().copied().unwrap_or(0.0), mean.last().copied().unwrap_or(0.0));
        let ends = 0.5 * (first + last);
        let mut state = 0;
        for (at, value) in mean.iter().enumerate() {
            if (value - ends).abs() > (mean[state] - ends).abs() {
                state = at;
            }
        }
        let outward = if mean[state] < ends { -1.0 } else { 1.0 };
        let way = way(mean.iter().map(|value| (*value, true)), outward).unwrap_or(0.0);
        Self { state: state as u32, way, sd: 0.0 }
    }

    /// The same with its mean way in these repetitions.
    pub(super) fn new<'a, V>(
        movement: &Movement,
        channel: usize,
        repetitions: impl Iterator<Item = V>,
    ) -> Self
    where
        V: Iterator<Item = (f64, bool)> + Clone + 'a,
    {
        let turn = Self::of_means(movement, channel);
        let (n, sum) = repetitions
            .filter_map(|values| turn.way_of(values))
            .fold((0.0, 0.0), |(n, sum), way| (n + 1.0, sum + way));
        Self { way: if n > 0.0 { sum / n } else { turn.way }, ..turn }
    }

    /// Where in a movement of so many states it is: 0 is the beginning, 1 the end.
    pub(super) fn phase(&self, states: usize) -> f64 {
        phase(self.state as usize, states)
    }

    /// The way of a repetition, in the same direction: of its values, and those beside it, which are not its own.
    pub(super) fn way_of(&self, values: impl Iterator<Item = (f64, bool)> + Clone) -> Option<f64> {
        way(values, self.outward())
    }

    /// 1 where the channel rises to its turning point, -1 where it falls.
    pub(super) fn outward(&self) -> f64 {
        if self.way < 0.0 { -1.0 } else { 1.0 }
    }
}

/// Where in a movement of so many states the middle of one of them is: 0 is the beginning, 1 the end.
pub(super) fn phase(state: usize, states: usize) -> f64 {
    (state as f64 + 0.5) / states as f64
}

/// From the nearer end, the least value before or after it, to the farthest point in a direction; the mean of three values each, for
/// one alone may be noise. The farthest point is one of the repetition's own values, the ends may lie beside it.
fn way(values: impl Iterator<Item = (f64, bool)> + Clone, outward: f64) -> Option<f64> {
    let there = values.filter(|(value, _)| value.is_finite());
    let smooth = there.clone().zip(there.clone().skip(1)).zip(there.skip(2));
    let out = smooth.map(|((a, b), c)| (outward * (a.0 + b.0 + c.0) / 3.0, b.1));
    let mut least = f64::INFINITY;
    let (mut farthest, mut before, mut after) = (f64::NEG_INFINITY, 0.0, 0.0);
    for (value, own) in out {
        least = least.min(value);
        after = f64::min(after, value);
        if own && value > farthest {
            (farthest, before, after) = (value, least, value);
        }
    }
    farthest.is_finite().then(|| outward * (farthest - before.max(after)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_way_is_from_the_nearer_end_and_in_its_direction() {
        let way = |values: &[f64], outward| way(values.iter().map(|value| (*value, true)), outward);
        // It begins at rest, 12 below where its repetitions end.
        assert_eq!(way(&[0.0, 0.0, 0.0, 60.0, 100.0, 100.0, 100.0, 40.0, 12.0, 12.0, 12.0], 1.0), Some(88.0));
        assert_eq!(way(&[90.0, 90.0, 90.0, 62.0, 62.0, 62.0, 90.0, 90.0, 90.0], -1.0), Some(-28.0));
        assert_eq!(way(&[1.0, f64::NAN, 2.0], 1.0), None);
    }

    #[test]
    fn an_end_may_lie_beside_a_repetition_and_a_turning_point_may_not() {
        // Cut in the middle of its way up; the one before turned at 120.
        let course = [120.0, 120.0, 120.0, 0.0, 0.0, 0.0, 60.0, 60.0, 100.0, 100.0, 100.0, 0.0, 0.0, 0.0];
        let values = course.into_iter().enumerate().map(|(at, value)| (value, at >= 6));
        assert_eq!(way(values, 1.0), Some(100.0));
    }
}
