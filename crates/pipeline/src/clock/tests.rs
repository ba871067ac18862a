//! The clock on simulated lines with known truth.

use posed_drivers::{Arrival, Measurement};

use super::*;

/// A small generator of our own: tests must give the same numbers for ever.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// How bytes come in, but for bursts.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Delivery {
    /// So many bytes at a time, each when the last of them has come over the wire.
    Fifo(u32),
    /// A whole cycle, when its last byte has come over the wire.
    Cycle,
    /// A whole cycle at once, without a wire.
    AtOnce,
}

/// A device on a line, and how its bytes reach the host.
#[derive(Clone, Copy)]
struct Line {
    rate_hz: f64,
    /// What it claims.
    nominal_hz: f64,
    drift_ppm: f64,
    birds: u32,
    record_bytes: u32,
    delivery: Delivery,
    /// The port has modem lines, so the clock is set to know that there is a wire.
    wire: bool,
    burst_s: Option<f64>,
    /// Share of cycles that leave no trace.
    lost: f64,
    /// Share of reads that come late, by up to `delay_s`.
    delayed: f64,
    delay_s: f64,
    phase_s: f64,
    seconds: f64,
}

impl Default for Line {
    fn default() -> Self {
        Self {
            rate_hz: 100.0,
            nominal_hz: 103.3,
            drift_ppm: 0.0,
            birds: 1,
            record_bytes: 15,
            delivery: Delivery::Fifo(1),
            wire: false,
            burst_s: None,
            lost: 0.0,
            delayed: 0.0,
            delay_s: 0.05,
            phase_s: 0.0,
            seconds: 20.0,
        }
    }
}

const BYTE_S: f64 = 10.0 / 115_200.0;

struct Outcome {
    /// Share of samples after 10 s within 1 ms.
    within: f64,
    /// Share of samples after 10 s within two stated sigmas.
    covered: f64,
    worst_s: f64,
    mean_sigma_s: f64,
    rate_hz: f64,
    skipped: u32,
    lost: u32,
}

impl Line {
    /// Samples with their true capture times, s, and the number of lost cycles.
    fn samples(&self, seed: u64) -> (Vec<(Sample, f64)>, u32) {
        let mut random = Random(seed);
        let period = (1.0 + self.drift_ppm * 1e-6) / self.rate_hz;
        // (arrival of the byte at the host, index of the record if it is a first byte)
        let mut bytes: Vec<(f64, Option<usize>)> = Vec::new();
        let mut records: Vec<(u32, u64, f64)> = Vec::new();
        let (mut count, mut lost) = (0, 0);
        for k in 0..(self.seconds * self.rate_hz) as u64 {
            let t = 1.0 + self.phase_s + k as f64 * period;
            if k > 100 && random.uniform() < self.lost {
                lost += 1;
                continue;
            }
            let cycle_bytes = self.birds * self.record_bytes;
            for i in 0..cycle_bytes {
                let pace = match self.delivery {
                    Delivery::Fifo(n) => f64::from(((i / n + 1) * n).min(cycle_bytes)) * BYTE_S,
                    Delivery::Cycle => f64::from(cycle_bytes) * BYTE_S,
                    Delivery::AtOnce => BYTE_S,
                };
                let first = (i % self.record_bytes == 0).then(|| {
                    records.push((i / self.record_bytes, count, t));
                    records.len() - 1
                });
                let at_host = match self.burst_s {
                    Some(burst) => ((t + pace) / burst).ceil() * burst,
                    None => t + pace,
                };
                bytes.push((at_host + 3e-5, first));
            }
            count += 1;
        }
        let mut samples: Vec<(Sample, f64)> = Vec::new();
        let mut previous = None;
        let mut at = 0;
        while at < bytes.len() {
            // A reader wakes a little after the first byte, sometimes much later, and takes all there is.
            let delay = if random.uniform() < self.delayed { self.delay_s * random.uniform() } else { 0.0 };
            let t_read = bytes[at].0 + 2e-5 + 8e-5 * random.uniform().powi(4) + delay;
            let end = at + bytes[at..].partition_point(|byte| byte.0 <= t_read);
            // A read that does not begin with a first byte goes on with the last record.
            if bytes[at].1.is_none()
                && let Some((sample, _)) = samples.last_mut()
            {
                sample.arrival.split = true;
            }
            for (i, byte) in bytes[at..end].iter().enumerate() {
                let Some(record) = byte.1 else { continue };
                let (bird, cycle, truth) = records[record];
                let arrival = Arrival {
                    t_read: Timestamp::from_secs_f64(t_read),
                    t_previous_read: previous.map(Timestamp::from_secs_f64),
                    bytes_after: (end - at - 1 - i) as u32,
                    cycle_bytes_before: bird * self.record_bytes,
                    split: false,
                    after_loss: false,
                };
                let measurement =
                    Measurement::Pose { position_m: None, orientation_wxyz: None, button: None };
                let t_device = DeviceTime::Cycle(cycle);
                samples.push((Sample { address: bird as u16 + 1, arrival, t_device, measurement }, truth));
            }
            previous = Some(t_read);
            at = end;
        }
        (samples, lost)
    }

    fn run(&self, seed: u64) -> Outcome {
        let (samples, lost) = self.samples(seed);
        let mut clock = Clock::new(Settings { byte_time_s: BYTE_S, measurement_delay_s: 0.0 });
        clock.set_nominal_rate_hz(Some(self.nominal_hz));
        if self.wire {
            clock.know_wire();
        }
        let mut last = None;
        let (mut n, mut within, mut covered, mut worst, mut sigma, mut skipped) =
            (0.0, 0.0, 0.0, 0.0f64, 0.0, 0);
        for (sample, truth) in &samples {
            let stamp = clock.push(sample);
            if stamp.begins_cycle {
                assert!(last.is_none_or(|last| last < stamp.t_valid), "capture times rise");
                last = Some(stamp.t_valid);
                skipped += stamp.cycles_skipped;
            }
            if *truth > 11.0 {
                let error = (stamp.t_valid.as_secs_f64() - truth).abs();
                n += 1.0;
                within += f64::from(u8::from(error < 1e-3));
                covered += f64::from(u8::from(error < 2.0 * stamp.sigma_s));
                worst = worst.max(error);
                sigma += stamp.sigma_s;
            }
        }
        Outcome {
            within: within / n,
            covered: covered / n,
            worst_s: worst,
            mean_sigma_s: sigma / n,
            rate_hz: clock.period_s().unwrap().recip(),
            skipped,
            lost,
        }
    }

    /// Runs over several phases and holds the requirement: 1 ms (95 %), and the stated sigma covers it.
    fn check(&self, name: &str) {
        let (mut within, mut covered) = (0.0, 0.0);
        let runs = 16;
        for run in 0..runs {
            let phase_s = 0.0023 * f64::from(run);
            let outcome = Line { phase_s, ..*self }.run(7 + run as u64);
            println!(
                "{name}: within {:.3} covered {:.3} worst {:.2} ms sigma {:.2} ms rate {:.4} skipped {}/{}",
                outcome.within,
                outcome.covered,
                outcome.worst_s * 1e3,
                outcome.mean_sigma_s * 1e3,
                outcome.rate_hz,
                outcome.skipped,
                outcome.lost
            );
            let truth_hz = self.rate_hz / (1.0 + self.drift_ppm * 1e-6);
            assert!((outcome.rate_hz / truth_hz - 1.0).abs() < 1e-3, "{name}: {} Hz", outcome.rate_hz);
            within += outcome.within / f64::from(runs);
            covered += outcome.covered / f64::from(runs);
        }
        assert!(within >= 0.95 && covered >= 0.95, "{name}: {within:.3} within, {covered:.3} covered");
    }
}

#[test]
fn a_prompt_line_is_timed_to_the_byte() {
    Line::default().check("paced");
    Line { birds: 2, ..Line::default() }.check("paced, two birds");
    Line { birds: 8, record_bytes: 13, delivery: Delivery::Fifo(8), ..Line::default() }
        .check("eight birds, by 8 bytes");
}

#[test]
fn a_cycle_in_one_piece_is_timed_over_the_wire_it_came_by() {
    for birds in [1, 2, 8] {
        let line = Line { birds, record_bytes: 13, delivery: Delivery::Cycle, wire: true, ..Line::default() };
        line.check(&format!("cycle in one piece, {birds} birds"));
    }
}

#[test]
fn where_nothing_shows_a_wire_the_stated_uncertainty_covers_both() {
    for delivery in [Delivery::Cycle, Delivery::AtOnce] {
        // One record: the doubt is within the millisecond.
        Line { delivery, ..Line::default() }.check(&format!("one bird, {delivery:?}"));
        for (birds, burst_s) in [(2, None), (8, None), (2, Some(0.016))] {
            let outcome = Line { birds, record_bytes: 13, delivery, burst_s, ..Line::default() }.run(3);
            let (worst_ms, sigma_ms) = (outcome.worst_s * 1e3, outcome.mean_sigma_s * 1e3);
            println!(
                "{delivery:?}, {birds} birds, burst {burst_s:?}: worst {worst_ms:.2} ms, sigma {sigma_ms:.2} ms"
            );
            assert!(outcome.covered >= 0.95, "{delivery:?}, {birds} birds: {}", outcome.covered);
        }
    }
}

#[test]
fn pieces_that_a_uart_keeps_do_not_move_the_capture_time_under_bursts() {
    for (birds, record_bytes, pieces) in [(1, 15, 8), (2, 15, 8), (8, 13, 8), (8, 13, 14)] {
        let delivery = Delivery::Fifo(pieces);
        let line =
            Line { birds, record_bytes, delivery, burst_s: Some(0.016), rate_hz: 103.3, ..Line::default() };
        line.check(&format!("bursts, {birds} birds, by {pieces} bytes"));
    }
}

#[test]
fn bursts_of_16_ms_do_not_hide_the_capture_time() {
    for rate_hz in [100.0, 103.3, 144.0] {
        for drift_ppm in [0.0, 50.0, -50.0] {
            let line = Line { rate_hz, drift_ppm, burst_s: Some(0.016), birds: 2, ..Line::default() };
            line.check(&format!("burst {rate_hz} Hz {drift_ppm} ppm"));
        }
    }
    let alone = Line { burst_s: Some(0.016), drift_ppm: 50.0, ..Line::default() };
    alone.check("burst, one bird");
}

#[test]
fn a_device_that_reports_seldom_keeps_its_phase_where_some_reads_say_much_and_most_nothing() {
    // Every 32nd cycle; some of its records are cut by a burst.
    let line = Line {
        rate_hz: 103.3 / 32.0,
        nominal_hz: 103.3 / 32.0,
        birds: 2,
        delivery: Delivery::Fifo(8),
        burst_s: Some(0.016),
        seconds: 60.0,
        ..Line::default()
    };
    for run in 0..16 {
        let outcome = Line { phase_s: 0.0023 * f64::from(run), ..line }.run(7 + run as u64);
        println!("{:.2} ms", outcome.worst_s * 1e3);
        assert!(outcome.worst_s < 0.016, "{} s", outcome.worst_s);
    }
}

#[test]
fn lost_cycles_are_counted_again() {
    for burst_s in [None, Some(0.016)] {
        let line = Line { burst_s, lost: 0.01, drift_ppm: 50.0, birds: 2, ..Line::default() };
        line.check(&format!("lost, burst {burst_s:?}"));
        for seed in 0..16 {
            let outcome = line.run(seed);
            assert_eq!(outcome.skipped, outcome.lost, "burst {burst_s:?}, seed {seed}");
            assert!((8..=32).contains(&outcome.lost), "about 19 of 1900: {}", outcome.lost);
        }
    }
}

#[test]
fn a_late_reader_does_not_move_the_capture_time() {
    for burst_s in [None, Some(0.016)] {
        let line = Line { burst_s, delayed: 0.01, drift_ppm: 50.0, birds: 2, ..Line::default() };
        line.check(&format!("late, burst {burst_s:?}"));
        Line { lost: 0.01, ..line }.check(&format!("late and lost, burst {burst_s:?}"));
    }
}

#[test]
fn a_host_that_is_often_late_makes_no_cycles_under_bursts() {
    for (birds, record_bytes) in [(2, 15), (8, 13)] {
        for delayed in [0.02, 0.1] {
            let line = Line {
                burst_s: Some(0.016),
                delayed,
                delay_s: 0.02,
                drift_ppm: 50.0,
                birds,
                record_bytes,
                rate_hz: 103.3,
                ..Line::default()
            };
            line.check(&format!("bursts, {birds} birds, {delayed} late"));
            let skipped = line.run(1).skipped;
            assert!(skipped <= 6, "{skipped} cycles that never were");
        }
    }
}

/// A whole record without values, read by itself.
pub(super) fn sample(
    address: u16,
    t_read: Timestamp,
    t_previous_read: Option<Timestamp>,
    t_device: DeviceTime,
) -> Sample {
    let arrival = Arrival {
        t_read,
        t_previous_read,
        bytes_after: 0,
        cycle_bytes_before: 0,
        split: false,
        after_loss: false,
    };
    let measurement = Measurement::Pose { position_m: None, orientation_wxyz: None, button: None };
    Sample { address, arrival, t_device, measurement }
}

/// A device that stamps its samples by milliseconds, read over a network that takes 1 to 4 ms; `stamped` may damage the stamp of a
/// cycle. Errors of the capture times, s, by cycle.
fn counted(cycles: u64, stamped: impl Fn(u64, u64) -> u64) -> Vec<f64> {
    let mut random = Random(5);
    let mut clock = Clock::new(Settings { byte_time_s: 0.0, measurement_delay_s: 0.0 });
    clock.set_nominal_rate_hz(Some(100.0));
    let mut previous = None;
    let mut errors = Vec::new();
    for k in 0..cycles {
        let truth_s = 20.0 + k as f64 * 0.01;
        let t_read = Timestamp::from_secs_f64(truth_s + 1e-3 + 3e-3 * random.uniform());
        let ticks = stamped(k, 50_000 + 10 * k);
        for address in 1..=2 {
            let t_device = DeviceTime::Counter { ticks, tick_s: 1e-3 };
            let stamp = clock.push(&sample(address, t_read, previous, t_device));
            assert!(stamp.t_valid <= t_read, "cycle {k}: captured after it was read");
            assert_eq!(stamp.begins_cycle, address == 1, "cycle {k}");
            assert_eq!(stamp.cycles_skipped, 0, "cycle {k}");
            errors.push(stamp.t_valid.as_secs_f64() - truth_s);
        }
        previous = Some(t_read);
    }
    errors.into_iter().step_by(2).collect()
}

/// Worst error, s, from the second second on.
fn worst_s(errors: &[f64]) -> f64 {
    errors[100..].iter().fold(0.0, |worst: f64, error| worst.max(error.abs()))
}

#[test]
fn a_wrong_stamp_moves_no_capture_time() {
    let clean_s = worst_s(&counted(1000, |_, ticks| ticks));
    assert!(clean_s < 4e-3, "{clean_s}");
    for wrong_ms in [100, 1_000, 8_000, 16_000, -100, -1_000, -8_000, -60_000] {
        let damaged = |k: u64, ticks: u64| {
            if k % 150 == 120 { ticks.saturating_add_signed(wrong_ms) } else { ticks }
        };
        let worst = worst_s(&counted(1000, damaged));
        assert!(worst < clean_s + 5e-3, "{wrong_ms} ms: {worst} s off");
    }
}

#[test]
fn random_stamps_move_no_capture_time() {
    let random = |k: u64| {
        let mut random = Random(k);
        random.uniform();
        (random.uniform() * 1e9) as u64
    };
    // One in ten, and from the very first on.
    let worst = worst_s(&counted(2000, |k, ticks| if k % 10 == 0 { random(k) } else { ticks }));
    assert!(worst < 1e-2, "{worst}");
    // Nothing but nonsense.
    let worst = worst_s(&counted(2000, |k, ticks| if k > 300 { random(k) } else { ticks }));
    assert!(worst < 2e-2, "{worst}");
}

#[test]
fn a_device_that_begins_anew_is_believed_after_a_few_cycles() {
    for begins in [0u64, 40_000, 10_000_000] {
        let errors = counted(2000, |k, ticks| if k >= 1000 { begins + 10 * (k - 1000) } else { ticks });
        let worst = worst_s(&errors);
        assert!(worst < 1e-2, "from {begins}: {worst}");
    }
}

#[test]
fn bursts_of_a_device_that_counts_leave_its_times_right() {
    let mut clock = Clock::new(Settings { byte_time_s: 0.0, measurement_delay_s: 0.0 });
    clock.set_nominal_rate_hz(Some(100.0));
    let mut previous = None;
    for k in 0..1200u64 {
        let truth_s = 1.0 + k as f64 * 0.01;
        // At once, but for two seconds in which a network delivers every 190 ms.
        let at_s: f64 = truth_s + 3e-4 + 1e-4 * (k % 3) as f64;
        let at_s = if (6.0..8.0).contains(&truth_s) { (at_s / 0.19).ceil() * 0.19 } else { at_s };
        let t_read = Timestamp::from_secs_f64(at_s);
        let t_device = DeviceTime::Counter { ticks: 5_000 + 10 * k, tick_s: 1e-3 };
        let stamp = clock.push(&sample(1, t_read, previous, t_device));
        previous = Some(t_read);
        let error_s = stamp.t_valid.as_secs_f64() - truth_s;
        // Restarted by what came late, the clock was 150 ms off.
        let limit_s = if (6.0..11.0).contains(&truth_s) { 1e-2 } else { 2e-3 };
        assert!(k < 100 || error_s.abs() < limit_s, "cycle {k}: {error_s} s");
    }
}

#[test]
fn cycles_that_left_no_trace_make_no_record_old_under_bursts() {
    for lost in 1..=10 {
        let mut clock = Clock::new(Settings { byte_time_s: 0.0, measurement_delay_s: 0.0 });
        clock.set_nominal_rate_hz(Some(40.0));
        let mut previous = None;
        for k in 0..400_u64 {
            let before = if k < 200 { 0 } else { lost };
            let truth_s = 1.0 + (k + before) as f64 * 0.025;
            let t_read = Timestamp::from_secs_f64((truth_s / 0.016).ceil() * 0.016);
            let stamp = clock.push(&sample(1, t_read, previous, DeviceTime::Cycle(k)));
            previous = Some(t_read);
            let off_s = (stamp.t_valid.as_secs_f64() - truth_s).abs();
            let stated = off_s < 0.02 || off_s < 4.0 * stamp.sigma_s;
            assert!(stamp.is_late() || stated, "{lost} lost: cycle {k} is {off_s} s off and no one says so");
        }
        let sigma_s = clock.sigma_t_s().unwrap();
        assert!(sigma_s <= MOST_SIGMA_S, "{lost} lost: {sigma_s} s at the end");
    }
}

#[test]
fn what_is_known_to_no_better_than_20_ms_is_late() {
    // Two cycles in a burst, in step with it: nothing ever tells when in the burst they were measured.
    for (burst_s, late) in [(0.16, true), (0.02, false)] {
        let mut clock = Clock::new(Settings { byte_time_s: 0.0, measurement_delay_s: 0.0 });
        clock.set_nominal_rate_hz(Some(2.0 / burst_s));
        let mut previous = None;
        for burst in 0..100_u64 {
            let t_read = Timestamp::from_secs_f64(1.0 + burst as f64 * burst_s);
            for k in 0..2 {
                let stamp = clock.push(&sample(1, t_read, previous, DeviceTime::Cycle(2 * burst + k)));
                assert!(burst < 50 || stamp.is_late() == late, "{burst_s} s: {stamp:?}");
            }
            previous = Some(t_read);
        }
    }
}

#[test]
fn cycles_that_left_no_trace_make_no_record_old() {
    for lost in [3, 5, 8, 30] {
        let mut clock = Clock::new(Settings { byte_time_s: 0.0, measurement_delay_s: 0.0 });
        clock.set_nominal_rate_hz(Some(100.0));
        let mut previous = None;
        for k in 0..40_u64 {
            // Nobody counts what is lost in front of the 20th.
            let before = if k < 20 { 0 } else { lost };
            let truth_s = 1.0 + (k + before) as f64 * 0.01;
            let t_read = Timestamp::from_secs_f64(truth_s + 2e-4);
            let stamp = clock.push(&sample(1, t_read, previous, DeviceTime::Cycle(k)));
            previous = Some(t_read);
            let off_s = (stamp.t_valid.as_secs_f64() - truth_s).abs();
            assert!(
                stamp.queued || off_s < 0.02,
                "{lost} lost: cycle {k} is {off_s} s off and no one says so"
            );
        }
    }
}

/// Nobody knows the period yet, and what is late by a lost cycle is as good as the others.
#[test]
fn cycles_lost_at_the_very_beginning_do_not_date_all_later_ones_early() {
    // What stands behind a cycle's first record in its read is what tells a lone one from one that waited.
    for (first, lost, step, behind) in (1..40).flat_map(|first| {
        (1..4).flat_map(move |lost| [(first, lost, 5, 0), (first, lost, 1, 0), (first, lost, 1, 141)])
    }) {
        let mut clock = Clock::new(Settings { byte_time_s: BYTE_S, measurement_delay_s: 0.0 });
        clock.set_nominal_rate_hz(Some(30.0));
        let mut random = Random(7);
        let (mut previous, mut count) = (None, 0);
        let mut off_s = 0.0_f64;
        for k in 0..600 {
            if k >= first && (k - first) % step == 0 && (k - first) / step < lost {
                continue;
            }
            let truth_s = 20.0 + f64::from(k) / 30.0;
            let t_read = Timestamp::from_secs_f64(truth_s + 4e-3 + 1e-3 * random.uniform());
            let mut sample = sample(1, t_read, previous, DeviceTime::Cycle(count));
            sample.arrival.bytes_after = if k < first { 0 } else { behind };
            let stamp = clock.push(&sample);
            (previous, count) = (Some(t_read), count + 1);
            if k > 300 {
                off_s = off_s.max((stamp.t_valid.as_secs_f64() - truth_s).abs());
            }
        }
        assert!(off_s < 0.01, "{lost} cycles lost from {first} on, {behind} bytes behind: {off_s} s off");
    }
}

/// Damage that reads like a record is a cycle that never was.
#[test]
fn cycles_that_never_were_do_not_bend_a_line_that_begins() {
    for (rate_hz, first) in [14.0, 40.0].into_iter().flat_map(|rate_hz| (1..70).map(move |at| (rate_hz, at)))
    {
        let mut clock = Clock::new(Settings { byte_time_s: BYTE_S, measurement_delay_s: 0.0 });
        clock.set_nominal_rate_hz(Some(rate_hz));
        let mut random = Random(7);
        let (mut previous, mut count) = (None, 0);
        for k in 0..400 {
            let truth_s = 20.0 + f64::from(k) / rate_hz;
            let t_read = |late_s: f64| Timestamp::from_secs_f64(truth_s + late_s);
            let mut push = |t_read| {
                let stamp = clock.push(&sample(1, t_read, previous, DeviceTime::Cycle(count)));
                (previous, count) = (Some(t_read), count + 1);
                stamp
            };
            let stamp = push(t_read(4e-3 + 1e-3 * random.uniform()));
            let off_s = (stamp.t_valid.as_secs_f64() - truth_s).abs();
            assert!(
                stamp.is_late() || off_s < f64::max(0.01, 6.0 * stamp.sigma_s) || k - first < 2,
                "{rate_hz} Hz, one from {first} on: cycle {k} is {off_s} s off"
            );
            if k == first {
                push(t_read(0.5 / rate_hz));
            }
        }
    }
}

/// Gives the clock of a device of `rate_hz`, on a wire, its `cycles`; those that `bursts` names are read when an adapter lets them go,
/// every `burst_ms`, the others at once. `alter` may change each sample, by the number of its cycle; `check` gets the stamp of each, with
/// that number and when it was measured, s.
fn read_in_bursts(
    (rate_hz, burst_ms): (f64, f64),
    cycles: impl Iterator<Item = u64>,
    bursts: impl Fn(u64) -> bool,
    alter: impl Fn(u64, &mut Sample),
    mut check: impl FnMut(&Clock, u64, f64, Stamp),
) {
    let mut clock = Clock::new(Settings { byte_time_s: BYTE_S, measurement_delay_s: 0.0 });
    clock.set_nominal_rate_hz(Some(rate_hz));
    clock.know_wire();
    let (mut previous, mut reads, mut latest_s) = (None, Vec::<(Timestamp, f64, u64)>::new(), 0.0_f64);
    for k in cycles {
        let truth_s = 20.0 + k as f64 / rate_hz;
        let there_s = truth_s + 33.0 * BYTE_S;
        let burst_s = burst_ms * 1e-3;
        let read_s = if bursts(k) { (there_s / burst_s).ceil() * burst_s } else { there_s };
        latest_s = latest_s.max(read_s);
        reads.push((Timestamp::from_secs_f64(latest_s), truth_s, k));
    }
    for chunk in reads.chunk_by(|(a, ..), (b, ..)| a == b) {
        for (place, &(t_read, truth_s, k)) in chunk.iter().enumerate() {
            let mut sample = sample(1, t_read, previous, DeviceTime::Cycle(k));
            sample.arrival.bytes_after = 33 * (chunk.len() - place) as u32 - 1;
            alter(k, &mut sample);
            let stamp = clock.push(&sample);
            check(&clock, k, truth_s, stamp);
        }
        previous = Some(chunk[0].0);
    }
}

/// An adapter that begins to keep bytes back, in the middle of a prompt stream: cycles of one read say nothing of the period.
#[test]
fn a_line_that_begins_to_burst_keeps_its_period() {
    for burst_ms in [20.0, 30.0, 42.7, 64.0] {
        let mut worst_s = 0.0_f64;
        let check = |_: &Clock, k, truth_s: f64, stamp: Stamp| {
            if k > 100 && !stamp.is_late() {
                worst_s = worst_s.max((stamp.t_valid.as_secs_f64() - truth_s).abs());
            }
        };
        read_in_bursts((120.0, burst_ms), 0..600, |k| k >= 300, |_, _| (), check);
        assert!(worst_s < burst_ms * 1e-3, "bursts of {burst_ms} ms: {worst_s} s off");
    }
}

/// What is claimed, or was learnt from a line that damage had bent, is not believed for ever against all reads.
#[test]
fn a_rate_that_is_not_the_devices_is_found_out() {
    for (rate_hz, claimed) in
        [12.5, 30.0].into_iter().flat_map(|rate_hz| [0.95, 0.98, 1.02, 1.05].map(|off| (rate_hz, off)))
    {
        let mut clock = Clock::new(Settings { byte_time_s: BYTE_S, measurement_delay_s: 0.0 });
        clock.set_nominal_rate_hz(Some(rate_hz * claimed));
        let mut previous = None;
        for k in 0..300_u64 {
            let truth_s = 20.0 + k as f64 / rate_hz;
            let t_read = Timestamp::from_secs_f64(truth_s + 14.0 * BYTE_S);
            let stamp = clock.push(&sample(1, t_read, previous, DeviceTime::Cycle(k)));
            previous = Some(t_read);
            let off_s = (stamp.t_valid.as_secs_f64() - truth_s).abs();
            let most_s = if k < 100 { f64::max(0.06, 3.0 * stamp.sigma_s) } else { 0.005 };
            assert!(
                stamp.is_late() || off_s < most_s,
                "{claimed} of {rate_hz} Hz is claimed: cycle {k} is {off_s} s off"
            );
            assert!(k < 200 || !stamp.is_late(), "{claimed} of {rate_hz} Hz is claimed: cycle {k} is late");
        }
    }
}

/// Reads say much of some blocks, and little of others: a line through all of them must not jump where that changes.
#[test]
fn a_line_that_ceases_to_burst_keeps_its_period() {
    for (rate_hz, burst_ms, burst_cycles) in [14.0, 40.0, 100.0].into_iter().flat_map(|rate_hz| {
        [20.0, 42.7, 57.1, 64.0].into_iter().flat_map(move |burst_ms| {
            [10_u64, 20, 31, 40, 57, 80].map(|burst_cycles| (rate_hz, burst_ms, burst_cycles))
        })
    }) {
        let check = |_: &Clock, k, truth_s: f64, stamp: Stamp| {
            let off_s = (stamp.t_valid.as_secs_f64() - truth_s).abs();
            // Half a period before, with a tenth of that stated.
            assert!(
                k < 16 || stamp.is_late() || off_s < f64::max(0.006, 6.0 * stamp.sigma_s),
                "{rate_hz} Hz, bursts of {burst_ms} ms for {burst_cycles} cycles: cycle {k} is {off_s} s off"
            );
        };
        read_in_bursts((rate_hz, burst_ms), 0..400, |k| k <= burst_cycles, |_, _| (), check);
    }
}

/// Bytes are lost, cycles with them, and bursts hide for a while that they are missing: no capture time is a cycle early meanwhile.
#[test]
fn cycles_lost_with_bytes_are_waited_for() {
    for (burst_ms, first, lost) in [40.0, 57.5, 75.0].into_iter().flat_map(|burst_ms| {
        // So late that a line which begins to burst at the 60th cycle is firm.
        (280_u64..300).flat_map(move |first| [0, 1, 2, 4].map(|lost| (burst_ms, first, lost)))
    }) {
        let alter = |k, sample: &mut Sample| {
            sample.t_device = DeviceTime::Cycle(if k < first { k } else { k - lost });
            sample.arrival.after_loss = k == first + lost;
        };
        let check = |clock: &Clock, k, truth_s: f64, stamp: Stamp| {
            let off_s = (stamp.t_valid.as_secs_f64() - truth_s).abs();
            let case = format!("{lost} cycles from {first} on, bursts of {burst_ms} ms: cycle {k}");
            assert!(
                stamp.is_late() || off_s < f64::max(0.01, 6.0 * stamp.sigma_s),
                "{case} is {off_s} s off"
            );
            let decided = k > first + lost + 15;
            assert!(!decided || clock.lossy.is_none() || stamp.is_late(), "{case} is in doubt");
        };
        let cycles = (0..480).filter(|k| !(first..first + lost).contains(k));
        read_in_bursts((30.0, burst_ms), cycles, |k| k >= 60, alter, check);
    }
}

/// A host that sleeps longer than half of the cycles that may contradict their line has read once, late: that is no other line.
#[test]
fn a_read_that_is_late_by_many_cycles_leaves_the_line_as_it_is() {
    let rate_hz = 120.0;
    for (burst_ms, first) in
        [200.0, 275.0, 350.0].into_iter().flat_map(|burst_ms| (200..272).map(move |first| (burst_ms, first)))
    {
        let burst = |k: u64| {
            let there_s = 20.0 + k as f64 / rate_hz + 33.0 * BYTE_S;
            (there_s * 1e3 / burst_ms).ceil() as u64
        };
        // Eight cycles by themselves between two times of sleep.
        let slept = burst(first);
        let again = (first..).find(|&k| burst(k) > slept).unwrap() + 8;
        let sleeps = |k: u64| burst(k) == slept || burst(k) == slept + 1 && k >= again;
        // By eight bytes at a time.
        let alter = |_, sample: &mut Sample| {
            sample.arrival.bytes_after -= 25;
            sample.arrival.t_read = sample.arrival.t_read - Duration::from_secs_f64(25.0 * BYTE_S);
        };
        let check = |clock: &Clock, k, truth_s: f64, stamp: Stamp| {
            let off_s = (stamp.t_valid.as_secs_f64() - truth_s).abs();
            let case = format!("asleep for {burst_ms} ms around {first}: cycle {k}");
            let stated = stamp.is_late() || off_s < f64::max(0.005, 6.0 * stamp.sigma_s);
            assert!(k < 100 || stated, "{case} is {off_s} s off");
            assert!(k < 100 || clock.window.is_settled(), "{case} begins another line");
        };
        read_in_bursts((rate_hz, burst_ms), 0..500, sleeps, alter, check);
    }
}

/// Nothing tells how late a first read is: one that holds many cycles held them for a while, and the line begins with the last of them.
#[test]
fn a_first_read_for_which_the_host_has_slept_dates_no_cycle_late() {
    for (rate_hz, burst_ms, counts) in [14.0, 40.0, 120.0].into_iter().flat_map(|rate_hz| {
        [230.0, 350.0]
            .into_iter()
            .flat_map(move |burst_ms| [(rate_hz, burst_ms, false), (rate_hz, burst_ms, true)])
    }) {
        let burst = |k: u64| {
            let there_s = 20.0 + k as f64 / rate_hz + 33.0 * BYTE_S;
            (there_s * 1e3 / burst_ms).ceil() as u64
        };
        let alter = |k: u64, sample: &mut Sample| {
            if counts {
                let ticks = (k as f64 / rate_hz * 1e6).round() as u64;
                sample.t_device = DeviceTime::Counter { ticks, tick_s: 1e-6 };
            }
        };
        let first = (1..).find(|&k| burst(k) > burst(0)).unwrap();
        let check = |_: &Clock, k, truth_s: f64, stamp: Stamp| {
            let off_s = (stamp.t_valid.as_secs_f64() - truth_s).abs();
            let case = format!("{rate_hz} Hz, {burst_ms} ms, counts {counts}: cycle {k}");
            assert!(
                stamp.is_late() || off_s < f64::max(0.01, 6.0 * stamp.sigma_s),
                "{case} is {off_s} s off"
            );
            assert!(k < first + 2 || !stamp.is_late(), "{case} is late: {stamp:?}");
        };
        read_in_bursts((rate_hz, burst_ms), 0..400, |k| burst(k) == burst(0), alter, check);
    }
}

/// A device that does not count and pauses for a part of its period goes on in another phase.
#[test]
fn a_pause_of_less_than_a_cycle_dates_none_early() {
    for (rate_hz, pause_ms) in [5.0, 8.0, 12.5, 20.0]
        .into_iter()
        .flat_map(|rate_hz| [25.0, 37.0, 52.0, 80.0].map(move |pause_ms| (rate_hz, pause_ms)))
    {
        let paused = |k: u64| Duration::from_secs_f64(if k >= 150 { pause_ms * 1e-3 } else { 0.0 });
        let alter = |k: u64, sample: &mut Sample| {
            let arrival = &mut sample.arrival;
            arrival.t_read = arrival.t_read + paused(k);
            arrival.t_previous_read = arrival.t_previous_read.map(|previous| previous + paused(k - 1));
        };
        let mut late = 0;
        let check = |_: &Clock, k: u64, truth_s: f64, stamp: Stamp| {
            let off_s = stamp.t_valid.as_secs_f64() - truth_s - paused(k).as_secs_f64();
            let case = format!("{rate_hz} Hz, {pause_ms} ms: cycle {k}");
            let stated = stamp.is_late() || off_s.abs() < f64::max(0.025, 6.0 * stamp.sigma_s);
            assert!(k < 100 || stated, "{case} is {off_s} s off");
            late += u32::from(k >= 100 && stamp.is_late());
        };
        read_in_bursts((rate_hz, 10.0), 0..400, |_| false, alter, check);
        assert!(late < 40, "{rate_hz} Hz, {pause_ms} ms: {late} of 300 cycles are late");
    }
}
