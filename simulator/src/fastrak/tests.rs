use nalgebra::Vector3;
use posed_drivers::fastrak::{FastrakSession, Settings};
use posed_drivers::{Measurement, Session, State};

use crate::faults::{Bytes, Fault};
use crate::scenario::{DeviceScenario, Scenario};
use crate::testing::{Pair, angle_to, scenario_of, stage_of};

fn pair(settings: Settings, faults: Vec<Fault>) -> Pair<FastrakSession> {
    let spec = stage_of("fastrak", "a", 115_200, &[1, 2, 4]);
    let device = DeviceScenario { faults, ..DeviceScenario::default() };
    let scenario = Scenario { sigma_signal_per_m3: 0.0, ..scenario_of(device) };
    Pair::new(&spec, &scenario, FastrakSession::new(settings, &[1, 2, 4]).unwrap())
}

fn binary(faults: Vec<Fault>) -> Pair<FastrakSession> {
    pair(Settings::default(), faults)
}

#[test]
fn in_binary_and_in_text_it_measures_what_is_true() {
    for (text, button) in [(false, false), (false, true), (true, false), (true, true)] {
        let mut pair = pair(Settings { text, button, ..Settings::default() }, vec![]);
        pair.run_until(2.0);
        assert_eq!(*pair.session.state(), State::Streaming, "{:?}", pair.warnings);
        pair.forget();
        pair.run_until(4.0);
        assert!((238..=241).contains(&pair.samples.len()), "{}", pair.samples.len());
        for sample in pair.samples.iter().skip(6) {
            let Measurement::Pose { position_m: Some(p), orientation_wxyz: Some(q), .. } = sample.measurement
            else {
                panic!("{sample:?}")
            };
            let (_, truth) = pair.truth_of(sample);
            assert!((Vector3::from(p) - truth.pose.translation.vector).norm() < 2e-6, "{p:?} {truth:?}");
            assert!(angle_to(q, &truth) < 3e-4, "{}", angle_to(q, &truth));
        }
        assert_eq!(pair.counted(), [0; 3]);
    }
}

#[test]
fn every_station_that_is_passed_over_is_counted() {
    let mut pair = binary(vec![Fault::LostPeriods { at_s: 3.0, count: 2 }]);
    pair.run_until(5.0);
    assert_eq!([1, 2, 4].map(|address| pair.lost(address)).iter().sum::<u64>(), 2);
    assert_eq!(pair.counted(), [1, 2, 4].map(|address| pair.lost(address)));

    let bytes = Bytes { count: 30, start_s: 3.0, end_s: 13.0 };
    let mut pair = binary(vec![Fault::LostBytes(bytes)]);
    pair.run_until(14.0);
    assert_eq!(pair.hits.len(), 30);
    let lost: u64 = [1, 2, 4].map(|address| pair.lost(address)).iter().sum();
    let counted: u64 = pair.counted().iter().sum();
    assert!((28..=30).contains(&lost));
    assert!(counted.abs_diff(lost) <= 6, "{lost} {counted}");
}

#[test]
fn a_station_that_is_gone_an_error_letter_and_another_list() {
    let dies = Fault::BirdDies { address: 2, at_s: 3.0, duration_s: Some(1.0) };
    let error = Fault::Error { address: 1, at_s: 5.0, code: 2, detail: 0 };
    let mut pair = binary(vec![dies, error]);
    pair.run_until(6.0);
    assert!((39..=41).contains(&pair.lost(2)), "{}", pair.lost(2));
    assert_eq!(pair.lost(1), 1);
    assert_eq!(pair.counted(), [pair.lost(1), pair.lost(2), 0]);
    assert!(pair.warnings.iter().any(|text| text.contains("error C")), "{:?}", pair.warnings);

    let mut pair = binary(vec![Fault::WrongOutput { at_s: 3.0, duration_s: None }]);
    pair.run_until(8.0);
    assert!(pair.session.counters().bytes_skipped > 100);
    assert_eq!(*pair.session.state(), State::Streaming);
    assert!(pair.now.seconds_since(pair.samples.last().unwrap().arrival.t_read) < 0.05);
}

#[test]
fn it_returns_after_power_plug_and_stalls() {
    for fault in [
        Fault::PowerCycle { at_s: 3.0 },
        Fault::Unplug { at_s: 3.0, duration_s: Some(1.0), power: false },
        Fault::Unplug { at_s: 3.0, duration_s: Some(1.0), power: true },
        Fault::Stall { at_s: 3.0, duration_s: 1.0 },
    ] {
        let mut pair = binary(vec![fault.clone()]);
        pair.run_until(9.0);
        assert_eq!(*pair.session.state(), State::Streaming, "{fault:?}");
        assert!(pair.now.seconds_since(pair.samples.last().unwrap().arrival.t_read) < 0.05, "{fault:?}");
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let run = |seed| {
        let scenario = Scenario { seed, ..scenario_of(DeviceScenario::default()) };
        let session = FastrakSession::new(Settings::default(), &[1]).unwrap();
        let mut pair = Pair::new(&stage_of("fastrak", "a", 115_200, &[1]), &scenario, session);
        pair.run_until(2.0);
        pair.bytes
    };
    assert_eq!(run(3), run(3));
    assert_ne!(run(3), run(4));
}
