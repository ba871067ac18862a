//! Teaching: from one recording of a few repetitions to an exercise.
//!
//! What comes in: a stream, a name, the announced number of repetitions. What goes out: the exercise and a report of
//! where the repetitions were, or a refusal with its reason. What it never does: teach from a demonstration in which it does
//! not see what was announced.
//!
//! Weber et al. 2011, section III: period, motifs, one hidden Markov model per candidate, refinement, choice. The
//! period and the phase at which a repetition begins are not decided beforehand: each likely pair is a hypothesis that
//! is refined to the end, for decoding costs a millisecond; the one that sees the announced number wins.

use std::ops::Range;

use super::align::{Repetition, repetitions};
use super::choice::{self, ASKED_FOR, TriedChannels, because, choose, sets_of};
use super::exercise::{Durations, Exercise, Gate};
use super::feedback::{beside, log_jerk, spread};
use super::hmm::{LogRatio, Movement, equal_parts, estimate, median, range, states_for};
use super::joint::{Joint, Spoken};
use super::judge::{Measures, is_alike, measure};
use super::kinds::{is_posture, kinds, largest, siblings};
use super::material::{Material, RATE_HZ, Stream};
use super::motif::motifs;
use super::psd::{periods, repeatability};
use super::report::{Report, TaughtRepetition, hidden, reason_of, remarks_of};
use super::smaller::{LEAST_GAIN, interval, sizes_down_to, smaller};
use super::still::stills;
use super::turns::Turn;

/// Shortest repetition, s.
pub(super) const SHORTEST_S: f64 = 0.5;
/// Periods tried.
const PERIODS: usize = 6;
/// Motifs tried per period.
const MOTIFS: usize = 2;
/// Phases tried per motif.
const PHASES: usize = 8;
/// Rounds of estimation and decoding per hypothesis.
const ROUNDS: usize = 2;
/// Rounds for the chosen one.
const LAST_ROUNDS: usize = 3;
/// A channel is used if this much of its variance within repetitions is the same in all of them.
const LEAST_COMMON: f64 = 0.25;
/// A channel is used if it moves so much, the largest of its kind being 1.
const LEAST_MOVED: f64 = 0.15;

/// Most passes through a lesson, each without some of its repetitions.
const FOLDS: usize = 8;

/// Frames per second while hypotheses are compared.
pub(super) const SEARCH_HZ: f64 = 12.5;
/// Least log ratio per frame of a repetition that counts, the taught median being 1: other days are less alike.
const LEAST_RATIO: f64 = 0.15;

/// A joint that goes so far in a demonstration moves, degrees.
const MOVES_DEG: f64 = 30.0;

/// Least size of a repetition that shows how far a movement goes, the taught one being 1.
const FULL_SIZE: f64 = 0.75;

/// How much a cut in full motion costs.
const AT_REST: f64 = 0.6;

/// How much movement as strong as the repetitions', left over before and after them, costs.
const LEFT_OVER: f64 = 0.1;

/// How much a repetition costs that ends elsewhere than it began.
const OPEN: f64 = 0.6;

/// What to teach, as announced by the person who shows it.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Name of the exercise, as in events.
    pub name: String,
    /// How many repetitions the recording holds; at least 2.
    pub repetitions: usize,
    /// Channels to use, as `all_channels` names them; chosen automatically by how much they move when not named.
    pub channels: Option<Vec<String>>,
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

impl Hypothesis {
    /// The paths of all repetitions.
    fn all(&self) -> impl Iterator<Item = &Vec<(usize, usize)>> {
        self.found.iter().chain(&self.smaller).map(|repetition| &repetition.path)
    }
}

/// A way to see the recording.
struct Hypothesis {
    movement: Movement,
    /// Repetitions that are like each other.
    found: Vec<Repetition>,
    /// Those of them that are alike but smaller.
    smaller: Vec<Repetition>,
    score: f64,
    /// How far from where it began the worst of the repetitions ends, from 0 to 1: all of its way.
    open: f64,
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

/// Frames of all repetitions, those of full size first.
fn ranges_of(hypothesis: &Hypothesis) -> Vec<Range<usize>> {
    let states = hypothesis.movement.states.mean.first().map_or(0, Vec::len);
    hypothesis.found.iter().chain(&hypothesis.smaller).map(|repetition| repetition.range(states)).collect()
}

/// How the repetitions are best seen in these channels, on the grid on which hypotheses are compared and on the one on which the best is refined.
fn see(coarse: &Material, fine: &Material, options: &Options) -> Option<(Material, Hypothesis)> {
    let announced = options.repetitions;
    let longest = coarse.frames() as f64 / announced as f64;
    let shortest = SHORTEST_S * coarse.rate_hz;
    let mut hypotheses = Vec::new();
    for period in periods(&coarse.values, coarse.width(), coarse.rate_hz, [shortest, longest], PERIODS) {
        for starts in starts_of(coarse, period, announced) {
            for phase in 0..PHASES {
                let shift = (phase as f64 / PHASES as f64 - 0.5) * period;
                let segments: Vec<_> =
                    starts.iter().filter_map(|start| moved(*start, shift, period, coarse.frames())).collect();
                if segments.len() + 1 < announced {
                    continue;
                }
                let refined = refine(coarse, &segments, options, ROUNDS);
                hypotheses.extend(refined.map(|(_, hypothesis)| hypothesis));
            }
        }
    }
    let factor = fine.rate_hz / coarse.rate_hz;
    let segments: Vec<_> = segments_of(best_of(&hypotheses)?)
        .iter()
        .filter_map(|segment| {
            moved(segment.start as f64 * factor, 0.0, segment.len() as f64 * factor, fine.frames())
        })
        .collect();
    let (material, mut hypothesis) = refine(fine, &segments, options, LAST_ROUNDS)?;
    let missing = announced.saturating_sub(hypothesis.found.len());
    hypothesis.smaller = smaller(&material, &hypothesis.movement, &hypothesis.found, missing);
    Some((material, hypothesis))
}

/// Leaves each repetition out once, and counts the lesson by what the others teach.
fn held_out(material: &Material, hypothesis: &Hypothesis, options: &Options) -> TriedChannels {
    let announced = options.repetitions;
    let states = hypothesis.movement.states.mean[0].len();
    let kinds = kinds(&material.channels);
    let idle = idle(hypothesis.all(), material.frames());
    let ranges = ranges_of(hypothesis);
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

/// First what is repeated and how often; then, among the hypotheses that see it as often, where it begins and ends. The
/// second question must not decide the first: the way to a repetition is part of the path of an open one.
fn best_of(hypotheses: &[Hypothesis]) -> Option<&Hypothesis> {
    let highest = |score: fn(&Hypothesis) -> f64, count: Option<usize>| {
        let requested = hypotheses.iter().filter(|one| count.is_none_or(|count| one.found.len() == count));
        requested.reduce(|best, next| if score(next) > score(best) { next } else { best })
    };
    let often = highest(|one| one.score, None)?.found.len();
    highest(|one| one.score * (1.0 - OPEN * one.open), Some(often))
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

/// Where the motif finder sees the repetitions of a period.
fn starts_of(all: &Material, period: f64, announced: usize) -> Vec<Vec<f64>> {
    let weights = repeatability(&all.values, all.width(), period, 0..all.frames());
    let highest = weights.iter().copied().fold(0.0, f64::max);
    // What repeats itself half as well as the best channel hardly counts.
    let weights: Vec<f64> = weights.iter().map(|weight| (weight / highest.max(1e-9)).powi(2)).collect();
    let chosen: Vec<usize> = (0..weights.len()).filter(|channel| weights[*channel] > 0.1).collect();
    let scaled = all.only(&chosen).scaled(&chosen.iter().map(|c| weights[*c].sqrt()).collect::<Vec<_>>());
    motifs(&scaled, chosen.len(), period as usize, announced, MOTIFS)
        .into_iter()
        .map(|motif| motif.starts.iter().map(|start| *start as f64).collect())
        .collect()
}

/// A segment of `length` frames from `start + shift` on; `None` where it leaves the recording.
fn moved(start: f64, shift: f64, length: f64, frames: usize) -> Option<std::ops::Range<usize>> {
    let from = start + shift;
    (from >= 0.0 && from + length <= frames as f64 + 1.0)
        .then(|| from as usize..((from + length) as usize).min(frames))
}

fn segments_of(hypothesis: &Hypothesis) -> Vec<std::ops::Range<usize>> {
    let states = hypothesis.movement.states.mean.first().map_or(0, Vec::len);
    hypothesis.found.iter().map(|repetition| repetition.range(states)).collect()
}

/// Estimates and decodes by turns, from rough segments.
fn refine(
    all: &Material,
    segments: &[std::ops::Range<usize>],
    options: &Options,
    iterations: usize,
) -> Option<(Material, Hypothesis)> {
    let states = states_for(median(segments.iter().map(|segment| segment.len() as f64))?);
    let mut alignments = equal_parts(segments, states);
    let chosen: Vec<usize> = match options.channels {
        Some(_) => (0..all.width()).collect(),
        None => common_channels(all, states, &alignments),
    };
    if chosen.is_empty() {
        return None;
    }
    let material = all.only(&chosen);
    let width = 2 * material.width();
    let kinds = kinds(&material.channels);
    let mut hypothesis = None;
    for _ in 0..iterations {
        let movement = estimate(
            &material.observations,
            &kinds,
            states,
            &alignments,
            &idle(alignments.iter(), material.frames()),
        );
        let found =
            repetitions(&material.observations, width, &[LogRatio::new(&movement, &material.channels)]);
        let (found, log_ratio) = alike(&material, &movement, found);
        if found.len() < 2 {
            return None;
        }
        alignments = found.iter().map(|repetition| repetition.path.clone()).collect();
        let announced = options.repetitions;
        let off = found.len().abs_diff(announced) as f64 / announced as f64;
        let score = log_ratio * (1.0 - off).max(0.0).powi(2) * steadiness(&material, &found, states);
        // One is enough: the last repetition and the way back to rest, taken together, are like the others otherwise.
        let open =
            found.iter().map(|one| openness(&material, &movement, one.range(states))).fold(0.0, f64::max);
        hypothesis = Some(Hypothesis { movement, found, smaller: Vec::new(), score, open });
    }
    hypothesis.map(|hypothesis| (material, hypothesis))
}

/// How likely the repetitions are cut at the right places, from 0 to 1: they follow each other without long gaps,
/// begin and end where the movement is slow, and leave no half of a movement over before the first and after the last.
fn steadiness(material: &Material, found: &[Repetition], states: usize) -> f64 {
    let ranges: Vec<_> = found.iter().map(|repetition| repetition.range(states)).collect();
    let (Some(first), Some(last)) = (ranges.first(), ranges.last()) else { return 0.0 };
    let busy: usize = ranges.iter().map(ExactSizeIterator::len).sum();
    let covered = busy as f64 / (last.end - first.start).max(1) as f64;
    let width = material.width();
    let scales: Vec<f64> = (0..width)
        .map(|channel| {
            let speeds = ranges
                .iter()
                .flat_map(|range| range.clone())
                .map(|frame| material.observations[frame * 2 * width + width + channel]);
            super::hmm::spread(speeds).map_or(0.0, |(_, sd)| if sd > 0.0 { 1.0 / sd } else { 0.0 })
        })
        .collect();
    // The velocity at a frame spans the frames before it: the cut lies in the middle of that span.
    let middle = super::frames::velocity_span(material.rate_hz).div_ceil(2);
    let speed = |frame: usize| -> f64 {
        let row = (frame + middle).min(material.frames() - 1) * 2 * width + width;
        let velocities = &material.observations[row..row + width];
        velocities.iter().zip(&scales).filter(|(v, _)| v.is_finite()).map(|(v, s)| (v * s).powi(2)).sum()
    };
    let cuts: f64 = ranges.iter().map(|range| speed(range.start)).sum::<f64>() / ranges.len() as f64;
    // A channel's mean square is 1 in these units.
    let at_rest = 1.0 - AT_REST * (cuts / width as f64).sqrt().min(1.0);
    let edge = 1 + busy / (2 * ranges.len());
    let edges = (first.start.saturating_sub(edge)..first.start)
        .chain(last.end..(last.end + edge).min(material.frames()));
    let left_over = edges.map(|frame| speed(frame).min(2.0 * width as f64)).sum::<f64>() / (2 * edge) as f64;
    let complete = 1.0 - LEFT_OVER * (left_over / width as f64).min(1.0);
    covered.sqrt() * at_rest * complete
}

/// How far from where it began a movement ends, from 0 to 1: all of its way.
fn openness(material: &Material, movement: &Movement, frames: Range<usize>) -> f64 {
    let width = material.width();
    let (mut apart, mut way) = (0.0, 0.0);
    for (channel, amplitude) in movement.amplitude[..width].iter().enumerate() {
        let value = |frame: usize| material.observations[frame * 2 * width + channel] / amplitude;
        let values = frames.clone().map(value).filter(|value| value.is_finite());
        let Some((first, last)) = values.clone().next().zip(values.clone().next_back()) else { continue };
        let (low, high) = range(values);
        apart += (last - first).powi(2);
        way += (high - low).powi(2);
    }
    if way > 0.0 { (apart / way).sqrt() } else { 0.0 }
}

/// The repetitions that are like most of them, and the middle between the mean and the least of their log ratios per
/// frame.
fn alike(material: &Material, movement: &Movement, found: Vec<Repetition>) -> (Vec<Repetition>, f64) {
    let ratio = LogRatio::new(movement, &material.channels);
    let states = ratio.states();
    let measured: Vec<Measures> = found
        .iter()
        .map(|repetition| {
            let rows = material.along(repetition.moving(states));
            measure(movement, &ratio, &material.channels, material.rate_hz, rows)
        })
        .collect();
    let middle = |value: fn(&Measures) -> f64| median(measured.iter().map(value)).unwrap_or(0.0);
    let (duration_s, log_ratio) = (middle(|m| m.duration_s), middle(|m| m.mean_log_ratio));
    let (mut sum, mut least, mut kept) = (0.0, f64::INFINITY, Vec::with_capacity(found.len()));
    for (repetition, measures) in found.into_iter().zip(&measured) {
        if is_alike(measures, duration_s, log_ratio) {
            sum += measures.mean_log_ratio;
            least = least.min(measures.mean_log_ratio);
            kept.push(repetition);
        }
    }
    // One that is unlike the others is more likely half of something else than one of them.
    let mean = if kept.is_empty() { 0.0 } else { sum / kept.len() as f64 };
    (kept, 0.5 * (mean + least.min(mean)))
}

/// Frames that belong to none of the paths.
fn idle<'a>(paths: impl Iterator<Item = &'a Vec<(usize, usize)>>, frames: usize) -> Vec<usize> {
    let mut busy = vec![false; frames];
    for (frame, _) in paths.flatten() {
        busy[*frame] = true;
    }
    (0..frames).filter(|frame| !busy[*frame]).collect()
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

/// Channels that do the same in every repetition, and enough of it: the mean course explains most of their variance.
fn common_channels(all: &Material, states: usize, alignments: &[Vec<(usize, usize)>]) -> Vec<usize> {
    let width = all.width();
    let mut moved = Vec::with_capacity(width);
    let mut common: Vec<(f64, usize)> = (0..width)
        .map(|channel| {
            let cells = alignments.iter().flatten().filter_map(|(frame, state)| {
                let value = all.values[frame * width + channel];
                value.is_finite().then_some((value, *state))
            });
            let mut moments = vec![(0.0, 0.0); states];
            let (mut n, mut sum, mut square) = (0.0, 0.0, 0.0);
            for (value, state) in cells {
                moments[state].0 += 1.0;
                moments[state].1 += value;
                n += 1.0;
                sum += value;
                square += value * value;
            }
            let total = square - sum * sum / f64::max(n, 1.0);
            let within: f64 =
                moments.iter().filter(|(n, _)| *n > 0.0).map(|(n, sum)| sum * sum / n).sum::<f64>();
            let between = within - sum * sum / f64::max(n, 1.0);
            moved.push((between / f64::max(n, 1.0)).max(0.0).sqrt());
            (if total > 1e-12 * square { between / total } else { 0.0 }, channel)
        })
        .collect();
    let most = largest(&kinds(&all.channels), &moved);
    common.retain(|(_, channel)| moved[*channel] >= LEAST_MOVED * most[*channel]);
    common.sort_by(|a, b| b.0.total_cmp(&a.0));
    let best = common.first().map_or(0.0, |(share, _)| *share);
    let mut chosen: Vec<usize> = common
        .iter()
        .filter(|(share, _)| *share >= LEAST_COMMON.min(0.9 * best))
        .map(|(_, channel)| *channel)
        .collect();
    chosen.sort_unstable();
    chosen
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
