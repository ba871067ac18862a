//! The fault script: bytes lost, inserted and flipped, 50 of each in 10 s, two birds at 100 Hz.

use posed_simulator::faults::{Bytes, Fault};
use posed_simulator::scenario::DeviceScenario;

use super::judge::{counted, judge, lost};
use super::{NOISY, QUIET, device, pair};

/// Faults come when the clock model has seen ten seconds of stream.
const START_S: f64 = 13.0;
const SPAN: Bytes = Bytes { count: 50, start_s: START_S, end_s: START_S + 10.0 };

/// How the host gets the bytes: one by one, a frame in one go, in bursts of 16 ms.
const DELIVERIES: [(&str, usize, f64); 3] = [("bytes", 1, 0.0), ("frames", 4096, 0.0), ("bursts", 8, 16.0)];

/// Runs the script; returns frames lost, wrong poses, wrong beyond 20 mm or 5 degrees; checks every count.
fn run(fault: Fault, seed: u64, (name, fifo_bytes, burst_ms): (&str, usize, f64)) -> (usize, usize, usize) {
    let what = format!("{}, {name}, seed {seed}", fault.name());
    let noise = if seed.is_multiple_of(2) { QUIET } else { NOISY };
    let device = DeviceScenario { fifo_bytes, burst_ms, ..device(0, vec![fault]) };
    let mut rig = pair(seed, noise, device);
    rig.run_until(START_S - 1.0);
    let (from_s, before) = counted(&rig, 0);
    // At the start the bad first half second and a clock model that has seen nothing leave a few.
    assert!(before.iter().all(|&lost| lost <= 6), "{what}: {before:?} lost at the start");
    rig.run_until(START_S + 12.0);
    let judgement = judge(&rig, 0, START_S - 1.0, START_S + 12.0, noise);
    println!(
        "{what}: {} frames lost, {} wrong, worst {:.1} sigma {:.2} mm {:?}",
        judgement.broken,
        judgement.wrong(),
        judgement.worst_sigmas,
        judgement.worst_mm,
        judgement.examples
    );
    assert!(judgement.frames > 1200, "{what}: {}", judgement.frames);
    let status = rig.pipeline.status();
    for (sensor, before) in before.iter().enumerate() {
        let reported = status.sensors[sensor].lost - before;
        assert_eq!(reported, lost(&rig, 0, sensor, from_s), "{what}: bird {}", sensor + 1);
    }
    let warnings: Vec<_> =
        rig.emitted.iter().filter(|emitted| matches!(emitted, posed_rig::Said::Warning(..))).collect();
    assert!(warnings.is_empty(), "{what}: {warnings:?}");
    (judgement.broken, judgement.wrong(), judgement.wrong_coarse)
}

/// Frames lost by all seeds and deliveries; no pose may be wrong.
fn never_wrong(fault: Fault) {
    let (mut most, mut sum, mut runs) = (0, 0, 0);
    let mut wrong = 0;
    for delivery in DELIVERIES {
        for seed in 0..4 {
            let (broken, bad, _) = run(fault.clone(), seed, delivery);
            most = most.max(broken);
            sum += broken;
            runs += 1;
            wrong += bad;
        }
    }
    assert_eq!(runs, 12);
    let mean = sum as f64 / f64::from(runs) / 50.0;
    println!("{}: frames lost per fault: mean {mean:.2}, most {:.2}", fault.name(), most as f64 / 50.0);
    assert_eq!(wrong, 0);
    // A fault costs the frame it hits, two frames where it falls between them: at most 53 were seen, 50 on average.
    assert!(most <= 56, "{most} frames lost by 50 faults");
    assert!(mean <= 1.05, "{mean} frames lost per fault");
}

#[test]
fn lost_bytes_make_no_wrong_pose() {
    never_wrong(Fault::LostBytes(SPAN));
}

#[test]
fn inserted_bytes_make_no_wrong_pose() {
    never_wrong(Fault::InsertedBytes(SPAN));
}

#[test]
fn flipped_phase_bits_make_no_wrong_pose() {
    never_wrong(Fault::Bit7Flips(SPAN));
}

#[test]
fn flipped_data_bits_are_never_wrong_beyond_20_mm_or_5_degrees() {
    let (mut wrong, mut frames, mut runs) = (0, 0, 0);
    for delivery in DELIVERIES {
        for seed in 0..4 {
            let (broken, bad, coarse) = run(Fault::DataBitFlips(SPAN), seed, delivery);
            assert_eq!(coarse, 0);
            wrong += bad;
            frames += broken;
            runs += 50;
        }
    }
    let per_fault = |count: usize| count as f64 / f64::from(runs);
    let (lost, wrong) = (per_fault(frames), per_fault(wrong));
    println!("data bits: per fault {lost:.2} frames lost, {wrong:.2} values wrong by more than 5 sigma");
    // Low bits are within what a hand may do: 0.81 frames and 0.27 values were seen.
    assert!(runs == 600 && lost <= 0.95 && wrong <= 0.33, "{lost} and {wrong} in {runs}");
}
