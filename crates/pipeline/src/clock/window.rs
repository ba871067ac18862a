//! The evidence of the latest cycles, and the line through it.

use super::reads::Evidence;
use super::{CRYSTAL, SIGMA_FLOOR_S};
use posed_drivers::Timestamp;
use posed_state::Plain;

/// Cycles in one block.
const BLOCK_CYCLES: u32 = 8;
/// Newest blocks that tell how late the reads of a line are now.
const LATEST_BLOCKS: usize = 2;
/// Blocks in the window: 3072 cycles, half a minute at 100 Hz.
const BLOCKS: usize = 384;
/// From so many blocks on the fitted period is better than a nominal one.
const SETTLED_BLOCKS: usize = 6;
/// From so many on it is good enough under bursts to tell one cycle from the next.
const FIRM_BLOCKS: usize = 12;
/// Share of blocks whose lower bound may be wrong: a late reader stamps it late.
const TRIMMED: f64 = 0.15;

/// Periods that a device may have, s; arrivals without sense must not give others.
const PERIOD_RANGE_S: std::ops::Range<f64> = 1e-4..60.0;
/// One block in so many is taken to be free of delays by the host.
const UNDISTURBED: usize = 8;
/// The first cycles show the period whatever is claimed where they span so many cycles, lie on a line to within this share of it, and
/// its slope differs by so many standard deviations: neither a step, of a cycle that was lost, nor a host that sleeps once does so.
const CLEAR_SPAN: f64 = 8.0;
const CLEAR_SHARE: f64 = 0.03;
const CLEAR_SIGMAS: f64 = 6.0;
/// Share of a period within which the reads of a block follow their cycles closely, and within which what lies between two such
/// blocks is a whole number of them.
const CLOSE: f64 = 0.2;
const SLIP: f64 = 0.3;
/// How far off the middle of a block may be besides half of the room between its bounds, s, and residuals, as a share of all that, up to
/// which no block is an outlier.
const MIDDLE_SIGMA_S: f64 = 2e-3;
const LEAST_RESIDUAL: f64 = 1e-2;
/// Candidate periods on either side of the first estimate.
const GRID: usize = 8;
/// Inflation of the spread between bounds, so that two sigmas hold also for simulated bursts in step with the cycles.
const STILL_PHASES: f64 = 1.8;

/// What is known of the period before the data speak, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Nominal {
    /// A rate that the device claims: a hint.
    Reported(f64),
    /// Ticks of the device's counter: no further off than [`CRYSTAL`].
    Counted(f64),
}

impl Nominal {
    /// The period nearest to a measured one that can be.
    fn limit(nominal: Option<Self>, period_s: f64) -> f64 {
        match nominal {
            Some(Self::Counted(period)) => period_s.clamp(period * (1.0 - CRYSTAL), period * (1.0 + CRYSTAL)),
            _ => period_s,
        }
    }
}

/// A bound at one cycle.
#[derive(Clone, Copy, Debug, Plain)]
struct Point {
    x: f64,
    t: f64,
}

/// The tightest bounds of a few cycles.
#[derive(Clone, Copy, Debug, Plain)]
struct Block {
    cycles: u32,
    /// Reads in which they came, and the latest of them.
    reads: u32,
    t_read: Timestamp,
    samples: f64,
    sum_x: f64,
    sum_paced: f64,
    sum_prompt: f64,
    upper: Point,
    lower: Option<Point>,
    paced: Point,
}

impl Block {
    /// How late its first read was at most, s: twice the mean of what the others were later, where each cycle came in a read of its
    /// own.
    fn lateness_s(&self, fit: &Fit) -> f64 {
        if self.reads < self.cycles {
            return if fit.prompt { fit.lateness } else { f64::INFINITY };
        }
        self.spread_s(fit)
    }

    /// Twice the mean of what its samples were later than the first.
    fn spread_s(&self, fit: &Fit) -> f64 {
        let mean = (self.sum_paced - fit.period_s * self.sum_x) / self.samples;
        2.0 * (mean - (self.paced.t - fit.period_s * self.paced.x)).max(0.0)
    }
}

/// `t = base_t + period (x - base_x)` plus something between `lower` and `upper`.
#[derive(Clone, Copy, Debug, Plain)]
pub(super) struct Fit {
    pub(super) period_s: f64,
    base_x: f64,
    base_t: f64,
    /// Bounds of the offset from the line, s.
    pub(super) upper: f64,
    pub(super) lower: f64,
    /// Best offset from the line, s, and its standard deviation.
    pub(super) middle: f64,
    pub(super) sigma: f64,
    /// How late a read usually is at most, s: twice the mean, and what pacing, if there were any, would take
    /// off the upper bound.
    pub(super) lateness: f64,
    /// Reads follow the bytes closely.
    pub(super) prompt: bool,
    /// By how much the bounds of the window contradict each other whatever the line, s.
    pub(super) crossing: f64,
}

impl Fit {
    /// The line without its offset, s.
    pub(super) fn line(&self, x: f64) -> f64 {
        self.base_t + self.period_s * (x - self.base_x)
    }

    /// Takes the one bound that needs no second opinion.
    pub(super) fn tighten(&mut self, evidence: &Evidence) {
        let upper = evidence.upper - self.line(evidence.x);
        if upper < self.upper {
            self.lower = self.lower.min(upper);
            self.upper = upper;
            self.middle = self.middle.min(upper);
        }
    }
}

/// A sliding window of blocks.
#[derive(Clone, Debug, Plain)]
pub(super) struct Window {
    /// Ring, oldest at `start` once full.
    blocks: Vec<Block>,
    next: usize,
    /// Sums over the first cycles, for a period before there are blocks: n, x, t, xx, xt, tt.
    sums: [f64; 6],
    /// [`Fit::lateness`] of the line before it began anew, 0 where there was none.
    known_lateness_s: f64,
    #[state(skip)]
    scratch: Vec<f64>,
}

impl Window {
    pub(super) fn new() -> Self {
        Self {
            blocks: Vec::with_capacity(BLOCKS),
            next: 0,
            sums: [0.0; 6],
            known_lateness_s: 0.0,
            scratch: Vec::with_capacity(BLOCKS),
        }
    }

    /// Begins anew; what stays is how late the reads of the line until now, `fit`, were: usually, or the newest where it `has_changed`.
    pub(super) fn clear(&mut self, fit: Option<&Fit>, has_changed: bool) {
        if let Some(fit) = fit.filter(|_| self.is_settled()) {
            let newest = if has_changed { LATEST_BLOCKS } else { 0 };
            let newest =
                (1..=newest).filter_map(|back| self.blocks.get((self.next + BLOCKS - back) % BLOCKS));
            self.known_lateness_s = newest.map(|block| block.spread_s(fit)).fold(fit.lateness, f64::max);
        }
        self.blocks.clear();
        self.next = 0;
        self.sums = [0.0; 6];
    }

    /// Bytes have turned out to take their time on a wire.
    pub(super) fn know_wire(&mut self) {
        for block in &mut self.blocks {
            block.upper = block.paced;
        }
    }

    /// Whether the period comes from the data.
    pub(super) fn is_settled(&self) -> bool {
        self.blocks.len() > SETTLED_BLOCKS
    }

    /// Whether the line is firm enough to doubt the count of cycles by it: bursts need more cycles for that.
    pub(super) fn may_judge(&self, prompt: bool) -> bool {
        self.blocks.len() > if prompt { SETTLED_BLOCKS } else { FIRM_BLOCKS }
    }

    /// Whether the count has slipped by whole cycles in these first blocks: one that was lost without a trace, or damage that read
    /// like one. Reads that follow their cycles closely show it, whatever the line through all of them; it would be bent for as long
    /// as the window remembers.
    pub(super) fn has_slipped(&self, fit: &Fit) -> bool {
        let begins = self.blocks.len() > SETTLED_BLOCKS && self.blocks.len() <= 2 * FIRM_BLOCKS;
        let newest = self.blocks.len().saturating_sub(1);
        let offset = |point: &Point| (point.t - fit.period_s * point.x) / fit.period_s;
        let close =
            |block: &&Block| block.reads >= block.cycles && block.lateness_s(fit) < CLOSE * fit.period_s;
        let mut cycles = self.blocks[..newest].iter().filter(close).map(|block| offset(&block.paced));
        let mut before = cycles.next();
        begins
            && cycles.any(|now| {
                let step = now - before.replace(now).unwrap_or(now);
                step.round() != 0.0 && (step - step.round()).abs() < SLIP
            })
    }

    /// Adds one arrival; returns whether it is time to fit again.
    pub(super) fn push(
        &mut self,
        evidence: &Evidence,
        begins_cycle: bool,
        fit: Option<&Fit>,
        tolerance_s: f64,
    ) -> bool {
        // A lower bound above the upper one was stamped late; it would only pull the middle up.
        let lower = match fit {
            Some(fit) if self.is_settled() => {
                evidence.lower.filter(|lower| lower - fit.line(evidence.x) <= fit.upper + tolerance_s)
            }
            _ => evidence.lower,
        };
        let settled = self.is_settled();
        if !settled {
            let (x, t) = (evidence.x, evidence.upper);
            for (sum, term) in self.sums.iter_mut().zip([1.0, x, t, x * x, x * t, t * t]) {
                *sum += term;
            }
        }
        let period = fit.map_or(0.0, |fit| fit.period_s);
        let full = self.newest().is_none_or(|block| begins_cycle && block.cycles >= BLOCK_CYCLES);
        if full {
            self.start_block(evidence, lower);
        } else {
            let at = self.newest_index();
            let block = &mut self.blocks[at];
            block.cycles += u32::from(begins_cycle);
            block.reads += u32::from(evidence.t_read != block.t_read);
            block.t_read = evidence.t_read;
            block.samples += 1.0;
            block.sum_x += evidence.x;
            block.sum_paced += evidence.paced;
            block.sum_prompt += evidence.prompt;
            let offset = |point: &Point| point.t - period * point.x;
            let upper = Point { x: evidence.x, t: evidence.upper };
            if offset(&upper) < offset(&block.upper) {
                block.upper = upper;
            }
            let paced = Point { x: evidence.x, t: evidence.paced };
            if offset(&paced) < offset(&block.paced) {
                block.paced = paced;
            }
            if let Some(t) = lower {
                let lower = Point { x: evidence.x, t };
                if block.lower.as_ref().is_none_or(|held| offset(&lower) > offset(held)) {
                    block.lower = Some(lower);
                }
            }
        }
        full || !settled
    }

    fn newest_index(&self) -> usize {
        (self.next + BLOCKS - 1) % BLOCKS
    }

    fn newest(&self) -> Option<&Block> {
        self.blocks.get(self.newest_index())
    }

    fn start_block(&mut self, evidence: &Evidence, lower: Option<f64>) {
        let x = evidence.x;
        let block = Block {
            cycles: 1,
            reads: 1,
            t_read: evidence.t_read,
            samples: 1.0,
            sum_x: x,
            sum_paced: evidence.paced,
            sum_prompt: evidence.prompt,
            upper: Point { x, t: evidence.upper },
            lower: lower.map(|t| Point { x, t }),
            paced: Point { x, t: evidence.paced },
        };
        if self.blocks.len() < BLOCKS {
            self.blocks.push(block);
        } else {
            self.blocks[self.next] = block;
        }
        self.next = (self.next + 1) % BLOCKS;
    }

    /// The line through the window; `None` while there is not enough to know a period.
    ///
    /// `before` is the one in use, which says how late reads usually are.
    pub(super) fn fit(&mut self, nominal: Option<Nominal>, before: Option<&Fit>) -> Option<Fit> {
        let settled = self.is_settled();
        let period_s = match nominal {
            Some(Nominal::Counted(period_s)) if !settled => Some(period_s),
            Some(Nominal::Reported(period_s)) if !settled => self.first_slope(Some(period_s)),
            None if !settled => self.first_slope(None),
            _ => self.period(nominal, before),
        };
        let period_s = period_s.filter(|period_s| PERIOD_RANGE_S.contains(period_s))?;
        let newest = *self.newest()?;
        let base = newest.upper;
        let offset = |point: &Point| point.t - base.t - period_s * (point.x - base.x);
        let (upper, bound) = self.bounds(period_s, base);
        let paced = self.blocks.iter().map(|block| offset(&block.paced)).fold(f64::INFINITY, f64::min);
        // A read is late by up to twice the mean; and nobody knows yet whether bytes take their time.
        let mut lateness = |sum: fn(&Block) -> f64, n: usize| {
            self.scratch.clear();
            self.scratch.extend(self.blocks.iter().map(|block| {
                offset(&Point { x: block.sum_x / block.samples, t: sum(block) / block.samples })
            }));
            let usual = nth(&mut self.scratch, n, false)?;
            Some(2.0 * (usual - paced).max(0.0) + (upper - paced).max(0.0))
        };
        let middle = self.blocks.len() / 2;
        // The first reads after a new beginning cannot tell how late they are: those before it did.
        let known_s = if settled { 0.0 } else { self.known_lateness_s };
        let prompt = lateness(|block| block.sum_prompt, middle)?.max(known_s) < 0.5 * period_s;
        let median = lateness(|block| block.sum_paced, middle)?;
        let bursts = bound > upper - median;
        // On a prompt line the blocks that fared best speak: a host that is late now and then gives no information about how
        // late reads usually are.
        let undisturbed = self.blocks.len() / UNDISTURBED;
        let lateness =
            if prompt { lateness(|block| block.sum_paced, undisturbed)? } else { median }.max(known_s);
        let lower = bound.max(upper - lateness);
        // Bounds that cross by a little, from an imperfect slope, share the error.
        let (lower, upper) = if lower > upper { (upper, lower) } else { (lower, upper) };
        let half = 0.5 * (upper - lower);
        let first = Fit {
            period_s,
            base_x: base.x,
            base_t: base.t,
            upper,
            lower,
            middle: 0.5 * (upper + lower),
            sigma: (half * half / 3.0 + SIGMA_FLOOR_S * SIGMA_FLOOR_S).sqrt(),
            lateness,
            prompt,
            crossing: 0.0,
        };
        Some(if settled && bursts { self.posterior(first, base, nominal) } else { first })
    }

    /// Offsets of the tightest upper and lower bound from a line of the given period through `base`.
    fn bounds(&mut self, period_s: f64, base: Point) -> (f64, f64) {
        let offset = |point: &Point| point.t - base.t - period_s * (point.x - base.x);
        let mut upper = f64::INFINITY;
        self.scratch.clear();
        for block in &self.blocks {
            upper = upper.min(offset(&block.upper));
            self.scratch.extend(block.lower.as_ref().map(offset));
        }
        let trimmed = (TRIMMED * self.scratch.len() as f64) as usize;
        (upper, nth(&mut self.scratch, trimmed, true).unwrap_or(f64::NEG_INFINITY))
    }

    /// Mean and spread of all lines between the bounds, each as likely as any other.
    ///
    /// With bursts in step with the cycles the middles of the blocks jump by whole phases and least squares
    /// follows the jumps; what the bounds allow as a whole is honest about it. Where they allow no line at all,
    /// bytes were kept for longer than the lower bounds admit, and those give way.
    fn posterior(&mut self, first: Fit, base: Point, nominal: Option<Nominal>) -> Fit {
        let Some(oldest) = self.blocks.get(self.next % self.blocks.len()) else { return first };
        let span = (base.x - oldest.upper.x).max(1.0);
        let reach = (2.0 * (first.upper - first.lower) + 1e-3) / span;
        let candidates: [(f64, f64, f64); 2 * GRID + 1] = std::array::from_fn(|i| {
            let candidate = Nominal::limit(nominal, first.period_s + reach * (i as f64 / GRID as f64 - 1.0));
            let (upper, bound) = self.bounds(candidate, base);
            (candidate, upper, bound.max(upper - first.lateness))
        });
        let most =
            candidates.iter().map(|&(_, upper, lower)| upper - lower).fold(f64::NEG_INFINITY, f64::max);
        let crossing = (-most).max(0.0);
        let (mut weight, mut period, mut mean, mut square) = (0.0, 0.0, 0.0, 0.0);
        for (candidate, upper, lower) in candidates {
            let lower = lower - crossing;
            let room = upper - lower + SIGMA_FLOOR_S;
            if room > 0.0 {
                let middle = 0.5 * (upper + lower);
                weight += room;
                period += room * candidate;
                mean += room * middle;
                square += room * (middle * middle + room * room / 12.0);
            }
        }
        if weight.is_nan() || weight <= 0.0 {
            return first;
        }
        let (period_s, middle) = (period / weight, mean / weight);
        if !PERIOD_RANGE_S.contains(&period_s) {
            return first;
        }
        let variance = (square / weight - middle * middle).max(0.0);
        let (upper, bound) = self.bounds(period_s, base);
        let lower = (bound - crossing).max(upper - first.lateness).min(middle);
        // Phases that stand still give less than independent bounds would; the factor covers it.
        let sigma = STILL_PHASES * (variance + SIGMA_FLOOR_S * SIGMA_FLOOR_S).sqrt();
        Fit { period_s, upper: upper.max(middle), lower, middle, sigma, crossing, ..first }
    }

    /// Period of a settled window: the slope of its blocks, or the one in use where the bounds allow that and contradict the slope.
    /// Where bursts begin, the middles of the first such blocks are far off, and few blocks outweigh them.
    fn period(&mut self, nominal: Option<Nominal>, before: Option<&Fit>) -> Option<f64> {
        let slope_s = Nominal::limit(nominal, self.slope(before)?);
        let in_use_s = before.map_or(slope_s, |fit| fit.period_s);
        let base = self.newest()?.upper;
        let mut is_allowed = |period_s: f64| {
            let (upper, bound) = self.bounds(period_s, base);
            bound <= upper
        };
        Some(if !is_allowed(slope_s) && is_allowed(in_use_s) { in_use_s } else { slope_s })
    }

    /// Period from the first cycles, by least squares and the nominal one.
    fn first_slope(&self, nominal_period_s: Option<f64>) -> Option<f64> {
        let [n, x, t, xx, xt, tt] = self.sums;
        let spread = n * xx - x * x;
        let span = (12.0 * spread / (n * n)).sqrt();
        let measured = (n * xt - x * t) / spread;
        match nominal_period_s {
            None => (span > 3.0).then_some(measured),
            Some(nominal) if span < 3.0 => Some(nominal),
            Some(nominal) => {
                // A slow line makes a unit skip whole cycles, so that its period is a multiple of the nominal.
                let multiple = (measured / nominal).round().max(1.0) * nominal;
                // A claim gives way to reads that lie on another line, each with a cycle of its own.
                let residual_s = ((n * tt - t * t - measured * measured * spread).max(0.0) / (n * n)).sqrt();
                let sigma_s = residual_s * (n / spread).sqrt();
                if span > CLEAR_SPAN
                    && self.blocks.iter().all(|block| block.reads >= block.cycles)
                    && residual_s < CLEAR_SHARE * measured
                    && (measured - multiple).abs() > CLEAR_SIGMAS * sigma_s
                {
                    return Some(measured);
                }
                // What comes in one read, or in bursts, shows the line's pace and not the unit's.
                let is_hurried = measured < nominal;
                Some(if is_hurried || (measured / multiple - 1.0).abs() < 0.2 { multiple } else { measured })
            }
        }
    }

    /// Period from the middles of the blocks' bounds, by least squares without the outliers: a block whose bounds are near says
    /// much, one that an adapter kept back little.
    fn slope(&self, before: Option<&Fit>) -> Option<f64> {
        let first = self.blocks.first()?.upper;
        let in_use_s = before.map_or(0.0, |fit| fit.period_s);
        let middle = |block: &Block| {
            let lower = block.lower.unwrap_or(block.upper);
            let offset = |point: &Point| point.t - in_use_s * point.x;
            // Where reads follow the bytes most lower bounds say nothing and a few say much: their middles would jump by half a
            // period, and so they would where bursts begin or cease. What the block's own reads were late by says more.
            let lower = before.map_or(lower, |fit| {
                let least = Point { t: block.upper.t - block.lateness_s(fit), ..block.upper };
                if offset(&lower) < offset(&least) { least } else { lower }
            });
            let room_s = before.map_or(0.0, |_| (offset(&block.upper) - offset(&lower)).max(0.0));
            let sigma_s = 0.5 * room_s + MIDDLE_SIGMA_S;
            let x = 0.5 * (block.upper.x + lower.x) - first.x;
            Middle { x, t: 0.5 * (block.upper.t + lower.t) - first.t, sigma_s }
        };
        let bounded = || self.blocks.iter().filter(|block| block.lower.is_some()).map(middle);
        let (mut a, mut b) = least_squares(bounded())?;
        for _ in 0..2 {
            let residual = |point: &Middle| (point.t - a - b * point.x).abs() / point.sigma_s;
            let (sum, n) = bounded().fold((0.0, 0.0), |(sum, n), point| (sum + residual(&point), n + 1.0));
            let limit = 2.0 * sum / n + LEAST_RESIDUAL;
            (a, b) = least_squares(bounded().filter(|point| residual(point) <= limit))?;
        }
        Some(b)
    }
}

/// The middle between the bounds of a block, and how far off it may be.
#[derive(Clone, Copy, Debug)]
struct Middle {
    x: f64,
    t: f64,
    sigma_s: f64,
}

/// Intercept and slope.
fn least_squares(points: impl Iterator<Item = Middle> + Clone) -> Option<(f64, f64)> {
    let weight = |point: &Middle| (point.sigma_s * point.sigma_s).recip();
    let (n, x, t) = points
        .clone()
        .fold((0.0, 0.0, 0.0), |(n, x, t), p| (n + weight(&p), x + weight(&p) * p.x, t + weight(&p) * p.t));
    let (mean_x, mean_t) = (x / n, t / n);
    let (xx, xt) = points.fold((0.0, 0.0), |(xx, xt), p| {
        let dx = weight(&p) * (p.x - mean_x);
        (xx + dx * (p.x - mean_x), xt + dx * (p.t - mean_t))
    });
    let slope = xt / xx;
    slope.is_finite().then_some((mean_t - slope * mean_x, slope))
}

/// The n-th smallest (or largest) value.
fn nth(values: &mut [f64], n: usize, largest: bool) -> Option<f64> {
    if n >= values.len() {
        return None;
    }
    let order = |a: &f64, b: &f64| if largest { b.total_cmp(a) } else { a.total_cmp(b) };
    Some(*values.select_nth_unstable_by(n, order).1)
}
