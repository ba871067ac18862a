//! Where a recording repeats itself, so that nobody needs to look for the times of a lesson.
//!
//! What comes in: a recording of any length. What goes out: ranges of time in which something is repeated, each of which can be
//! taught as it is. What it never does: say which of them is the exercise; who walks up to the place repeats something, too.
//!
//! Two windows of one length that follow each other are alike where it is the period of a movement. Their mean squared difference is
//! held against the variance about their common mean: a slow drift has neighbours that are alike, but all of its variance lies
//! between them.

use std::ops::Range;

use super::hmm::median;
use super::hypothesis::SHORTEST_S;
use super::kinds::{kinds, largest};
use super::material::{Material, Stream};
use super::teach::{Lesson, Options, Refusal, SEARCH_HZ, moving_channels, teach};

/// Longest period looked for, s.
const LONGEST_S: f64 = 12.0;
/// Each period tried, the one before being 1; people differ more from one repetition to the next.
const LAG_STEP: f64 = 1.04;
/// Least similarity of two windows, 1 being the same. A period that varies by 15 % leaves a sine 0.6.
const LEAST: f64 = 0.5;
/// A multiple of the period is as alike; it must be better by so much.
const AS_GOOD: f64 = 0.1;
/// Lags within this factor belong to one peak.
const SAME: f64 = 1.3;
/// So many periods may be unlike within a range: where what follows has another period, and where it has the same.
const HOLES: [f64; 2] = [0.25, 1.0];
/// Fewest repetitions of a range: two of anything are alike somewhere.
const REPETITIONS: usize = 3;
/// Fewest periods in a range.
const FEWEST: f64 = 2.7;
/// Most periods of a range that are proposed: a lesson needs no more, and an hour of walking need not be taught.
const MOST: f64 = 30.0;

/// A range of time that can be taught as it is.
#[derive(Clone, Debug, PartialEq)]
pub struct RepeatingRange {
    /// Beginning, s, with a rest before the first repetition where there is one; whole hundredths.
    pub from_s: f64,
    /// End, s, likewise.
    pub to_s: f64,
    /// What teaching from it with the number of repetitions that it holds gives.
    pub lesson: Lesson,
}

/// The ranges of a recording in which something is repeated at least three times, in order of time. `options.repetitions` is not
/// looked at: each range holds as many as its lesson saw.
///
/// # Errors
/// A channel of `options` is not there.
pub fn repeating_ranges(stream: &Stream<'_>, options: &Options) -> Result<Vec<RepeatingRange>, Refusal> {
    let material = moving_channels(stream, options, SEARCH_HZ)?;
    let found = runs(&material);
    let mut ranges = Vec::with_capacity(found.len());
    for (index, (frames, period)) in found.iter().enumerate() {
        // A rest before and after belongs to a lesson, but half of it to the neighbour.
        let before = index.checked_sub(1).map_or(0, |before| found[before].0.end.midpoint(frames.start));
        let after = found
            .get(index + 1)
            .map_or(material.frames(), |(after, _)| frames.end.midpoint(after.start.max(frames.end)));
        let rest = period.ceil() as usize;
        let from = frames.start.saturating_sub(rest).max(before.min(frames.start));
        let to = (frames.end + rest).min(after);
        let from_s = (100.0 * material.t_s(from)).floor() / 100.0;
        let to_s = (100.0 * material.t_s(to)).ceil() / 100.0;
        let about = (frames.len() as f64 / period).round() as usize;
        if let Some(lesson) = lesson(&stream.between(from_s, to_s), options, about) {
            ranges.push(RepeatingRange { from_s, to_s, lesson });
        }
    }
    Ok(ranges)
}

/// The lesson of a range that holds about so many repetitions; `None` where it teaches nothing.
fn lesson(stream: &Stream<'_>, options: &Options, about: usize) -> Option<Lesson> {
    let taught = |repetitions| {
        if repetitions < REPETITIONS {
            return Err(Refusal::NothingRepeats(REPETITIONS));
        }
        teach(stream, &Options { repetitions, ..options.clone() })
    };
    let seen = match taught(about) {
        Ok(lesson) if lesson.report.repetitions.len() == about => return Some(lesson),
        Ok(lesson) => lesson.report.repetitions.len(),
        Err(Refusal::Count { report, .. }) => report.repetitions.len(),
        Err(_) => return None,
    };
    taught(seen).ok().filter(|lesson| lesson.report.repetitions.len() == seen)
}

/// Frames in which something is repeated, and its period in frames.
fn runs(material: &Material) -> Vec<(Range<usize>, f64)> {
    let similar = similarities(material);
    let mut runs: Vec<Run> = Vec::new();
    for (frame, (lag, _)) in similar.iter().enumerate().filter(|(_, (_, similarity))| *similarity >= LEAST) {
        let (end, lag) = (frame + 2 * lag, *lag as f64);
        match runs.last_mut().filter(|run| run.goes_on_at(frame, lag)) {
            Some(run) => {
                run.frames.end = run.frames.end.max(end);
                run.newest = frame;
                run.lags.push(lag);
            }
            None => runs.push(Run { frames: frame..end, newest: frame, lags: vec![lag] }),
        }
    }
    let kept = runs.into_iter().filter_map(|Run { frames: range, lags, .. }| {
        let period = median(lags.into_iter())?;
        let end = range.end.min(range.start + (MOST * period) as usize);
        (range.len() as f64 >= FEWEST * period).then_some((range.start..end, period))
    });
    // What begins before the one before it has ended is no range of its own.
    let mut apart: Vec<(Range<usize>, f64)> = Vec::new();
    for (range, period) in kept {
        match apart.last() {
            Some((before, _)) if range.start < before.end => {
                let start = before.end;
                if range.end.saturating_sub(start) as f64 >= FEWEST * period {
                    apart.push((start..range.end, period));
                }
            }
            _ => apart.push((range, period)),
        }
    }
    apart
}

/// A range under construction.
struct Run {
    frames: Range<usize>,
    /// Where the newest two windows that are alike begin.
    newest: usize,
    lags: Vec<f64>,
}

impl Run {
    /// Whether two windows of a length that are alike, and begin at a frame, belong to it.
    fn goes_on_at(&self, frame: usize, lag: f64) -> bool {
        let before = self.lags.last().copied().unwrap_or(lag);
        let is_same = lag <= SAME * before && before <= SAME * lag;
        (frame - self.newest) as f64 <= 1.0 + HOLES[usize::from(is_same)] * before
    }
}

/// For each frame the length of two windows that begin there and are alike, frames, and how much.
fn similarities(material: &Material) -> Vec<(usize, f64)> {
    let (width, frames) = (material.width(), material.frames());
    let sds: Vec<f64> = (0..width).map(|channel| material.sd(channel)).collect();
    let most = largest(&kinds(&material.channels), &sds);
    let weights: Vec<f64> = sds.iter().zip(most).map(|(sd, most)| sd / most.max(1e-12)).collect();
    let values = material.scaled(&weights);
    let row = |frame: usize| &values[frame * width..(frame + 1) * width];
    // Sums up to each frame: of every channel, and of all squares.
    let mut sums = vec![0.0; (frames + 1) * width];
    let mut squares = vec![0.0; frames + 1];
    for frame in 0..frames {
        for (channel, value) in row(frame).iter().enumerate() {
            sums[(frame + 1) * width + channel] = sums[frame * width + channel] + value;
        }
        squares[frame + 1] = squares[frame] + row(frame).iter().map(|value| value * value).sum::<f64>();
    }
    let mut lag = (SHORTEST_S * material.rate_hz).ceil();
    let mut lags: Vec<usize> = Vec::new();
    while lag <= LONGEST_S * material.rate_hz {
        lags.push(lag as usize);
        lag = (lag * LAG_STEP).max(lag + 1.0).floor();
    }
    let of = |lag: usize| -> Vec<f64> {
        let count = (frames + 1).saturating_sub(2 * lag);
        let mut differences = vec![0.0; frames.saturating_sub(lag) + 1];
        for frame in 0..frames.saturating_sub(lag) {
            let apart = row(frame).iter().zip(row(frame + lag)).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
            differences[frame + 1] = differences[frame] + apart;
        }
        (0..count)
            .map(|frame| {
                let end = frame + 2 * lag;
                // A gap is no part of a repetition.
                if material.index[end - 1] - material.index[frame] != (2 * lag - 1) as u64 {
                    return 0.0;
                }
                let n = 2.0 * lag as f64;
                let means =
                    (0..width).map(|c| ((sums[end * width + c] - sums[frame * width + c]) / n).powi(2));
                let variance = (squares[end] - squares[frame]) / n - means.sum::<f64>();
                let apart = (differences[frame + lag] - differences[frame]) / lag as f64;
                if variance > 1e-9 { 1.0 - apart / (2.0 * variance) } else { 0.0 }
            })
            .collect()
    };
    let mut best = vec![(1, 0.0); frames];
    for lag in lags {
        for (best, similarity) in best.iter_mut().zip(of(lag)) {
            let least = if lag as f64 <= SAME * best.0 as f64 { best.1 } else { best.1 + AS_GOOD };
            if similarity > least {
                *best = (lag, similarity);
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::super::viterbi::tests::Random;
    use super::*;

    /// Two angles at 50 Hz: what was done when.
    struct Take {
        random: Random,
        columns: Vec<String>,
        values: Vec<Option<f64>>,
        t_s: Vec<f64>,
    }

    impl Take {
        fn new() -> Self {
            let columns = ["elbow_r_flexion_deg", "knee_r_flexion_deg"].map(str::to_owned).to_vec();
            Self { random: Random::new(7), columns, values: Vec::new(), t_s: Vec::new() }
        }

        /// Moves to both angles within so many seconds.
        fn go(&mut self, seconds: f64, course: impl Fn(f64) -> [f64; 2]) {
            let frames = (50.0 * seconds) as usize;
            for frame in 0..frames {
                let noise = [self.random.unit() - 0.5, self.random.unit() - 0.5];
                let angles = course(frame as f64 / frames as f64);
                self.values.extend([Some(angles[0] + noise[0]), Some(angles[1] + noise[1])]);
                self.t_s.push(self.t_s.len() as f64 / 50.0);
            }
        }

        fn rest(&mut self, seconds: f64) {
            self.go(seconds, |_| [10.0, 5.0]);
        }

        /// Repetitions of either joint; gives when the first began and the last ended, s.
        fn set(&mut self, count: usize, period_s: f64, size_deg: [f64; 2]) -> [f64; 2] {
            let from_s = self.t_s.len() as f64 / 50.0;
            for _ in 0..count {
                let tempo = 0.9 + 0.2 * self.random.unit();
                self.go(period_s * tempo, |phase| {
                    let lift = 0.5 - 0.5 * libm::cos(std::f64::consts::TAU * phase);
                    [10.0 + size_deg[0] * lift, 5.0 + size_deg[1] * lift]
                });
            }
            [from_s, self.t_s.len() as f64 / 50.0]
        }

        fn stream(&self) -> Stream<'_> {
            Stream { columns: &self.columns, t_s: &self.t_s, values: &self.values }
        }
    }

    fn options(repetitions: usize) -> Options {
        Options { name: "exercise".to_owned(), repetitions, ..Options::default() }
    }

    #[test]
    fn each_set_of_a_session_is_a_range_that_can_be_taught() {
        let mut take = Take::new();
        take.rest(20.0);
        let curls = take.set(6, 2.4, [110.0, 0.0]);
        take.rest(8.0);
        // Sits down: a movement, but no repetition.
        take.go(5.0, |phase| [10.0, 5.0 + 85.0 * phase]);
        take.go(10.0, |_| [10.0, 90.0]);
        take.go(5.0, |phase| [10.0, 90.0 - 85.0 * phase]);
        take.rest(6.0);
        let squats = take.set(8, 3.1, [0.0, 90.0]);
        take.rest(15.0);
        let ranges = repeating_ranges(&take.stream(), &options(0)).unwrap();
        assert_eq!(ranges.len(), 2, "{:?}", ranges.iter().map(|r| (r.from_s, r.to_s)).collect::<Vec<_>>());
        for (range, (set, count)) in ranges.iter().zip([(curls, 6), (squats, 8)]) {
            let RepeatingRange { from_s, to_s, lesson } = range;
            assert!(*from_s <= set[0] && *to_s >= set[1], "{from_s} to {to_s}, {set:?}");
            assert!(*from_s > set[0] - 8.0 && *to_s < set[1] + 8.0, "{from_s} to {to_s}, {set:?}");
            assert_eq!(lesson.report.repetitions.len(), count);
            let again = teach(&take.stream().between(*from_s, *to_s), &options(count)).unwrap();
            assert_eq!(again, *lesson);
        }
    }

    #[test]
    fn what_does_not_repeat_is_no_range() {
        let mut take = Take::new();
        take.rest(30.0);
        take.go(20.0, |phase| [10.0 + 100.0 * phase, 5.0]);
        take.set(2, 2.5, [100.0, 0.0]);
        take.go(20.0, |phase| [110.0 - 100.0 * phase, 5.0]);
        assert_eq!(repeating_ranges(&take.stream(), &options(0)).unwrap(), []);
        let nothing = Stream { columns: &take.columns, t_s: &[], values: &[] };
        assert_eq!(repeating_ranges(&nothing, &options(0)).unwrap(), []);
    }
}
