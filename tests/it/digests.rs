//! What a recording tells without being played: its digest, and where everything was at a time.

use std::fs::File;
use std::sync::Arc;

use posed_drivers::Timestamp;
use posed_protocol::LookSensor;
use posed_recording::{Chunks, Header, Item, Looker, Scribe, Take, make_digest, read_digest};
use posed_rig::{Rig, people_toml};
use posed_simulator::body::Activity;
use posed_stage::{RecordingContent, Stage};
use serde_json::Value;

/// Two people who wear IMUs, for some seconds, with everything.
fn two_people(path: &std::path::Path, content: RecordingContent) {
    let (text, scenario) =
        people_toml(&[("anna", 1.7, Activity::Strolling), ("ben", 1.8, Activity::Strolling)]);
    let stage = Stage::parse(&text).unwrap();
    let mut rig = Rig::new(&stage, &scenario);
    rig.run_until(3.0);
    let header = Header { content, ..Header::new(&stage, &text, 1_700_000_000_000_000_000) };
    let mut scribe = Scribe::new(File::create(path).unwrap(), header).unwrap();
    rig.log.iter().for_each(|entry| _ = scribe.entry(entry).unwrap());
    scribe.finish("enough").unwrap();
}

#[test]
fn a_recording_and_its_replay_have_one_digest_with_a_picture_of_who_wears_imus() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    two_people(&path, RecordingContent::Log);
    let digest = read_digest(&path).unwrap().unwrap();
    assert_eq!(make_digest(&path, |_| true).unwrap(), digest);
    assert!((digest.length_s - 3.0).abs() < 0.1, "{digest:?}");
    let paths: Vec<_> = digest.picture.paths.iter().map(|path| path.name.as_str()).collect();
    assert!(paths.contains(&"anna/pelvis") && paths.contains(&"ben/pelvis"), "{paths:?}");
    // It ends where who asked for it wants it no more.
    let mut looks = 0;
    let cancelled = make_digest(&path, |_| {
        looks += 1;
        looks < 10
    });
    assert!(matches!(cancelled, Err(posed_recording::ReadError::Cancelled)) && looks == 10);
}

#[test]
fn a_look_shows_what_the_messages_say() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    two_people(&path, RecordingContent::Full);
    let mut bodies: Vec<(f64, Value)> = Vec::new();
    for item in Take::open(&path).unwrap() {
        if let Item::Message(message) = item.unwrap()
            && &*message.topic == "body"
        {
            bodies.push((message.t.as_secs_f64(), serde_json::from_slice(&message.json).unwrap()));
        }
    }
    let mut looker = Looker::new(Arc::new(Chunks::read(&path).unwrap().unwrap())).unwrap();
    for t_s in [1.603, 2.9, 1.9] {
        let look = looker.at(Timestamp::from_secs_f64(t_s)).unwrap();
        let names: Vec<_> = look.bodies.iter().map(|body| body.name.as_str()).collect();
        assert_eq!(names, ["anna", "ben"]);
        for body in &look.bodies {
            let is_it = |(at_s, said): &&(f64, Value)| *at_s <= t_s && said["name"] == body.name.as_str();
            let said = bodies.iter().rfind(is_it).unwrap().1["segments"].as_array().unwrap();
            let shown = said.iter().filter(|segment| !segment["position_m"].is_null());
            let expected: Vec<Value> = shown
                .map(|segment| {
                    serde_json::json!({"name": segment["name"], "position_m": segment["position_m"], "orientation_wxyz": segment["orientation_wxyz"]})
                })
                .collect();
            assert!(!expected.is_empty());
            assert_eq!(serde_json::to_value(&body.segments).unwrap(), Value::from(expected), "{t_s}");
        }
        // IMUs measure no position, and are somewhere all the same.
        let nowhere = |sensor: &LookSensor| sensor.position_m.is_none();
        assert!(!look.sensors.is_empty() && look.sensors.iter().all(nowhere), "{:?}", look.sensors);
    }
}
