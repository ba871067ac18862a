//! Capture times of units behind a radio: they count on a clock of their own, and what they send comes late, now by 5 ms, now by 80.
//!
//! What comes in: samples in the order of their arrival, with the unit's counter or the number of the sample. What goes out: one
//! [`Stamp`] per sample. A radio only adds: no sample arrives before it was measured. So the fastest arrivals say where the unit's clock
//! lies on the host's, and the rest says nothing but how rare they are. Blocks of half a second keep their fastest arrival each; the line that
//! lies under all of them ([`posed_geometry::soonest`]), and close to them, is the clock. How far they lie above it shows how far the fastest of all may be from one that
//! nothing has kept back: what is late is late for a while, so it is blocks that are counted, not arrivals.
//!
//! Of a unit that numbers its samples and has no clock the number is one, of a rate that shows itself. One that does neither is believed by
//! its arrivals alone.

use posed_drivers::{DeviceTime, Sample, Timestamp};
use posed_geometry::soonest::{BLOCK_S, Kept, Soonest, Under};
use posed_state::Plain;

use super::{LEAST_STEP_NS, Settings, Stamp};

/// Blocks that are kept. Where samples keep their order and wait for one another, a fast one is rare: of 100 a second
/// that are delayed by up to 80 ms one in 700 is less than 8 ms late. Four minutes hold enough of them to show offset and drift.
const BLOCKS: usize = 512;
/// Time that blocks must span before their drift is believed; until then only the latest of them count, s.
const DRIFTS_AFTER_S: f64 = 20.0;
const RECENT_S: f64 = 10.0;
/// How far a unit's crystal may be off, and how far its rate where it only numbers its samples, as a share.
const CRYSTAL: f64 = 5e-4;
const RATE: f64 = 0.15;
/// Drift that is usual for a crystal, as a share: what is not known yet may be so much.
const USUAL_DRIFT: f64 = 5e-5;
/// What a radio adds even to the fastest arrival is not known: 0 to 10 ms, as a standard deviation, s.
const PATH_S: f64 = 3e-3;
/// How late the fastest arrival of a block is expected to be before any is known, s, and how many blocks that counts as.
const EXCESS_S: f64 = 0.02;
const EXCESS_BLOCKS: f64 = 2.0;
/// How much less sure the fastest of all blocks is than if blocks had nothing to do with one another.
const DEPENDENT: f64 = 2.0;
/// A sample that is earlier than the line by so much is damaged, or of another life of the unit, until so many agree; s.
const AHEAD_S: f64 = 0.02;
const AGREEING: u32 = 3;
/// So many blocks must be known before anything is doubted.
const FIRM: usize = 8;
/// Lateness of all arrivals of so many blocks, s, from which on the unit's clock has jumped or its number is no clock.
const LOST_S: f64 = 0.5;
const LOST_BLOCKS: usize = 20;
/// A step on the unit's own clock further back than this is a restart, s.
const RESTART_S: f64 = 1.0;
/// Share of a step by which it may become shorter or longer while the line is put right.
const SLEW: f64 = 0.5;
/// Samples over which the rate of a unit that only numbers them is first found.
const FIRST_COUNTS: u64 = 64;
/// Uncertainty of a sample of which only the arrival is known, s.
const ARRIVAL_SIGMA_S: f64 = 0.025;
/// Steps of which the median is the interval.
const STEPS: usize = 31;
/// Longest step that counts as one, s.
const LONGEST_STEP_S: f64 = 1.1;

/// Where a unit's own time begins on the clock's axis.
#[derive(Clone, Copy, Debug, Plain)]
struct Origin {
    t: Timestamp,
    raw: u64,
    /// Duration of a count, s: the unit's word, or measured where it only numbers samples.
    tick_s: f64,
    /// Whether the unit has a clock.
    is_clock: bool,
}

/// The latest sample.
#[derive(Clone, Copy, Debug, Plain)]
struct Latest {
    raw: u64,
    t_read: Timestamp,
    t_valid: Timestamp,
    device_s: f64,
    sigma_s: f64,
    queued: bool,
}

/// The line of a unit's clock: host time is device time, plus `offset_s` at `at_s`, plus `drift` for each second since.
#[derive(Clone, Copy, Debug, Plain)]
struct Line {
    at_s: f64,
    offset_s: f64,
    drift: f64,
    /// Standard deviation of the drift.
    drift_sigma: f64,
    /// How far the fastest arrivals may still be from the fastest possible, s.
    fastest_sigma_s: f64,
}

impl Line {
    fn offset_s(&self, device_s: f64) -> f64 {
        self.offset_s + self.drift * (device_s - self.at_s)
    }
}

/// Clock model of one unit behind a radio. Causal; it allocates nothing per sample.
#[derive(Clone, Debug, Plain)]
pub struct RadioClock {
    settings: Settings,
    origin: Option<Origin>,
    /// The first of a unit that only numbers its samples, before its rate is known.
    first: Option<(u64, Timestamp)>,
    fastest: Soonest,
    line: Option<Line>,
    latest: Option<Latest>,
    /// Samples in a row that came too early.
    ahead: u32,
    /// Latest steps on the unit's clock, s, the next one's place, and their median.
    steps: Vec<f64>,
    next_step: usize,
    period_s: Option<f64>,
    nominal_period_s: Option<f64>,
    #[state(skip)]
    scratch: Vec<f64>,
}

impl RadioClock {
    /// A clock that has seen nothing yet; of its settings only the delay counts.
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            origin: None,
            first: None,
            fastest: Soonest::new(BLOCKS),
            line: None,
            latest: None,
            ahead: 0,
            steps: Vec::with_capacity(STEPS),
            next_step: 0,
            period_s: None,
            nominal_period_s: None,
            scratch: Vec::with_capacity(STEPS),
        }
    }

    /// The rate that the unit claims, Hz; its samples show another.
    pub fn set_nominal_rate_hz(&mut self, rate_hz: Option<f64>) {
        let period_s = rate_hz.filter(|rate| rate.is_finite() && *rate > 0.0).map(f64::recip);
        self.nominal_period_s = period_s.or(self.nominal_period_s);
    }

    /// Forgets where the unit's clock lies: the unit or its radio began anew. Capture times go on rising.
    pub fn restart(&mut self) {
        self.origin = None;
        self.first = None;
        self.fastest.clear();
        self.line = None;
        self.ahead = 0;
    }

    /// Interval of the samples, s: the median of the latest steps. `None` before there are some.
    pub fn period_s(&self) -> Option<f64> {
        self.period_s
    }

    /// The same, or before it the interval that the unit claims.
    pub fn period_or_nominal_s(&self) -> Option<f64> {
        self.period_s.or(self.nominal_period_s)
    }

    /// Standard deviation of the latest capture time, s; `None` before the first sample.
    pub fn sigma_t_s(&self) -> Option<f64> {
        self.latest.map(|latest| latest.sigma_s)
    }

    /// Takes the next sample, in order of arrival, and returns when it was measured.
    pub fn push(&mut self, sample: &Sample) -> Stamp {
        let t_read = sample.arrival.t_read;
        let raw = match sample.t_device {
            DeviceTime::Counter { ticks, .. } | DeviceTime::Cycle(ticks) => ticks,
        };
        if let Some(latest) = self.latest.filter(|latest| latest.raw == raw && latest.t_read == t_read) {
            let Latest { t_valid, sigma_s, queued, .. } = latest;
            return Stamp { t_valid, sigma_s, begins_cycle: false, cycles_skipped: 0, queued };
        }
        let Some(origin) = self.origin(sample, raw) else { return self.by_arrival(raw, t_read) };
        // A coarse count stands still within its tick: the sample was in its middle, as far as anybody knows.
        let device_s = raw.wrapping_sub(origin.raw) as i64 as f64 * origin.tick_s + self.half_tick_s(&origin);
        if self.latest.is_some_and(|latest| device_s < latest.device_s - RESTART_S) && self.line.is_some() {
            self.restart();
            return self.push(sample);
        }
        let offset_s = t_read.seconds_since(origin.t) - device_s;
        let late_s = self.line.map_or(0.0, |line| offset_s - line.offset_s(device_s));
        if late_s < -AHEAD_S && self.fastest.blocks() >= FIRM {
            self.ahead += 1;
            if self.ahead < AGREEING {
                return self.by_arrival(raw, t_read);
            }
            self.restart();
            return self.push(sample);
        }
        self.ahead = 0;
        self.keep(device_s, offset_s);
        if self.is_lost() {
            self.restart();
            return self.push(sample);
        }
        self.stamp(raw, t_read, device_s, &origin)
    }

    /// Where the unit's time begins; `None` while a unit without a clock has not shown its rate.
    fn origin(&mut self, sample: &Sample, raw: u64) -> Option<Origin> {
        let t = sample.arrival.t_read;
        let new = match sample.t_device {
            DeviceTime::Counter { tick_s, .. } => Origin { t, raw, tick_s, is_clock: true },
            DeviceTime::Cycle(_) => {
                if let Some(origin) = self.origin.filter(|origin| !origin.is_clock) {
                    return Some(origin);
                }
                let (first, begun) = *self.first.get_or_insert((raw, t));
                let counts = raw.checked_sub(first);
                if counts.is_none() {
                    self.first = Some((raw, t));
                }
                let counts = counts.filter(|counts| *counts >= FIRST_COUNTS)?;
                let tick_s = t.seconds_since(begun) / counts as f64;
                Origin { t, raw, tick_s: Some(tick_s).filter(|tick_s| *tick_s > 1e-4)?, is_clock: false }
            }
        };
        let same = |origin: &Origin| origin.is_clock == new.is_clock && origin.tick_s == new.tick_s;
        if let Some(origin) = self.origin {
            if same(&origin) {
                return Some(origin);
            }
            self.restart();
        }
        self.origin = Some(new);
        // What lies before is on another axis.
        if let Some(latest) = &mut self.latest {
            latest.device_s = f64::NEG_INFINITY;
        }
        Some(new)
    }

    fn half_tick_s(&self, origin: &Origin) -> f64 {
        if origin.is_clock { 0.5 * origin.tick_s } else { 0.0 }
    }

    /// Notes an arrival in the blocks, and draws the line anew where it says something. The drift is found once a block, and kept between.
    fn keep(&mut self, device_s: f64, offset_s: f64) {
        let drift = self.line.map_or(0.0, |line| line.drift);
        match self.fastest.keep(device_s, offset_s, drift) {
            Kept::Late => {}
            Kept::Sooner => self.line = self.fit(Some(drift)),
            Kept::Begun => self.line = self.fit(None),
        }
    }

    /// The line under the fastest arrivals, close to them.
    fn fit(&self, drift: Option<f64>) -> Option<Line> {
        let span_s = self.fastest.span_s();
        let is_clock = self.origin.is_some_and(|origin| origin.is_clock);
        let most = if is_clock { CRYSTAL } else { RATE };
        let knows_drift = span_s >= DRIFTS_AFTER_S || !is_clock && self.fastest.blocks() > 4;
        let Under { at_s, least_s, drift, count, excess_s } =
            self.fastest.under(drift, knows_drift.then_some(most), RECENT_S)?;
        let excess_s = excess_s / count;
        let expected_s = (count * excess_s + EXCESS_BLOCKS * EXCESS_S) / (count + EXCESS_BLOCKS);
        // The fastest of n is later than the fastest possible by an n-th of what each is where something undelayed is usual, and by as much
        // as each where nothing is. The first is more usual: a quarter is taken, and may be wrong by twice that.
        let still_late_s = 0.25 * excess_s + expected_s / count;
        let fastest_sigma_s = libm::hypot(0.5 * expected_s, DEPENDENT * expected_s / count);
        let drift_sigma =
            if knows_drift { (2.0 * fastest_sigma_s / span_s.max(BLOCK_S)).min(most) } else { USUAL_DRIFT };
        Some(Line { at_s, offset_s: least_s - still_late_s, drift, drift_sigma, fastest_sigma_s })
    }

    /// Whether all arrivals of the latest blocks were so late that the unit's time lies elsewhere.
    fn is_lost(&self) -> bool {
        self.line.is_some_and(|line| {
            self.fastest.are_late(LOST_BLOCKS, |at_s, offset_s| offset_s - line.offset_s(at_s) > LOST_S)
        })
    }

    fn stamp(&mut self, raw: u64, t_read: Timestamp, device_s: f64, origin: &Origin) -> Stamp {
        let Some(line) = self.line else { return self.by_arrival(raw, t_read) };
        let model_s = device_s + line.offset_s(device_s) - self.settings.measurement_delay_s;
        let model_ns = origin.t.as_nanos().saturating_add((model_s * 1e9).round() as i64);
        let mut t_ns = model_ns;
        let (mut begins_cycle, mut cycles_skipped) = (true, 0);
        if let Some(latest) = self.latest {
            let step_s = device_s - latest.device_s;
            if step_s.is_finite() && step_s > 0.0 && step_s <= LONGEST_STEP_S {
                // Put right bit by bit, so that time neither stands nor jumps.
                let step_ns = step_s * 1e9;
                let (least, most) = ((1.0 - SLEW) * step_ns, (1.0 + SLEW) * step_ns);
                let before_ns = latest.t_valid.as_nanos();
                t_ns =
                    t_ns.clamp(before_ns.saturating_add(least as i64), before_ns.saturating_add(most as i64));
                let periods = self.period_s.map_or(1.0, |period_s| (step_s / period_s).round());
                cycles_skipped = (periods as u32).saturating_sub(1);
            }
            t_ns = t_ns.max(latest.t_valid.as_nanos().saturating_add(LEAST_STEP_NS));
            begins_cycle = latest.raw != raw || step_s != 0.0;
            if step_s.is_finite() {
                self.step(step_s);
            }
        }
        let held_s = (t_ns - model_ns) as f64 * 1e-9;
        let ahead_s = device_s - line.at_s;
        let coarse_s = if origin.is_clock { origin.tick_s / 12_f64.sqrt() } else { 0.0 };
        let variance = [PATH_S, line.fastest_sigma_s, line.drift_sigma * ahead_s.max(1.0), coarse_s, held_s]
            .iter()
            .map(|sigma| sigma * sigma)
            .sum::<f64>();
        let sigma_s = variance.sqrt();
        let t_valid = Timestamp::from_nanos(t_ns);
        self.latest = Some(Latest { raw, t_read, t_valid, device_s, sigma_s, queued: false });
        Stamp { t_valid, sigma_s, begins_cycle, cycles_skipped, queued: false }
    }

    /// Stamps a sample by its arrival: nothing better is known of it.
    fn by_arrival(&mut self, raw: u64, t_read: Timestamp) -> Stamp {
        let delay = std::time::Duration::from_secs_f64(self.settings.measurement_delay_s);
        let mut t_valid = t_read - delay;
        if let Some(latest) = self.latest {
            t_valid =
                t_valid.max(Timestamp::from_nanos(latest.t_valid.as_nanos().saturating_add(LEAST_STEP_NS)));
        }
        let device_s = self.latest.map_or(f64::NEG_INFINITY, |latest| latest.device_s);
        let sigma_s = ARRIVAL_SIGMA_S;
        self.latest = Some(Latest { raw, t_read, t_valid, device_s, sigma_s, queued: true });
        Stamp { t_valid, sigma_s, begins_cycle: true, cycles_skipped: 0, queued: true }
    }

    /// Notes a step of the unit's clock.
    fn step(&mut self, step_s: f64) {
        if !(0.0..=LONGEST_STEP_S).contains(&step_s) {
            return;
        }
        if self.steps.len() < STEPS {
            self.steps.push(step_s);
        } else {
            self.steps[self.next_step] = step_s;
        }
        self.next_step = (self.next_step + 1) % STEPS;
        if self.steps.len() < 5 {
            return;
        }
        self.scratch.clear();
        self.scratch.extend(&self.steps);
        let middle = self.scratch.len() / 2;
        let median = *self.scratch.select_nth_unstable_by(middle, f64::total_cmp).1;
        if median > 0.0 {
            self.period_s = Some(median);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::sample;
    use super::*;

    /// A unit behind a radio: its clock, its rate, and what its radio does.
    #[derive(Clone, Copy)]
    struct Radio {
        rate_hz: f64,
        tick_s: Option<f64>,
        drift: f64,
        /// Least delay, and what is added at most, s.
        least_s: f64,
        jitter_s: f64,
        seed: u64,
    }

    struct Noise(u64);

    impl Noise {
        fn uniform(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1_u64 << 53) as f64
        }
    }

    impl Radio {
        fn usual(jitter_s: f64, seed: u64) -> Self {
            Self { rate_hz: 60.0, tick_s: Some(1e-6), drift: 80e-6, least_s: 2e-3, jitter_s, seed }
        }

        /// Runs the unit for some seconds with 2 % loss: error and stated deviation of each capture time that is not late, and how
        /// many were late.
        fn run(&self, clock: &mut RadioClock, begin_s: f64, seconds: f64) -> (Vec<(f64, f64)>, usize) {
            let mut noise = Noise(self.seed);
            let (mut errors, mut late, mut came_s) = (Vec::new(), 0, 0.0_f64);
            for k in 0..(seconds * self.rate_hz) as u64 {
                let t_s = begin_s + k as f64 / self.rate_hz;
                let device_s = (t_s - begin_s) * (1.0 + self.drift) + 17.3;
                if noise.uniform() < 0.02 {
                    continue;
                }
                let delay_s = self.least_s + self.jitter_s * noise.uniform();
                // What left later does not overtake.
                came_s = came_s.max(t_s + delay_s);
                let t_device = match self.tick_s {
                    Some(tick_s) => DeviceTime::Counter { ticks: (device_s / tick_s) as u64, tick_s },
                    None => DeviceTime::Cycle(k),
                };
                let before = clock.latest.map(|latest| latest.t_valid);
                let stamp = clock.push(&sample(1, Timestamp::from_secs_f64(came_s), None, t_device));
                assert!(before.is_none_or(|before| before < stamp.t_valid), "time stands or goes back");
                if stamp.is_late() {
                    late += 1;
                } else {
                    errors.push((stamp.t_valid.as_secs_f64() - t_s, stamp.sigma_s));
                }
            }
            (errors, late)
        }
    }

    fn share(errors: &[(f64, f64)], good: impl Fn(&(f64, f64)) -> bool) -> f64 {
        errors.iter().filter(|error| good(error)).count() as f64 / errors.len() as f64
    }

    fn settings() -> Settings {
        Settings { byte_time_s: 0.0, measurement_delay_s: 0.0 }
    }

    #[test]
    fn capture_times_are_within_8_ms_whatever_the_radio_adds() {
        for jitter_s in [0.005, 0.03, 0.08] {
            let (mut stated, mut runs) = (0.0, 0.0);
            for (drift, tick_s) in
                [(80e-6, Some(1e-6)), (-400e-6, Some(1e-6)), (30e-6, Some(0.004)), (0.0, None)]
            {
                for seed in 1..4 {
                    let radio = Radio { drift, tick_s, ..Radio::usual(jitter_s, seed) };
                    let (errors, late) = radio.run(&mut RadioClock::new(settings()), 5.0, 120.0);
                    // It takes a few seconds until something comes undelayed.
                    let near = share(&errors[600..], |(error_s, _)| error_s.abs() < 8e-3);
                    let what = format!("{jitter_s} s, {drift}, {tick_s:?}, {seed}");
                    assert!(near > 0.95, "{what}: {near}");
                    // A rate takes longer to find than an offset.
                    let most_late = if tick_s.is_some() { 60 } else { 240 };
                    assert!(late < most_late, "{what}: {late} late");
                    stated += share(&errors, |(error_s, sigma_s)| error_s.abs() < 2.0 * sigma_s);
                    runs += 1.0;
                }
            }
            // A run may be unlucky; all together may not.
            assert!(stated / runs > 0.95, "{jitter_s} s: {}", stated / runs);
        }
    }

    /// Samples that are delayed by eight times their interval and keep their order: the fastest are rare.
    #[test]
    fn a_radio_that_bunches_samples_is_timed_within_8_ms_once_its_fastest_have_come() {
        let (mut near, mut stated, mut runs) = (0.0, 0.0, 0.0);
        for drift in [80e-6, -400e-6, 30e-6, 200e-6] {
            for seed in 1..4 {
                let radio = Radio { rate_hz: 100.0, drift, ..Radio::usual(0.08, seed) };
                let (errors, _) = radio.run(&mut RadioClock::new(settings()), 5.0, 300.0);
                near += share(&errors[6000..], |(error_s, _)| error_s.abs() < 8e-3);
                stated += share(&errors, |(error_s, sigma_s)| error_s.abs() < 2.0 * sigma_s);
                runs += 1.0;
            }
        }
        assert!(near / runs > 0.95, "{}", near / runs);
        assert!(stated / runs > 0.95, "{}", stated / runs);
    }

    #[test]
    fn a_reset_counter_begins_anew_and_time_goes_on() {
        let mut clock = RadioClock::new(settings());
        let radio = Radio::usual(0.03, 9);
        radio.run(&mut clock, 5.0, 30.0);
        let (errors, late) = radio.run(&mut clock, 40.0, 30.0);
        assert!(share(&errors, |(error_s, _)| error_s.abs() < 8e-3) > 0.95, "{:?}", errors.first());
        assert!(late < 60, "{late}");
    }

    #[test]
    fn a_damaged_time_bends_nothing() {
        let mut clock = RadioClock::new(settings());
        let radio = Radio::usual(0.01, 4);
        radio.run(&mut clock, 5.0, 30.0);
        let line = clock.line.unwrap();
        let latest = clock.latest.unwrap();
        let ticks = latest.raw + 600_000;
        let t_read = latest.t_read + std::time::Duration::from_millis(17);
        let stamp = clock.push(&sample(1, t_read, None, DeviceTime::Counter { ticks, tick_s: 1e-6 }));
        assert!(stamp.is_late());
        assert!(stamp.t_valid <= t_read);
        assert!((clock.line.unwrap().offset_s(line.at_s) - line.offset_s).abs() < 1e-6);
    }

    #[test]
    fn a_clap_is_at_one_time_for_two_phones() {
        let mut apart = Vec::new();
        for seed in 1..20 {
            let at = |drift, jitter_s, rate_hz, seed| {
                let radio = Radio { drift, rate_hz, ..Radio::usual(jitter_s, seed) };
                let mut clock = RadioClock::new(settings());
                // Both samples are the ones of the clap itself.
                let (errors, _) = radio.run(&mut clock, 5.0, 60.0);
                errors.last().copied().unwrap()
            };
            let (first, second) = (at(300e-6, 0.06, 60.0, seed), at(-200e-6, 0.015, 67.0, seed + 100));
            let sigma_s = libm::hypot(first.1, second.1);
            assert!((first.0 - second.0).abs() < 2.0 * sigma_s, "{first:?} {second:?}");
            apart.push((first.0 - second.0).abs());
        }
        assert!(apart.iter().all(|apart_s| *apart_s < 8e-3), "{apart:?}");
    }
}
