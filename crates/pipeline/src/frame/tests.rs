//! Ticks and waiting, without clocks and devices.

use super::*;

fn ms(ms: f64) -> Timestamp {
    Timestamp::from_secs_f64(ms * 1e-3)
}

fn stamp(t_ms: f64) -> Stamp {
    Stamp { t_valid: ms(t_ms), sigma_s: 1e-4, begins_cycle: true, cycles_skipped: 0, queued: false }
}

fn measured(t_ms: f64) -> Measured {
    Measured {
        t_valid: ms(t_ms),
        position_m: None,
        clipped: false,
        orientation_wxyz: None,
        button: None,
        inertial: None,
    }
}

/// Devices of 100 Hz with one sensor each, unless said otherwise.
struct Bench {
    frames: Assembler,
    closed: Vec<Frame>,
}

impl Bench {
    fn new(sensors: &[DeviceIndex], rate_hz: Option<f64>) -> Self {
        let devices = usize::from(*sensors.iter().max().unwrap()) + 1;
        Self { frames: Assembler::new(devices, sensors, rate_hz, 5.0), closed: Vec::new() }
    }

    /// A record of cycle `t_ms` is complete at `now_ms`.
    fn record(&mut self, device: DeviceIndex, sensor: SensorIndex, t_ms: f64, now_ms: f64) {
        self.frames.stamp(device, &stamp(t_ms), Some(0.01), ms(now_ms));
        self.frames.sample(sensor, measured(t_ms), false);
        self.poll(now_ms);
    }

    /// One device that has fallen silent, after all ticks that follow.
    fn silent_since_90_ms() -> Self {
        let mut bench = Self::new(&[0], None);
        for k in 0..10 {
            let t = f64::from(k) * 10.0;
            bench.record(0, 0, t, t + 1.0);
        }
        let mut now = 91.0;
        while let Some(due) = bench.frames.poll_timeout(ms(now)) {
            now = due.as_secs_f64() * 1e3;
            bench.poll(now);
        }
        bench
    }

    fn poll(&mut self, now_ms: f64) {
        while let Some(frame) = self.frames.poll(ms(now_ms)) {
            self.closed.push(frame.clone());
        }
    }

    fn times_ms(&self) -> Vec<f64> {
        self.closed.iter().map(|frame| (frame.t_valid.as_secs_f64() * 1e5).round() / 100.0).collect()
    }
}

#[test]
fn a_frame_closes_with_its_last_sensor() {
    let mut bench = Bench::new(&[0, 0], None);
    for k in 0..5 {
        let t = f64::from(k) * 10.0;
        bench.record(0, 0, t, t + 1.0);
        let open = bench.closed.len();
        bench.record(0, 1, t, t + 2.0);
        assert_eq!(bench.closed.len(), open + usize::from(k > 0), "tick {k} waits for both");
    }
    let frame = bench.closed.last().unwrap();
    assert_eq!((frame.number, frame.t_valid, frame.t_closed), (4, ms(40.0), ms(42.0)));
    assert!(frame.sensors.iter().all(|sensor| sensor.samples.len() == 1 && !sensor.samples[0].late));
}

#[test]
fn a_lost_record_delays_its_frame_only_until_the_next_cycle() {
    let mut bench = Bench::new(&[0, 0], None);
    for k in 0..10 {
        let t = f64::from(k) * 10.0;
        bench.record(0, 0, t, t + 1.0);
        if k != 5 {
            bench.record(0, 1, t, t + 2.0);
        }
    }
    let frame = &bench.closed[5];
    assert_eq!(frame.t_valid, ms(50.0));
    assert!(frame.sensors[1].samples.is_empty() && frame.sensors[1].expected());
    assert_eq!(bench.closed.len(), 10);
}

#[test]
fn lost_cycles_have_ticks_of_their_own() {
    let mut bench = Bench::new(&[0], None);
    for k in [0, 1, 2, 5, 6] {
        let t = f64::from(k) * 10.0;
        bench.record(0, 0, t, t + 1.0);
    }
    assert_eq!(bench.times_ms(), [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0]);
    let by_model: Vec<bool> = bench.closed.iter().map(|frame| frame.by_model).collect();
    assert_eq!(by_model, [false, false, false, true, true, false, false]);
}

#[test]
fn a_silent_stage_ticks_on_for_half_a_second_and_counts_the_rest() {
    let mut bench = Bench::silent_since_90_ms();
    assert_eq!(bench.times_ms().last(), Some(&590.0));
    bench.record(0, 0, 2000.0, 2001.0);
    let frame = bench.closed.last().unwrap();
    assert_eq!((frame.t_valid, frame.ticks_left_out), (ms(2000.0), 140));
}

/// The first records of a unit that begins anew come before the period of its new line is known, and the first guess may be wrong.
#[test]
fn no_tick_is_laid_into_a_silence_that_is_over() {
    let mut bench = Bench::silent_since_90_ms();
    for period_s in [None, Some(0.03)] {
        bench.frames.stamp(0, &Stamp { begins_cycle: false, ..stamp(2000.0) }, period_s, ms(2001.0));
        bench.poll(2001.0);
        assert_eq!(bench.times_ms().last(), Some(&590.0));
        assert_eq!(bench.frames.poll_timeout(ms(2001.0)), None);
    }
    // Its first cycle is a tick, though nobody has stated the period of the new line.
    bench.frames.stamp(0, &stamp(2010.0), None, ms(2011.0));
    bench.frames.sample(0, measured(2010.0), false);
    bench.poll(2011.0);
    let frame = bench.closed.last().unwrap();
    assert_eq!((frame.t_valid, frame.ticks_left_out), (ms(2010.0), 46));
}

/// A unit that begins anew measures in another phase, a little later than the ticks that go on without it.
#[test]
fn ticks_follow_a_device_that_has_changed_its_phase() {
    for shift_ms in [10.0, 25.0, 45.0, 55.0, 90.0] {
        let mut bench = Bench::new(&[0], None);
        let mut last_ms = 0.0;
        for k in 0..40 {
            let t_ms = f64::from(k) * 100.0 + if k < 10 { 0.0 } else { shift_ms };
            while let Some(due) = bench.frames.poll_timeout(ms(last_ms)).filter(|due| *due < ms(t_ms + 1.0)) {
                last_ms = due.as_secs_f64() * 1e3;
                bench.poll(last_ms);
            }
            last_ms = t_ms + 1.0;
            bench.frames.stamp(0, &stamp(t_ms), Some(0.1), ms(last_ms));
            bench.frames.sample(0, measured(t_ms), false);
            bench.poll(last_ms);
        }
        let tick_ms = bench.times_ms();
        let last_ms = tick_ms.last().unwrap();
        assert!((last_ms - 3900.0 - shift_ms).abs() < 0.1, "by {shift_ms} ms: {tick_ms:?}");
    }
}

#[test]
fn each_device_misses_its_own_cycles_of_a_silence() {
    let mut bench = Bench::new(&[0, 1], None);
    let both = |bench: &mut Bench, t: f64| {
        // Before the frame closes: a late record would count as missed there.
        if t % 50.0 == 0.0 {
            bench.frames.stamp(1, &stamp(t), Some(0.05), ms(t + 1.0));
            bench.frames.sample(1, measured(t), false);
        }
        bench.record(0, 0, t, t + 1.0);
    };
    (0..=20).for_each(|k| both(&mut bench, f64::from(k) * 10.0));
    let mut now = 201.0;
    while let Some(due) = bench.frames.poll_timeout(ms(now)) {
        now = due.as_secs_f64() * 1e3;
        bench.poll(now);
    }
    (200..=210).for_each(|k| both(&mut bench, f64::from(k) * 10.0));
    let missed = [0, 1].map(|at| bench.closed.iter().map(|frame| frame.sensors[at].missed).sum::<u32>());
    assert_eq!(missed, [179, 35]);
}

#[test]
fn what_comes_after_its_frame_is_late_in_the_next() {
    let mut bench = Bench::new(&[0, 1], None);
    for k in 0..20 {
        let t = f64::from(k) * 10.0;
        bench.record(0, 0, t, t + 1.0);
        if k != 10 {
            bench.record(1, 1, t - 1.0, t + 1.5);
        }
        if k == 10 {
            let due = bench.frames.poll_timeout(ms(t + 1.0)).unwrap();
            assert!(due > ms(t + 5.0) && due < ms(t + 9.0), "{due:?}");
            bench.poll(due.as_secs_f64() * 1e3);
            assert_eq!(bench.times_ms().last(), Some(&t), "closed without the second device");
            bench.record(1, 1, t - 1.0, t + 9.5);
        }
    }
    let next = bench.closed.iter().find(|frame| frame.t_valid == ms(110.0)).unwrap();
    let samples = &next.sensors[1].samples;
    assert_eq!((samples.len(), samples[0].late, samples[1].late), (2, true, false));
}

/// Both devices fall silent after a sample for which no tick comes any more.
#[test]
fn what_waits_through_a_silence_is_late_in_the_frame_after_it() {
    for rate_hz in [None, Some(100.0)] {
        let mut bench = Bench::new(&[0, 1], rate_hz);
        for k in 0..20 {
            let t = f64::from(k) * 10.0;
            bench.record(0, 0, t, t + 1.0);
            bench.record(1, 1, t + 4.0, t + 5.0);
        }
        bench.frames.stop(0);
        bench.frames.stop(1);
        bench.record(0, 0, 720.0, 721.0);
        bench.record(0, 0, 730.0, 731.0);
        bench.poll(760.0);
        let after = bench.closed.iter().find(|frame| frame.ticks_left_out > 0).unwrap();
        let waited = &after.sensors[1].samples;
        assert!(waited.iter().all(|sample| sample.late), "{rate_hz:?}: {after:?}");
        assert_eq!(waited.len(), 1, "{rate_hz:?}: it is not lost");
        assert!(after.sensors[0].samples.iter().all(|sample| !sample.late), "{rate_hz:?}: {after:?}");
    }
}

/// A fast device ends just before a tick of a slow one, which takes over the clock.
#[test]
fn what_waits_for_a_slower_device_is_late() {
    let mut bench = Bench::new(&[0, 1], None);
    for k in 0..200 {
        let t = f64::from(k) * 10.0;
        if k < 181 {
            bench.record(0, 0, t, t + 1.0);
        }
        if k == 180 {
            bench.frames.sample(0, measured(t + 4.0), false);
            bench.frames.stop(0);
        }
        if k % 40 == 20 {
            bench.frames.stamp(1, &stamp(t + 2.0), Some(0.4), ms(t + 3.0));
            bench.frames.sample(1, measured(t + 2.0), false);
        }
        bench.poll(t + 3.5);
    }
    bench.frames.stamp(1, &stamp(2202.0), Some(0.4), ms(2203.0));
    bench.frames.sample(1, measured(2202.0), false);
    bench.poll(2300.0);
    let samples = bench.closed.iter().flat_map(|frame| {
        frame.sensors[0].samples.iter().map(|sample| (frame.t_valid, sample.measured.t_valid, sample.late))
    });
    let mut waited = 0;
    for (tick, t_valid, late) in samples {
        assert_eq!(late, tick.seconds_since(t_valid) > 0.1, "{t_valid:?} in the frame of {tick:?}");
        waited += u32::from(late);
    }
    assert_eq!(waited, 1);
    let last = bench.closed.last().unwrap();
    assert!(last.sensors[1].samples.iter().all(|sample| !sample.late), "{last:?}");
}

#[test]
fn a_rate_of_its_own_makes_a_grid() {
    let mut bench = Bench::new(&[0], Some(25.0));
    for k in 0..50 {
        let t = f64::from(k) * 10.0 + 3.0;
        bench.record(0, 0, t, t + 1.0);
    }
    assert_eq!(bench.times_ms()[..5], [40.0, 80.0, 120.0, 160.0, 200.0]);
    assert!(bench.closed[1..].iter().all(|frame| frame.sensors[0].samples.len() == 4));
}

/// Ten devices of one rate whose cycles lie `spread_ms` apart, read 3 ms later; their capture times are known to `sigma_ms`.
/// Frames that lack a sensor, and cycles that are counted as missed, of 2000 frames.
fn in_step(spread_ms: f64, sigma_ms: f64, drift_ppm: f64) -> (usize, u32) {
    const DEVICES: u16 = 10;
    let sensors: Vec<DeviceIndex> = (0..DEVICES).collect();
    let mut bench = Bench::new(&sensors, None);
    let mut random = 1u64;
    let mut noise = || {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((random >> 11) as f64 / (1u64 << 53) as f64 - 0.5) * 12.0_f64.sqrt()
    };
    for k in 0..2000 {
        for device in 0..DEVICES {
            let period_ms = 10.0 * (1.0 + 1e-6 * drift_ppm * f64::from(device));
            let t = f64::from(k) * period_ms + f64::from(device) * spread_ms;
            bench.record(
                device,
                device,
                t + sigma_ms * noise(),
                f64::from(k) * 10.0 + 3.0 + 0.1 * f64::from(device),
            );
        }
    }
    let frames = &bench.closed[20..];
    let lacking = frames.iter().filter(|frame| frame.sensors.iter().any(|sensor| sensor.samples.is_empty()));
    let missed = frames.iter().flat_map(|frame| &frame.sensors).map(|sensor| sensor.missed).sum();
    (lacking.count(), missed)
}

#[test]
fn devices_in_step_lack_no_frame() {
    for (spread_ms, sigma_ms) in [(0.0, 0.1), (0.0, 0.5), (0.1, 0.3), (-0.1, 0.3)] {
        assert_eq!(in_step(spread_ms, sigma_ms, 0.0), (0, 0), "{spread_ms} ms apart, sigma {sigma_ms} ms");
    }
}

/// Each of nine devices slips past a tick at most once or twice in 20 s.
#[test]
fn devices_that_drift_slip_past_a_tick_once() {
    for drift_ppm in [-50.0, 50.0] {
        let (lacking, missed) = in_step(0.1, 0.3, drift_ppm);
        assert!(
            lacking <= 18 && missed <= 18,
            "{drift_ppm} ppm: {lacking} frames lack a sensor, {missed} missed"
        );
    }
}

#[test]
fn a_tick_of_a_fast_device_that_has_gone_silent_takes_no_later_sample_of_a_slow_one() {
    let mut bench = Bench::new(&[0, 1], None);
    let slow = |bench: &mut Bench, t_ms: f64, now_ms: f64| {
        bench.frames.stamp(1, &stamp(t_ms), Some(0.34), ms(now_ms));
        bench.frames.sample(1, measured(t_ms), false);
    };
    for k in 0..=200 {
        let t = f64::from(k) * 10.0;
        if k % 34 == 0 && k < 200 {
            slow(&mut bench, t, t + 1.0);
        }
        bench.record(0, 0, t, t + 1.0);
    }
    // The host sleeps, with two more cycles of the fast one and one of the slow one before it.
    for t in [2010.0, 2020.0] {
        bench.frames.stamp(0, &stamp(t), Some(0.01), ms(2021.0));
        bench.frames.sample(0, measured(t), false);
    }
    slow(&mut bench, 2090.0, 2800.0);
    bench.poll(2800.0);
    let samples_at = |t_ms: f64| {
        let frame = bench.closed.iter().find(|frame| frame.t_valid == ms(t_ms));
        frame.map(|frame| frame.sensors[1].samples.len())
    };
    assert_eq!([2010.0, 2020.0].map(samples_at), [Some(0), Some(0)]);
}

#[test]
fn no_frame_of_a_grid_closes_before_its_time() {
    let mut bench = Bench::new(&[0], Some(100.0));
    for t in [0.0, 10.0, 20.0] {
        bench.record(0, 0, t, t + 1.0);
    }
    bench.record(0, 0, 30.1, 29.9);
    assert_eq!(bench.times_ms(), [10.0, 20.0]);
    assert_eq!(bench.frames.poll_timeout(ms(29.9)), Some(ms(30.0)));
    bench.poll(30.0);
    assert_eq!(bench.times_ms(), [10.0, 20.0, 30.0]);
}
