//! Lines with a wire or without, read byte by byte, by cycles or in bursts, by hosts that are late: how well times and their stated
//! uncertainty hold over many phases.

use super::*;

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
                let measurement = Measurement::Pose {
                    position_m: None,
                    clipped: false,
                    orientation_wxyz: None,
                    button: None,
                };
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
