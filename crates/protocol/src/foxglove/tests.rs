//! Messages against their schemas, read as the viewers' parser reads them.

use std::collections::BTreeMap;

use posed_drivers::Timestamp;
use serde_json::Value;

use super::*;
use crate::{Counters, Status};
use posed_fusion::body::{ANGLES, BodySegment, Heading, SEGMENTS, Skeleton, upright};
use posed_stage::input::{Truth, TruthSensor};
use posed_stage::output::{
    Body, Estimate, Outcome, OutcomeKind, PoseEstimate, PositionSource, SegmentEstimate, SegmentState,
    SensorEstimate, SensorState,
};

const EPOCH_UTC_NS: i64 = 1_700_000_000_000_000_000;

fn stage() -> Stage {
    Stage::parse(
        r#"
        name = "Stage A"
        [transmitter]
        pose_in_room = { position_m = [0.0, 0.0, 1.0], orientation_wxyz = [1.0, 0.0, 0.0, 0.0] }
        [[device]]
        name = "flock"
        driver = "flock-of-birds"
        port = "auto"
        [[sensor]]
        name = "left"
        device = "flock"
        address = 1
        segment = "forearm_l"
        [[sensor]]
        name = "right"
        device = "flock"
        address = 2
        segment = "forearm_r"
        [body]
        height_m = 1.8
        "#,
    )
    .unwrap()
}

fn estimate(state: SensorState, x_m: f64) -> Estimate {
    let pose = PoseEstimate {
        position_m: Some([x_m, 0.2, 1.234567]),
        orientation_wxyz: [0.5f64.sqrt(), 0.0, 0.0, 0.5f64.sqrt()],
        velocity_m_s: Some([0.0; 3]),
        angular_velocity_rad_s: [0.0; 3],
        covariance: [0.0; 21],
        sigma_m: Some(0.001),
    };
    let left = SensorEstimate { state, pose: Some(pose), ..SensorEstimate::default() };
    let t_valid = Timestamp::from_nanos(1_250_000_000);
    Estimate { t_valid, sensors: vec![left, SensorEstimate::default()], ..Estimate::default() }
}

/// Upright over the origin; the left forearm is suspect, the right shank missing.
fn figure() -> Body {
    let skeleton = Skeleton::from_height(1.8);
    let origins = skeleton.origins_m(&[upright(); SEGMENTS], [0.0, 0.0, 1.0].into());
    let segment = |segment: BodySegment| SegmentEstimate {
        state: match segment {
            BodySegment::ForearmL => SegmentState::Suspect,
            BodySegment::ShankR => SegmentState::Missing,
            _ => SegmentState::Ok,
        },
        sensor: None,
        position_m: Some(origins[segment.index()].into()),
        orientation_wxyz: Some(posed_geometry::orientation_to_wxyz(&upright())),
        sigma_rad: 0.01,
        fault: None,
        learnt: None,
    };
    Body {
        index: 0,
        t_valid: Timestamp::from_nanos(1_250_000_000),
        heading: Heading::Field,
        heading_sigma_rad: Some(0.02),
        position_source: PositionSource::Trackers,
        position_sigma_m: Some(0.02),
        contacts: None,
        segments: BodySegment::ALL.into_iter().take(BodySegment::BEFORE_SHOULDERS).map(segment).collect(),
        angles_rad: [Some(0.5); ANGLES],
        spread: Default::default(),
    }
}

/// Messages by topic that follow from payloads.
fn emitted(payloads: &[Payload<'_>]) -> BTreeMap<String, Vec<Value>> {
    let stage = stage();
    let topics = [Topic::Status, Topic::Sensors, Topic::Body, Topic::Faults, Topic::Truth];
    let channels = channels(&stage, &topics);
    let mut publisher = Publisher::new(&stage, EPOCH_UTC_NS);
    let mut counters = Counters::default();
    let mut emitted: BTreeMap<String, Vec<Value>> = BTreeMap::new();
    for payload in payloads {
        let stamp = counters.stamp(payload);
        publisher.publish(payload, &stamp, &channels, &|_| true, &mut |place, json| {
            let channel: &Channel = &channels[place];
            let message: Value = serde_json::from_slice(json).unwrap();
            let schema: Value = serde_json::from_str(&channel.schema).unwrap();
            fits(&message, &schema, &channel.topic);
            emitted.entry(channel.topic.clone()).or_default().push(message);
        });
    }
    emitted
}

/// As the viewers' parser reads it: what it refuses, and what does not fit, fails. Null is what is not known.
fn fits(value: &Value, schema: &Value, at: &str) {
    let is_level = |schema: &Value| {
        schema["oneOf"].as_array().is_some_and(|all| all.iter().all(|one| one["const"].is_number()))
    };
    match schema["type"].as_str() {
        _ if value.is_null() => assert!(at.starts_with("/posed/"), "{at} is null"),
        Some("object") => {
            for name in schema["required"].as_array().into_iter().flatten() {
                assert!(value.get(name.as_str().unwrap()).is_some(), "{at} lacks {name}");
            }
            for (name, of) in schema["properties"].as_object().unwrap_or_else(|| panic!("{at}: {schema}")) {
                assert!(of["type"].is_string() || is_level(of), "{at}.{name}: {of}");
                if let Some(value) = value.get(name) {
                    fits(value, of, &format!("{at}.{name}"));
                }
            }
        }
        Some("array") => {
            let items = &schema["items"];
            assert!(items["type"].is_string() && items["type"] != "array", "{at}: {schema}");
            value.as_array().unwrap().iter().for_each(|value| fits(value, items, &format!("{at}[]")));
        }
        Some("number") => assert!(value.is_number(), "{at}: {value}"),
        Some("integer") => assert!(value.is_u64(), "{at}: {value}"),
        Some("string") => assert!(value.is_string(), "{at}: {value}"),
        Some("boolean") => assert!(value.is_boolean(), "{at}: {value}"),
        _ => assert!(is_level(schema) && value.is_u64(), "{at}: {schema}"),
    }
}

#[test]
fn a_good_sensor_is_a_frame_a_pose_and_a_ball() {
    let estimate = estimate(SensorState::Ok, 0.1);
    let emitted = emitted(&[Payload::Estimate(&estimate)]);
    let frames = &emitted["/tf"][0]["transforms"];
    let children: Vec<_> = frames.as_array().unwrap().iter().map(|frame| &frame["child_frame_id"]).collect();
    assert_eq!(children, ["transmitter", "sensors/left"], "the right one is missing");
    assert_eq!(frames[0]["translation"]["z"], 1.0);
    assert_eq!(frames[1]["timestamp"]["sec"], 1_700_000_001);
    assert_eq!(frames[1]["timestamp"]["nsec"], 250_000_000);
    let pose = &emitted["/sensors/left/pose"][0]["pose"];
    assert_eq!((&pose["position"]["x"], &pose["position"]["z"]), (&0.1.into(), &1.23457.into()));
    // To six digits, as on our own websocket.
    let half_turn = (1e6 * std::f64::consts::FRAC_1_SQRT_2).round() / 1e6;
    assert_eq!(
        (&pose["orientation"]["w"], &pose["orientation"]["z"]),
        (&half_turn.into(), &half_turn.into())
    );
    assert!(!emitted.contains_key("/sensors/right/pose"));
    let entity = &emitted["/scene/sensors"][0]["entities"][0];
    assert_eq!((&entity["id"], &entity["texts"][0]["text"]), (&"sensors".into(), &"left".into()));
    assert_eq!(
        (entity["spheres"].as_array().unwrap().len(), entity["cubes"].as_array().unwrap().len()),
        (1, 1)
    );
    assert_eq!(emitted["/posed/sensors"][0]["sensors"][0]["position_m"][2], 1.23457);
}

#[test]
fn what_is_not_good_is_shown_as_such_or_not_at_all() {
    let [suspect, none] = [estimate(SensorState::Suspect, 0.1), estimate(SensorState::Ok, f64::NAN)];
    let emitted = emitted(&[Payload::Estimate(&suspect), Payload::Estimate(&none)]);
    for frames in &emitted["/tf"] {
        assert_eq!(frames["transforms"].as_array().unwrap().len(), 1, "the transmitter only");
    }
    assert!(!emitted.contains_key("/sensors/left/pose"));
    let balls =
        |at: usize| emitted["/scene/sensors"][at]["entities"][0]["spheres"].as_array().unwrap().clone();
    assert!(balls(0)[0]["color"]["r"].as_f64() > balls(0)[0]["color"]["b"].as_f64(), "orange");
    assert!(balls(1).is_empty());
}

#[test]
fn the_body_is_a_figure_of_the_right_size() {
    let body = figure();
    let emitted = emitted(&[Payload::Body(&body)]);
    assert_eq!(emitted["/tf"][0]["transforms"].as_array().unwrap().len(), 13, "two of fifteen are not good");
    let entity = &emitted["/scene/body"][0]["entities"][0];
    let lines = &entity["lines"][0];
    let points = lines["points"].as_array().unwrap();
    // Fourteen segments, hips and shoulders, without the missing shank; the pelvis itself has no length.
    assert_eq!((points.len(), lines["colors"].as_array().unwrap().len()), (2 * 15, 2 * 15));
    let heights = || points.iter().map(|point| point["z"].as_f64().unwrap());
    let (low, high) = heights().fold((f64::MAX, f64::MIN), |(low, high), z| (low.min(z), high.max(z)));
    assert!((low - (1.0 - 0.53 * 1.8)).abs() < 1e-4, "the soles: {low}");
    assert!((high - (1.0 + 0.47 * 1.8)).abs() < 1e-4, "the top of the head: {high}");
    let head = entity["spheres"][0]["pose"]["position"]["z"].as_f64().unwrap();
    assert!(1.0 + 0.288 * 1.8 < head && head < high, "{head}");
}

#[test]
fn events_truth_and_a_moved_transmitter_are_reported() {
    let t = Timestamp::from_nanos(2_000_000_000);
    let outcome = |what| Outcome { t_valid: t, t_decided: t, what };
    let fault =
        outcome(OutcomeKind::Fault { sensor: 1, cause: posed_fusion::faults::Cause::Gate, active: true });
    let moved = Model::Transmitter { position_m: [0.5, 0.0, 0.0], orientation_wxyz: [1.0, 0.0, 0.0, 0.0] };
    let moved = outcome(OutcomeKind::ModelSwapped(moved));
    let sensors = vec![TruthSensor {
        sensor: 0,
        position_m: [1.0, 2.0, 3.0],
        orientation_wxyz: [1.0, 0.0, 0.0, 0.0],
        class: "clean".into(),
    }];
    let truth = Truth { t_valid: t, sensors };
    let (estimate, status) = (estimate(SensorState::Ok, 0.1), Status::default());
    let emitted = emitted(&[
        Payload::Outcome(&fault),
        Payload::Outcome(&moved),
        Payload::Truth(&truth),
        Payload::Status(&status),
        Payload::Estimate(&estimate),
    ]);
    let log = &emitted["/log"];
    assert_eq!((&log[0]["level"], &log[0]["name"]), (&3.into(), &"right".into()));
    assert_eq!(log[0]["message"], "the pose is not where it can be");
    assert_eq!(log[1]["level"], 2);
    assert_eq!(emitted["/truth"][0]["poses"][0]["position"]["z"], 3.0);
    assert_eq!(emitted["/tf"][0]["transforms"][0]["translation"]["x"], 0.5);
    assert_eq!(emitted["/posed/faults"][0]["event_id"], 1);
    assert!(emitted.contains_key("/posed/status"));
}

#[test]
fn every_schema_is_one_that_viewers_read() {
    let channels = channels(&stage(), &Topic::ALL);
    let mut topics: Vec<_> = channels.iter().map(|channel| channel.topic.clone()).collect();
    topics.sort();
    topics.dedup();
    assert_eq!(topics.len(), channels.len(), "each has a topic of its own");
    for channel in &channels {
        let schema: Value = serde_json::from_str(&channel.schema).unwrap();
        assert!(!schema["properties"].as_object().unwrap().is_empty(), "{schema}");
        readable(&schema, &channel.topic);
    }
    let of = |topic: &str| {
        let channel = channels.iter().find(|channel| channel.topic == topic).unwrap();
        serde_json::from_str::<Value>(&channel.schema).unwrap()
    };
    let sensor = &of("/posed/sensors")["properties"]["sensors"]["items"]["properties"];
    assert_eq!(sensor["position_m"]["items"]["type"], "number", "a null beside it hides nothing");
    assert_eq!(of("/posed/exercise")["properties"]["count"]["type"], "integer", "fields of all variants");
}

/// Every type down to the last, whether a message uses it or not.
fn readable(schema: &Value, at: &str) {
    match schema["type"].as_str() {
        Some("object") => {
            for (name, of) in schema["properties"].as_object().unwrap_or_else(|| panic!("{at}: {schema}")) {
                readable(of, &format!("{at}.{name}"));
            }
        }
        Some("array") => {
            assert_ne!(schema["items"]["type"], "array", "{at}");
            readable(&schema["items"], &format!("{at}[]"));
        }
        Some("number" | "integer" | "string" | "boolean") => {}
        _ => assert!(schema["oneOf"][0]["const"].is_number(), "{at}: {schema}"),
    }
}

#[test]
fn a_thinned_recording_shows_sensors_and_body_at_the_same_moments_and_every_event() {
    let stage = stage();
    let mut counts = [RecordingContent::Full, RecordingContent::Log].map(|content| {
        let mut views = Views::new(&stage, EPOCH_UTC_NS, content);
        let (mut counters, mut counts) = (Counters::default(), BTreeMap::<String, Vec<i64>>::new());
        for n in 0..100_i64 {
            let t = Timestamp::from_nanos(n * 10_000_000 + 3_000_000);
            let mut frame = estimate(SensorState::Ok, 0.1);
            frame.t_valid = t;
            let body = Body { t_valid: Timestamp::from_nanos(n * 10_000_000), ..figure() };
            let cause = posed_fusion::faults::Cause::Gate;
            let what = OutcomeKind::Fault { sensor: 1, cause, active: n % 2 == 0 };
            let fault = Outcome { t_valid: t, t_decided: t, what };
            for payload in [Payload::Body(&body), Payload::Estimate(&frame), Payload::Outcome(&fault)] {
                let stamp = counters.stamp(&payload);
                views.publish(&payload, &stamp, |channel, _| {
                    counts.entry(channel.topic.clone()).or_default().push(stamp.t_us / 10_000);
                });
            }
        }
        counts
    });
    let [full, lean] = &mut counts;
    assert_eq!(lean.keys().collect::<Vec<_>>(), ["/log", "/scene/body", "/scene/sensors", "/tf"]);
    assert_eq!((full["/tf"].len(), full["/log"].len(), full["/sensors/left/pose"].len()), (200, 100, 100));
    assert_eq!(lean["/log"], full["/log"]);
    assert_eq!(lean["/scene/body"], [0, 20, 40, 60, 80]);
    assert_eq!(lean["/scene/sensors"], lean["/scene/body"]);
    assert_eq!(lean["/tf"].len(), 10);
}
