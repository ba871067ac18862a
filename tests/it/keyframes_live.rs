//! Key poses as the pipeline reports them, on a simulated arm that curls and rests.

use nalgebra::Isometry3;
use posed_motion::keyframes::{Detector, Hinge, HingeSettings};
use posed_pipeline::Pipeline;
use posed_simulator::motion::{Curl, Motion};
use posed_simulator::scenario::{BodySpec, Scenario, SensorScenario};
use posed_stage::output::{KeyPoseEvent, Outcome, OutcomeKind, Phase, SensorState};
use posed_stage::{Keyframes, Stage};

use posed_rig::{Rig, Said, replay, stage};

const WINDOW: u16 = 20;

fn curling() -> (Stage, Rig) {
    let mut stage_file = stage(&[2]);
    let sensors = Some(vec!["s0-0".to_owned()]);
    stage_file.keyframes = Some(Keyframes { sensors, window_frames: WINDOW, false_alarms_per_min: 1.0 });
    let curl = Curl { start_s: 3.0, period_s: 1.5, pause_s: 0.8, ..Curl::default() };
    let forearm = SensorScenario {
        name: "s0-0".into(),
        body: "arm".into(),
        segment: Some("forearm".into()),
        offset_m: [0.0, -0.18, 0.04],
        mount_quat_wxyz: [1.0, 0.0, 0.0, 0.0],
    };
    let arm = BodySpec { name: "arm".into(), motion: Motion::Curl(curl) };
    let scenario = Scenario { bodies: vec![arm], sensors: vec![forearm], ..Scenario::default() };
    let mut rig = Rig::new(&stage_file, &scenario);
    rig.run_until(12.0);
    (stage_file, rig)
}

fn key_poses(emitted: &[Said]) -> Vec<(&Outcome, &KeyPoseEvent)> {
    emitted
        .iter()
        .filter_map(|emitted| match emitted {
            Said::Outcome(outcome) => match &outcome.what {
                OutcomeKind::KeyPose(event) => Some((outcome, event)),
                _ => None,
            },
            _ => None,
        })
        .collect()
}

#[test]
fn they_are_those_of_the_offline_detector_and_late_by_the_stated_delay() {
    let (_, rig) = curling();
    let events = key_poses(&rig.emitted);
    let estimates: Vec<_> = rig.estimates().collect();
    // The stage's rate is measured over its first frames.
    let first = 30;
    let span_s = estimates[first].t_valid.seconds_since(estimates[0].t_valid);
    let detector = Detector::new(Hinge::new(HingeSettings {
        window: usize::from(WINDOW),
        frame_rate_hz: first as f64 / span_s,
        ..HingeSettings::default()
    }));
    let begin = (first..).find(|k| estimates[*k].sensors[0].state == SensorState::Ok).unwrap();
    let poses: Vec<Isometry3<f64>> = estimates[begin..]
        .iter()
        .map(|estimate| {
            let pose = estimate.sensors[0].pose.unwrap();
            posed_geometry::isometry(pose.position_m.unwrap(), pose.orientation_wxyz).unwrap()
        })
        .collect();
    let ending = poses.len() as u64;
    let (keys, trace) = detector.run(&poses);
    // The statistic speaks of an earlier frame, and is what the whole motion gives.
    let statistic: Vec<_> = estimates.iter().filter_map(|estimate| estimate.sensors[0].change).collect();
    let of_whole: Vec<_> = trace
        .iter()
        .map(|trace| (estimates[begin + trace.frame as usize].t_valid, trace.score.value))
        .collect();
    assert_eq!(statistic.iter().map(|change| (change.t_valid, change.score)).collect::<Vec<_>>(), of_whole);
    assert!(keys.iter().all(|key| key.score > statistic[0].threshold));
    assert!(estimates.iter().all(|estimate| estimate.sensors[1].change.is_none()));
    let offline: Vec<_> = keys
        .into_iter()
        // What the end of a file decides, a stream has not decided yet.
        .filter(|key| key.frame + 2 * u64::from(WINDOW) < ending)
        .map(|key| estimates[begin + key.frame as usize].t_valid)
        .collect();
    let confirmed: Vec<_> = events.iter().filter(|(_, event)| event.phase == Phase::Confirmed).collect();
    let live: Vec<_> = confirmed.iter().map(|(outcome, _)| outcome.t_valid).collect();
    assert_eq!(live, offline);
    assert!(live.len() >= 4, "{} key poses in three curls", live.len());
    for (outcome, event) in &confirmed {
        assert_eq!(event.sensor, 0);
        let delay_frames = outcome.t_decided.seconds_since(outcome.t_valid) * first as f64 / span_s;
        assert!((delay_frames - 2.0 * f64::from(WINDOW)).abs() < 1.5, "{delay_frames}");
        let reported = |(earlier, event): &&(&Outcome, &KeyPoseEvent)| {
            event.phase == Phase::Provisional && earlier.t_valid == outcome.t_valid
        };
        assert_eq!(events.iter().filter(reported).count(), 1);
    }
}

#[test]
fn a_replay_that_begins_in_the_middle_says_the_same() {
    let (stage_file, rig) = curling();
    let middle = rig.log.partition_point(|entry| entry.t.as_secs_f64() < 6.2);
    let mut pipeline = Pipeline::new(&stage_file).unwrap();
    let before = replay(&mut pipeline, &rig.log[..middle]).len();
    let mut restored = Pipeline::restore(&stage_file, pipeline.models(), &pipeline.snapshot()).unwrap();
    assert_eq!(replay(&mut restored, &rig.log[middle..]), rig.emitted[before..]);
}

#[test]
fn a_stage_that_does_not_ask_gets_none() {
    let mut rig = Rig::new(&stage(&[1]), &Scenario::default());
    rig.run_until(5.0);
    assert!(key_poses(&rig.emitted).is_empty());
    let mut wrong = stage(&[1]);
    let sensors = Some(vec!["nobody".to_owned()]);
    wrong.keyframes = Some(Keyframes { sensors, window_frames: 30, false_alarms_per_min: 1.0 });
    assert!(Pipeline::new(&wrong).is_err());
}
