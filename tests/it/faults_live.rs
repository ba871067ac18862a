//! The fault map in the pipeline: a walking figure whose birds flip and freeze.

use std::sync::LazyLock;

use posed_fusion::faults::{Cause, Class, Repair};
use posed_motion::fault_map::Frames;
use posed_motion::fault_map::Training;
use posed_motion::fault_map::{FaultMap, Size};
use posed_pipeline::{Pipeline, raw_poses};
use posed_simulator::faults::Fault;
use posed_simulator::motion::{Motion, Walk};
use posed_simulator::scenario::{BodySpec, DeviceScenario, Scenario, SensorScenario};
use posed_stage::Stage;
use posed_stage::input::{Input, Model};
use posed_stage::output::{Estimate, OutcomeKind, SensorState};

use posed_rig::{Rig, Said, replay, stage};

/// The figure's sensors, by the segments that they sit on.
pub(crate) const BODY_SENSORS: [&str; 4] = ["pelvis", "torso", "thigh_r", "thigh_l"];

fn walking() -> Stage {
    let mut stage = stage(&[4]);
    for (sensor, name) in stage.sensors.iter_mut().zip(BODY_SENSORS) {
        sensor.name = name.into();
    }
    stage
}

fn scenario(faults: Vec<Fault>) -> Scenario {
    let walk = Walk { center_m: [0.65, 0.0, -0.55], radius_m: [0.1, 0.2], speed_m_s: 0.4, ..Walk::default() };
    let sensor = |name: &str| SensorScenario {
        name: name.into(),
        body: "figure".into(),
        segment: Some(name.into()),
        // A torso begins at the hips.
        offset_m: [0.05, if name == "torso" { 0.3 } else { -0.1 }, 0.0],
        mount_quat_wxyz: [1.0, 0.0, 0.0, 0.0],
    };
    Scenario {
        bodies: vec![BodySpec { name: "figure".into(), motion: Motion::Walk(walk) }],
        sensors: BODY_SENSORS.map(sensor).into(),
        devices: vec![DeviceScenario { name: "d0".into(), faults, ..DeviceScenario::default() }],
        ..Scenario::default()
    }
}

fn flip(address: u16, at_s: f64, duration_s: f64) -> Fault {
    Fault::HemisphereFlip { address, at_s, duration_s }
}

fn flip_all(at_s: f64, duration_s: f64) -> impl Iterator<Item = Fault> {
    (1..=4).map(move |address| flip(address, at_s, duration_s))
}

/// What the map sees of these estimates.
fn raw<'a>(rig: &Rig, estimates: impl Iterator<Item = &'a Estimate>) -> Frames {
    let mut frames = Frames { sensors: BODY_SENSORS.map(str::to_owned).into(), ..Frames::default() };
    let room = rig.pipeline.room_transmitter();
    for estimate in estimates {
        frames.t_s.push(estimate.t_valid.as_secs_f64());
        raw_poses(estimate, &[0, 1, 2, 3], |pose| pose.upright(room).append_to(&mut frames));
    }
    frames
}

/// Learnt from one session with all kinds of frames.
pub(crate) static NETWORK: LazyLock<FaultMap> = LazyLock::new(|| {
    let frozen = Fault::OutOfRange { address: 2, at_s: 16.0, duration_s: 1.5 };
    let faults = flip_all(8.0, 3.0).chain([flip(3, 13.0, 1.5), frozen]).collect();
    let mut rig = Rig::new(&walking(), &Scenario { seed: 5, ..scenario(faults) });
    rig.run_until(24.0);
    let frames = raw(&rig, rig.estimates().filter(|estimate| estimate.t_valid.as_secs_f64() > 3.0));
    let size = Size { neurons: 21, side: 7 };
    FaultMap::train(&frames, size, &Training { epochs: 8, ..Training::default() }).unwrap().0
});

fn model(fault_map: &FaultMap) -> Input {
    Input::Model(Model::Faults { fault_map: Box::new(fault_map.clone()) })
}

/// A session with faults, watched from its beginning.
fn session(stage: &Stage) -> Rig {
    let frozen = Fault::OutOfRange { address: 1, at_s: 11.0, duration_s: 1.5 };
    let faults = flip_all(6.0, 2.0).chain([flip(4, 9.0, 1.0), frozen]).collect();
    let mut rig = Rig::new(stage, &scenario(faults));
    rig.push(model(&NETWORK));
    rig.run_until(14.0);
    rig
}

fn from_to(rig: &Rig, from_s: f64, to_s: f64) -> Vec<&Estimate> {
    rig.estimates().filter(|e| (from_s..to_s).contains(&e.t_valid.as_secs_f64())).collect()
}

#[test]
fn labels_are_those_of_the_offline_command_and_repairs_are_marked() {
    let rig = session(&walking());
    let frames = raw(&rig, rig.estimates());
    let mut watch = NETWORK.watch();
    for (k, estimate) in rig.estimates().enumerate() {
        let judged = watch.push(&NETWORK, frames.frame(k));
        let emitted = estimate.fault.unwrap();
        assert_eq!((emitted.label, emitted.cause), (judged.label.class, judged.label.cause), "frame {k}");
        assert_eq!(emitted.cell, judged.winner.map(|winner| winner.cell as u32));
        for (sensor, label) in estimate.sensors.iter().zip(judged.sensors) {
            let fault = sensor.fault.unwrap();
            assert_eq!((fault.label, fault.cause), (label.class, label.cause), "frame {k}");
        }
    }
    for estimate in from_to(&rig, 6.05, 7.95) {
        assert_eq!(estimate.fault.unwrap().label, Class::Inverted, "at {}", estimate.t_valid.as_secs_f64());
        for sensor in &estimate.sensors {
            assert_eq!(sensor.state, SensorState::Repaired);
            assert_eq!(sensor.fault.unwrap().repair, Some(Repair::Mirrored));
            let (raw, pose) = (sensor.measured.unwrap().position_m.unwrap(), sensor.pose.unwrap());
            // The record stays as it came, beside the pose that is good.
            let apart: f64 =
                raw.iter().zip(pose.position_m.unwrap()).map(|(a, b)| (a + b).powi(2)).sum::<f64>().sqrt();
            assert!(apart < 0.02, "{apart} m from the mirror image");
        }
    }
    for estimate in from_to(&rig, 11.2, 12.4) {
        let fault = estimate.sensors[0].fault.unwrap();
        assert_eq!((fault.label, fault.cause), (Class::Anomalous, Some(Cause::Stuck)));
        assert!(!matches!(estimate.sensors[0].state, SensorState::Ok | SensorState::Repaired));
    }
    let good = from_to(&rig, 3.0, 5.9).len();
    let clean = from_to(&rig, 3.0, 5.9).iter().filter(|e| e.fault.unwrap().label == Class::Clean).count();
    assert!(clean * 100 >= 99 * good, "{clean} of {good}");
    let faults: Vec<_> = rig
        .emitted
        .iter()
        .filter_map(|emitted| match emitted {
            Said::Outcome(outcome) => match outcome.what {
                OutcomeKind::Fault { sensor: 3, cause, active } if outcome.t_valid.as_secs_f64() > 5.0 => {
                    Some((cause, active))
                }
                _ => None,
            },
            _ => None,
        })
        .collect();
    let flip = Cause::HemisphereInversion;
    assert_eq!(faults, [(flip, true), (flip, false), (flip, true), (flip, false)]);
}

#[test]
fn a_figure_that_is_inverted_from_the_beginning_is_identified_by_the_map() {
    let faults: Vec<Fault> = flip_all(0.0, 5.0).collect();
    let mut rig = Rig::new(&walking(), &scenario(faults.clone()));
    rig.push(model(&NETWORK));
    rig.run_until(8.0);
    let states = |rig: &Rig, from_s: f64, to_s: f64, state: SensorState| {
        let all = from_to(rig, from_s, to_s);
        let of = all.iter().flat_map(|estimate| &estimate.sensors).filter(|sensor| sensor.state == state);
        of.count() as f64 / (4 * all.len()) as f64
    };
    assert_eq!(states(&rig, 3.0, 4.9, SensorState::Repaired), 1.0);
    assert!(states(&rig, 5.2, 8.0, SensorState::Ok) > 0.99);
    // Without a map nobody could know.
    let mut rig = Rig::new(&walking(), &scenario(faults.clone()));
    rig.run_until(3.5);
    assert_eq!(states(&rig, 3.0, 3.5, SensorState::Ok), 1.0);
    // A map that is swapped in then contradicts what is tracked: nothing is good until it has its way.
    rig.push(model(&NETWORK));
    rig.run_until(4.9);
    assert_eq!(states(&rig, 3.52, 3.7, SensorState::Ok), 0.0);
    assert_eq!(states(&rig, 4.2, 4.9, SensorState::Repaired), 1.0);
}

#[test]
fn repairs_can_be_switched_off() {
    let mut stage = walking();
    stage.faults.repair = false;
    let rig = session(&stage);
    for estimate in from_to(&rig, 6.05, 7.95) {
        for sensor in &estimate.sensors {
            assert_eq!((sensor.state, sensor.pose), (SensorState::Suspect, None));
            assert!(sensor.measured.is_some());
            assert_eq!(sensor.fault.unwrap().repair, None);
        }
    }
    assert!(from_to(&rig, 8.2, 8.9).iter().all(|e| e.sensors.iter().all(|s| s.state == SensorState::Ok)));
}

#[test]
fn a_replay_that_begins_in_the_middle_says_the_same() {
    let rig = session(&walking());
    let middle = rig.log.partition_point(|entry| entry.t.as_secs_f64() < 7.0);
    let mut pipeline = Pipeline::new(&walking()).unwrap();
    let before = replay(&mut pipeline, &rig.log[..middle]).len();
    let mut restored = Pipeline::restore(&walking(), pipeline.models(), &pipeline.snapshot()).unwrap();
    // NaN is not itself; text is.
    let text = |emitted: &[Said]| emitted.iter().map(|emitted| format!("{emitted:?}")).collect::<Vec<_>>();
    assert_eq!(text(&replay(&mut restored, &rig.log[middle..])), text(&rig.emitted[before..]));
}

#[test]
fn a_map_of_other_sensors_is_refused_and_renaming_a_cell_goes_on() {
    let mut rig = Rig::new(&stage(&[4]), &Scenario::default());
    rig.push(model(&NETWORK));
    rig.run_until(3.0);
    assert_eq!(rig.pipeline.status().models_refused, 1);
    assert!(rig.estimates().all(|estimate| estimate.fault.is_none()));

    let mut rig = Rig::new(&walking(), &scenario(Vec::new()));
    rig.push(model(&NETWORK));
    rig.run_until(4.0);
    let cell = rig.estimates().last().unwrap().fault.unwrap().cell.unwrap() as usize;
    let mut renamed = NETWORK.clone();
    renamed.name_cell(cell / 7, cell % 7, Class::Inverted).unwrap();
    assert!(renamed.name_cell(7, 0, Class::Clean).is_err());
    assert!(NETWORK.is_renamed(&renamed));
    rig.push(model(&renamed));
    rig.run_until(4.2);
    assert_eq!(rig.pipeline.status().models_refused, 0);
    let swapped = |emitted: &&Said| matches!(emitted, Said::Outcome(outcome) if matches!(outcome.what, OutcomeKind::ModelSwapped(_)));
    assert_eq!(rig.emitted.iter().filter(swapped).count(), 2);
}
