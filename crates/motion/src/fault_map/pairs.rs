//! Distances between sensors: each pair has a range that joints allow.
//!
//! What comes in: positions on the clean side. What goes out: which sensors are where the others say they cannot be.
//! Another body is taller or shorter: the ranges are scaled by what most pairs say, so that one sensor cannot move them.

use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::memory::{Point, distance};

/// A range is widened by this much and this share of itself: sensors are never put on twice in the same way.
const MARGIN_M: f64 = 0.06;
const MARGIN_SHARE: f64 = 0.15;
/// Hindsight, which knows this very recording, doubts from this share of the margin on.
const DOUBT: f64 = 0.5;
/// Parts of a recording that are held against each other.
const PARTS: usize = 5;
/// Share of the place inside a range in how strange a place is.
const INNER_SHARE: f64 = 0.03;
/// Pairs whose range is below this share of their distance tell the size of a body.
const RIGID_SHARE: f64 = 0.25;
/// A distance that stays outside its range without a jump is how the sensors are put on: the range gives way, at
/// first at once, later slowly, and never farther than this, m.
const SETTLING_FRAMES: u32 = 300;
const GIVING: [f64; 2] = [0.1, 0.002];
const LARGEST_SHIFT_M: f64 = 0.12;
/// The range of a pair that is no bone was not seen whole: it gives way at once, to sensors that did not jump, so far, m.
const LARGEST_NOVELTY_M: f64 = 0.5;
/// It gives way from this share of the margin on, so that there is room again.
const STRAIN: f64 = 0.4;
/// Least weight of a frame in the size, and the size's limits: people of one stage.
const SIZE_WEIGHT: f64 = 0.002;
const SIZE: [f64; 2] = [0.7, 1.4];

/// The ranges.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Plain)]
pub(super) struct Pairs {
    ranges: Vec<Range>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
struct Range {
    a: usize,
    b: usize,
    low_m: f64,
    high_m: f64,
    /// By how much one part of the recording goes beyond the rest of it, at the lower and the upper end: so much farther
    /// another recording may go.
    beyond_m: [f64; 2],
    /// Usual distance of a pair that hardly changes; absent for others.
    length_m: Option<f64>,
}

impl Range {
    /// How far a distance is beyond the range of a body of this size, with its sign, m; 0 inside.
    fn excess(&self, length_m: f64, size: f64, shift: &Shift) -> f64 {
        self.beyond(length_m, size, shift, self.margin())
    }

    fn margin(&self) -> f64 {
        MARGIN_M + MARGIN_SHARE * (self.high_m - self.low_m)
    }

    fn beyond(&self, length_m: f64, size: f64, shift: &Shift, margin: f64) -> f64 {
        let [below, above] = self.beyond_m;
        let low = self.low_m * size + shift[0] - margin - below;
        let high = self.high_m * size + shift[1] + margin + above;
        if length_m < low {
            length_m - low
        } else if length_m > high {
            length_m - high
        } else {
            0.0
        }
    }
}

/// By how much the largest value is beyond the second; NaN are none.
fn farthest(mut values: [f64; PARTS]) -> f64 {
    values.iter_mut().filter(|value| value.is_nan()).for_each(|value| *value = f64::NEG_INFINITY);
    values.sort_unstable_by(f64::total_cmp);
    let by = values[PARTS - 1] - values[PARTS - 2];
    if by.is_finite() { by } else { 0.0 }
}

/// By how much the lower and the upper end of a range were moved, m.
type Shift = [f64; 2];

/// What is remembered from frame to frame, and room to work.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Size {
    /// Size of this body over that of the training's.
    size: Option<f64>,
    /// By how much each range has given way, and for how many frames it could.
    shifts_m: Vec<Shift>,
    frames: u32,
    ratios: Vec<f64>,
    wrong_m: Vec<f64>,
}

impl Size {
    pub(super) fn new(sensors: usize, pairs: &Pairs) -> Self {
        let shifts_m = vec![[0.0; 2]; pairs.ranges.len()];
        Self {
            size: None,
            shifts_m,
            frames: 0,
            ratios: Vec::with_capacity(pairs.ranges.len()),
            wrong_m: vec![0.0; sensors],
        }
    }

    /// Size of this body over that of the training's.
    pub(super) fn value(&self) -> f64 {
        self.size.unwrap_or(1.0)
    }
}

impl Pairs {
    /// Learns the ranges from the distances of sensors that are thought to be where they say, all but a share of them
    /// at either end.
    pub(super) fn learn(
        sensors: usize,
        frames: usize,
        outside: f64,
        here: impl Fn(usize, usize) -> Option<Point>,
    ) -> Self {
        let mut ranges = Vec::new();
        let mut lengths = Vec::with_capacity(frames);
        for a in 0..sensors {
            for b in a + 1..sensors {
                let length = |k: usize| Some(distance(here(k, a)?, here(k, b)?));
                lengths.clear();
                let mut ends = [[0.0; 2]; PARTS];
                for (part, ends) in ends.iter_mut().enumerate() {
                    let start = lengths.len();
                    lengths.extend((part * frames / PARTS..(part + 1) * frames / PARTS).filter_map(length));
                    let of_part = &mut lengths[start..];
                    *ends = if of_part.is_empty() {
                        [f64::NAN; 2]
                    } else {
                        [quantile(of_part, outside), quantile(of_part, 1.0 - outside)]
                    };
                }
                if lengths.len() < 10 {
                    continue;
                }
                let [low_m, high_m] = [outside, 1.0 - outside].map(|share| quantile(&mut lengths, share));
                let middle = quantile(&mut lengths, 0.5);
                let length_m = (high_m - low_m < RIGID_SHARE * middle).then_some(middle);
                let beyond_m = [farthest(ends.map(|end| -end[0])), farthest(ends.map(|end| end[1]))];
                ranges.push(Range { a, b, low_m, high_m, beyond_m, length_m });
            }
        }
        Self { ranges }
    }

    /// Whether nothing is known.
    pub(super) fn is_empty(&self) -> bool {
        self.ranges.is_empty()
    }

    /// The sensor from which the distance of this one varies least.
    pub(super) fn nearest(&self, sensor: usize) -> Option<usize> {
        let of = self.ranges.iter().filter(|range| range.a == sensor || range.b == sensor);
        let best = of.min_by(|x, y| (x.high_m - x.low_m).total_cmp(&(y.high_m - y.low_m)))?;
        Some(best.a + best.b - sensor)
    }

    pub(super) fn fit(&self, sensors: usize) -> bool {
        self.ranges.iter().all(|range| range.a < sensors && range.b < sensors)
    }

    /// Calls `bad` for each sensor that is where the others say it cannot be, the worst first; `here` is where a
    /// sensor is, if it is believed so far.
    pub(super) fn check(
        &self,
        size: &mut Size,
        positions: impl Fn(usize) -> Option<Point>,
        here: impl Fn(usize) -> Option<Point>,
        mut bad: impl FnMut(usize),
    ) {
        self.measure(size, &here);
        let scale = size.value();
        size.wrong_m.fill(0.0);
        let Size { shifts_m, frames, wrong_m, .. } = size;
        let giving = GIVING[usize::from(*frames >= SETTLING_FRAMES)];
        *frames = frames.saturating_add(1);
        let mut any = false;
        for (range, shift) in self.ranges.iter().zip(shifts_m.iter_mut()) {
            let (Some(a), Some(b)) = (here(range.a), here(range.b)) else { continue };
            let length = distance(a, b);
            let excess = range.excess(length, scale, shift);
            let strain = range.beyond(length, scale, shift, STRAIN * range.margin());
            match range.length_m {
                Some(_) => {
                    *shift = shift.map(|m| (m + giving * strain).clamp(-LARGEST_SHIFT_M, LARGEST_SHIFT_M))
                }
                None => {
                    let end = usize::from(strain > 0.0);
                    shift[end] =
                        (shift[end] + GIVING[0] * strain).clamp(-LARGEST_NOVELTY_M, LARGEST_NOVELTY_M);
                }
            }
            if excess != 0.0 {
                wrong_m[range.a] += excess.abs();
                wrong_m[range.b] += excess.abs();
                any = true;
            }
        }
        if !any {
            return;
        }
        loop {
            let worst = (0..wrong_m.len()).max_by(|a, b| wrong_m[*a].total_cmp(&wrong_m[*b]));
            let Some(worst) = worst.filter(|worst| wrong_m[*worst] > 1e-9) else { return };
            bad(worst);
            wrong_m[worst] = f64::NEG_INFINITY;
            for (range, shift) in self.ranges.iter().zip(shifts_m.iter()) {
                let other = match worst {
                    _ if range.a == worst => range.b,
                    _ if range.b == worst => range.a,
                    _ => continue,
                };
                if let (Some(p), Some(q)) = (positions(worst), here(other)) {
                    wrong_m[other] -= range.excess(distance(p, q), scale, shift).abs();
                }
            }
        }
    }

    /// Whether a sensor at `p` is where the believed ones allow it.
    pub(super) fn allow(
        &self,
        size: &Size,
        sensor: usize,
        p: Point,
        here: impl Fn(usize) -> Option<Point>,
    ) -> bool {
        let scale = size.value();
        self.ranges.iter().zip(&size.shifts_m).all(|(range, shift)| {
            let other = match sensor {
                _ if range.a == sensor => range.b,
                _ if range.b == sensor => range.a,
                _ => return true,
            };
            here(other).is_none_or(|q| range.excess(distance(p, q), scale, shift) == 0.0)
        })
    }

    /// How far the believed sensors do not allow one at `p`, 0 to 1; what one of them alone says does not count.
    pub(super) fn doubt(&self, sensor: usize, p: Point, here: impl Fn(usize) -> Option<Point>) -> f64 {
        let (mut sum, mut largest) = (0.0, 0.0f64);
        for range in &self.ranges {
            let other = match sensor {
                _ if range.a == sensor => range.b,
                _ if range.b == sensor => range.a,
                _ => continue,
            };
            let Some(q) = here(other) else { continue };
            let beyond = range.beyond(distance(p, q), 1.0, &[0.0; 2], DOUBT * range.margin()) / MARGIN_M;
            sum += beyond * beyond;
            largest = largest.max(beyond * beyond);
        }
        (sum - largest).min(1.0)
    }

    /// How strange it would be to find a sensor at `p`: squares of what is beyond its ranges, in margins, and a little
    /// of what is off their middles.
    pub(super) fn strangeness(
        &self,
        size: &Size,
        sensor: usize,
        p: Point,
        here: impl Fn(usize) -> Option<Point>,
    ) -> f64 {
        let scale = size.value();
        let square = |(range, shift): (&Range, &Shift)| {
            let other = match sensor {
                _ if range.a == sensor => range.b,
                _ if range.b == sensor => range.a,
                _ => return None,
            };
            let length = distance(p, here(other)?);
            let beyond = range.beyond(length, scale, shift, 0.0);
            let half = 0.5 * (range.high_m - range.low_m) * scale + MARGIN_M;
            let off = length - 0.5 * ((range.low_m + range.high_m) * scale + shift[0] + shift[1]);
            Some(
                beyond * beyond / (range.margin() * range.margin()) + INNER_SHARE * off * off / (half * half),
            )
        };
        self.ranges.iter().zip(&size.shifts_m).filter_map(square).sum()
    }

    fn measure(&self, size: &mut Size, here: &impl Fn(usize) -> Option<Point>) {
        size.ratios.clear();
        let ratio = |range: &Range| Some(distance(here(range.a)?, here(range.b)?) / range.length_m?);
        size.ratios.extend(self.ranges.iter().filter_map(ratio));
        if size.ratios.len() < 3 {
            return;
        }
        let now = quantile(&mut size.ratios, 0.5).clamp(SIZE[0], SIZE[1]);
        let weight = SIZE_WEIGHT.max(1.0 / f64::from(size.frames + 1));
        size.size = Some(size.size.map_or(now, |old| old + weight * (now - old)));
    }
}

/// A quantile of some values; 0 of none.
pub(super) fn quantile(values: &mut [f64], share: f64) -> f64 {
    let at = ((values.len().saturating_sub(1)) as f64 * share) as usize;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(at, f64::total_cmp).1 }
}
