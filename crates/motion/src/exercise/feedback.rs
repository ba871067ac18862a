//! What was off: one repetition against the taught ones.
//!
//! What comes in: the observations and states of a repetition. What goes out: the largest deviation with its channel,
//! phase and size, the tempo and the smoothness, and a sentence. What it never does: decide whether it counts.

use serde::{Deserialize, Serialize};

use super::exercise::Exercise;
use super::judge::Measures;

/// Deviations are means over this share of the movement: shorter ones are noise or alignment.
const WINDOW: f64 = 0.12;
/// Least deviation worth a word, half the taught range of the largest channel of its kind being 1.
pub(super) const WORTH_A_WORD: f64 = 0.16;
/// Tempo within these bounds is as taught.
const SAME_TEMPO: [f64; 2] = [0.75, 1.35];
/// Log dimensionless jerk above the taught one that is worth a word.
const JERKY: f64 = 1.5;
/// Channels that move less than this, the largest of their kind being 1, have no turning point worth a word.
const TURNING: f64 = 0.3;
/// Half width of the turning point, as a share of the movement.
const TURN: f64 = 0.15;

/// What deviated in a repetition from the movement as it was taught. It compares with the demonstration, which need not
/// be right itself.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Feedback {
    /// Index of the channel that deviated most.
    pub channel: usize,
    /// Its deviation there, in the channel's unit; positive is more than taught.
    pub deviation: f64,
    /// The same, half the taught range of the largest channel of its kind being 1.
    pub share: f64,
    /// The same in standard deviations of the taught movement.
    pub deviation_sd: f64,
    /// Where in the movement: 0 is the beginning, 1 the end.
    pub phase: f64,
    /// Root mean square deviation of that channel over the repetition, in standard deviations.
    pub rms_sd: f64,
    /// Range of that channel, the taught one being 1.
    pub range: f64,
    /// Duration, the taught median being 1; above 1 is slower.
    pub tempo: f64,
    /// Duration of each fifth of the movement, the taught one being 1.
    pub fifth_tempo: [f64; 5],
    /// Log dimensionless jerk above the taught one; 0.7 is twice the jerk.
    pub jerk: f64,
}

/// Compares a repetition with what was taught; `None` where no channel has a value.
pub(super) fn describe<'a>(
    exercise: &Exercise,
    measures: &Measures,
    rows: impl Iterator<Item = (&'a [f64], usize)> + Clone,
) -> Option<Feedback> {
    let states = exercise.states();
    let gaussians = &exercise.movement.states;
    let half = (0.5 * WINDOW * states as f64).max(1.0);
    let mut worst: Option<(Feedback, (bool, f64))> = None;
    for channel in 0..exercise.channels.len() {
        let (mean, sd) = (&gaussians.mean[channel], &gaussians.sd[channel]);
        let there = rows
            .clone()
            .filter(|(observation, _)| observation[channel].is_finite())
            .map(|(observation, state)| (observation[channel], state));
        let (mut n, mut square, mut low, mut high) = (0.0, 0.0, f64::INFINITY, f64::NEG_INFINITY);
        let (mut taught_low, mut taught_high) = (f64::INFINITY, f64::NEG_INFINITY);
        for (value, state) in there.clone() {
            n += 1.0;
            square += ((value - mean[state]) / sd[state]).powi(2);
            (low, high) = (low.min(value), high.max(value));
            (taught_low, taught_high) = (taught_low.min(mean[state]), taught_high.max(mean[state]));
        }
        // The largest mean deviation over a window of states.
        let (mut peak, mut turned) = ((0.0, 0.0_f64, 0.0), false);
        for centre in 0..states {
            let (mut weight, mut sum, mut sum_sd) = (0.0, 0.0, 0.0);
            for (value, state) in there.clone() {
                if (state as f64 - centre as f64).abs() <= half {
                    weight += 1.0;
                    sum += value - mean[state];
                    sum_sd += (value - mean[state]) / sd[state];
                }
            }
            if weight > 0.0 && (sum / weight).abs() > peak.1.abs() {
                peak = (sum_sd / weight, sum / weight, (centre as f64 + 0.5) / states as f64);
            }
        }
        // How far the turn is from the taught one does not depend on the alignment: it comes first.
        if let Some((turn, off)) = at_turn(exercise, channel, there.clone())
            && off.abs() >= WORTH_A_WORD * exercise.movement.amplitude[channel]
        {
            peak = (off / sd[turn], off, (turn as f64 + 0.5) / states as f64);
            turned = true;
        }
        let (deviation_sd, deviation, phase) = peak;
        let share = deviation / exercise.movement.amplitude[channel];
        let rank = (turned, share.abs());
        if n > 0.0 && worst.is_none_or(|(_, worst)| rank > worst) {
            let feedback = Feedback {
                channel,
                deviation,
                share,
                deviation_sd,
                phase,
                rms_sd: f64::sqrt(square / n),
                range: (high - low) / (taught_high - taught_low).max(1e-9),
                tempo: measures.duration_s / exercise.durations.median_s,
                fifth_tempo: [0.0; 5],
                jerk: log_jerk(rows.clone().map(|(observation, _)| observation), exercise)
                    - exercise.log_jerk,
            };
            worst = Some((feedback, rank));
        }
    }
    let (mut feedback, _) = worst?;
    for (_, state) in rows {
        feedback.fifth_tempo[(5 * state / states).min(4)] +=
            5.0 / (exercise.durations.median_s * exercise.rate_hz);
    }
    Some(feedback)
}

/// The state in which a channel turns, and how far beyond the taught turn it went; none of a channel that hardly moves.
fn at_turn(
    exercise: &Exercise,
    channel: usize,
    values: impl Iterator<Item = (f64, usize)> + Clone,
) -> Option<(usize, f64)> {
    let mean = &exercise.movement.states.mean[channel];
    let (turn, reach) = turning_point(exercise, channel);
    if reach.abs() < 2.0 * TURNING * exercise.movement.amplitude[channel] {
        return None;
    }
    let outward = reach.signum();
    // Three frames at a time: one alone may be noise.
    let later = values.clone().skip(1);
    let latest = values.clone().skip(2);
    let smooth = values.zip(later).zip(latest).map(|((a, b), c)| outward * (a.0 + b.0 + c.0) / 3.0);
    let farthest = smooth.fold(f64::NEG_INFINITY, f64::max);
    farthest.is_finite().then(|| (turn, outward * (farthest - outward * mean[turn])))
}

/// Log dimensionless jerk (Hogan & Sternad 2009) of all channels, each in units of its amplitude.
pub(super) fn log_jerk<'a>(rows: impl Iterator<Item = &'a [f64]> + Clone, exercise: &Exercise) -> f64 {
    let width = exercise.channels.len();
    let rate_hz = exercise.rate_hz;
    let (mut jerk, mut fastest, mut frames) = (0.0, 0.0_f64, 0.0);
    let later = rows.clone().skip(1);
    let latest = rows.clone().skip(2);
    for ((a, b), c) in rows.zip(later).zip(latest) {
        let (mut squared, mut speed) = (0.0, 0.0);
        for channel in 0..width {
            let scale = 1.0 / exercise.movement.amplitude[channel];
            let velocity = width + channel;
            let second = (a[velocity] - 2.0 * b[velocity] + c[velocity]) * scale * rate_hz * rate_hz;
            if second.is_finite() {
                squared += second * second;
                speed += (b[velocity] * scale).powi(2);
            }
        }
        jerk += squared / rate_hz;
        fastest = fastest.max(speed);
        frames += 1.0;
    }
    let duration_s = frames / rate_hz;
    if jerk > 0.0 && fastest > 0.0 { libm::log(duration_s.powi(3) * jerk / fastest) } else { 0.0 }
}

/// A deviation in words, as far as they do not depend on the channel's name.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Remark {
    /// A channel deviates somewhere in the movement.
    Deviation {
        /// Index of the channel.
        channel: usize,
        /// How much, in the channel's unit; positive is more than taught.
        deviation: f64,
        /// In which way.
        way: DeviationKind,
        /// Where in the movement.
        place: MovementPhase,
    },
    /// Slower or faster; the duration, the taught one being 1.
    Tempo(f64),
    /// Less smooth.
    Jerky,
}

/// In which way a channel deviates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DeviationKind {
    /// Beyond the turning point.
    TooFar,
    /// Not as far as the turning point.
    Short,
    /// A larger value elsewhere.
    TooHigh,
    /// A smaller value elsewhere.
    TooLow,
}

/// Where in the movement, relative to the turning point of the channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum MovementPhase {
    /// Its first tenth.
    Start,
    /// Before the turning point.
    WayUp,
    /// Around the turning point.
    Top,
    /// After the turning point.
    WayBack,
    /// Its last tenth.
    End,
}

impl Feedback {
    /// The one thing to say of it; `None` where all was as taught.
    pub fn remark(&self, exercise: &Exercise) -> Option<Remark> {
        if self.share.abs() >= WORTH_A_WORD {
            Remark::deviation(exercise, self.channel, self.deviation, self.phase)
        } else if !(SAME_TEMPO[0]..=SAME_TEMPO[1]).contains(&self.tempo) {
            Some(Remark::Tempo(self.tempo))
        } else {
            (self.jerk > JERKY).then_some(Remark::Jerky)
        }
    }

    /// One English sentence for the person who moves; `None` where all was as taught.
    pub fn sentence(&self, exercise: &Exercise) -> Option<String> {
        let channel = exercise.channels.get(self.channel)?;
        self.remark(exercise).map(|remark| remark.sentence(channel))
    }
}

impl Remark {
    /// That a channel deviates at a phase of the movement.
    pub(super) fn deviation(exercise: &Exercise, channel: usize, deviation: f64, phase: f64) -> Option<Self> {
        let mean = exercise.movement.states.mean.get(channel)?;
        let (turn, reach) = turning_point(exercise, channel);
        let outward = reach.signum();
        let turn_phase = (turn as f64 + 0.5) / mean.len() as f64;
        let place = if (phase - turn_phase).abs() <= TURN {
            MovementPhase::Top
        } else if phase < 0.1 {
            MovementPhase::Start
        } else if phase > 0.9 {
            MovementPhase::End
        } else if phase < turn_phase {
            MovementPhase::WayUp
        } else {
            MovementPhase::WayBack
        };
        let way = match (place == MovementPhase::Top, deviation * outward > 0.0, deviation > 0.0) {
            (true, true, _) => DeviationKind::TooFar,
            (true, false, _) => DeviationKind::Short,
            (false, _, true) => DeviationKind::TooHigh,
            (false, _, false) => DeviationKind::TooLow,
        };
        Some(Self::Deviation { channel, deviation, way, place })
    }

    /// One sentence for the person who moves; `channel` is the name of the channel it speaks of.
    pub fn sentence(&self, channel: &str) -> String {
        match *self {
            Self::Deviation { deviation, way, place, .. } => {
                let (name, unit, factor) = words(channel);
                let size = amount(deviation.abs() * factor);
                format!("{name} {size}{unit} {} {}", way.words(), place.words())
            }
            Self::Tempo(tempo) if tempo > 1.0 => {
                format!("slower than taught: {tempo:.1} times the duration")
            }
            Self::Tempo(tempo) => format!("faster than taught: {tempo:.1} times the duration"),
            Self::Jerky => "less smooth than taught".to_owned(),
        }
    }
}

impl DeviationKind {
    fn words(self) -> &'static str {
        match self {
            Self::TooFar => "too far",
            Self::Short => "short",
            Self::TooHigh => "too high",
            Self::TooLow => "too low",
        }
    }
}

impl MovementPhase {
    fn words(self) -> &'static str {
        match self {
            Self::Start => "at the start",
            Self::WayUp => "on the way up",
            Self::Top => "at the top",
            Self::WayBack => "on the way back",
            Self::End => "at the end",
        }
    }
}

/// The state in which a channel is farthest from rest, and how far.
fn turning_point(exercise: &Exercise, channel: usize) -> (usize, f64) {
    let rest = exercise.movement.background.mean[channel][0];
    let mut farthest = (0, 0.0_f64);
    for (state, value) in exercise.movement.states.mean[channel].iter().enumerate() {
        if (value - rest).abs() > farthest.1.abs() {
            farthest = (state, value - rest);
        }
    }
    farthest
}

/// A channel's name in words, its unit with a space before it, and the factor from its unit to that one.
fn words(channel: &str) -> (String, &'static str, f64) {
    let (name, unit, factor) = if let Some(name) = channel.strip_suffix("_deg") {
        (name, " degrees", 1.0)
    } else if let Some(name) = channel.strip_suffix("_rad") {
        (name, " degrees", 180.0 / std::f64::consts::PI)
    } else if let Some(name) = channel.strip_suffix("_m") {
        (name, " cm", 100.0)
    } else if let Some((name, axis)) = channel.rsplit_once("up_") {
        // A component of the vertical in sensor axes: about the angle by which that axis is lifted.
        let tilt = format!("{} tilt of {axis}", name.trim_end_matches('_').replace('_', " "));
        return (tilt.trim_start().to_owned(), " degrees", 180.0 / std::f64::consts::PI);
    } else {
        (channel, "", 1.0)
    };
    (name.replace('_', " "), unit, factor)
}

/// A number with the digits that matter to a person.
fn amount(value: f64) -> String {
    match value {
        value if value >= 10.0 => format!("{value:.0}"),
        value if value >= 1.0 => format!("{value:.1}"),
        _ => format!("{value:.2}"),
    }
}
