//! The body over the websocket, in a recording, and as an animation.

use std::fs;

use serde_json::{Value, json};

use super::process::{Posed, ok, record_start, refused, until};
use crate::cli::posed;

fn segment<'a>(body: &'a Value, name: &str) -> &'a Value {
    body["segments"].as_array().unwrap().iter().find(|segment| segment["name"] == name).unwrap()
}

fn z_m(body: &Value, name: &str) -> f64 {
    segment(body, name)["position_m"][2].as_f64().unwrap()
}

#[tokio::test]
async fn the_demo_s_body_stands_moves_and_is_exported_from_its_recording() {
    let folder = tempfile::tempdir().unwrap();
    posed_rig::copy_demo(folder.path());
    let stage = folder.path().join("demo.toml");
    let posed_demo = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut client = posed_demo.subscriber(&["body"]).await;
    let mut flexions = Vec::new();
    let mut last = Value::Null;
    let bend = |flexions: &[f64]| {
        let most = |f: fn(f64, f64) -> f64| flexions.iter().copied().reduce(f).unwrap_or(0.0);
        most(f64::max) - most(f64::min)
    };
    // The trackers speak later than the IMUs: first the body stands at the origin. Its person rests now and then.
    while flexions.len() < 150
        || last["position_source"] != "trackers"
        || (bend(&flexions) <= 20.0 && flexions.len() < 2000)
    {
        last = until(&mut client, "a body", |message| message["type"] == "body").await;
        let joints = last["joints"].as_array().unwrap();
        let elbow = joints.iter().find(|joint| joint["name"] == "elbow_r").unwrap();
        flexions.extend(elbow["angles_deg"]["flexion"].as_f64());
    }
    assert_eq!((&last["position_source"], &last["heading"]), (&json!("trackers"), &json!("field")), "{last}");
    assert_eq!(last["segments"].as_array().unwrap().len(), 15);
    assert_eq!(segment(&last, "head")["state"], "inferred");
    assert_eq!(segment(&last, "forearm_r")["sensor"], "imu_forearm_r");
    assert!(
        z_m(&last, "shank_r") < z_m(&last, "thigh_r") && z_m(&last, "pelvis") < z_m(&last, "torso"),
        "{last}"
    );
    assert!(bend(&flexions) > 20.0, "{flexions:?}");
    // Its mounting is given, but somebody may find it anew; and only by poses that are held.
    let job = ok(&mut client, json!({"type": "body.calibrate", "id": 7, "how": "quick"})).await;
    ok(&mut client, json!({"type": "job.cancel", "id": 8, "job": job["job"]})).await;
    // A unit of several is to be named.
    let (_, sentence) = refused(&mut client, json!({"type": "imu.calibrate", "id": 9})).await;
    assert!(sentence.contains("name one of imu_torso"), "{sentence}");
    let (_, sentence) =
        refused(&mut client, json!({"type": "imu.calibrate", "id": 10, "sensor": "wand"})).await;
    assert!(sentence.contains("\"wand\" is no IMU"), "{sentence}");
    // Not from the start on: to every format, seconds are enough.
    ok(&mut client, record_start("take")).await;
    for _ in 0..150 {
        until(&mut client, "a body", |message| message["type"] == "body").await;
    }
    ok(&mut client, json!({"type": "record.stop"})).await;
    assert_eq!(posed_demo.end("INT").await.code(), Some(0));

    let recording = folder.path().join("recordings/take.mcap");
    for to in ["bvh", "trc", "glb", "vrm", "vrma", "usda", "c3d", "sto", "mot"] {
        let output = folder.path().join(format!("take.{to}"));
        let args = ["export", recording.to_str().unwrap(), "--to", to, "-o", output.to_str().unwrap()];
        let done = posed(args);
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        assert!(fs::metadata(&output).unwrap().len() > 1000);
    }
    let bvh = fs::read_to_string(folder.path().join("take.bvh")).unwrap();
    let frames = bvh.lines().find_map(|line| line.strip_prefix("Frames: ")).unwrap();
    assert!(bvh.starts_with("HIERARCHY") && frames.trim().parse::<u32>().unwrap() >= 150, "{frames} frames");
}

#[tokio::test]
async fn a_stage_without_a_body_has_none_to_calibrate() {
    let folder = tempfile::tempdir().unwrap();
    let stage = super::process::two_devices(folder.path(), "");
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut client = posed.client().await;
    let (code, sentence) = refused(&mut client, json!({"type": "body.calibrate", "id": 1})).await;
    assert!(code == "no_body" && sentence.contains("no human [[body]]"), "{code}: {sentence}");
    // Nor an IMU to align the stage by; three surveyed points would do.
    let (code, sentence) = refused(&mut client, json!({"type": "stage.align", "id": 2})).await;
    assert!(code == "bad_request" && sentence.contains("three surveyed points"), "{code}: {sentence}");
    let (_, sentence) =
        refused(&mut client, json!({"type": "stage.align", "id": 3, "sensor": "nobody"})).await;
    assert!(sentence.contains("no magnetic sensor \"nobody\""), "{sentence}");
    // Nor one to find the intrinsics of.
    let (code, sentence) = refused(&mut client, json!({"type": "imu.calibrate", "id": 6})).await;
    assert!(code == "bad_request" && sentence.contains("no IMU"), "{code}: {sentence}");
    let points = ["a", "b", "c"].map(|name| json!({"name": name, "position_m": [1, 0, 0]}));
    let job = ok(&mut client, json!({"type": "stage.align", "id": 4, "anchors": points})).await;
    ok(&mut client, json!({"type": "job.cancel", "id": 5, "job": job["job"]})).await;
    assert_eq!(posed.end("INT").await.code(), Some(0));
}

#[tokio::test]
async fn a_body_is_calibrated_from_a_terminal() {
    let folder = tempfile::tempdir().unwrap();
    // A person who first raises the arms forward.
    let stage = crate::browser::calibration::posing(folder.path());
    let text = fs::read_to_string(&stage).unwrap();
    let with_mistake = "activity = \"poses\"\nmistake = \"arms-forward\"";
    assert!(text.contains("activity = \"poses\""), "{text}");
    fs::write(&stage, text.replace("activity = \"poses\"", with_mistake)).unwrap();
    let daemon = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let at = daemon.address.to_string();
    let calibrate = move |more: &'static [&'static str]| {
        let at = at.clone();
        let args = move || posed(["body", "calibrate", "--how", "quick", "--at", &at].iter().chain(more));
        tokio::task::spawn_blocking(args)
    };
    let done = calibrate(&[]).await.unwrap();
    let reported = String::from_utf8_lossy(&done.stdout).into_owned();
    assert!(done.status.success(), "{reported}{}", String::from_utf8_lossy(&done.stderr));
    let lines: Vec<&str> = reported.lines().collect();
    assert!(
        lines[0].starts_with("1 of 2: Stand upright") && lines[1].starts_with("2 of 2: Raise"),
        "{reported}"
    );
    assert!(
        lines[2].starts_with("1 of 2: t_pose (upper_arm_r) and t_pose (upper_arm_l) disagree by 1")
            && lines[2]
                .ends_with("Once more: Stand upright, arms hanging, palms to the body, and hold still"),
        "{reported}"
    );
    assert!(lines[3].starts_with("2 of 2: Raise"), "{reported}");
    assert!(lines[4].starts_with("the sensors' mounting is known") && lines.len() == 20, "{reported}");
    // Nobody is there.
    assert_eq!(daemon.end("INT").await.code(), Some(0));
    let alone = calibrate(&["--json"]).await.unwrap();
    assert_eq!(alone.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&alone.stderr).contains("no daemon can be spoken to at"));
}
