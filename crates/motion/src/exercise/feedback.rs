//! What was off: one repetition against the taught ones.
//!
//! What comes in: the observations and states of a repetition. What goes out: what deviated most with its channel, place and size, the
//! tempo, the smoothness, and a score. What it never does: decide whether it counts; speak of an angle where it is not defined, of a
//! sensor's axis, or of what is within the person's own spread.
//!
//! How far a joint goes is its way from the nearer end of the repetition to its turning point, beside how far the other joints went:
//! who tires goes less far with all of them, and that is no fault of one. On the way there and back only what is far off is worth a
//! word, and nothing in the first and the last fifth, where a set begins and ends elsewhere than its repetitions.

use serde::{Deserialize, Serialize};

use super::exercise::Exercise;
use super::hmm::range;
use super::joint::{Joint, Spoken};
use super::judge::Measures;
use super::remark::{DeviationKind, MovementPhase, Remark};
use super::score::Score;
use super::turns::phase;

/// Least way that is missing at a turning point to be worth a word, degrees; beyond it, where the lesson's own spread is larger.
const SHORT_DEG: f64 = 11.0;
/// The same of what is too much: farther than shown is seldom a fault.
const FAR_DEG: f64 = 20.0;
/// Least deviation on the way there and back that is worth a word, degrees.
const ASTRAY_DEG: f64 = 25.0;
/// Standard deviations of the lesson that are nobody's fault.
const SPREAD: f64 = 2.0;
/// The part of a repetition in which deviations on the way are worth a word.
pub(super) const ON_THE_WAY: std::ops::RangeInclusive<f64> = 0.2..=0.8;
/// Deviations on the way are means over this share of the movement: shorter ones are noise or alignment.
const WINDOW: f64 = 0.12;
/// Half width of the turning point, as a share of the movement.
pub(super) const TURN: f64 = 0.15;
/// Least way of a joint that turns: as a share of the one that goes farthest, and in degrees.
const LEAST_WAY: f64 = 0.2;
const LEAST_WAY_DEG: f64 = 15.0;
/// Least way of a joint that turns, as a share of the range of its taught course.
const IN_PHASE: f64 = 0.7;
/// The frames beside a repetition in which its ends may lie, as a share of its duration: where the path begins and ends is where the
/// movement is likelier than rest.
const BESIDE: f64 = 0.3;
/// By how much the whole repetition may be smaller or larger before the difference is a joint's own.
const COMMON: f64 = 0.12;
/// A way that goes as taught, degrees, against which the other joints' ways are weighed: small ones alone say little about the size.
const AS_TAUGHT_DEG: f64 = 40.0;
/// Size of a movement without joints that is as taught.
const SAME_SIZE: [f64; 2] = [0.75, 1.35];
/// Tempo within these bounds is as taught, and so is what is within this factor of the lesson's own.
const SAME_TEMPO: [f64; 2] = [0.65, 1.5];
const LESSON_TEMPO: f64 = 1.15;
/// Log dimensionless jerk above the taught one that is worth a word.
const JERKY: f64 = 2.0;

/// What deviated in a repetition from the movement as it was taught. It compares with the demonstration, which need not
/// be right itself.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Feedback {
    /// Number of the channel that deviated most, for [`Exercise::channel`].
    pub channel: usize,
    /// Its deviation there, in the channel's unit; positive is more than taught. At a turning point that of its way, beside how far the
    /// other joints went.
    pub deviation: f64,
    /// The same, the least that is worth a word being 1; 0 of a channel that no word is said of.
    pub worth: f64,
    /// In which way it deviates.
    pub kind: DeviationKind,
    /// Where in the movement, relative to its turning point.
    pub place: MovementPhase,
    /// Where in the movement: 0 is the beginning, 1 the end.
    pub phase: f64,
    /// Root mean square deviation of that channel over the repetition, in standard deviations.
    pub rms_sd: f64,
    /// Range of that channel, the taught one being 1.
    pub range: f64,
    /// Size of the whole movement, the taught one being 1, where the exercise has no joints to speak of.
    pub size: Option<f64>,
    /// Duration, the taught median being 1; above 1 is slower.
    pub tempo: f64,
    /// Whether that is worth a word.
    pub off_tempo: bool,
    /// Duration of each fifth of the movement, the taught one being 1.
    pub fifth_tempo: [f64; 5],
    /// Log dimensionless jerk above the taught one; 0.7 is twice the jerk.
    pub jerk: f64,
    /// In points.
    pub score: Score,
}

impl Feedback {
    /// The one thing to say of it; `None` where all was as taught.
    pub fn remark(&self) -> Option<Remark> {
        let Self { channel, deviation, kind, place, .. } = *self;
        let size = self.size.filter(|size| !(SAME_SIZE[0]..=SAME_SIZE[1]).contains(size));
        if self.worth >= 1.0 {
            Some(Remark::Deviation { channel, deviation, kind, place })
        } else if let Some(size) = size {
            Some(Remark::Size(size))
        } else if self.off_tempo {
            Some(Remark::Tempo(self.tempo))
        } else {
            (self.jerk > JERKY).then_some(Remark::Jerky)
        }
    }
}

/// A deviation of one channel.
#[derive(Clone, Copy)]
struct Deviation {
    channel: usize,
    deviation: f64,
    worth: f64,
    kind: DeviationKind,
    place: MovementPhase,
    phase: f64,
}

/// A joint's way in a repetition and in the lesson, degrees, and the lesson's spread of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Way {
    went: f64,
    taught: f64,
    sd: f64,
}

/// Number of frames beside a repetition of so many in which its ends may lie.
pub(super) fn beside(frames: usize) -> usize {
    (BESIDE * frames as f64).ceil() as usize
}

/// Compares a repetition, whose size is so much of the taught one, with what was taught; `None` where no channel has a value. `rows` are
/// its frames with their states, `around` these and what is [`beside`] them, each with whether it is one of its own;
/// `compensation` is the joint among those that keep still that moved most with the movement, by how much, and what that is worth;
/// `ways` is room for the joints' ways.
pub(super) fn describe<'a>(
    (exercise, spoken): (&Exercise, &[Option<Spoken>]),
    measures: &Measures,
    size: f64,
    rows: impl Iterator<Item = (&'a [f64], usize)> + Clone,
    around: impl Iterator<Item = (&'a [f64], bool)> + Clone,
    compensation: Option<(usize, f64, f64)>,
    ways: &mut Vec<Option<Way>>,
) -> Option<Feedback> {
    fill(ways, exercise, spoken, size, around);
    let at_turn = (0..ways.len()).filter_map(|channel| at_turn(exercise, ways, channel));
    let largest = |best: Option<Deviation>, next: Deviation| match best {
        Some(best) if best.worth >= next.worth => Some(best),
        _ => Some(next),
    };
    let turned = at_turn.fold(None, largest);
    let compensated = compensation.map(|(still, deviation, worth)| Deviation {
        channel: exercise.channels.len() + still,
        deviation,
        worth,
        kind: DeviationKind::Moved,
        place: MovementPhase::Top,
        phase: 0.5,
    });
    // How far the turn is from the taught one does not depend on the alignment: it comes first.
    let said = turned.filter(|turned| turned.worth >= 1.0).or_else(|| {
        let astray = (0..spoken.len()).filter_map(|channel| {
            let spoken = spoken[channel]?;
            on_the_way(exercise, spoken, channel, ways[channel].is_some(), rows.clone())
        });
        astray.chain(turned).chain(compensated).fold(None, largest)
    });
    let most = said.or_else(|| strangest(exercise, rows.clone()))?;
    let states = exercise.states();
    // Of a joint that keeps still no course was taught.
    let is_channel = most.channel < exercise.channels.len();
    let (rms_sd, range) = if is_channel { course(exercise, most.channel, rows.clone()) } else { (0.0, 1.0) };
    let jerk = log_jerk(rows.clone().map(|(observation, _)| observation), exercise) - exercise.log_jerk;
    let mut fifth_tempo = [0.0; 5];
    for (_, state) in rows {
        fifth_tempo[(5 * state / states).min(4)] += 5.0 / (exercise.durations.median_s * exercise.rate_hz);
    }
    let speaks = spoken.iter().any(Option::is_some);
    let duration_s = measures.duration_s;
    let durations = &exercise.durations;
    let tempo = duration_s / durations.median_s;
    let like_the_lesson = durations.shortest_s / LESSON_TEMPO..=durations.longest_s * LESSON_TEMPO;
    Some(Feedback {
        channel: most.channel,
        deviation: most.deviation,
        worth: most.worth,
        kind: most.kind,
        place: most.place,
        phase: most.phase,
        rms_sd,
        range,
        size: (!speaks).then_some(measures.gain),
        tempo,
        off_tempo: !(SAME_TEMPO[0]..=SAME_TEMPO[1]).contains(&tempo)
            && !like_the_lesson.contains(&duration_s),
        fifth_tempo,
        jerk,
        score: score(exercise, ways, measures, jerk),
    })
}

/// The ways of the joints that turn, in place of what was there.
fn fill<'a>(
    ways: &mut Vec<Option<Way>>,
    exercise: &Exercise,
    spoken: &[Option<Spoken>],
    size: f64,
    around: impl Iterator<Item = (&'a [f64], bool)> + Clone,
) {
    let of = |channel: usize| {
        let (spoken, turn) = (spoken[channel].as_ref()?, exercise.turns.get(channel)?);
        let means = &exercise.movement.states.mean;
        let taught = |other: usize| means[other][(turn.state as usize).min(means[other].len() - 1)];
        // A joint that is elsewhere in its own cycle (the other arm, by turns) has no way of its own within the repetition.
        let (low, high) = range(means[channel].iter().copied());
        (turn.way.abs() >= IN_PHASE * (high - low)).then_some(())?;
        spoken.is_defined(taught).then_some(())?;
        let went = turn.way_of(around.clone().map(|(observation, own)| (observation[channel], own)))?;
        let degrees = spoken.degrees;
        Some(Way { went: went * degrees, taught: size * turn.way * degrees, sd: turn.sd * degrees })
    };
    ways.clear();
    ways.extend((0..spoken.len()).map(of));
    let farthest = ways.iter().flatten().map(|way| way.taught.abs()).fold(0.0, f64::max);
    for way in ways {
        *way = way.filter(|way| way.taught.abs() >= LEAST_WAY_DEG.max(LEAST_WAY * farthest));
    }
}

/// How far beyond its taught turning point a joint went, degrees, beside how far the others went.
fn beyond(exercise: &Exercise, ways: &[Option<Way>], channel: usize) -> Option<f64> {
    let way = ways[channel]?;
    let joint = Joint::of(&exercise.channels[channel])?;
    let others = ways.iter().zip(&exercise.channels).filter_map(|(way, name)| {
        let other = Joint::of(name)?;
        way.filter(|_| !other.is_beside(&joint))
    });
    let as_taught = AS_TAUGHT_DEG.powi(2);
    let (went, taught) = others.fold((as_taught, as_taught), |(went, taught), other| {
        (went + other.went * other.taught, taught + other.taught.powi(2))
    });
    let size = (went / taught).clamp(1.0 - COMMON, 1.0 + COMMON);
    Some(exercise.turns[channel].outward() * (way.went - size * way.taught))
}

/// States for each channel how much its way differs from repetition to repetition of the lesson, beside the other joints' ways. The
/// rows are those around each repetition.
pub(super) fn spread<'a, R>(exercise: &mut Exercise, repetitions: impl Iterator<Item = R>)
where
    R: Iterator<Item = (&'a [f64], bool)> + Clone,
{
    let spoken = Spoken::of(&exercise.channels);
    let (mut sums, mut ways) = (vec![(0.0, 0.0); spoken.len()], Vec::new());
    for rows in repetitions {
        fill(&mut ways, exercise, &spoken, 1.0, rows);
        for (channel, (n, squares)) in sums.iter_mut().enumerate() {
            if let Some(beyond) = beyond(exercise, &ways, channel) {
                *n += 1.0;
                *squares += beyond.powi(2);
            }
        }
    }
    for ((turn, spoken), (n, squares)) in exercise.turns.iter_mut().zip(&spoken).zip(sums) {
        if let Some(spoken) = spoken {
            turn.sd = (squares / f64::max(n - 1.0, 1.0)).sqrt() / spoken.degrees;
        }
    }
}

/// The same with what is worth a word.
fn at_turn(exercise: &Exercise, ways: &[Option<Way>], channel: usize) -> Option<Deviation> {
    let (way, off) = (ways[channel]?, beyond(exercise, ways, channel)?);
    let turn = exercise.turns[channel];
    let joint = Joint::of(&exercise.channels[channel])?;
    let least = if off < 0.0 { SHORT_DEG } else { FAR_DEG };
    Some(Deviation {
        channel,
        deviation: turn.outward() * off / joint.degrees,
        worth: off.abs() / least.max(SPREAD * way.sd),
        kind: if off < 0.0 { DeviationKind::Short } else { DeviationKind::TooFar },
        place: MovementPhase::Top,
        phase: turn.phase(exercise.states()),
    })
}

/// Least deviation in a state that is worth a word, in the channel's unit: in the lesson itself the first and the last repetition may differ
/// from the others, where the next one begins before this one has ended.
pub(super) fn astray(exercise: &Exercise, spoken: &Spoken, channel: usize, state: usize) -> f64 {
    (ASTRAY_DEG / spoken.degrees).max(SPREAD * exercise.movement.states.sd[channel][state])
}

/// The largest mean deviation over a window of the way there and back.
fn on_the_way<'a>(
    exercise: &Exercise,
    spoken: Spoken,
    channel: usize,
    turns: bool,
    rows: impl Iterator<Item = (&'a [f64], usize)> + Clone,
) -> Option<Deviation> {
    let states = exercise.states();
    let means = &exercise.movement.states.mean;
    let half = 0.5 * WINDOW;
    let turn_phase = exercise.turns[channel].phase(states);
    let off = rows.filter_map(|(observation, state)| {
        let here = spoken.is_defined_in(observation, means, state);
        let off = observation[channel] - means[channel][state];
        (here && off.is_finite())
            .then(|| (phase(state, states), off, astray(exercise, &spoken, channel, state)))
    });
    let mut most: Option<(f64, f64, f64)> = None;
    for centre in (0..states).map(|state| phase(state, states)) {
        if !ON_THE_WAY.contains(&centre) || (turns && (centre - turn_phase).abs() <= TURN) {
            continue;
        }
        let near = off.clone().filter(|(at, ..)| (at - centre).abs() <= half);
        let (sum, least, n) =
            near.fold((0.0, 0.0, 0.0), |(sum, least, n), (_, off, one)| (sum + off, least + one, n + 1.0));
        let worth = f64::abs(sum) / least;
        if n > 0.0 && most.is_none_or(|(_, _, most)| worth > most) {
            most = Some((centre, sum / n, worth));
        }
    }
    let (phase, deviation, worth) = most?;
    Some(Deviation {
        channel,
        deviation,
        worth,
        kind: DeviationKind::on_the_way(deviation),
        place: MovementPhase::of(phase, turn_phase),
        phase,
    })
}

/// The channel that is farthest from what was taught in its own measure, where no word is said of any.
fn strangest<'a>(
    exercise: &Exercise,
    rows: impl Iterator<Item = (&'a [f64], usize)> + Clone,
) -> Option<Deviation> {
    let (states, gaussians) = (exercise.states(), &exercise.movement.states);
    let mut most: Option<(f64, Deviation)> = None;
    for channel in 0..exercise.channels.len() {
        let amplitude = exercise.movement.amplitude[channel];
        for (observation, state) in rows.clone() {
            let deviation = observation[channel] - gaussians.mean[channel][state];
            let share = deviation.abs() / amplitude;
            if share.is_finite() && most.is_none_or(|(most, _)| share > most) {
                let phase = phase(state, states);
                let kind = DeviationKind::on_the_way(deviation);
                let place = MovementPhase::of(phase, exercise.turns[channel].phase(states));
                most = Some((share, Deviation { channel, deviation, worth: 0.0, kind, place, phase }));
            }
        }
    }
    most.map(|(_, most)| most)
}

/// Root mean square deviation of a channel in standard deviations, and its range, the taught one being 1.
fn course<'a>(
    exercise: &Exercise,
    channel: usize,
    rows: impl Iterator<Item = (&'a [f64], usize)>,
) -> (f64, f64) {
    let gaussians = &exercise.movement.states;
    let (mean, sd) = (&gaussians.mean[channel], &gaussians.sd[channel]);
    let (mut n, mut square, mut low, mut high) = (0.0, 0.0, f64::INFINITY, f64::NEG_INFINITY);
    let (mut taught_low, mut taught_high) = (f64::INFINITY, f64::NEG_INFINITY);
    for (observation, state) in rows {
        let value = observation[channel];
        if value.is_finite() {
            n += 1.0;
            square += ((value - mean[state]) / sd[state]).powi(2);
            (low, high) = (low.min(value), high.max(value));
            (taught_low, taught_high) = (taught_low.min(mean[state]), taught_high.max(mean[state]));
        }
    }
    if n == 0.0 {
        return (0.0, 0.0);
    }
    ((square / n).sqrt(), (high - low) / (taught_high - taught_low).max(1e-9))
}

fn score(exercise: &Exercise, ways: &[Option<Way>], measures: &Measures, jerk: f64) -> Score {
    let all = || {
        let ways = ways.iter().zip(&exercise.channels).enumerate();
        ways.filter_map(|(channel, (way, name))| Some((channel, (*way)?, Joint::of(name)?)))
    };
    let other_side = |joint: &Joint<'_>| {
        all().map(|(_, way, other)| (way, other)).find(|(_, other)| {
            (other.joint, other.movement) == (joint.joint, joint.movement)
                && joint.side.zip(other.side).is_some_and(|(side, other)| side != other)
        })
    };
    // Of two sides that move by turns, the repetition is that of one: what the other one does in it depends on whether it is the first
    // or the last of a set.
    let there = || {
        all().filter_map(|(channel, way, joint)| {
            let by_turns = other_side(&joint).is_some_and(|(other, _)| other.taught * way.taught < 0.0);
            (!by_turns || begins_at_rest(exercise, channel)).then_some((way, joint, by_turns))
        })
    };
    let share = |way: &Way| way.went / way.taught;
    let (mut went, mut whole) = (0.0, 0.0);
    let (mut even, mut both) = (0.0, 0.0);
    for (way, joint, by_turns) in there() {
        went += share(&way).clamp(0.0, 1.0) * way.taught.abs();
        whole += way.taught.abs();
        if let Some((other, _)) = other_side(&joint).filter(|_| !by_turns) {
            let (a, b) = (share(&way).max(0.0), share(&other).max(0.0));
            even += way.taught.abs() * if a.max(b) > 0.0 { a.min(b) / a.max(b) } else { 0.0 };
            both += way.taught.abs();
        }
    }
    let amplitude = if whole > 0.0 { went / whole } else { measures.gain };
    let symmetry = (both > 0.0).then(|| even / both);
    Score::new(amplitude, measures.duration_s, &exercise.durations, jerk, symmetry)
}

/// Whether the taught course of a joint is nearer to its rest at the ends than at its turning point.
fn begins_at_rest(exercise: &Exercise, channel: usize) -> bool {
    let (movement, turn) = (&exercise.movement, exercise.turns[channel]);
    let rest = movement.background.mean[channel][0];
    let states = &movement.states.mean[channel];
    let turned = states[(turn.state as usize).min(states.len() - 1)];
    (turned - turn.way - rest).abs() <= (turned - rest).abs()
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
