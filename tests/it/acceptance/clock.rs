//! Capture times under bursts, drift and a host that is late: right to a millisecond, and no better than stated.

use posed_drivers::flock::wire::Format;
use posed_simulator::scenario::DeviceScenario;
use posed_stage::{Driver, Stage};

use super::judge::{cycles, nearest, within};
use super::{QUIET, device, scene};
use posed_rig::{Rig, Sleepy, stage};

/// Ten seconds after the stream has begun, and the end.
const FROM_S: f64 = 13.0;
const UNTIL_S: f64 = 23.0;

/// Shares of frames: within a millisecond, within two stated sigmas, within four; the rate over the device's.
struct Times {
    within_1_ms: f64,
    within_2_sigma: f64,
    within_4_sigma: f64,
    rate: f64,
    sigma_ms: f64,
    mean_ms: f64,
}

/// A stage of one flock in the format that fits its line.
fn flock(birds: u16) -> Stage {
    let mut stage = stage(&[birds]);
    #[allow(irrefutable_let_patterns, reason = "there are other drivers to come")]
    if let Driver::FlockOfBirds(settings) = &mut stage.devices[0].driver
        && birds > 7
    {
        settings.format = Format::PositionAngles;
    }
    stage
}

fn run(seed: u64, birds: u16, rate_hz: f64, burst_ms: f64, sleepy: Option<Sleepy>) -> Times {
    let stage = flock(birds);
    let names: Vec<&str> = stage.sensors.iter().map(|sensor| sensor.name.as_str()).collect();
    let device = DeviceScenario { rate_hz, burst_ms, drift_ppm: 50.0, ..device(0, Vec::new()) };
    let mut rig = Rig::new(&stage, &scene(seed, QUIET, &names, vec![device]));
    rig.host.sleepy = sleepy;
    rig.run_until(UNTIL_S + 0.1);
    let cycles = cycles(&rig, 0);
    let mut errors = Vec::new();
    for estimate in within(&rig, FROM_S, UNTIL_S) {
        let t_s = estimate.t_valid.as_secs_f64();
        errors.push((t_s - nearest(&cycles, t_s).t.as_secs_f64(), estimate.sigma_t_s));
    }
    let share = |ok: &dyn Fn(&(f64, f64)) -> bool| {
        errors.iter().filter(|error| ok(error)).count() as f64 / errors.len() as f64
    };
    // A line that is too slow for every cycle makes the unit leave out whole ones.
    let bytes = if birds > 7 { 13.0 } else { 15.0 } * f64::from(birds);
    let every = (bytes * 10.0 / 115_200.0 * rate_hz).ceil().max(1.0);
    let true_hz = rate_hz / (1.0 + 50e-6) / every;
    let first = within(&rig, FROM_S, UNTIL_S).next().expect("frames").t_valid;
    let last = within(&rig, FROM_S, UNTIL_S).last().expect("frames").t_valid;
    Times {
        within_1_ms: share(&|(error, _)| error.abs() <= 1e-3),
        within_2_sigma: share(&|(error, sigma)| error.abs() <= 2.0 * sigma),
        within_4_sigma: share(&|(error, sigma)| error.abs() <= 4.0 * sigma),
        rate: (errors.len() - 1) as f64 / last.seconds_since(first) / true_hz,
        sigma_ms: errors.iter().map(|(_, sigma)| sigma).sum::<f64>() / errors.len() as f64 * 1e3,
        mean_ms: errors.iter().map(|(error, _)| error).sum::<f64>() / errors.len() as f64 * 1e3,
    }
}

/// Runs all seeds of a case; returns how many kept to two sigmas, of how many, and how many were wrong.
fn case(
    what: &str,
    birds: u16,
    rate_hz: f64,
    burst_ms: f64,
    sleepy: Option<(f64, f64)>,
) -> (f64, f64, usize) {
    let (mut covered, mut runs, mut wrong) = (0.0, 0.0, 0);
    for seed in 0..3 {
        let sleepy = sleepy.map(|(share, longest_ms)| Sleepy::new(seed, share, longest_ms, 0.0));
        let times = run(seed, birds, rate_hz, burst_ms, sleepy);
        println!(
            "{what}, {birds} birds, {rate_hz} Hz, seed {seed}: {:.3} within 1 ms, {:.3} within 2 sigma, error {:.3} ms, \
             sigma {:.3} ms, rate {:.6}",
            times.within_1_ms, times.within_2_sigma, times.mean_ms, times.sigma_ms, times.rate
        );
        // Where bursts keep step with the cycles a run may be off by a few of its sigmas; all runs together may not.
        let covered_at_all = burst_ms > 0.0 || times.within_4_sigma >= 0.95;
        assert!(covered_at_all, "{what}, {birds} birds, {rate_hz} Hz, seed {seed}: sigma is too small");
        let right = times.within_1_ms >= 0.95;
        wrong += usize::from(!right || (times.rate - 1.0).abs() > 1e-3);
        covered += times.within_2_sigma;
        runs += 1.0;
    }
    (covered, runs, wrong)
}

fn cases(what: &str, burst_ms: f64, sleepy: Option<(f64, f64)>, may_be_wrong: usize) {
    let (mut covered, mut runs, mut wrong) = (0.0, 0.0, 0);
    for birds in [1, 2, 8] {
        for rate_hz in [100.0, 103.3, 144.0] {
            let (kept, of, bad) = case(what, birds, rate_hz, burst_ms, sleepy);
            covered += kept;
            runs += of;
            wrong += bad;
        }
    }
    println!("{what}: {:.3} of all frames within two stated sigmas", covered / runs);
    assert!(wrong <= may_be_wrong, "{what}: {wrong} runs with times or a rate that are wrong");
    assert!(covered / runs >= 0.95, "{what}: {}", covered / runs);
}

#[test]
fn bursts_and_drift_leave_times_within_a_millisecond() {
    // Bursts in step with the cycles (16 and 10 ms) leave 2 ms between the bounds of a unit with one record a cycle
    // until the drift has moved them on: one of the 27 runs is in doubt for some seconds, and says so.
    cases("bursts of 16 ms", 16.0, None, 1);
}

#[test]
fn a_host_that_is_late_leaves_times_within_a_millisecond() {
    cases("reads up to 20 ms late", 0.0, Some((0.02, 20.0)), 0);
}

#[test]
fn bursts_and_a_late_host_leave_times_within_a_millisecond() {
    // The same one.
    cases("bursts of 16 ms, reads up to 5 ms late", 16.0, Some((0.002, 5.0)), 1);
}

#[test]
fn bursts_and_a_host_that_is_often_late_leave_times_within_a_millisecond() {
    cases("bursts of 16 ms, 5 % of reads up to 20 ms late", 16.0, Some((0.05, 20.0)), 1);
}
