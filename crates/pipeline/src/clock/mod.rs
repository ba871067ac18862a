//! Capture times: from a record's arrival and its device's counter to `t_valid` with an uncertainty.
//!
//! What comes in: samples in the order of their arrival. What goes out: one [`Stamp`] per sample. What it
//! never does: read a clock; assume that bytes come in at the line's pace; let `t_valid` run backwards.
//!
//! The device measures cycle `x` at `t(x) = a + P x`. One read tells two things: its bytes were on the host's
//! side at or before `t_read`, a bound that delays of any kind cannot break, and the first of them not before
//! `t_previous_read`, since a read delivers all there is ([`reads`]). A burst adapter makes both loose, but their phases
//! differ from cycle to cycle, and over a [`Window`] the gap between the bounds closes: `P` is a robust fit,
//! `a` the middle of the gap, the stated uncertainty its width. Where reads follow the bytes closely the lower
//! bound says nothing (nothing came since the last cycle), and the usual lateness takes its place.
//!
//! A device that counts states how much time lies between two of its cycles. Its ticks are only as long as its crystal
//! is right, so `x` is its count in nominal periods and `P` is within [`CRYSTAL`] of nominal: that makes the fit
//! right from the first second on, and lost cycles cost nothing.
//!
//! Cycles that leave no trace on the wire make the driver's count fall behind. The same bounds show it: a
//! cycle cannot have been read before it was measured, nor have waited through an earlier read. The first is proof, where
//! it is by most of a cycle; by less than half of one it may be the line, and the clock begins anew. The second may be a
//! host that stamped the earlier read late, and a cycle that is late by whole periods the first of a burst, so they are
//! believed on [`Trial`]: times follow at once, but are not relied on, and count and window only when [`CONFIRMED`] reads
//! agree, and none that contradicts has come before.
//!
//! Where the driver saw that bytes are missing, cycles may be missing with them, and a slow reader or bursts hide it for a while: until
//! a read shows that none is, or how many, times are not relied on.
//!
//! A count that its own read contradicts is doubted ([`doubt`]): such a cycle is taken for the next one, and the window does
//! not see it. No capture time lies after its read, whatever the device says, but for the microsecond by which each of several
//! cycles that would have the same follows the one before.

mod arrival;
mod doubt;
mod interval;
pub mod offset;
mod radio;
mod reads;
mod window;

use posed_drivers::{DeviceTime, Sample, Timestamp};
use posed_state::Plain;
use std::time::Duration;

pub use arrival::ArrivalClock;
use doubt::{Count, Doubt, Opinion};
use interval::Interval;
pub use radio::RadioClock;
use reads::{Evidence, Reads};
use window::{Fit, Nominal, Window};

/// Uncertainty that remains when the bounds meet: stamps and adapters are not better than this, s.
const SIGMA_FLOOR_S: f64 = 1e-4;
/// Slack of a bound before it counts as broken, s.
const TOLERANCE_S: f64 = 3e-4;
/// Share of a period by which one cycle's time may be corrected.
const SLEW: f64 = 0.05;
/// So many of the latest [`INCONSISTENT_SPAN`] reads with cycles outside their bounds mean another phase: start again.
const INCONSISTENT_LIMIT: u32 = 32;
const INCONSISTENT_SPAN: u32 = 64;
/// Bytes that a UART may keep to itself, beyond those that the bounds allow for.
const FIFO_BYTES: f64 = 9.0;
/// Lateness beyond the usual from which on a cycle's time is not to be relied on until it is known what it comes from, s.
const UNDECIDED_S: f64 = 0.02;
/// Longest time from a cycle on a line to the read of its first bytes where nothing was kept back, beyond what is usual, s.
const ALONE_S: f64 = 5e-3;
/// The same from which on the clock begins anew, unless it is less than half a period, and how many undecided cycles in a row make it
/// do so, or reads while little is known.
const LOST_S: f64 = 0.06;
const UNDECIDED_CYCLES: u32 = 8;
/// Uncertainty of a capture time from which on its sample is late, s.
const MOST_SIGMA_S: f64 = 0.02;
/// How long times are not to be relied on after they were contradicted, s.
const CONTRADICTED_S: f64 = 0.2;
/// By how much less than whole cycles a read may be late and still mean that they are missing, s.
const LATE_BY_LESS_S: f64 = 5e-5;
/// How long cycles may be missing without a trace after bytes were lost, unless a read shows that none is, s.
const LOSSY_S: f64 = 0.5;
/// Share of a period by which the bounds of a window may contradict each other.
const CONTRADICTION: f64 = 0.4;
/// Reads that must agree on cycles that left no trace.
const CONFIRMED: u32 = 3;
/// Cycles after which a suspicion that was neither confirmed nor refuted is dropped.
const TRIAL_CYCLES: u32 = 64;
/// How far a device's counter may be off, as a share: crystals are within 100 ppm, ceramic resonators within 0.5 %.
const CRYSTAL: f64 = 1e-3;
/// Period of a device that counts and has not said its rate, s.
const UNREPORTED_PERIOD_S: f64 = 0.01;
/// Least spacing of two cycles of one device, ns.
const LEAST_STEP_NS: i64 = 1_000;

/// What is known of a device and its line beforehand. Both are taken as exact.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Settings {
    /// Time of one byte on the line, s, at least 0: 10 bits at `baud` of the stage file; 0 where bytes cost no time that is
    /// known.
    pub byte_time_s: f64,
    /// Constant delay from measurement to the first byte of the cycle, s, at least 0: `measurement_delay_ms` of the stage file
    /// and what the driver knows. An error of it shifts every capture time, and no stated uncertainty shows it.
    pub measurement_delay_s: f64,
}

/// Capture time of one sample: an estimate on the host's clock, made when the sample arrived and not revised.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Stamp {
    /// When the measurement was true; the same for all samples of one cycle, and later than that of the cycle before.
    pub t_valid: Timestamp,
    /// Standard deviation of `t_valid`, s, as the clock states it: a [`Clock`] by what the bounds of its window leave, 0.01
    /// before its first fit.
    pub sigma_s: f64,
    /// Whether this sample begins a cycle.
    pub begins_cycle: bool,
    /// Cycles that are missing in front of this one: nothing of them came through. By the device's count or the clock's estimate
    /// of it; 0 after a restart, for samples inside a cycle, and for devices without cycles.
    pub cycles_skipped: u32,
    /// Whether its time may be another one by more than `sigma_s` says: it may have waited on its way where nothing but its arrival
    /// tells when it was measured ([`ArrivalClock`]), or it is of the first read of a line, or it comes late and alone, and nobody
    /// knows yet whether cycles before it were lost.
    pub queued: bool,
}

impl Stamp {
    /// Whether its sample must not pass for one of its time: it may have waited, or that time is hardly known. A frame states the
    /// uncertainty of its own time, which need not be that of each of its samples.
    pub fn is_late(&self) -> bool {
        self.queued || self.sigma_s > MOST_SIGMA_S
    }
}

/// Clock model of one device that measures in cycles. Causal; it allocates nothing per sample.
#[derive(Clone, Debug, Plain)]
pub struct Clock {
    settings: Settings,
    /// Period to believe until the data speak, s.
    nominal_period_s: Option<f64>,
    reads: Reads,
    window: Window,
    fit: Option<Fit>,
    origin: Option<Origin>,
    /// Intervals of the cycles in units of `x`: 1 but for devices that count.
    interval: Interval,
    /// Cycles that the driver's count is behind (Cycle only).
    renumbered: i64,
    trial: Option<Trial>,
    /// When bytes were lost, as long as nobody knows whether whole cycles went with them (Cycle only).
    lossy: Option<Timestamp>,
    /// When a cycle was read last that had not been measured yet, by the line.
    contradicted: Option<Timestamp>,
    /// Cycles in a row that came late and alone.
    undecided: u32,
    /// Reads in a row of which all came late, while little is known of the line.
    late_reads: u32,
    doubt: Doubt,
    last: Option<Cycle>,
    /// Most bytes that were behind a cycle that was not late.
    usual_behind: u32,
    /// Bytes that usually follow in the chunk of a cycle's first record.
    usual_bytes_after: u32,
    inconsistent: u32,
    inconsistent_seen: u32,
    /// The latest read that was counted, and whether as one outside.
    judged: Option<(Timestamp, bool)>,
}

/// Where internal times and counts begin, so that doubles keep their precision.
#[derive(Clone, Copy, Debug, Plain)]
struct Origin {
    t: Timestamp,
    index: u64,
    /// Ticks of the device's counter per unit of `x`; 1 where it does not count.
    ticks: f64,
    /// Nominal duration of that many ticks, s, where the device counts.
    counted_s: Option<f64>,
}

impl Origin {
    fn new(sample: &Sample, raw: u64, nominal_period_s: Option<f64>) -> Self {
        let t = sample.arrival.t_read;
        match sample.t_device {
            DeviceTime::Cycle(_) => Self { t, index: raw, ticks: 1.0, counted_s: None },
            DeviceTime::Counter { tick_s, .. } => {
                let ticks = (nominal_period_s.unwrap_or(UNREPORTED_PERIOD_S) / tick_s).round().max(1.0);
                Self { t, index: raw, ticks, counted_s: Some(ticks * tick_s) }
            }
        }
    }

    /// Position of a count on the clock's own axis.
    fn x(&self, raw: u64) -> f64 {
        raw.wrapping_sub(self.index) as i64 as f64 / self.ticks
    }
}

/// A suspicion that cycles have left no trace.
#[derive(Clone, Copy, Debug, Plain)]
struct Trial {
    /// How many.
    shift: i64,
    /// Reads that say so, and the latest of them.
    agreeing: u32,
    t_read: Timestamp,
    /// Cycles since it began.
    cycles: u32,
}

/// The latest cycle.
#[derive(Clone, Copy, Debug, Plain)]
struct Cycle {
    /// The device's own count: the latest that was believed.
    raw: u64,
    /// Count after renumbering, from the origin.
    x: f64,
    t_read: Timestamp,
    t_valid: Timestamp,
    sigma_s: f64,
    /// As [`Stamp::queued`].
    queued: bool,
}

impl Clock {
    /// A clock that has seen nothing yet.
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            nominal_period_s: None,
            reads: Reads::new(),
            window: Window::new(),
            fit: None,
            origin: None,
            interval: Interval::default(),
            renumbered: 0,
            trial: None,
            lossy: None,
            contradicted: None,
            undecided: 0,
            late_reads: 0,
            doubt: Doubt::default(),
            last: None,
            usual_behind: FIFO_BYTES as u32,
            usual_bytes_after: 0,
            inconsistent: 0,
            inconsistent_seen: 0,
            judged: None,
        }
    }

    /// Sets the rate of the cycles that the device claims, Hz; believed only until the data speak, and only if they
    /// do not contradict it. `None`, and what is no rate above 1/60 Hz, leaves the one before.
    pub fn set_nominal_rate_hz(&mut self, rate_hz: Option<f64>) {
        let period = rate_hz.filter(|rate| rate.is_finite() && *rate > 0.0).map(f64::recip);
        self.nominal_period_s = period.filter(|period| *period < 60.0).or(self.nominal_period_s);
    }

    /// States that the line has a wire on which bytes take their time; without this word the clock finds out, where records
    /// arrive in two pieces.
    pub fn know_wire(&mut self) {
        self.reads.know_wire();
        self.window.know_wire();
    }

    /// Forgets the phase: the device or its line began anew. The period is kept as the nominal one, and capture times go on
    /// rising.
    pub fn restart(&mut self) {
        self.begin_anew(false);
    }

    /// As [`Clock::restart`]; whether the line is not what it was.
    fn begin_anew(&mut self, has_changed: bool) {
        if let Some(period) = self.period_s() {
            self.nominal_period_s = Some(period);
        }
        self.window.clear(self.fit.as_ref(), has_changed);
        self.fit = None;
        self.origin = None;
        self.interval = Interval::default();
        self.renumbered = 0;
        self.trial = None;
        self.lossy = None;
        self.undecided = 0;
        self.late_reads = 0;
        self.doubt = Doubt::default();
        self.usual_bytes_after = 0;
        self.judged = None;
        self.inconsistent = 0;
        self.inconsistent_seen = 0;
        // `last` stays: time goes on rising over a restart.
    }

    /// Measured interval of the cycles on the host's clock, s; `None` before some 50 cycles have shown it.
    pub fn period_s(&self) -> Option<f64> {
        self.fit.map(|fit| fit.period_s * self.interval.x()).filter(|_| self.window.is_settled())
    }

    /// Measured interval of the cycles, or before that the nominal one, s; `None` where neither is known.
    pub fn period_or_nominal_s(&self) -> Option<f64> {
        self.period_s().or(self.nominal_period_s)
    }

    /// Standard deviation of the latest `t_valid`, s; `None` before the first sample.
    pub fn sigma_t_s(&self) -> Option<f64> {
        self.last.map(|cycle| cycle.sigma_s)
    }

    /// Capture time of the latest cycle; `None` before the first sample.
    pub fn latest(&self) -> Option<Timestamp> {
        self.last.map(|cycle| cycle.t_valid)
    }

    /// Takes the next sample, in order of arrival, and returns when it was measured. A count that goes back is a device that
    /// began anew.
    pub fn push(&mut self, sample: &Sample) -> Stamp {
        let (raw, counted) = match sample.t_device {
            DeviceTime::Cycle(cycle) => (cycle, false),
            DeviceTime::Counter { ticks, .. } => (ticks, true),
        };
        if self.reads.push(&sample.arrival) {
            self.window.know_wire();
        }
        match self.opinion(raw, sample.arrival.t_read) {
            Opinion::Believed => {}
            Opinion::BeganAnew => self.restart(),
            Opinion::Doubted => return self.next_cycle(sample.arrival.t_read),
            Opinion::DoubtedAgain => return self.repeat(),
        }
        let known = self.origin.is_some();
        let nominal = self.nominal_period_s;
        let origin = *self.origin.get_or_insert_with(|| Origin::new(sample, raw, nominal));
        let begins_cycle = !known || self.last.is_none_or(|last| raw != last.raw);
        let count = origin.x(raw);
        let byte_s = self.settings.byte_time_s;
        let mut evidence =
            self.reads.evidence(&sample.arrival, origin.t, count + self.renumbered as f64, byte_s);
        // Without a line there is none to fall behind of.
        if let Some(fit) = self.fit.filter(|_| sample.arrival.after_loss && !counted) {
            if !self.window.may_judge(fit.prompt) {
                // Nor one that shows whether cycles are missing: they would bend the line for as long as the window remembers.
                return self.begin_with(sample);
            }
            self.lossy = Some(sample.arrival.t_read);
        }
        if begins_cycle && self.fit.is_some_and(|fit| self.window.may_judge(fit.prompt)) {
            self.check(&evidence, !counted);
            if self.fit.is_none() {
                // The check found another phase and started again.
                return self.push(sample);
            }
        }
        let tried = self.trial.map_or(0, |trial| trial.shift);
        let x = count + (self.renumbered + tried) as f64;
        evidence.x = x;
        let (late_s, lone) =
            self.fit.filter(|_| !counted).map_or((0.0, false), |fit| self.lateness_s(&fit, &evidence));
        let lateness_s = if lone { late_s } else { 0.0 };
        let undecided = lateness_s > UNDECIDED_S || !counted && self.waited_alone(&evidence);
        self.undecided = if undecided { self.undecided + u32::from(begins_cycle) } else { 0 };
        // What waited for a reader bends a line of which little is known; but what always does tells that the line is wrong.
        let waited = late_s > UNDECIDED_S && !self.window.is_settled();
        let is_next_read = self.last.is_some_and(|last| last.t_read != sample.arrival.t_read);
        self.late_reads = if waited { self.late_reads + u32::from(is_next_read) } else { 0 };
        let contradicts = self.late_reads > UNDECIDED_CYCLES;
        let lost = self.fit.is_some_and(|fit| lateness_s > LOST_S.max(0.5 * fit.period_s));
        if lost || self.undecided > UNDECIDED_CYCLES || contradicts {
            // An unknown number of cycles is lost, or else a reader was late; what follows shows which.
            return self.begin_with(sample);
        }
        let contradicted =
            self.contradicted.is_some_and(|t| sample.arrival.t_read.seconds_since(t) < CONTRADICTED_S);
        let lossy = self.lossy.is_some_and(|t| sample.arrival.t_read.seconds_since(t) < LOSSY_S);
        // Only the read before tells for how long the bytes of a first read can have waited.
        let is_first = evidence.t_read == origin.t
            && evidence.lower.is_none_or(|lower| evidence.upper - lower > UNDECIDED_S);
        let queued = undecided || contradicted || lossy || is_first || self.trial.is_some();
        if self.trial.is_some() || undecided || waited || lossy {
            // Evidence of a count that may be wrong would bend the line.
        } else if self.window.push(&evidence, begins_cycle, self.fit.as_ref(), TOLERANCE_S)
            || self.fit.is_none()
        {
            if !counted && self.fit.is_some_and(|fit| self.window.has_slipped(&fit)) {
                self.restart();
                return self.push(sample);
            }
            let nominal = origin.counted_s.map(Nominal::Counted).or(nominal.map(Nominal::Reported));
            self.fit = self.window.fit(nominal, self.fit.as_ref());
            if !counted && self.fit.is_some_and(|fit| fit.crossing > CONTRADICTION * fit.period_s) {
                // A cycle was lost before the line was firm enough to show it.
                self.restart();
                return self.push(sample);
            }
        } else if let Some(fit) = &mut self.fit {
            fit.tighten(&evidence);
        }
        if begins_cycle {
            return self.begin_cycle(raw, x, origin, known, &evidence, queued);
        }
        if let Some(last) = &mut self.last {
            // What comes after a loss may be of a later cycle.
            last.queued |= lossy;
        }
        self.repeat()
    }

    /// Begins anew with a sample that the line cannot explain.
    fn begin_with(&mut self, sample: &Sample) -> Stamp {
        self.restart();
        self.contradicted = Some(sample.arrival.t_read);
        self.push(sample)
    }

    /// What to think of a count before it is used.
    fn opinion(&mut self, raw: u64, t_read: Timestamp) -> Opinion {
        let (Some(origin), Some(last)) = (self.origin, self.last) else { return Opinion::Believed };
        let Some(fit) = self.fit else {
            // Nothing is known of the line yet, so that there is nothing to lose.
            return if raw < last.raw { Opinion::BeganAnew } else { Opinion::Believed };
        };
        self.doubt.judge(&Count {
            raw,
            last: last.raw,
            tick_s: origin.counted_s.unwrap_or(fit.period_s) / origin.ticks,
            ahead_s: fit.line(origin.x(raw)) + fit.lower - t_read.seconds_since(origin.t),
            settled: self.window.is_settled(),
            t_read,
        })
    }

    /// Stamps a cycle whose count is not believed: so many usual intervals after the latest as fit between the reads.
    fn next_cycle(&mut self, t_read: Timestamp) -> Stamp {
        let (Some(last), Some(fit)) = (self.last, self.fit) else { return self.repeat() };
        let period_s = fit.period_s * self.interval.x();
        let cycles = (t_read.seconds_since(last.t_read) / period_s).round().max(1.0);
        let t_valid = last.t_valid + Duration::from_secs_f64(cycles * period_s);
        let t_valid = rising(t_valid.min(t_read), last.t_valid);
        let sigma_s = last.sigma_s.max(0.5 * period_s);
        self.last = Some(Cycle { x: last.x + cycles * self.interval.x(), t_read, t_valid, sigma_s, ..last });
        Stamp { t_valid, sigma_s, begins_cycle: true, cycles_skipped: cycles as u32 - 1, queued: false }
    }

    /// Holds a cycle's bounds against the model, and puts the count right where they contradict it.
    fn check(&mut self, evidence: &Evidence, may_renumber: bool) {
        let Some(fit) = self.fit else { return };
        let period = fit.period_s;
        let tolerance = TOLERANCE_S.min(0.3 * period);
        let late = evidence.upper - fit.line(evidence.x);
        // Bytes may have lain in a UART's buffer while the earlier read took place.
        let early_tolerance = (TOLERANCE_S + FIFO_BYTES * self.settings.byte_time_s).min(0.3 * period);
        let early = evidence.lower.map_or(f64::NEG_INFINITY, |lower| lower - fit.line(evidence.x));
        let usual = fit.prompt && late <= fit.upper + fit.lateness + tolerance;
        // What a device counts may come late for any reason; only for what is not counted it may mean another phase.
        let mut inconsistent = may_renumber && fit.prompt && !usual;
        if late < fit.lower - tolerance {
            // Read before it was measured: a shift was wrong, or the line is.
            let periods_early = (fit.lower - tolerance - late) / period;
            let ahead = periods_early.ceil() as i64;
            inconsistent = self.renumbered < ahead;
            if !inconsistent && periods_early.fract() < 0.5 {
                // Whole cycles would be much: it may as well be the line.
                self.begin_anew(false);
                self.contradicted = Some(evidence.t_read);
                return;
            }
            self.contradicted = Some(evidence.t_read);
            self.renumber(if inconsistent { 0 } else { -ahead });
        } else if early > fit.upper + early_tolerance {
            // It would have waited through an earlier read: the count is behind, if a whole number fits.
            let n = ((early - fit.upper - tolerance) / period).ceil();
            let fits = late - n * period >= fit.lower - tolerance;
            inconsistent = !fits || !may_renumber;
            if fits && may_renumber {
                self.suspect(n as i64, evidence.t_read);
            }
        } else if may_renumber && fit.prompt && late > fit.upper + 0.5 * period {
            // Late by whole periods on a prompt line, with nothing queued behind it: cycles are missing, or bursts begin. A
            // late reader would have found the following cycles in the same chunk.
            let n = ((late - fit.upper) / period).round();
            let rest = late - n * period;
            // A host that was late by a little less than a cycle would have found no more either.
            let fits = rest >= fit.upper - LATE_BY_LESS_S && rest <= fit.upper + fit.lateness + tolerance;
            if fits && evidence.bytes_after <= self.usual_bytes_after {
                inconsistent = false;
                self.suspect(n as i64, evidence.t_read);
            }
        } else if usual {
            self.usual_bytes_after = self.usual_bytes_after.max(evidence.bytes_after);
        }
        if self.lossy.is_some() && late - period < fit.lower - tolerance {
            // Were it a later cycle, it would have been read before it was measured: none is missing.
            self.lossy = None;
        }
        if let Some(trial) = &mut self.trial {
            trial.cycles += 1;
            let refuted = late - trial.shift as f64 * period < fit.lower - tolerance;
            if refuted || trial.cycles > TRIAL_CYCLES {
                self.trial = None;
            } else if trial.agreeing >= CONFIRMED {
                let shift = trial.shift;
                self.renumber(shift);
            }
        }
        self.count_consistency(inconsistent, evidence.t_read);
    }

    /// By how much a cycle comes later than usual, s; and whether nothing is behind it: cycles before it may be missing then, or the
    /// device may have paused for a part of one, as well as it may have waited.
    fn lateness_s(&mut self, fit: &Fit, evidence: &Evidence) -> (f64, bool) {
        let late_s = evidence.upper - fit.line(evidence.x) - fit.upper - fit.lateness;
        if late_s <= 0.0 {
            self.usual_behind = self.usual_behind.max(evidence.bytes_after);
        }
        (late_s, evidence.bytes_after <= self.usual_behind)
    }

    /// Whether a line's cycle would have waited until the next one should have been there, too, which is not: the device may have paused.
    fn waited_alone(&self, evidence: &Evidence) -> bool {
        let on_line = self.settings.byte_time_s > 0.0 && evidence.alone;
        self.fit.is_some_and(|fit| {
            let waited_s = evidence.upper - fit.line(evidence.x) - fit.upper;
            on_line && waited_s > fit.period_s + ALONE_S
        })
    }

    fn renumber(&mut self, shift: i64) {
        self.renumbered += shift;
        self.trial = None;
        self.lossy = None;
    }

    /// One more read says that at least so many cycles left no trace.
    fn suspect(&mut self, shift: i64, t_read: Timestamp) {
        let begun = Trial { shift, agreeing: 1, t_read, cycles: 0 };
        let trial = self.trial.get_or_insert(begun);
        if shift > trial.shift {
            *trial = begun;
        } else if trial.t_read != t_read {
            trial.agreeing += 1;
            trial.t_read = t_read;
        }
    }

    /// A read counts once, however many cycles it holds: a host that has slept was late once.
    fn count_consistency(&mut self, inconsistent: bool, t_read: Timestamp) {
        let judged = self.judged.filter(|(judged, _)| *judged == t_read);
        let counted = judged.is_some_and(|(_, counted)| counted);
        self.inconsistent_seen += u32::from(judged.is_none());
        self.inconsistent += u32::from(inconsistent && !counted);
        self.judged = Some((t_read, inconsistent || counted));
        if self.inconsistent >= INCONSISTENT_LIMIT {
            self.begin_anew(true);
            self.contradicted = Some(t_read);
        } else if self.inconsistent_seen >= INCONSISTENT_SPAN {
            self.inconsistent_seen = 0;
            self.inconsistent = 0;
        }
    }

    fn begin_cycle(
        &mut self,
        raw: u64,
        x: f64,
        origin: Origin,
        known: bool,
        evidence: &Evidence,
        queued: bool,
    ) -> Stamp {
        let (relative_s, sigma_s, period_s) = match &self.fit {
            Some(fit) => (fit.line(x) + fit.middle, fit.sigma, fit.period_s),
            None => (evidence.upper, 1e-2, 1e-2),
        };
        // Whether cycles left no trace is not decided yet.
        let mut sigma_s =
            self.trial.map_or(sigma_s, |trial| sigma_s.max(0.5 * period_s * trial.shift as f64));
        let model_ns = ((relative_s - self.settings.measurement_delay_s) * 1e9).round() as i64;
        let mut t_ns = origin.t.as_nanos().saturating_add(model_ns);
        let mut cycles_skipped = 0;
        if let Some(last) = self.last {
            let steps = x - last.x;
            if known && steps > 0.0 {
                if origin.counted_s.is_some() {
                    self.interval.push(steps);
                }
                cycles_skipped = ((steps / self.interval.x()).round() as u32).saturating_sub(1);
                let expected_ns = last.t_valid.as_nanos().saturating_add((steps * period_s * 1e9) as i64);
                let error_ns = t_ns.saturating_sub(expected_ns);
                let limit_ns = (SLEW * period_s * steps * 1e9) as i64;
                // A renumbering or a first fit is put right at once, a correction of the phase bit by bit.
                if self.window.is_settled() && error_ns.saturating_abs() < (0.5 * period_s * 1e9) as i64 {
                    let held_ns = error_ns - error_ns.clamp(-limit_ns, limit_ns);
                    t_ns -= held_ns;
                    sigma_s = libm::hypot(sigma_s, held_ns as f64 * 1e-9);
                }
            }
        }
        // Nothing was measured after it was read.
        let t_valid = Timestamp::from_nanos(t_ns).min(evidence.t_read);
        let t_valid = self.last.map_or(t_valid, |last| rising(t_valid, last.t_valid));
        self.last = Some(Cycle { raw, x, t_read: evidence.t_read, t_valid, sigma_s, queued });
        Stamp { t_valid, sigma_s, begins_cycle: true, cycles_skipped, queued }
    }

    fn repeat(&self) -> Stamp {
        let (t_valid, sigma_s, queued) =
            self.last.map_or((Timestamp::ZERO, 0.0, false), |last| (last.t_valid, last.sigma_s, last.queued));
        Stamp { t_valid, sigma_s, begins_cycle: false, cycles_skipped: 0, queued }
    }

    /// Capture time that the model gives for `cycles` after the latest one, by the measured or else the nominal interval; `None`
    /// before the first sample, or where no interval is known.
    pub fn predict(&self, cycles: u32) -> Option<Timestamp> {
        let period_s = self.period_or_nominal_s()?;
        Some(self.latest()? + Duration::from_secs_f64(period_s * f64::from(cycles)))
    }
}

/// A capture time after the one before.
fn rising(t_valid: Timestamp, before: Timestamp) -> Timestamp {
    t_valid.max(Timestamp::from_nanos(before.as_nanos().saturating_add(LEAST_STEP_NS)))
}

#[cfg(test)]
mod tests;
