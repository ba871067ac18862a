use nalgebra::Vector3;
use posed_drivers::polhemus::{PolhemusSession, Settings};
use posed_drivers::{DeviceTime, Measurement, Session, State};

use crate::faults::{Bytes, Fault};
use crate::scenario::{DeviceScenario, Scenario};
use crate::testing::{Pair, angle_to, scenario_of, stage_of};

/// Three stations on a line that carries them.
const BAUD: u32 = 921_600;

fn pair(settings: Settings, device: DeviceScenario) -> Pair<PolhemusSession> {
    let addresses: &[u16] = if device.patriot { &[1, 2] } else { &[1, 2, 4] };
    let spec = stage_of("polhemus", "a", BAUD, addresses);
    let scenario = Scenario { sigma_signal_per_m3: 0.0, ..scenario_of(device) };
    Pair::new(&spec, &scenario, PolhemusSession::new(settings, BAUD, addresses).unwrap())
}

fn binary(faults: Vec<Fault>) -> Pair<PolhemusSession> {
    pair(Settings::default(), DeviceScenario { faults, ..DeviceScenario::default() })
}

/// How many samples are not what was true when they were measured, to the unit's own resolution of time.
fn wrong(pair: &Pair<PolhemusSession>) -> usize {
    let is_true = |sample: &&posed_drivers::Sample| {
        let Measurement::Pose { position_m: Some(p), orientation_wxyz: Some(q), .. } = sample.measurement
        else {
            return false;
        };
        let (t, _) = pair.truth_of(sample);
        // A host reads a record soon after its frame; bursts and resynchronisation hold it back by a frame or two.
        let near = pair.truth.iter().filter(|cycle| t.seconds_since(cycle.t).abs() < 0.03);
        near.filter_map(|cycle| cycle.sensors.get([1, 2, 4].iter().position(|a| *a == sample.address)?)).any(
            |row| (Vector3::from(p) - row.pose.translation.vector).norm() < 1e-5 && angle_to(q, row) < 1e-3,
        )
    };
    pair.samples.iter().filter(|sample| !is_true(sample)).count()
}

#[test]
fn in_binary_and_in_text_liberty_and_patriot_measure_what_is_true() {
    for (text, button, patriot) in
        [(false, false, false), (false, true, true), (true, false, true), (true, true, false)]
    {
        let device = DeviceScenario { patriot, drift_ppm: 80.0, ..DeviceScenario::default() };
        let mut pair = pair(Settings { text, button, ..Settings::default() }, device);
        pair.run_until(2.0);
        assert_eq!(*pair.session.state(), State::Streaming, "{:?}", pair.warnings);
        pair.forget();
        pair.run_until(4.0);
        let (stations, expected) = if patriot { (2, 2 * 120) } else { (3, 3 * 480) };
        assert!(pair.samples.len().abs_diff(expected) <= 6, "{} of {expected}", pair.samples.len());
        for sample in pair.samples.iter().skip(6) {
            let Measurement::Pose { position_m: Some(p), orientation_wxyz: Some(q), .. } = sample.measurement
            else {
                panic!("{sample:?}")
            };
            let (t, truth) = pair.truth_of(sample);
            assert!((Vector3::from(p) - truth.pose.translation.vector).norm() < 2e-5, "{p:?} {truth:?}");
            assert!(angle_to(q, &truth) < 3e-4, "{}", angle_to(q, &truth));
            let DeviceTime::Counter { ticks, tick_s } = sample.t_device else { panic!() };
            assert!((t.as_secs_f64() - ticks as f64 * tick_s).abs() < 2e-3);
        }
        assert_eq!((pair.counted(), pair.warnings.len()), (vec![0; stations], 0), "{:?}", pair.warnings);
    }
}

#[test]
fn every_frame_that_does_not_come_is_counted() {
    let mut pair = binary(vec![Fault::LostPeriods { at_s: 3.0, count: 5 }]);
    pair.run_until(5.0);
    assert_eq!(pair.counted(), [5, 5, 5]);
    assert_eq!(pair.counted(), [1, 2, 4].map(|address| pair.lost(address)));

    let dies = Fault::BirdDies { address: 2, at_s: 3.0, duration_s: Some(1.0) };
    let mut pair = binary(vec![dies, Fault::Error { address: 1, at_s: 5.0, code: 2, detail: 0 }]);
    pair.run_until(6.0);
    assert_eq!(pair.counted(), [0, pair.lost(2), 0]);
    assert!(pair.warnings.iter().any(|text| text.contains("error C")), "{:?}", pair.warnings);
}

#[test]
fn damaged_lines_make_no_wrong_pose_and_are_counted() {
    let bytes = Bytes { count: 60, start_s: 3.0, end_s: 13.0 };
    for (text, fault) in [
        (false, Fault::LostBytes(bytes)),
        (false, Fault::InsertedBytes(bytes)),
        (true, Fault::LostBytes(bytes)),
        (true, Fault::InsertedBytes(bytes)),
    ] {
        let device = DeviceScenario { faults: vec![fault.clone()], ..DeviceScenario::default() };
        let mut pair = pair(Settings { text, ..Settings::default() }, device);
        pair.run_until(14.0);
        assert_eq!(pair.hits.len(), 60);
        assert_eq!(wrong(&pair), 0, "{fault:?}");
        let lost: u64 = [1, 2, 4].map(|address| pair.lost(address)).iter().sum();
        let counted: u64 = pair.counted().iter().sum();
        // A resynchronisation may cost a record more than the damage; each that did not come is counted.
        assert!(counted.abs_diff(lost) <= 70, "{fault:?}: {lost} {counted}");
        let frames = pair.truth.iter().filter(|cycle| cycle.t.as_secs_f64() > 3.0).count() as u64;
        let came =
            pair.samples.iter().filter(|sample| sample.arrival.t_read.as_secs_f64() > 3.0).count() as u64;
        assert!(
            (3 * frames).abs_diff(came + counted) <= 4,
            "{fault:?}: {frames} frames, {came} came, {counted} lost"
        );
    }
}

#[test]
fn it_returns_after_power_plug_stalls_another_list_and_a_count_that_begins_anew() {
    for fault in [
        Fault::PowerCycle { at_s: 3.0 },
        Fault::Unplug { at_s: 3.0, duration_s: Some(1.0), power: false },
        Fault::Unplug { at_s: 3.0, duration_s: Some(1.0), power: true },
        Fault::Stall { at_s: 3.0, duration_s: 1.0 },
        Fault::WrongOutput { at_s: 3.0, duration_s: None },
        Fault::CounterRestart { at_s: 3.0 },
    ] {
        let mut pair = binary(vec![fault.clone()]);
        pair.run_until(9.0);
        assert_eq!(*pair.session.state(), State::Streaming, "{fault:?}");
        assert!(pair.now.seconds_since(pair.samples.last().unwrap().arrival.t_read) < 0.05, "{fault:?}");
        assert_eq!(wrong(&pair), 0, "{fault:?}");
    }
}

#[test]
fn a_line_that_is_too_slow_loses_frames_and_counts_them() {
    let spec = stage_of("polhemus", "a", 115_200, &[1, 2, 4]);
    let session = PolhemusSession::new(Settings::default(), 115_200, &[1, 2, 4]).unwrap();
    let scenario = Scenario { sigma_signal_per_m3: 0.0, ..scenario_of(DeviceScenario::default()) };
    let mut pair = Pair::new(&spec, &scenario, session);
    pair.run_until(5.0);
    assert!(pair.warnings.iter().any(|text| text.contains("records will be missing")), "{:?}", pair.warnings);
    let (lost, counted) = (pair.lost(1), pair.counted()[0]);
    assert!(lost > 200 && lost.abs_diff(counted) <= 8, "{lost} {counted}");
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let run = |seed| {
        let scenario = Scenario { seed, ..scenario_of(DeviceScenario::default()) };
        let session = PolhemusSession::new(Settings::default(), 115_200, &[1]).unwrap();
        let mut pair = Pair::new(&stage_of("polhemus", "a", 115_200, &[1]), &scenario, session);
        pair.run_until(2.0);
        pair.bytes
    };
    assert_eq!(run(3), run(3));
    assert_ne!(run(3), run(4));
}
