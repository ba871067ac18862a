//! Devices that count or stamp by a clock of their own, and stamps that are damaged.

use super::*;

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
