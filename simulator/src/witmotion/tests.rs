use nalgebra::Vector3;
use posed_drivers::witmotion::{Settings, WitMotionSession};
use posed_drivers::{Measurement, Sample, Session, State};

use crate::faults::{Bytes, Fault};
use crate::inertial::{GRAVITY_M_S2, ImuClass};
use crate::scenario::DeviceScenario;
use crate::testing::{Pair, angle_to, scenario_of, stage_of};

fn pair(baud: u32, faults: Vec<Fault>) -> Pair<WitMotionSession> {
    let session = WitMotionSession::new(Settings::default(), baud, &[0]).unwrap();
    let device = DeviceScenario { imu: ImuClass::Ideal, faults, ..DeviceScenario::default() };
    Pair::new(&stage_of("witmotion", "a", baud, &[0]), &scenario_of(device), session)
}

/// Whether a sample is what was true about when it was read.
fn is_true(pair: &Pair<WitMotionSession>, sample: &Sample) -> bool {
    let Measurement::Imu { orientation_wxyz, specific_force_m_s2: Some(force), .. } = sample.measurement
    else {
        return false;
    };
    let (t, _) = pair.truth_of(sample);
    let mut near = pair.truth.iter().filter(|cycle| t.seconds_since(cycle.t).abs() < 0.05);
    near.any(|cycle| {
        let row = &cycle.sensors[0];
        let up = row.pose.rotation * Vector3::from(force);
        orientation_wxyz.is_none_or(|q| angle_to(q, row) < 0.03)
            && (up - Vector3::z() * GRAVITY_M_S2).norm() < 2.0
    })
}

#[test]
fn it_is_set_up_from_its_own_rate_and_streams_what_is_true() {
    for (baud, expected) in [(115_200, 200), (9600, 40)] {
        let mut pair = pair(baud, vec![]);
        pair.run_until(3.0);
        assert_eq!(*pair.session.state(), State::Streaming, "{:?}", pair.warnings);
        pair.forget();
        pair.run_until(5.0);
        assert!(pair.samples.len().abs_diff(expected) <= 1, "{}", pair.samples.len());
        // The first were measured before the truth that is remembered.
        assert!(pair.samples.iter().skip(2).all(|sample| is_true(&pair, sample)));
        assert_eq!((pair.counted()[0], pair.lost(0)), (0, 0));
    }
}

#[test]
fn what_is_lost_is_counted_by_time_and_damage_makes_no_wrong_sample() {
    let mut pair1 = pair(115_200, vec![Fault::LostPeriods { at_s: 6.0, count: 7 }]);
    pair1.run_until(9.0);
    assert!(pair1.counted()[0].abs_diff(7) <= 1 && pair1.lost(0) == 7, "{:?}", pair1.counted());
    let bytes = Bytes { count: 60, start_s: 6.0, end_s: 26.0 };
    for fault in [
        Fault::LostBytes(bytes),
        Fault::InsertedBytes(bytes),
        Fault::Bit7Flips(bytes),
        Fault::DataBitFlips(bytes),
    ] {
        let mut pair = pair(115_200, vec![fault.clone()]);
        pair.run_until(28.0);
        assert_eq!(pair.hits.len(), 60);
        assert_eq!(pair.samples.iter().filter(|sample| !is_true(&pair, sample)).count(), 0, "{fault:?}");
        let (lost, counted) = (pair.lost(0), pair.counted()[0]);
        assert!(lost.abs_diff(counted) <= 12, "{fault:?}: {lost} {counted}");
    }
}

#[test]
fn it_returns_after_power_plug_stalls_and_another_output() {
    for fault in [
        Fault::PowerCycle { at_s: 4.0 },
        Fault::Unplug { at_s: 4.0, duration_s: Some(1.0), power: false },
        Fault::Unplug { at_s: 4.0, duration_s: Some(1.0), power: true },
        Fault::Stall { at_s: 4.0, duration_s: 1.0 },
        Fault::WrongOutput { at_s: 4.0, duration_s: None },
        Fault::BirdDies { address: 0, at_s: 4.0, duration_s: Some(1.0) },
    ] {
        let mut pair = pair(115_200, vec![fault.clone()]);
        pair.run_until(11.0);
        assert_eq!(*pair.session.state(), State::Streaming, "{fault:?}");
        assert!(pair.now.seconds_since(pair.samples.last().unwrap().arrival.t_read) < 0.05, "{fault:?}");
        assert!(pair.samples.iter().all(|sample| is_true(&pair, sample)), "{fault:?}");
    }
}
