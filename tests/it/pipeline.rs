//! The whole core on virtual Flocks: set-up, capture times, frames, filter, faults.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests may panic and print")]

use posed_drivers::State;
use posed_fusion::faults::Cause;
use posed_pipeline::Pipeline;
use posed_simulator::faults::{Bytes, Fault};
use posed_simulator::scenario::{DeviceScenario, Scenario};
use posed_simulator::truth::TruthCycle;
use posed_stage::input::{Input, Model};
use posed_stage::output::{Estimate, OutcomeKind, SensorState};

use posed_rig::{Rig, Said, replay, stage};

fn scenario(devices: Vec<DeviceScenario>) -> Scenario {
    Scenario { devices, ..Scenario::default() }
}

fn flock(device: usize, rate_hz: f64) -> DeviceScenario {
    DeviceScenario { name: format!("d{device}"), rate_hz, ..DeviceScenario::default() }
}

/// Nearest cycle of a device.
fn truth_at(truth: &[TruthCycle], device: usize, t: f64) -> &TruthCycle {
    let of_device = || truth.iter().filter(|cycle| cycle.device == device);
    of_device()
        .min_by(|a, b| {
            let distance = |cycle: &TruthCycle| (cycle.t.as_secs_f64() - t).abs();
            distance(a).total_cmp(&distance(b))
        })
        .unwrap()
}

struct Report {
    frames: usize,
    ok: usize,
    wrong_5_sigma: usize,
    wrong_20_mm: usize,
    within_1_ms: f64,
    rate_hz: f64,
}

/// Compares what was published after `from_s` with the truth of the same cycle.
fn report(rig: &Rig, from_s: f64, sigma_signal: f64) -> Report {
    let estimates: Vec<&Estimate> = rig.estimates().filter(|e| e.t_valid.as_secs_f64() > from_s).collect();
    let mut out = Report {
        frames: estimates.len(),
        ok: 0,
        wrong_5_sigma: 0,
        wrong_20_mm: 0,
        within_1_ms: 0.0,
        rate_hz: 0.0,
    };
    let recent: Vec<TruthCycle> =
        rig.host.truth.iter().filter(|c| c.t.as_secs_f64() > from_s - 1.0).cloned().collect();
    let mut at = 0;
    for estimate in &estimates {
        let t = estimate.t_valid.as_secs_f64();
        while at + 1 < recent.len() && recent[at + 1].t.as_secs_f64() < t - 0.05 {
            at += 1;
        }
        let near = &recent[at..(at + 40).min(recent.len())];
        let cycle = truth_at(near, 0, t);
        out.within_1_ms += f64::from(u8::from((cycle.t.as_secs_f64() - t).abs() < 1e-3));
        for row in &cycle.sensors {
            let sensor = &estimate.sensors[row.sensor];
            if sensor.state != SensorState::Ok {
                continue;
            }
            out.ok += 1;
            let pose = sensor.pose.unwrap();
            let truth = row.pose.translation.vector + row.distortion_m;
            let error = (nalgebra::Vector3::from(pose.position_m.unwrap()) - truth).norm();
            let r = truth.norm();
            let across = 0.745 * sigma_signal * r.powi(4);
            let sigma = (2.0 * across * across
                + (0.136 * sigma_signal * r.powi(4)).powi(2)
                + 3.0 * 1.3e-4f64.powi(2))
            .sqrt();
            let [w, x, y, z] = pose.orientation_wxyz;
            let q = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
            let rotation_deg = q.angle_to(&row.pose.rotation).to_degrees();
            out.wrong_5_sigma += usize::from(error > 5.0 * sigma);
            out.wrong_20_mm += usize::from(error > 0.02 || rotation_deg > 5.0);
        }
    }
    let (first, last) = (estimates.first().unwrap(), estimates.last().unwrap());
    out.rate_hz = (estimates.len() - 1) as f64 / last.t_valid.seconds_since(first.t_valid);
    out.within_1_ms /= estimates.len() as f64;
    println!(
        "frames {}, ok {}, wrong (5 sigma) {}, wrong (20 mm, 5 deg) {}, within 1 ms {:.3}, {:.4} Hz",
        out.frames, out.ok, out.wrong_5_sigma, out.wrong_20_mm, out.within_1_ms, out.rate_hz
    );
    out
}

#[test]
fn two_clean_birds_are_published_without_a_loss() {
    let mut rig = Rig::new(&stage(&[2]), &scenario(vec![flock(0, 100.0)]));
    rig.run_until(16.0);
    assert!(rig.emitted.contains(&Said::State(0, State::Streaming)));
    let report = report(&rig, 5.0, 2e-4);
    assert_eq!(report.ok, 2 * report.frames, "every sample is ok");
    assert_eq!((report.wrong_5_sigma, report.wrong_20_mm), (0, 0));
    assert!((report.rate_hz / 100.0 - 1.0).abs() < 1e-3);
    assert!(report.within_1_ms > 0.95);
    let mut last = None;
    for estimate in rig.estimates() {
        assert!(last.is_none_or(|last| last < estimate.t_valid), "frames rise");
        last = Some(estimate.t_valid);
    }
    let status = rig.pipeline.status();
    assert!(status.sensors.iter().all(|sensor| sensor.samples > 1000 && sensor.lost <= 3), "{status:?}");
}

#[test]
fn bursts_and_drift_leave_the_rate_and_the_times_right() {
    let device = DeviceScenario { burst_ms: 16.0, drift_ppm: 50.0, ..flock(0, 100.0) };
    let mut rig = Rig::new(&stage(&[2]), &scenario(vec![device]));
    rig.run_until(25.0);
    let report = report(&rig, 13.0, 2e-4);
    assert!(report.within_1_ms >= 0.95);
    assert!((report.rate_hz / 99.995 - 1.0).abs() < 1e-3);
    assert!(report.ok as f64 > 0.99 * 2.0 * report.frames as f64);
    assert_eq!(report.wrong_20_mm, 0);
}

#[test]
fn a_second_slower_flock_shares_the_frames_of_the_first() {
    let mut rig = Rig::new(&stage(&[2, 2]), &scenario(vec![flock(0, 100.0), flock(1, 60.0)]));
    rig.run_until(10.0);
    let report = report(&rig, 5.0, 2e-4);
    assert!((report.rate_hz / 100.0 - 1.0).abs() < 1e-3, "{}", report.rate_hz);
    let status = rig.pipeline.status();
    let (rate, samples) = (status.devices[1].rate_hz.unwrap(), status.sensors[2].samples);
    assert!((rate / 60.0 - 1.0).abs() < 1e-3);
    let held: usize = rig.estimates().filter(|e| e.sensors[2].measured.is_some()).count();
    assert!(held as u64 + 5 > samples, "{held} of {samples}: each sample is in a frame of its own");
}

#[test]
fn the_same_entries_give_the_same_outputs_also_from_a_snapshot() {
    let stage_file = stage(&[2, 1]);
    let device = DeviceScenario { burst_ms: 16.0, ..flock(0, 100.0) };
    let mut rig = Rig::new(&stage_file, &scenario(vec![device, flock(1, 103.3)]));
    rig.run_until(4.3217);
    let snapshot = rig.pipeline.snapshot();
    let (said_before, log_before) = (rig.emitted.len(), rig.log.len());
    let model = Model::Transmitter { position_m: [0.0, 0.0, 1.0], orientation_wxyz: [0.0, 1.0, 0.0, 0.0] };
    rig.push(Input::Model(model));
    rig.run_until(6.0);
    assert_eq!(replay(&mut Pipeline::new(&stage_file).unwrap(), &rig.log), rig.emitted);
    let mut restored = Pipeline::restore(&stage_file, rig.pipeline.models(), &snapshot).unwrap();
    assert_eq!(restored.snapshot(), snapshot);
    assert_eq!(replay(&mut restored, &rig.log[log_before..]), rig.emitted[said_before..]);
    assert_eq!(restored.status(), rig.pipeline.status());
    assert!(Pipeline::restore(&stage(&[2, 2]), rig.pipeline.models(), &snapshot).is_err());
    // As many devices and sensors, under other names.
    let (mut devices, mut sensors) = (stage_file.clone(), stage_file.clone());
    devices.devices[1].name = "another".into();
    devices
        .sensors
        .iter_mut()
        .filter(|sensor| sensor.device == "d1")
        .for_each(|sensor| sensor.device = "another".into());
    sensors.sensors[0].name = "another".into();
    for other in [devices, sensors] {
        assert!(Pipeline::new(&other).is_ok());
        assert!(Pipeline::restore(&other, rig.pipeline.models(), &snapshot).is_err());
    }
    assert!(Pipeline::restore(&stage_file, rig.pipeline.models(), b"nonsense").is_err());
}

fn faulty(faults: Vec<Fault>) -> Rig {
    let device = DeviceScenario { faults, ..flock(0, 100.0) };
    let mut rig = Rig::new(&stage(&[2]), &scenario(vec![device]));
    rig.run_until(18.0);
    rig
}

fn fifty() -> Bytes {
    Bytes { count: 50, start_s: 6.0, end_s: 16.0 }
}

#[test]
fn damaged_bytes_never_make_a_wrong_pose() {
    for (name, fault) in [
        ("lost", Fault::LostBytes(fifty())),
        ("inserted", Fault::InsertedBytes(fifty())),
        ("bit 7", Fault::Bit7Flips(fifty())),
    ] {
        let rig = faulty(vec![fault]);
        print!("{name}: ");
        let report = report(&rig, 5.0, 2e-4);
        assert_eq!((report.wrong_5_sigma, report.wrong_20_mm), (0, 0), "{name}");
        let lost: u64 = rig.pipeline.status().sensors.iter().map(|sensor| sensor.lost).sum();
        let unpublished = 2 * report.frames - report.ok;
        assert!(unpublished <= 100 && unpublished as u64 <= lost, "{name}: {unpublished} of {lost}");
    }
}

#[test]
fn flipped_data_bits_are_never_good_beyond_20_mm_or_5_degrees() {
    // Over several scenes: where a bit falls is luck.
    for seed in 1..=8 {
        flips(seed);
    }
}

fn flips(seed: u64) {
    let device = DeviceScenario { faults: vec![Fault::DataBitFlips(fifty())], ..flock(0, 100.0) };
    let mut rig = Rig::new(&stage(&[2]), &Scenario { seed, ..scenario(vec![device]) });
    rig.run_until(18.0);
    let report = report(&rig, 5.0, 2e-4);
    assert_eq!(report.wrong_20_mm, 0);
    assert!(2 * report.frames - report.ok <= 100);
}

/// States of one sensor by name, from `from_s` to `to_s`, with how many frames had them.
fn states(rig: &Rig, sensor: usize, from_s: f64, to_s: f64) -> String {
    let mut counts = std::collections::BTreeMap::new();
    for estimate in rig.estimates().filter(|e| (from_s..to_s).contains(&e.t_valid.as_secs_f64())) {
        *counts.entry(format!("{:?}", estimate.sensors[sensor].state)).or_insert(0) += 1;
    }
    format!("{counts:?}")
}

#[test]
fn single_records_outside_the_gate_are_suspect_and_no_fault() {
    let device = DeviceScenario { faults: vec![Fault::DataBitFlips(fifty())], ..flock(0, 100.0) };
    let mut rig = Rig::new(&stage(&[2]), &Scenario { seed: 1, ..scenario(vec![device]) });
    rig.run_until(18.0);
    let is_suspect =
        |estimate: &&Estimate| estimate.sensors.iter().any(|sensor| sensor.state == SensorState::Suspect);
    let suspect = rig.estimates().filter(|e| e.t_valid.as_secs_f64() > 5.0).filter(is_suspect).count();
    let gate = |sensor| OutcomeKind::Fault { sensor, cause: Cause::Gate, active: true };
    let is_gate =
        |said: &&Said| matches!(said, Said::Outcome(outcome) if [gate(0), gate(1)].contains(&outcome.what));
    let faults = rig.emitted.iter().filter(is_gate).count();
    assert!(suspect > 10 && faults == 0, "{suspect} frames, {faults} faults");
}

#[test]
fn a_hemisphere_flip_is_repaired_at_once() {
    let rig = faulty(vec![Fault::HemisphereFlip { address: 2, at_s: 8.0, duration_s: 3.0 }]);
    assert_eq!(states(&rig, 1, 8.05, 10.95), r#"{"Repaired": 290}"#);
    assert_eq!(states(&rig, 0, 8.05, 10.95), r#"{"Ok": 290}"#);
    let report = report(&rig, 5.0, 2e-4);
    assert_eq!(report.wrong_20_mm, 0);
    let outcomes: Vec<_> = rig
        .emitted
        .iter()
        .filter_map(|emitted| match emitted {
            Said::Outcome(outcome) if outcome.t_valid.as_secs_f64() > 5.0 => Some(&outcome.what),
            _ => None,
        })
        .collect();
    let hemisphere = |active| OutcomeKind::Fault { sensor: 1, cause: Cause::HemisphereInversion, active };
    assert_eq!(outcomes, [&hemisphere(true), &hemisphere(false)]);
}

#[test]
fn a_frozen_sensor_is_stuck_and_comes_back() {
    let rig = faulty(vec![Fault::OutOfRange { address: 1, at_s: 8.0, duration_s: 3.0 }]);
    println!("{} then {}", states(&rig, 0, 8.05, 10.95), states(&rig, 0, 11.1, 18.0));
    let stuck = states(&rig, 0, 8.1, 10.95);
    assert_eq!(stuck, r#"{"Stuck": 285}"#);
    assert!(states(&rig, 0, 11.1, 17.9).starts_with(r#"{"Ok": 680"#), "{}", states(&rig, 0, 11.1, 17.9));
    assert_eq!(report(&rig, 5.0, 2e-4).wrong_5_sigma, 0);
}

#[test]
fn a_dead_bird_does_not_hold_up_the_others_and_a_lost_port_costs_what_it_must() {
    let dead = Fault::BirdDies { address: 2, at_s: 7.0, duration_s: Some(2.0) };
    let unplug = Fault::Unplug { at_s: 11.0, duration_s: Some(2.0), power: false };
    let rig = faulty(vec![dead, unplug]);
    println!("dead: {}", states(&rig, 1, 7.2, 8.9));
    assert!(states(&rig, 1, 7.2, 8.9).starts_with(r#"{"Missing""#));
    assert!(states(&rig, 0, 7.2, 8.9).starts_with(r#"{"Ok": 17"#), "{}", states(&rig, 0, 7.2, 8.9));
    let longest_wait = rig
        .estimates()
        .filter(|e| (7.5..8.9).contains(&e.t_valid.as_secs_f64()))
        .map(|e| e.t_closed.seconds_since(e.t_valid))
        .fold(0.0, f64::max);
    assert!(longest_wait < 0.01, "{longest_wait}");
    // Half a second of missing frames, then silence, then poses again; every sample in between is counted.
    assert_eq!(states(&rig, 0, 11.6, 12.9), "{}");
    assert!(states(&rig, 0, 15.0, 17.9).starts_with(r#"{"Ok": 290"#), "{}", states(&rig, 0, 15.0, 17.9));
    let sensors = rig.pipeline.status().sensors;
    assert!(sensors[0].estimated && (200..500).contains(&sensors[0].lost), "{sensors:?}");
    assert_eq!(report(&rig, 5.0, 2e-4).wrong_20_mm, 0);
}

/// The first records of a stream come before the session knows that it streams; on a line in bursts nothing contradicts the times that
/// the line of before would give them.
#[test]
fn a_unit_that_begins_anew_on_a_line_in_bursts_is_timed_by_its_new_line() {
    for k in 0..10 {
        let at_s = 4.5 + 0.0137 * f64::from(k);
        let bursts = Fault::Bursts { start_s: at_s + 2.2, end_s: 17.0, burst_ms: 56.457 };
        let faults = vec![Fault::PowerCycle { at_s }, bursts];
        let device = DeviceScenario { faults, fifo_bytes: 4096, ..flock(0, 50.0) };
        let mut rig = Rig::new(&stage(&[4]), &scenario(vec![device]));
        rig.run_until(12.0);
        let last = rig.estimates().last().unwrap();
        assert!(last.t_valid.as_secs_f64() > 11.8, "it streams again");
        for estimate in rig.estimates() {
            let waited_s = estimate.t_closed.seconds_since(estimate.t_valid);
            assert!(waited_s < 0.2, "power cycle at {at_s}: {waited_s} s at {:?}", estimate.t_closed);
        }
    }
}
