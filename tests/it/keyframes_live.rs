//! Key poses as the pipeline reports them, on a simulated arm that curls and rests.

use nalgebra::Isometry3;
use posed_motion::keyframes::{Detector, Method, Screw};
use posed_pipeline::Pipeline;
use posed_simulator::motion::{Curl, Motion};
use posed_simulator::scenario::{BodySpec, Scenario, SensorScenario};
use posed_stage::output::{Estimate, KeyPoseEvent, Outcome, OutcomeKind, Phase, SensorState};
use posed_stage::{Keyframes, KeyframesMethod, Stage};

use posed_rig::{Rig, Said, replay, stage};

const WINDOW: u16 = 20;

fn curling(method: KeyframesMethod) -> (Stage, Rig) {
    let mut stage_file = stage(&[2]);
    let sensors = Some(vec!["s0-0".to_owned()]);
    stage_file.keyframes = Some(Keyframes { sensors, method, window_frames: WINDOW, ..Keyframes::default() });
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

fn pose(estimate: &Estimate) -> Isometry3<f64> {
    let pose = estimate.sensors[0].pose.unwrap();
    posed_geometry::isometry(pose.position_m.unwrap(), pose.orientation_wxyz).unwrap()
}

#[test]
fn they_are_those_of_the_offline_detector_and_late_by_the_stated_delay() {
    agrees_with_offline(KeyframesMethod::Hinge);
}

#[test]
fn the_published_ones_too() {
    agrees_with_offline(KeyframesMethod::Paper);
}

fn agrees_with_offline(method: KeyframesMethod) {
    let (stage_file, rig) = curling(method);
    let events = key_poses(&rig.emitted);
    let estimates: Vec<_> = rig.estimates().collect();
    // The stage's rate is measured over its first frames.
    let first = 30;
    let span_s = estimates[first].t_valid.seconds_since(estimates[0].t_valid);
    let settings = stage_file.keyframes.unwrap().settings(first as f64 / span_s, true);
    let detector = Detector::new(Method::new(settings));
    let delay = detector.delay_frames();
    let begin = (first..).find(|k| estimates[*k].sensors[0].state == SensorState::Ok).unwrap();
    let poses: Vec<Isometry3<f64>> = estimates[begin..].iter().map(|estimate| pose(estimate)).collect();
    let ending = poses.len() as u64;
    let (keys, trace) = detector.run(&poses);
    // The statistic speaks of an earlier frame, and is what the whole motion gives.
    let statistic: Vec<_> = estimates.iter().filter_map(|estimate| estimate.sensors[0].change).collect();
    let of_whole: Vec<_> = trace
        .iter()
        .map(|trace| {
            (estimates[begin + trace.frame as usize].t_valid, trace.score.value, trace.score.threshold)
        })
        .collect();
    let live: Vec<_> =
        statistic.iter().map(|change| (change.t_valid, change.score, change.threshold)).collect();
    assert_eq!(live, of_whole);
    assert!(estimates.iter().all(|estimate| estimate.sensors[1].change.is_none()));
    let offline: Vec<_> = keys
        .into_iter()
        // What the end of a file decides, a stream has not decided yet.
        .filter(|key| key.frame + (delay as u64) < ending)
        .map(|key| estimates[begin + key.frame as usize].t_valid)
        .collect();
    let confirmed: Vec<_> = events.iter().filter(|(_, event)| event.phase == Phase::Confirmed).collect();
    let live: Vec<_> = confirmed.iter().map(|(outcome, _)| outcome.t_valid).collect();
    assert_eq!(live, offline);
    assert!(live.len() >= 4, "{} key poses in three curls", live.len());
    for (outcome, event) in &confirmed {
        assert_eq!(event.sensor, 0);
        let delay_frames = outcome.t_decided.seconds_since(outcome.t_valid) * first as f64 / span_s;
        assert!((delay_frames - delay as f64).abs() < 1.5, "{delay_frames}");
        let reported = |(earlier, event): &&(&Outcome, &KeyPoseEvent)| {
            event.phase == Phase::Provisional && earlier.t_valid == outcome.t_valid
        };
        assert_eq!(events.iter().filter(reported).count(), 1);
    }
    // Each confirmed one has the screw from the key pose before it, the first from where the motion began.
    let mut since = estimates[begin].t_valid;
    for (outcome, event) in &confirmed {
        let at = |t_valid| pose(estimates.iter().find(|estimate| estimate.t_valid == t_valid).unwrap());
        let segment = event.segment.unwrap();
        assert_eq!(segment.since, since);
        assert_eq!(Some(segment.screw), Screw::between(&at(since), &at(outcome.t_valid)));
        since = outcome.t_valid;
    }
    assert!(events.iter().all(|(_, event)| event.phase == Phase::Confirmed || event.segment.is_none()));
}

#[test]
fn a_replay_that_begins_in_the_middle_says_the_same() {
    let (stage_file, rig) = curling(KeyframesMethod::Paper);
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
    wrong.keyframes = Some(Keyframes { sensors, ..Keyframes::default() });
    assert!(Pipeline::new(&wrong).is_err());
}
