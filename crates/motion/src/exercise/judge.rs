//! Whether what the path calls a repetition is one.
//!
//! What comes in: the observations of a repetition and their states. What goes out: its measures, and the first one
//! that is out of the gate. The best path alone would also count half movements, slow drifts and other things that are
//! merely likelier than "any movement".

use serde::{Deserialize, Serialize};

use super::exercise::{Durations, Gate};
use super::hmm::{LogRatio, Movement, WORST, range};
use super::kinds::is_posture;

/// A joint so far from where it was taught is in another posture, degrees: half a right angle, more than people and the placing of
/// sensors differ.
pub(super) const ELSEWHERE_DEG: f64 = 45.0;
/// A movement of which a longer share is spent there is another one.
const ELSEWHERE: f64 = 0.6;
/// Shortest and longest repetition of a demonstration, the median being 1.
const UNEVEN: [f64; 2] = [0.55, 1.7];
/// Least log ratio per frame of a repetition of a demonstration, the median being 1.
const LEAST_ALIKE: f64 = 0.5;
/// Least correlation of a repetition of a demonstration with their mean.
const LEAST_SIMILARITY: f64 = 0.6;

/// Measures of one repetition, by which the gate of its exercise decides.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measures {
    /// Duration, s.
    pub duration_s: f64,
    /// Mean log ratio of exercise and background per frame, nats; above 0 the exercise is likelier.
    pub mean_log_ratio: f64,
    /// The same in its worst fifth.
    pub fifth_log_ratio: f64,
    /// Size of the movement along the taught one, which is 1, and not above how far joints went; a shift does not change it.
    pub gain: f64,
    /// Correlation with the taught movement, at most 1.
    pub similarity: f64,
    /// Share of the states visited, 0 to 1.
    pub visited: f64,
    /// Of the joint that was longest in quite another posture than taught: the share of the repetition in which it was.
    #[serde(default)]
    pub elsewhere: f64,
}

/// Why a repetition does not count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// Much shorter than taught.
    TooFast,
    /// Much longer than taught.
    TooSlow,
    /// Much smaller than taught.
    TooSmall,
    /// Much larger than taught.
    TooLarge,
    /// It went another way.
    Different,
    /// Only a part of it was done.
    Incomplete,
    /// Too soon after the one before.
    TooSoon,
}

impl Reason {
    /// The word in events.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::TooFast => "too_fast",
            Self::TooSlow => "too_slow",
            Self::TooSmall => "too_small",
            Self::TooLarge => "too_large",
            Self::Different => "different",
            Self::Incomplete => "incomplete",
            Self::TooSoon => "too_soon",
        }
    }
}

/// Measures a repetition of the channels `names`: `observation` gives the observation of each frame of `path`, whose items are states.
pub(super) fn measure<'a>(
    movement: &Movement,
    ratio: &LogRatio,
    names: &[String],
    rate_hz: f64,
    frames: impl Iterator<Item = (&'a [f64], usize)> + Clone,
) -> Measures {
    let states = ratio.states();
    let channels = movement.amplitude.len() / 2;
    let count = frames.clone().count().max(1);
    let (mut sum, mut visited, mut last) = (0.0, 0, usize::MAX);
    let mut fifths = [(0.0, 0.0); 5];
    for (observation, state) in frames.clone() {
        let log_ratio = ratio.of(observation, state);
        sum += log_ratio;
        let fifth = &mut fifths[(5 * state / states).min(4)];
        *fifth = (fifth.0 + log_ratio, fifth.1 + 1.0);
        visited += usize::from(state != last);
        last = state;
    }
    let worst = fifths.iter().filter(|fifth| fifth.1 > 0.0).map(|fifth| fifth.0 / fifth.1);
    let (mut along, mut taught, mut done) = (0.0, 0.0, 0.0);
    let (mut reached, mut whole) = (0.0, 0.0);
    let (mut joints_went, mut joints_go) = (0.0, 0.0);
    for channel in 0..channels {
        let (mean, sd) = (&movement.states.mean[channel], &movement.states.sd[channel]);
        // A glitch, or a channel that has gone elsewhere, has no say here either.
        let farthest = farthest_sds();
        let pairs = frames
            .clone()
            .map(|(observation, state)| (observation[channel], mean[state], sd[state]))
            .filter(|(value, mean, sd)| (value - mean).abs() < farthest * sd)
            .map(|(value, mean, _)| (value, mean));
        let (mut n, mut x, mut y, mut xy, mut xx, mut yy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for (value, expected) in pairs {
            n += 1.0;
            x += value;
            y += expected;
            xy += value * expected;
            xx += value * value;
            yy += expected * expected;
        }
        // A path around the turning point would find the rest of the movement in full size.
        let (low, high) = range(mean.iter().copied());
        let (lowest, highest) = range(frames.clone().map(|(_, state)| mean[state]));
        let weight = (high - low) / movement.amplitude[channel].powi(2);
        whole += weight * (high - low);
        reached += weight * (highest - lowest).max(0.0);
        let values = frames.clone().map(|(observation, _)| observation[channel]);
        if let Some(went) = way(values.clone()).filter(|_| is_posture(&names[channel])) {
            joints_went += weight * went;
            joints_go += weight * (high - low);
        }
        // A joint that says the same all the time has failed, and does not make another movement of this one.
        let (least, greatest) = range(values.clone());
        let has_failed = is_posture(&names[channel]) && least == greatest;
        if n > 0.0 && !has_failed {
            let scale = movement.amplitude[channel].powi(-2);
            along += scale * (xy - x * y / n);
            taught += scale * (yy - y * y / n);
            done += scale * (xx - x * x / n);
        }
    }
    let gain = if taught > 0.0 && whole > 0.0 { (done / taught).sqrt() * reached / whole } else { 0.0 };
    // The path stays where the joints do: who stops half-way is held against states half-way. How far joints go shows it.
    let went = if joints_go > 0.0 { joints_went / joints_go } else { f64::INFINITY };
    Measures {
        duration_s: count as f64 / rate_hz,
        mean_log_ratio: sum / count as f64,
        fifth_log_ratio: worst.fold(f64::INFINITY, f64::min),
        gain: gain.min(went),
        similarity: if taught > 0.0 && done > 0.0 { along / (taught * done).sqrt() } else { 0.0 },
        visited: visited as f64 / states as f64,
        elsewhere: elsewhere(movement, names, frames),
    }
}

/// Whether a repetition of a demonstration is like the others, whose median duration (s) and mean log ratio these are.
pub(super) fn is_alike(measures: &Measures, duration_s: f64, log_ratio: f64) -> bool {
    (UNEVEN[0]..=UNEVEN[1]).contains(&(measures.duration_s / duration_s))
        && measures.mean_log_ratio > LEAST_ALIKE * log_ratio
        && measures.fifth_log_ratio > -log_ratio
        && measures.similarity > LEAST_SIMILARITY
}

/// Of the joint that was longest in quite another posture than taught: the share of the repetition in which it was.
///
/// The path does not mind: a channel that has failed must not end a repetition, so what any channel can say against it is bounded. But
/// a joint that lives and is nowhere near is no failure, it is another exercise: half a curl bends the elbow as a push-up at the wall
/// does, with the arm elsewhere.
fn elsewhere<'a>(
    movement: &Movement,
    names: &[String],
    frames: impl Iterator<Item = (&'a [f64], usize)> + Clone,
) -> f64 {
    let share = |channel: usize| {
        let (mean, sd) = (&movement.states.mean[channel], &movement.states.sd[channel]);
        let values = frames.clone().map(|(observation, state)| (observation[channel], state));
        share_far(values.map(|(value, state)| {
            let allowed = ELSEWHERE_DEG.max(farthest_sds() * sd[state]);
            (value, (value - mean[state]).abs() > allowed)
        }))
    };
    (0..names.len()).filter(|channel| is_posture(&names[*channel])).map(share).fold(0.0, f64::max)
}

/// Share of the values that are far; 0 of a joint that says the same all the time: it has failed.
pub(super) fn share_far(values: impl Iterator<Item = (f64, bool)>) -> f64 {
    let (mut count, mut far, mut low, mut high) = (0.0, 0.0, f64::INFINITY, f64::NEG_INFINITY);
    for (value, is_far) in values.filter(|(value, _)| !value.is_nan()) {
        count += 1.0;
        far += f64::from(u8::from(is_far));
        (low, high) = (f64::min(low, value), f64::max(high, value));
    }
    if high > low { far / count } else { 0.0 }
}

/// How far a joint went, from its least to its greatest angle; `None` where it has failed, and says the same all the time, or was not seen all the time.
fn way(values: impl Iterator<Item = f64> + Clone) -> Option<f64> {
    let seen = !values.clone().any(f64::is_nan);
    let (low, high) = range(values);
    (seen && high > low).then_some(high - low)
}

/// Farther than so many standard deviations a channel's say is bounded.
fn farthest_sds() -> f64 {
    (2.0 * WORST).sqrt()
}

/// Whether a movement goes the way of the exercise, whatever its size and its tempo.
pub(super) fn goes_the_way(measures: &Measures, gate: &Gate) -> bool {
    measures.elsewhere <= ELSEWHERE && measures.similarity >= gate.similarity
}

/// The first measure that is out of the gate.
pub(super) fn judge(measures: &Measures, gate: &Gate, durations: &Durations) -> Result<(), Reason> {
    let Measures { duration_s, mean_log_ratio, fifth_log_ratio, gain, visited, .. } = *measures;
    if duration_s < gate.duration[0] * durations.shortest_s {
        Err(Reason::TooFast)
    } else if duration_s > gate.duration[1] * durations.longest_s {
        Err(Reason::TooSlow)
    } else if visited < gate.visited {
        Err(Reason::Incomplete)
    } else if gain < gate.gain[0] {
        Err(Reason::TooSmall)
    } else if gain > gate.gain[1] {
        Err(Reason::TooLarge)
    } else if !goes_the_way(measures, gate)
        || mean_log_ratio < gate.mean_log_ratio
        || fifth_log_ratio < gate.fifth_log_ratio
    {
        Err(Reason::Different)
    } else {
        Ok(())
    }
}
