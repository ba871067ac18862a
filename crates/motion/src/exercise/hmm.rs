//! The hidden Markov model of an exercise: Gaussian states from left to right, and a background.
//!
//! What comes in: observations (values, then velocities) and where the repetitions are. What goes out: a model, and
//! per frame how much likelier each state is than the background. What it never does: decode; see `viterbi`.
//!
//! Weber et al. 2011, section III, and Bloit & Rodet 2008, with these changes: one state sequence for all channels;
//! variances shrunk towards the pooled one and kept above a share of the movement's amplitude, because few repetitions
//! of one day know little of other days; a term of the log density that is bounded, so that one glitch or one strange
//! channel cannot end a repetition.

use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::align::{is_first, is_last};
use super::kinds::{is_posture, largest};

/// Frames that the pooled variance counts for.
const POOLED_FRAMES: f64 = 4.0;
/// Least standard deviation of a state as a share of the channel's amplitude: values, which shift with posture and the
/// place of the sensor, and velocities, which do not.
const FLOOR: [f64; 2] = [0.3, 0.2];
/// How far another day, and somebody else, goes and how fast, against the lesson: a standard deviation as a share of the way from the
/// movement's ends, and of the velocity.
const VARIES: f64 = 0.15;
/// Least amplitude that a channel is taken for, as a share of the largest of its kind: so much of that one a
/// misplaced sensor mixes into it, and posture shifts it as far.
const LEAST_SHARE: f64 = 0.33;
/// How far a sensor sits turned against the day it was taught, rad.
const TURNED: f64 = 0.2;
/// Standard deviation of the wide background as a share of the channel's amplitude.
const WIDE: f64 = 1.0;
/// Least standard deviation of the resting background as a share of the channel's amplitude.
const REST_FLOOR: f64 = 0.1;
/// Most that one channel can speak against a state, in half squared standard deviations.
pub(super) const WORST: f64 = 8.0;
/// The same of the angle of a joint: one that is alive and elsewhere means another movement, and one that has failed is left out
/// ([`super::frozen`]).
const WORST_POSTURE: f64 = 16.0;
/// Mean frames in a state at the taught speed.
const FRAMES_PER_STATE: f64 = 2.0;
/// Fewest states.
const FEWEST_STATES: usize = 6;

/// Means and standard deviations of Gaussians with one variance per channel, `[channel][state]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Gaussians {
    /// Mean, in the channel's unit (velocities: per second).
    pub mean: Vec<Vec<f64>>,
    /// Standard deviation, in the same.
    pub sd: Vec<Vec<f64>>,
}

/// What is known about an exercise's movement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Movement {
    /// The states in order.
    pub states: Gaussians,
    /// Background: state 0 is rest, 1 is any movement.
    pub background: Gaussians,
    /// Half the range of the mean of the largest channel of each channel's kind.
    pub amplitude: Vec<f64>,
}

impl Movement {
    /// What one of the channels does, with its velocity.
    pub(super) fn of_channel(&self, channel: usize) -> Self {
        let rows = [channel, channel + self.amplitude.len() / 2];
        let of = |gaussians: &Gaussians| Gaussians {
            mean: rows.map(|row| gaussians.mean[row].clone()).into(),
            sd: rows.map(|row| gaussians.sd[row].clone()).into(),
        };
        Self {
            states: of(&self.states),
            background: of(&self.background),
            amplitude: rows.map(|row| self.amplitude[row]).into(),
        }
    }

    /// The same movement seen by a sensor that may sit somewhat turned against the day it was taught: each axis of a vector
    /// gets a share of the others, state by state. `siblings` are the other axes of each channel's vector.
    pub(super) fn turned(&self, siblings: &[Vec<usize>]) -> Self {
        let mut turned = self.clone();
        for (channel, sds) in turned.states.sd.iter_mut().enumerate() {
            let own = channel % siblings.len();
            for other in &siblings[own] {
                for (sd, mean) in sds.iter_mut().zip(&self.states.mean[other + channel - own]) {
                    *sd = libm::hypot(*sd, TURNED * mean);
                }
            }
        }
        turned
    }

    /// The same movement as its joints do it on another day, and with somebody else: farther or less far, faster or slower. What is no
    /// joint stays as it is.
    pub(super) fn varied(&self, channels: &[String]) -> Self {
        let mut varied = self.clone();
        let width = channels.len();
        for (row, (sds, means)) in varied.states.sd.iter_mut().zip(&self.states.mean).enumerate() {
            if !is_posture(&channels[row % width]) {
                continue;
            }
            let ends = if row < width { 0.5 * (means[0] + means[means.len() - 1]) } else { 0.0 };
            for (sd, mean) in sds.iter_mut().zip(means) {
                *sd = libm::hypot(*sd, VARIES * (mean - ends));
            }
        }
        varied
    }

    /// The same movement in another tempo, the taught one being 1: so much faster along the same way.
    pub(super) fn at_tempo(&self, tempo: f64) -> Self {
        let mut faster = self.clone();
        let velocities = self.amplitude.len() / 2;
        for rows in [&mut faster.states.mean, &mut faster.states.sd] {
            rows[velocities..].iter_mut().flatten().for_each(|value| *value *= tempo);
        }
        faster.amplitude[velocities..].iter_mut().for_each(|amplitude| *amplitude *= tempo);
        faster
    }

    /// The same movement at another size, the taught one being 1: as far from rest as that, and as fast.
    pub(super) fn sized(&self, size: f64) -> Self {
        let mut sized = self.clone();
        if size == 1.0 {
            return sized;
        }
        let rests = self.background.mean.iter().map(|background| background[0]);
        for ((means, sds), rest) in sized.states.mean.iter_mut().zip(&mut sized.states.sd).zip(rests) {
            means.iter_mut().for_each(|mean| *mean = rest + size * (*mean - rest));
            sds.iter_mut().for_each(|sd| *sd *= size);
        }
        sized.amplitude.iter_mut().for_each(|amplitude| *amplitude *= size);
        sized
    }
}

/// Log densities of Gaussians, with coefficients derived once.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Density {
    states: usize,
    /// `[channel * states + state]`.
    mean: Vec<f64>,
    half_precision: Vec<f64>,
    log_norm: Vec<f64>,
    /// Sum of `log_norm` over the channels, per state.
    log_norms: Vec<f64>,
    /// Most that each channel can speak against a state.
    worst: Vec<f64>,
}

impl Density {
    /// Of the values and velocities of `channels`.
    pub(super) fn new(gaussians: &Gaussians, channels: &[String]) -> Self {
        let states = gaussians.mean.first().map_or(0, Vec::len);
        let sd = || gaussians.sd.iter().flatten();
        let log_norm: Vec<f64> =
            sd().map(|sd| -libm::log(*sd) - 0.5 * libm::log(std::f64::consts::TAU)).collect();
        let log_norms = (0..states).map(|state| log_norm.iter().skip(state).step_by(states).sum()).collect();
        Self {
            states,
            mean: gaussians.mean.iter().flatten().copied().collect(),
            half_precision: sd().map(|sd| 0.5 / (sd * sd)).collect(),
            log_norm,
            log_norms,
            worst: (0..gaussians.mean.len())
                .map(|row| {
                    if channels.get(row).is_some_and(|name| is_posture(name)) { WORST_POSTURE } else { WORST }
                })
                .collect(),
        }
    }

    /// Log density of `observation` in each state; a channel without a value (NaN) says nothing.
    pub(super) fn log_density(&self, observation: &[f64], out: &mut [f64]) {
        out.copy_from_slice(&self.log_norms);
        let channels = self.mean.chunks_exact(self.states).zip(self.half_precision.chunks_exact(self.states));
        let norms = self.log_norm.chunks_exact(self.states).zip(&self.worst);
        for ((value, (mean, half_precision)), (log_norm, worst)) in
            observation.iter().zip(channels).zip(norms)
        {
            if value.is_nan() {
                for (out, log_norm) in out.iter_mut().zip(log_norm) {
                    *out -= log_norm;
                }
                continue;
            }
            for ((out, mean), half_precision) in out.iter_mut().zip(mean).zip(half_precision) {
                let off = value - mean;
                *out -= (off * off * half_precision).min(*worst);
            }
        }
    }
}

impl Density {
    /// [`Density::log_density`] of one state.
    fn of(&self, observation: &[f64], state: usize) -> f64 {
        let mut sum = 0.0;
        for (channel, value) in observation.iter().enumerate() {
            let place = channel * self.states + state;
            if !value.is_nan() {
                let off = value - self.mean[place];
                sum +=
                    self.log_norm[place] - (off * off * self.half_precision[place]).min(self.worst[channel]);
            }
        }
        sum
    }
}

/// How much likelier than the background each state of an exercise makes a frame.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct LogRatio {
    states: Density,
    background: Density,
    /// Its channels are angles of joints: who waits may look like its ends.
    of_joints: bool,
}

impl LogRatio {
    /// Of a movement of these channels.
    pub(super) fn new(movement: &Movement, channels: &[String]) -> Self {
        Self {
            states: Density::new(&movement.states, channels),
            background: Density::new(&movement.background, channels),
            of_joints: channels.iter().any(|channel| is_posture(channel)),
        }
    }

    pub(super) fn states(&self) -> usize {
        self.states.states
    }

    /// Log of the ratio of the densities per state.
    ///
    /// # Panics
    /// `out` has another length than there are states.
    pub(super) fn write(&self, observation: &[f64], out: &mut [f64]) {
        self.states.log_density(observation, out);
        let background = self.background(observation);
        let states = out.len();
        let waiting = background.max(out[0]).max(out[states - 1]);
        for (state, out) in out.iter_mut().enumerate() {
            *out -= if self.is_end(state) { waiting } else { background };
        }
    }

    /// [`LogRatio::write`] for one state.
    pub(super) fn of(&self, observation: &[f64], state: usize) -> f64 {
        let (mut background, last) = (self.background(observation), self.states() - 1);
        if self.is_end(state) {
            let ends = [0, last].map(|end| self.states.of(observation, end));
            background = background.max(ends[0]).max(ends[1]);
        }
        self.states.of(observation, state) - background
    }

    /// Whether a state is in the first or the last part of a movement of joints. Who waits on another day, when sensors sit otherwise,
    /// or waits for another exercise, often looks more like these states than like the rest of the lesson. So they are held against
    /// waiting there, too, and a path gains nothing by it: else it would be there, and not elsewhere, when a movement begins. What
    /// is no posture (angular velocities of a watch) needs its ends: its rest is the same on all days.
    fn is_end(&self, state: usize) -> bool {
        let states = self.states();
        self.of_joints && (is_first(state, states) || is_last(state, states))
    }

    /// Log density of the mixture of rest and any movement.
    fn background(&self, observation: &[f64]) -> f64 {
        let mut parts = [0.0; 2];
        self.background.log_density(observation, &mut parts);
        let [rest, wide] = parts;
        let (low, high) = (rest.min(wide), rest.max(wide));
        // Below half the last place of 1 the other part adds nothing, which most frames need not work out.
        if low - high < -37.0 {
            return high - std::f64::consts::LN_2;
        }
        high + libm::log(0.5 * (1.0 + libm::exp(low - high)))
    }
}

/// Number of states for repetitions of `frames` frames.
pub(super) fn states_for(frames: f64) -> usize {
    ((frames / FRAMES_PER_STATE).ceil() as usize).max(FEWEST_STATES)
}

/// Cuts repetitions into `states` equal parts: the state of every frame of each, `(frame, state)`.
pub(super) fn equal_parts(segments: &[std::ops::Range<usize>], states: usize) -> Vec<Vec<(usize, usize)>> {
    let part = |segment: &std::ops::Range<usize>| {
        let length = segment.len().max(1);
        segment.clone().map(|frame| (frame, (frame - segment.start) * states / length)).collect()
    };
    segments.iter().map(part).collect()
}

/// Estimates a movement from aligned repetitions.
///
/// `observations` has the values and velocities of `kinds.len()` channels per frame, NaN where there is none; `kinds` are
/// their kinds; `alignments` gives the frames and states
/// of each repetition; `idle` the frames that belong to none.
pub(super) fn estimate(
    observations: &[f64],
    kinds: &[usize],
    states: usize,
    alignments: &[Vec<(usize, usize)>],
    idle: &[usize],
) -> Movement {
    let width = 2 * kinds.len();
    let courses: Vec<Course> =
        (0..width).map(|channel| Course::new(observations, width, channel, states, alignments)).collect();
    let sizes: Vec<f64> = courses.iter().map(|course| course.amplitude).collect();
    let (values, velocities) = sizes.split_at(width / 2);
    let amplitude = [largest(kinds, values), largest(kinds, velocities)].concat();
    let empty = || Gaussians { mean: Vec::new(), sd: Vec::new() };
    let mut model = Movement { states: empty(), background: empty(), amplitude };
    for (channel, course) in courses.into_iter().enumerate() {
        let Course { mean, variance, low, high, .. } = course;
        let size = course.amplitude.max(LEAST_SHARE * model.amplitude[channel]);
        let floor = (FLOOR[usize::from(2 * channel >= width)] * size).powi(2);
        let sd = variance.iter().map(|variance| (variance + floor).sqrt()).collect();
        let rest = spread(idle.iter().map(|frame| observations[frame * width + channel]));
        let (rest_mean, rest_sd) = rest.unwrap_or_else(|| (0.5 * (mean[0] + mean[states - 1]), size));
        model.background.mean.push(vec![rest_mean, 0.5 * (low + high)]);
        model.background.sd.push(vec![rest_sd.max(REST_FLOOR * size), WIDE * size]);
        model.states.mean.push(mean);
        model.states.sd.push(sd);
    }
    model
}

/// What a channel does in the repetitions.
struct Course {
    /// Mean and variance in each state, the variance shrunk towards the pooled one.
    mean: Vec<f64>,
    variance: Vec<f64>,
    low: f64,
    high: f64,
    /// Half the range of the mean; of a channel that stands still the width of its noise, so that it has no say.
    amplitude: f64,
}

impl Course {
    fn new(
        observations: &[f64],
        width: usize,
        channel: usize,
        states: usize,
        alignments: &[Vec<(usize, usize)>],
    ) -> Self {
        let cells = || {
            let cell = |(frame, state): &(usize, usize)| (observations[frame * width + channel], *state);
            alignments.iter().flatten().map(cell).filter(|(value, _)| value.is_finite())
        };
        let mut moments = vec![(0.0, 0.0); states];
        for (value, state) in cells() {
            moments[state].0 += 1.0;
            moments[state].1 += value;
        }
        let mean = fill(moments.iter().map(|(n, sum)| (*n > 0.0).then(|| sum / n)).collect());
        let mut squares = vec![0.0; states];
        for (value, state) in cells() {
            squares[state] += (value - mean[state]).powi(2);
        }
        let frames: f64 = moments.iter().map(|(n, _)| n).sum();
        let pooled = squares.iter().sum::<f64>() / frames.max(1.0);
        let (low, high) = range(mean.iter().copied());
        let shrunk =
            |(square, (n, _)): (&f64, &(f64, f64))| (square + POOLED_FRAMES * pooled) / (n + POOLED_FRAMES);
        let variance = squares.iter().zip(&moments).map(shrunk).collect();
        let amplitude = (0.5 * (high - low)).max(2.0 * pooled.sqrt()).max(1e-9);
        Self { mean, variance, low, high, amplitude }
    }
}

/// Fills states that no frame fell into from their neighbours.
fn fill(values: Vec<Option<f64>>) -> Vec<f64> {
    let known: Vec<(usize, f64)> =
        values.iter().enumerate().filter_map(|(state, value)| value.map(|value| (state, value))).collect();
    (0..values.len())
        .map(|state| {
            let after = known.partition_point(|(other, _)| *other < state);
            match (known.get(after.wrapping_sub(1)), known.get(after)) {
                (_, Some((other, value))) if *other == state => *value,
                (Some((a, x)), Some((b, y))) => x + (y - x) * (state - a) as f64 / (b - a) as f64,
                (Some((_, value)), None) | (None, Some((_, value))) => *value,
                (None, None) => 0.0,
            }
        })
        .collect()
}

/// Lowest and highest value.
pub(super) fn range(values: impl IntoIterator<Item = f64>) -> (f64, f64) {
    values
        .into_iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)))
}

/// Middle value; `None` of none.
pub(super) fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Mean and standard deviation of the values that are there; `None` with fewer than two.
pub(super) fn spread(values: impl Iterator<Item = f64> + Clone) -> Option<(f64, f64)> {
    let there = values.filter(|value| value.is_finite());
    let n = there.clone().count();
    if n < 2 {
        return None;
    }
    let mean = there.clone().sum::<f64>() / n as f64;
    let variance = there.map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1) as f64;
    Some((mean, variance.sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gaussians(mean: [f64; 2], sd: [f64; 2]) -> Gaussians {
        Gaussians { mean: vec![mean.to_vec(); 2], sd: vec![sd.to_vec(); 2] }
    }

    #[test]
    fn the_log_density_is_that_of_independent_gaussians() {
        let density = Density::new(&gaussians([0.0, 1.0], [1.0, 2.0]), &[]);
        let mut out = [0.0; 2];
        density.log_density(&[0.5, 1.0], &mut out);
        let gauss = |x: f64, mean: f64, sd: f64| {
            libm::exp(-0.5 * ((x - mean) / sd).powi(2)) / (sd * std::f64::consts::TAU.sqrt())
        };
        for (state, (mean, sd)) in [(0.0, 1.0), (1.0, 2.0)].into_iter().enumerate() {
            let expected = libm::log(gauss(0.5, mean, sd) * gauss(1.0, mean, sd));
            assert!((out[state] - expected).abs() < 1e-12, "{out:?}");
        }
    }

    #[test]
    fn a_missing_channel_says_nothing_and_a_glitch_has_a_limit() {
        let density = Density::new(&gaussians([0.0, 1.0], [1.0, 2.0]), &[]);
        let mut one = [0.0; 2];
        density.log_density(&[f64::NAN, f64::NAN], &mut one);
        assert_eq!(one, [0.0; 2]);
        density.log_density(&[1e6, f64::NAN], &mut one);
        assert!(one[0] > -20.0);
    }

    #[test]
    fn a_joint_that_is_elsewhere_speaks_louder_than_a_glitch() {
        let names = ["elbow_flexion_deg".to_owned()];
        let speaks = |channels: &[String], observation: [f64; 2], expected: f64| {
            let density = Density::new(&gaussians([0.0, 0.0], [1.0, 1.0]), channels);
            let spoken = density.of(&[0.0; 2], 0) - density.of(&observation, 0);
            assert!((spoken - expected).abs() < 1e-9, "{channels:?}, {observation:?}: {spoken}");
        };
        speaks(&names, [5.0, 0.0], 12.5);
        speaks(&names, [90.0, 0.0], WORST_POSTURE);
        // Neither its velocity nor what is no joint.
        speaks(&names, [0.0, 90.0], WORST);
        speaks(&["gx".to_owned()], [90.0, 0.0], WORST);
    }

    #[test]
    fn another_tempo_changes_velocities_alone() {
        let movement = Movement {
            states: gaussians([3.0, 5.0], [1.0, 2.0]),
            background: gaussians([1.0, 2.0], [1.0, 1.0]),
            amplitude: vec![2.0; 2],
        };
        let slow = movement.at_tempo(0.5);
        assert_eq!((&slow.states.mean[0], &slow.states.sd[0]), (&vec![3.0, 5.0], &vec![1.0, 2.0]));
        assert_eq!((&slow.states.mean[1], &slow.states.sd[1]), (&vec![1.5, 2.5], &vec![0.5, 1.0]));
        assert_eq!((slow.amplitude, slow.background), (vec![2.0, 1.0], movement.background.clone()));
        assert_eq!(movement.at_tempo(1.0), movement);
    }

    #[test]
    fn means_are_those_of_the_parts_and_still_channels_have_no_say() {
        // Channel 0 climbs 0, 1, .. 11 in every repetition, channel 1 stands still.
        let observations: Vec<f64> = (0..36).flat_map(|frame| [f64::from(frame % 12), 5.0]).collect();
        let alignments = equal_parts(&[0..12, 12..24, 24..36], 6);
        let movement = estimate(&observations, &[0], 6, &alignments, &[]);
        assert_eq!(movement.states.mean[0], [0.5, 2.5, 4.5, 6.5, 8.5, 10.5]);
        assert_eq!(movement.amplitude[0], 5.0);
        let ratio = LogRatio::new(&movement, &[]);
        let mut out = [0.0; 6];
        ratio.write(&[2.5, 5.0], &mut out);
        assert!(out[1] > 0.5 && out[1] > out[2] && out[5] < 0.0, "{out:?}");
    }

    #[test]
    fn states_without_frames_lie_between_their_neighbours() {
        assert_eq!(fill(vec![None, Some(1.0), None, Some(3.0), None]), [1.0, 1.0, 2.0, 3.0, 3.0]);
    }

    #[test]
    fn a_smaller_movement_is_as_far_from_rest_as_its_size_says_and_a_turned_sensor_allows_for_its_other_axes()
    {
        let pair = |mean: [f64; 2], sd: [f64; 2]| Gaussians {
            mean: vec![mean.to_vec(), vec![0.0, 4.0], vec![0.0; 2], vec![0.0; 2]],
            sd: vec![sd.to_vec(); 4],
        };
        let movement = Movement {
            states: pair([3.0, 5.0], [1.0, 2.0]),
            background: pair([1.0, 2.0], [1.0, 1.0]),
            amplitude: vec![2.0; 4],
        };
        let half = movement.sized(0.5);
        assert_eq!(
            (half.states.mean[0].as_slice(), half.states.sd[0].as_slice()),
            ([2.0, 3.0].as_slice(), [0.5, 1.0].as_slice())
        );
        assert_eq!((half.amplitude[0], &half.background), (1.0, &movement.background));
        assert_eq!(movement.sized(1.0), movement);
        let turned = movement.turned(&[vec![1], vec![]]);
        assert_eq!(turned.states.sd[0], [1.0, libm::hypot(2.0_f64, 4.0 * TURNED)]);
        assert_eq!(turned.states.sd[1..], movement.states.sd[1..]);
    }
}
