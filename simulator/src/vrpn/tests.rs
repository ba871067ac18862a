use nalgebra::Vector3;
use posed_drivers::vrpn::{Settings, VrpnSession};
use posed_drivers::{DeviceTime, Measurement, Session, State};

use crate::faults::{Bytes, Fault};
use crate::scenario::DeviceScenario;
use crate::testing::{Pair, angle_to, scenario_of, stage_of};

const HEAD: u16 = 1;
const WAND: u16 = 256 + 2;

fn pair(faults: Vec<Fault>) -> Pair<VrpnSession> {
    let trackers = vec!["Head".to_owned(), "Wand".to_owned()];
    let mut spec = stage_of("vrpn", "tcp://a:3883", 115_200, &[HEAD, WAND]);
    spec.devices[0].serials.clone_from(&trackers);
    let scenario = scenario_of(DeviceScenario { faults, rate_hz: 100.0, ..DeviceScenario::default() });
    Pair::new(&spec, &scenario, VrpnSession::new(Settings { trackers }, &[HEAD, WAND]).unwrap())
}

/// Every sample is what was true, whatever went wrong.
fn all_true(pair: &Pair<VrpnSession>) {
    for sample in &pair.samples {
        let Measurement::Pose { position_m: Some(p), orientation_wxyz: Some(q), .. } = sample.measurement
        else {
            panic!("{sample:?}")
        };
        let (_, truth) = pair.truth_of(sample);
        assert!((Vector3::from(p) - truth.pose.translation.vector).norm() < 2e-3, "{p:?} {truth:?}");
        assert!(angle_to(q, &truth) < 1e-2, "{}", angle_to(q, &truth));
    }
}

#[test]
fn trackers_are_where_they_are() {
    let mut pair = pair(vec![]);
    pair.run_until(2.0);
    assert_eq!(*pair.session.state(), State::Streaming, "{:?}", pair.warnings);
    assert!((190..=201).contains(&pair.samples_of(HEAD).len()), "{}", pair.samples_of(HEAD).len());
    assert_eq!(pair.samples_of(HEAD).len(), pair.samples_of(WAND).len());
    all_true(&pair);
    let ticks = |k: usize| match pair.samples_of(HEAD)[k].t_device {
        DeviceTime::Counter { ticks, .. } => ticks,
        DeviceTime::Cycle(_) => panic!("it has a clock"),
    };
    assert!((ticks(100) - ticks(0)).abs_diff(1_000_000) <= 1);
    assert_eq!((pair.session.counters().rejected, pair.session.counters().bytes_skipped), (0, 0));
    assert!(pair.warnings.is_empty(), "{:?}", pair.warnings);
}

#[test]
fn it_comes_back_after_a_lost_connection_a_power_cycle_and_a_stall() {
    for fault in [
        Fault::Unplug { at_s: 3.0, duration_s: Some(1.0), power: false },
        Fault::PowerCycle { at_s: 3.0 },
        Fault::Stall { at_s: 3.0, duration_s: 2.0 },
    ] {
        let mut pair = pair(vec![fault.clone()]);
        pair.run_until(3.5);
        pair.forget();
        pair.run_until(14.0);
        assert_eq!(*pair.session.state(), State::Streaming, "{fault:?}");
        assert!(pair.samples_of(WAND).len() > 150, "{fault:?}: {}", pair.samples_of(WAND).len());
        all_true(&pair);
    }
}

#[test]
fn a_tracker_that_stops_stops_no_other_and_what_is_no_pose_is_refused() {
    let dies = Fault::BirdDies { address: HEAD, at_s: 2.0, duration_s: Some(1.0) };
    let wrong = Fault::WrongOutput { at_s: 4.0, duration_s: Some(0.2) };
    let error = Fault::Error { address: HEAD, at_s: 5.0, code: 2, detail: 0 };
    let mut pair = pair(vec![dies, wrong, error]);
    pair.run_until(6.0);
    let (head, wand) = (pair.samples_of(HEAD).len(), pair.samples_of(WAND).len());
    assert!((wand - head).abs_diff(100) <= 1, "{head} {wand}");
    assert!(pair.session.counters().rejected.abs_diff(40) <= 2, "{:?}", pair.session.counters());
    all_true(&pair);
    assert_eq!(*pair.session.state(), State::Streaming);
}

#[test]
fn lost_bytes_cost_the_poses_that_they_were_of() {
    let bytes = Bytes { count: 30, start_s: 2.0, end_s: 12.0 };
    let mut pair = pair(vec![Fault::LostBytes(bytes)]);
    pair.run_until(13.0);
    assert_eq!(pair.hits.len(), 30);
    let missing = 2600 - pair.samples.len();
    assert!(missing <= 90, "{missing}");
    all_true(&pair);
    assert!(pair.session.counters().rejected >= 25, "{:?}", pair.session.counters());
}
