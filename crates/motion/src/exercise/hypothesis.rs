//! A way to see a demonstration: where its repetitions are, and the model that they make.
//!
//! Weber et al. 2011, section III: period, motifs, one hidden Markov model per candidate, refinement, choice. The period and the phase
//! at which a repetition begins are not decided beforehand: each likely pair is a hypothesis that is refined to the end, for decoding
//! costs a millisecond; the one that sees the announced number wins.
//!
//! What comes in: the channels that move, on a coarse grid and on a fine one, and the announced number of repetitions. What goes out: the
//! hypothesis that sees them best. What it never does: judge whether that is good enough to teach.

use std::ops::Range;

use super::align::{Repetition, repetitions, repetitions_per_channel};
use super::hmm::{LogRatio, Movement, equal_parts, estimate, median, range, states_for};
use super::judge::{Measures, is_alike, measure};
use super::kinds::{kinds, largest};
use super::material::Material;
use super::motif::motifs;
use super::psd::{periods, repeatability};
use super::smaller::smaller;
use super::teach::Options;

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
/// How much a cut in full motion costs.
const AT_REST: f64 = 0.6;
/// How much movement as strong as the repetitions', left over before and after them, costs.
const LEFT_OVER: f64 = 0.1;
/// How much a repetition costs that ends elsewhere than it began.
const OPEN: f64 = 0.6;

/// A way to see the recording.
pub(super) struct Hypothesis {
    pub(super) movement: Movement,
    /// Repetitions that are like each other.
    pub(super) found: Vec<Repetition>,
    /// Those of them that are alike but smaller.
    pub(super) smaller: Vec<Repetition>,
    pub(super) score: f64,
    /// How far from where it began the worst of the repetitions ends, from 0 to 1: all of its way.
    pub(super) open: f64,
}

impl Hypothesis {
    /// The paths of all repetitions.
    pub(super) fn all(&self) -> impl Iterator<Item = &Vec<(usize, usize)>> {
        self.found.iter().chain(&self.smaller).map(|repetition| &repetition.path)
    }

    /// Frames of all repetitions, those of full size first.
    pub(super) fn ranges(&self) -> Vec<Range<usize>> {
        let states = self.movement.states.mean.first().map_or(0, Vec::len);
        self.found.iter().chain(&self.smaller).map(|repetition| repetition.range(states)).collect()
    }
}

/// How the repetitions are best seen in these channels, on the grid on which hypotheses are compared and on the one on which the best is refined.
pub(super) fn see(coarse: &Material, fine: &Material, options: &Options) -> Option<(Material, Hypothesis)> {
    let announced = options.repetitions;
    let longest = coarse.frames() as f64 / announced as f64;
    let shortest = SHORTEST_S * coarse.rate_hz;
    let mut hypotheses = Vec::new();
    for period in periods(&coarse.values, coarse.width(), coarse.rate_hz, [shortest, longest], PERIODS) {
        for starts in starts_of(coarse, period, options) {
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
    let segments: Vec<_> = best_of(&hypotheses)?
        .ranges()
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

/// Where the motif finder sees the repetitions of a period.
fn starts_of(all: &Material, period: f64, options: &Options) -> Vec<Vec<f64>> {
    let weights = repeatability(&all.values, all.width(), period, 0..all.frames());
    let highest = weights.iter().copied().fold(0.0, f64::max);
    // What repeats itself half as well as the best channel hardly counts.
    let weights: Vec<f64> = weights.iter().map(|weight| (weight / highest.max(1e-9)).powi(2)).collect();
    let chosen: Vec<usize> = (0..weights.len()).filter(|channel| weights[*channel] > 0.1).collect();
    let scaled = all.only(&chosen).scaled(&chosen.iter().map(|c| weights[*c].sqrt()).collect::<Vec<_>>());
    let partners =
        if options.as_published.kth_neighbour { options.repetitions } else { options.repetitions - 1 };
    motifs(&scaled, chosen.len(), period as usize, partners, MOTIFS)
        .into_iter()
        .map(|motif| motif.starts.iter().map(|start| *start as f64).collect())
        .collect()
}

/// A segment of `length` frames from `start + shift` on; `None` where it leaves the recording.
fn moved(start: f64, shift: f64, length: f64, frames: usize) -> Option<Range<usize>> {
    let from = start + shift;
    (from >= 0.0 && from + length <= frames as f64 + 1.0)
        .then(|| from as usize..((from + length) as usize).min(frames))
}

/// Estimates and decodes by turns, from rough segments.
fn refine(
    all: &Material,
    segments: &[Range<usize>],
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
        let found = if options.as_published.per_channel {
            repetitions_per_channel(&material, &movement)
        } else {
            repetitions(&material.observations, width, &[LogRatio::new(&movement, &material.channels)])
        };
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
pub(super) fn idle<'a>(paths: impl Iterator<Item = &'a Vec<(usize, usize)>>, frames: usize) -> Vec<usize> {
    let mut busy = vec![false; frames];
    for (frame, _) in paths.flatten() {
        busy[*frame] = true;
    }
    (0..frames).filter(|frame| !busy[*frame]).collect()
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
