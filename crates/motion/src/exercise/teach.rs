//! Teaching: from one recording of a few repetitions to an exercise.
//!
//! What comes in: a stream, a name, the announced number of repetitions. What goes out: the exercise and a report of
//! where the repetitions were, or a refusal with its reason. What it never does: teach from a demonstration in which it does
//! not see what was announced.
//!
//! Weber et al. 2011, section III: how the repetitions are found is in [`super::hypothesis`].

use std::ops::Range;

use super::align::Repetition;
use super::choice::{self, ASKED_FOR, TriedChannels, because, choose, sets_of};
use super::exercise::{Durations, Exercise, Gate};
use super::feedback::{beside, log_jerk, spread};
use super::hmm::{LogRatio, estimate, median, range};
use super::hypothesis::{Hypothesis, SHORTEST_S, idle, see};
use super::joint::{Joint, Spoken};
use super::judge::{Measures, measure};
use super::kinds::{is_posture, kinds, siblings};
use super::material::{Material, RATE_HZ, Stream};
use super::posture::rest_of;
use super::report::{Report, TaughtRepetition, hidden, reason_of, remarks_of};
use super::smaller::{LEAST_GAIN, interval, sizes_down_to};
use super::still::stills;
use super::turns::Turn;

/// Most passes through a lesson, each without some of its repetitions.
const FOLDS: usize = 8;

/// Frames per second while hypotheses are compared.
pub(super) const SEARCH_HZ: f64 = 12.5;
/// Least log ratio per frame of a repetition that counts, the taught median being 1: other days are less alike.
const LEAST_RATIO: f64 = 0.15;

/// A joint that goes so far in a demonstration moves, degrees.
const MOVES_DEG: f64 = 30.0;

/// Tempi in which joints are looked for, the taught one being 1: the states' deviations cover what lies between them.
const TEMPI: [f64; 3] = [1.0, 1.4, 0.7];

/// Least size of a repetition that shows how far a movement goes, the taught one being 1.
const FULL_SIZE: f64 = 0.75;

/// Steps of Weber et al. 2011, section III, as the paper has them, in place of ours. The default: none of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AsPublished {
    /// The density of a subsequence is that of its k-th neighbour for k repetitions, which is never one of them: ours takes the (k - 1)-th.
    pub kth_neighbour: bool,
    /// Each channel is decoded by itself: ours has one state sequence for all. The paper leaves open how the channels come together: here the
    /// channel decides of whose repetitions most are seen in half of the channels at least.
    pub per_channel: bool,
}

/// What to teach, as announced by the person who shows it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Options {
    /// Name of the exercise, as in events.
    pub name: String,
    /// How many repetitions the recording holds; at least 2.
    pub repetitions: usize,
    /// Channels to use, as `all_channels` names them; chosen automatically by how much they move when not named.
    pub channels: Option<Vec<String>>,
    /// How repetitions are found.
    pub as_published: AsPublished,
}

/// A taught exercise and how good the demonstration was.
#[derive(Clone, Debug, PartialEq)]
pub struct Lesson {
    /// The exercise.
    pub exercise: Exercise,
    /// What was seen.
    pub report: Report,
}

/// Why a demonstration was refused.
#[derive(Debug, thiserror::Error)]
pub enum Refusal {
    /// Fewer than two repetitions announced.
    #[error("an exercise is taught from at least 2 repetitions; {0} announced")]
    TooFew(usize),
    /// A channel was named that is not there.
    #[error("the recording has no channel `{0}`")]
    NoChannel(String),
    /// The recording is too short for what was announced.
    #[error("the recording lasts {seconds:.1} s: too short for {announced} repetitions")]
    TooShort {
        /// Length of the recording.
        seconds: f64,
        /// Announced repetitions.
        announced: usize,
    },
    /// Nothing in it repeats itself.
    #[error("nothing in the recording repeats itself {0} times")]
    NothingRepeats(usize),
    /// Another number than announced.
    #[error("found {} of {}: {reason}{}", report.repetitions.len(), report.announced, request(*more))]
    Count {
        /// What was seen.
        report: Box<Report>,
        /// What is wrong with it.
        reason: String,
        /// How many more repetitions make a lesson of it, done as the ones that were seen; 0 where more would not.
        more: usize,
    },
}

/// What the person is asked for.
fn request(more: usize) -> String {
    match more {
        0 => String::new(),
        1 => "; do 1 more repetition like the others, then rest".to_owned(),
        more => format!("; do {more} more repetitions like the others, then rest"),
    }
}

/// Teaches an exercise from a recording of a few repetitions. Offline; the same recording gives the same exercise.
///
/// Method: `docs/methods/exercise.md`; how well taught exercises count on other days and people: `docs/exercise.md`.
///
/// # Errors
/// Fewer than two repetitions are announced, a channel is not there, the recording is too short, nothing repeats
/// itself, or another number of repetitions than announced was seen, which the error reports.
pub fn teach(stream: &Stream<'_>, options: &Options) -> Result<Lesson, Refusal> {
    let announced = options.repetitions;
    if announced < 2 {
        return Err(Refusal::TooFew(announced));
    }
    let (coarse, fine) =
        (moving_channels(stream, options, SEARCH_HZ)?, moving_channels(stream, options, RATE_HZ)?);
    let seconds = coarse.frames() as f64 / coarse.rate_hz;
    if coarse.frames() as f64 / (announced as f64) < SHORTEST_S * coarse.rate_hz {
        return Err(Refusal::TooShort { seconds, announced });
    }
    let sets = match options.channels {
        Some(_) => vec![(0..coarse.width()).collect()],
        None => sets_of(&coarse),
    };
    let (mut tried, mut lessons): (Vec<TriedChannels>, Vec<Option<(Material, Hypothesis)>>) =
        Default::default();
    for set in &sets {
        let coarse = coarse.only(set);
        let in_fine = |name: &String| fine.channels.iter().position(|channel| channel == name);
        let fine = fine.only(&coarse.channels.iter().filter_map(in_fine).collect::<Vec<_>>());
        let seen = see(&coarse, &fine, options);
        // Where there is nothing to choose from nothing needs to be left out.
        if sets.len() == 1 {
            lessons.push(seen);
            break;
        }
        let of = match &seen {
            Some((material, hypothesis)) => held_out(material, hypothesis, options),
            None => TriedChannels::nothing(coarse.channels, announced),
        };
        // What is alike more often than announced in all channels is so whatever a part of them says.
        let is_enough = of.is_perfect() || tried.is_empty() && !of.accepted && of.of > announced;
        lessons.push(seen);
        tried.push(of);
        if is_enough {
            break;
        }
    }
    // Where none teaches what was announced, the richest that saw anything states why.
    let taken = choose(&tried).or_else(|| lessons.iter().position(Option::is_some));
    let Some((taken, (material, hypothesis))) =
        taken.and_then(|taken| Some((taken, lessons.swap_remove(taken)?)))
    else {
        return Err(Refusal::NothingRepeats(announced));
    };
    let because = if options.channels.is_some() { ASKED_FOR.to_owned() } else { because(&tried, taken) };
    let mut result = conclude(&material, &hypothesis, options);
    let report = match &mut result {
        Ok(lesson) => Some(&mut lesson.report),
        Err(Refusal::Count { report, .. }) => Some(&mut **report),
        Err(_) => None,
    };
    if let Some(report) = report {
        (report.because, report.tried) = (because, tried);
    }
    if let Ok(Lesson { exercise, report }) = &mut result {
        let spans: Vec<_> = report.repetitions.iter().map(|one| [one.t_start_s, one.t_end_s]).collect();
        exercise.still = stills(stream, exercise, &spans);
    }
    result
}

/// Leaves each repetition out once, and counts the lesson by what the others teach.
fn held_out(material: &Material, hypothesis: &Hypothesis, options: &Options) -> TriedChannels {
    let announced = options.repetitions;
    let states = hypothesis.movement.states.mean[0].len();
    let kinds = kinds(&material.channels);
    let idle = idle(hypothesis.all(), material.frames());
    let ranges = hypothesis.ranges();
    let seen = ranges.len();
    let folds = seen.min(FOLDS);
    let (mut counted, mut false_counts) = (0, 0);
    for fold in 0..folds {
        let is_kept = |index: &usize| index % folds != fold;
        let pick = |from: &[Repetition], first: usize| -> Vec<Repetition> {
            (0..from.len())
                .filter(|index| is_kept(&(first + index)))
                .map(|index| from[index].clone())
                .collect()
        };
        let found = pick(&hypothesis.found, 0);
        let smaller = pick(&hypothesis.smaller, hypothesis.found.len());
        if found.len() < 2 {
            continue;
        }
        let alignments: Vec<_> = found.iter().map(|repetition| repetition.path.clone()).collect();
        let movement = estimate(&material.observations, &kinds, states, &alignments, &idle);
        let others = Hypothesis { movement, found, smaller, score: 0.0, open: 0.0 };
        let measured = against_the_others(material, &others);
        let (hits, wrong) =
            choice::counted(&exercise_of(material, &others, &measured, options), material, &ranges);
        counted += (0..seen).filter(|index| !is_kept(index) && hits[*index]).count();
        false_counts += wrong;
    }
    let of = seen.max(announced);
    let similarities =
        against_the_others(material, hypothesis).into_iter().map(|(_, one)| one.similarity.max(0.0));
    TriedChannels {
        channels: material.channels.clone(),
        counted,
        of,
        explained: similarities.map(|similarity| similarity * similarity).sum::<f64>() / of as f64,
        false_counts: false_counts as f64 / folds.max(1) as f64,
        accepted: seen.abs_diff(announced) <= tolerance(announced),
    }
}

/// The channels that move, on a grid of at most `most_hz`.
pub(super) fn moving_channels(
    stream: &Stream<'_>,
    options: &Options,
    most_hz: f64,
) -> Result<Material, Refusal> {
    let all = Material::new(stream, options.channels.as_deref(), most_hz).map_err(Refusal::NoChannel)?;
    let moving = without_still_channels(&all);
    Ok(if options.channels.is_none() { joints_or_all(moving) } else { moving })
}

/// The angles of the joints, where one of them moves: the tilts and places of the sensors say the same once more, in words that nobody
/// understands.
fn joints_or_all(moving: Material) -> Material {
    let spoken = Spoken::of(&moving.channels);
    let middle = |channel: usize| {
        median(
            moving
                .values
                .iter()
                .skip(channel)
                .step_by(moving.width())
                .copied()
                .filter(|value| value.is_finite()),
        )
    };
    // Nor an angle that the movement loses on its way.
    let is_defined = |spoken: &Spoken| spoken.is_defined(|channel| middle(channel).unwrap_or(f64::NAN));
    let joints: Vec<usize> =
        (0..moving.width()).filter(|channel| spoken[*channel].as_ref().is_some_and(is_defined)).collect();
    let moves = |channel: &usize| {
        let degrees = Joint::of(&moving.channels[*channel]).map_or(0.0, |joint| joint.degrees);
        let column = moving.values.iter().skip(*channel).step_by(moving.width()).copied();
        let (low, high) = range(column);
        is_posture(&moving.channels[*channel]) && (high - low) * degrees >= MOVES_DEG
    };
    if joints.iter().any(moves) { moving.only(&joints) } else { moving }
}

/// Channels without a value or without any movement say nothing and would only be in the way.
fn without_still_channels(all: &Material) -> Material {
    let moving: Vec<usize> = (0..all.width())
        .filter(|channel| {
            let column = all.values.iter().skip(*channel).step_by(all.width()).copied();
            let there = column.clone().filter(|value| value.is_finite()).count();
            2 * there >= all.frames()
                && super::hmm::spread(column).is_some_and(|(mean, sd)| sd > 1e-9 * mean.abs())
        })
        .collect();
    all.only(&moving)
}

/// Judges the chosen hypothesis: the exercise, or the reason why not.
fn conclude(material: &Material, hypothesis: &Hypothesis, options: &Options) -> Result<Lesson, Refusal> {
    let announced = options.repetitions;
    let measured = against_the_others(material, hypothesis);
    let repetitions: Vec<TaughtRepetition> = measured
        .iter()
        .map(|(segment, measures)| TaughtRepetition {
            t_start_s: material.t_s(segment.start),
            t_end_s: material.t_s(segment.end),
            measures: *measures,
        })
        .collect();
    let similarities = measured.iter().map(|(_, measures)| measures.similarity);
    let quality = similarities.sum::<f64>() / measured.len() as f64;
    let mut report = Report { announced, repetitions, quality: quality.clamp(0.0, 1.0), ..Report::default() };
    let seen = report.repetitions.len();
    let hidden = hidden(material, &report.repetitions);
    let missing = announced.saturating_sub(seen);
    if missing > tolerance(announced).max(hidden.len()) || seen > announced + tolerance(announced) {
        // A lesson of which not even half is like the rest is none: what was seen may be something else.
        let more = if 2 * seen > announced { missing } else { 0 };
        let reason = reason_of(&report);
        return Err(Refusal::Count { report: Box::new(report), reason, more });
    }
    let exercise = exercise_of(material, hypothesis, &measured, options);
    report.remarks = remarks_of(&report, &exercise.durations, &hidden);
    Ok(Lesson { exercise, report })
}

/// What the repetitions teach, each with its measures against the others.
fn exercise_of(
    material: &Material,
    hypothesis: &Hypothesis,
    measured: &[(Range<usize>, Measures)],
    options: &Options,
) -> Exercise {
    let (segments, measures): (Vec<Range<usize>>, Vec<Measures>) = measured.iter().cloned().unzip();
    let lengths = || segments.iter().map(|segment| segment.len() as f64 / material.rate_hz);
    let (shortest_s, longest_s) = range(lengths());
    let durations = Durations {
        shortest_s,
        median_s: median(lengths()).unwrap_or(longest_s),
        longest_s,
        interval_s: interval(&segments).unwrap_or(0.0) / material.rate_hz,
    };
    let least = measures.iter().map(|measures| measures.gain).fold(1.0, f64::min);
    let sizes = sizes_down_to(least);
    let mut exercise = Exercise::new(
        options.name.clone(),
        material.rate_hz,
        material.channels.clone(),
        hypothesis.movement.turned(&siblings(&material.channels)).varied(&material.channels),
        durations,
        gate_of(&measures, sizes.last().copied().unwrap_or(1.0)),
    );
    exercise.sizes = sizes;
    if material.channels.iter().any(|channel| is_posture(channel)) {
        exercise.tempi = TEMPI.to_vec();
        exercise.rest = rest_of(material, &idle(hypothesis.all(), material.frames()));
    }
    let width = 2 * material.width();
    let jerks = segments.iter().map(|segment| {
        let rows = material.observations[segment.start * width..segment.end * width].chunks_exact(width);
        log_jerk(rows, &exercise)
    });
    exercise.log_jerk = jerks.sum::<f64>() / segments.len() as f64;
    find_turns(&mut exercise, material, &segments, &measures);
    exercise
}

/// Finds where each channel turns, and how far it goes there in the repetitions of full size.
fn find_turns(
    exercise: &mut Exercise,
    material: &Material,
    segments: &[Range<usize>],
    measures: &[Measures],
) {
    let width = 2 * material.width();
    let whole = || segments.iter().zip(measures).filter(|(_, measures)| measures.gain >= FULL_SIZE);
    let around = |segment: &Range<usize>| {
        let (own, pad) = (segment.clone(), beside(segment.len()));
        let frames = segment.start.saturating_sub(pad)..(segment.end + pad).min(material.frames());
        frames.map(move |frame| (&material.observations[frame * width..][..width], own.contains(&frame)))
    };
    let turn = |channel: usize| {
        let values = whole().map(|(segment, _)| around(segment).map(move |(row, own)| (row[channel], own)));
        Turn::new(&exercise.movement, channel, values)
    };
    exercise.turns = (0..material.width()).map(turn).collect();
    spread(exercise, whole().map(|(segment, _)| around(segment)));
}

/// How far the number seen may be from the number announced: people miscount long sets.
fn tolerance(announced: usize) -> usize {
    if announced < 8 { 0 } else { announced / 5 }
}

/// Every repetition with its measures against a model of the others of full size, in order.
fn against_the_others(material: &Material, hypothesis: &Hypothesis) -> Vec<(Range<usize>, Measures)> {
    let states = hypothesis.movement.states.mean[0].len();
    let alignments: Vec<_> = hypothesis.found.iter().map(|repetition| repetition.path.clone()).collect();
    let idle = idle(hypothesis.all(), material.frames());
    let kinds = kinds(&material.channels);
    let full = (0..alignments.len()).map(|left_out| {
        let mut others = alignments.clone();
        others.remove(left_out);
        (&hypothesis.found[left_out], 1.0, estimate(&material.observations, &kinds, states, &others, &idle))
    });
    let (sizes, siblings) = (sizes_down_to(0.0), siblings(&material.channels));
    let smaller = hypothesis.smaller.iter().map(|repetition| {
        let size = sizes[repetition.size];
        (repetition, size, hypothesis.movement.sized(size))
    });
    let mut measured: Vec<_> = full
        .chain(smaller)
        .map(|(repetition, size, movement)| {
            let rows = material.along(repetition.path.iter());
            let movement = movement.turned(&siblings).varied(&material.channels);
            let mut measures = measure(
                &movement,
                &LogRatio::new(&movement, &material.channels),
                &material.channels,
                material.rate_hz,
                rows,
            );
            measures.gain *= size;
            (repetition.range(states), measures)
        })
        .collect();
    measured.sort_by_key(|(range, _)| range.start);
    measured
}

/// What a repetition must be like, from how much the taught ones differ from each other.
fn gate_of(measures: &[Measures], smallest: f64) -> Gate {
    let middle = |value: fn(&Measures) -> f64| median(measures.iter().map(value)).unwrap_or(0.0);
    let lowest = |value: fn(&Measures) -> f64| measures.iter().map(value).fold(f64::INFINITY, f64::min);
    let log_ratio = middle(|m| m.mean_log_ratio).max(0.0);
    Gate {
        mean_log_ratio: LEAST_RATIO * log_ratio,
        fifth_log_ratio: (lowest(|m| m.fifth_log_ratio) - 3.0).min(-log_ratio),
        // What was taught as a repetition is one, however small.
        gain: [(LEAST_GAIN * smallest).min(0.85 * lowest(|m| m.gain)), 1.7],
        similarity: (lowest(|m| m.similarity) - 0.15).clamp(0.6, 0.75),
        duration: [0.4, 2.5],
        visited: 0.45,
    }
}
