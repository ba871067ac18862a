//! Exercises on a running daemon: loaded from the stage file and from the folder, selected, taught.

use std::fs;
use std::path::Path;

use serde_json::{Value, json};

use super::process::{Posed, all_ok, ok, refused, two_devices, until};
use crate::exercise::CURL;
use crate::sessions::write_curl_of_a_body;

/// The exercise of the simulated arm, as if taught with this stage's sensors.
pub(super) fn write(path: &Path, name: &str) {
    let mut exercise = CURL.clone();
    exercise.name = name.into();
    for channel in &mut exercise.channels {
        *channel = channel.replace("s0-0", "of one").replace("s0-1", "of two");
    }
    fs::write(path, exercise.to_json().unwrap()).unwrap();
}

#[tokio::test]
async fn exercises_are_loaded_selected_and_taught() {
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "[models]\nexercises = [\"curl.json\"]\n");
    write(&folder.path().join("curl.json"), "curl");
    fs::create_dir(folder.path().join("exercises")).unwrap();
    write(&folder.path().join("exercises/squat-001.json"), "squat");
    write(&folder.path().join("exercises/squat-002.json"), "squat");
    let posed = Posed::demo_that_keeps(&stage);
    let mut client = posed.subscriber(&["exercise", "jobs", "sensors"]).await;
    let loaded = until(&mut client, "what is loaded", |message| message["event"] == "loaded").await;
    assert_eq!((&loaded["exercise"], &loaded["subject"]), (&json!("curl"), &json!(null)));
    let state = until(&mut client, "what is counted", |message| message["event"] == "state").await;
    assert_eq!(state["state"]["exercises"][0]["exercise"], "curl");
    let list = ok(&mut client, json!({"type": "exercise.list"})).await;
    assert_eq!(list["exercises"], json!([{"name": "squat", "revision": 2}]));

    let (code, sentence) =
        refused(&mut client, json!({"type": "exercise.select", "exercises": ["lunge"]})).await;
    assert_eq!((code.as_str(), sentence.contains("lunge")), ("failed", true), "{sentence}");
    let select =
        json!({"type": "exercise.select", "exercises": ["squat"], "repetitions": 10, "subject": "ada"});
    // By another client: who asks may be notified before the answer comes.
    let mut watcher = posed.subscriber(&["exercise"]).await;
    ok(&mut client, select).await;
    let of_ada = |message: &serde_json::Value| message["subject"] == "ada" && message["event"] == "state";
    let state = until(&mut watcher, "ada's state", of_ada).await;
    assert_eq!(state["state"]["repetitions"], 10);

    // Nothing repeats itself five times in two seconds.
    until(&mut client, "all sensors", all_ok).await;
    let teach = json!({"type": "exercise.teach", "name": "wave", "repetitions": 5, "last_s": 2});
    ok(&mut client, teach.clone()).await;
    let jobs = until(&mut client, "its end", |message| message["jobs"][0]["state"] == "failed").await;
    assert_eq!(jobs["jobs"][0]["kind"], "exercise.teach");
    // Without a span it waits for the repetitions, and can be stopped.
    let teach = json!({"type": "exercise.teach", "name": "wave", "repetitions": 5, "sensors": ["of one"]});
    let waiting = ok(&mut client, teach).await;
    ok(&mut client, json!({"type": "job.cancel", "job": waiting["job"]})).await;
    until(&mut client, "the cancelled job's end", |message| {
        message["jobs"][1]["job"] == waiting["job"] && message["jobs"][1]["state"] != "running"
    })
    .await;
    let name = json!({"type": "exercise.teach", "name": "../wave", "repetitions": 5});
    assert_eq!(refused(&mut client, name).await.0, "bad_request");
    assert_eq!(posed.end("INT").await.code(), Some(0));
}

/// Who is to do the same sees a figure do it; one that was taught from anything but joints has none.
#[tokio::test]
async fn a_demonstration_is_a_figure_that_moves() {
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "");
    fs::create_dir(folder.path().join("exercises")).unwrap();
    write(&folder.path().join("exercises/wave-001.json"), "wave");
    write_curl_of_a_body(&folder.path().join("exercises/curl-001.json"));
    let posed = Posed::demo_that_keeps(&stage);
    let mut client = posed.client().await;
    let ask = |exercise: &str| json!({"type": "exercise.demonstration", "exercise": exercise});
    for exercise in ["lunge", "wave"] {
        let (code, sentence) = refused(&mut client, ask(exercise)).await;
        assert_eq!((code.as_str(), sentence.contains(exercise)), ("bad_request", true), "{sentence}");
    }
    let shown = ok(&mut client, ask("curl")).await;
    assert_eq!((&shown["exercise"], &shown["revision"]), (&json!("curl"), &json!(1)));
    assert!((1.0..4.0).contains(&shown["duration_s"].as_f64().unwrap()), "{shown}");
    assert!(shown["angles"].as_array().unwrap().contains(&json!("elbow_r_flexion_deg")), "{shown}");
    // The right forearm is folded up in the middle and hangs at both ends; nothing leaves the floor.
    let frames = shown["frames"].as_array().unwrap();
    let up = |frame: &Value, name: &str| {
        let segment = frame.as_array().unwrap().iter().find(|segment| segment["name"] == name).unwrap();
        let q: [f64; 4] = serde_json::from_value(segment["orientation_wxyz"].clone()).unwrap();
        posed_geometry::orientation_from_wxyz(q).unwrap() * nalgebra::Vector3::y()
    };
    let bend_deg: Vec<f64> = frames
        .iter()
        .map(|frame| up(frame, "upper_arm_r").angle(&up(frame, "forearm_r")).to_degrees())
        .collect();
    let most_deg = bend_deg.iter().copied().fold(0.0, f64::max);
    assert!(most_deg > 80.0 && bend_deg[0] < 50.0 && bend_deg[frames.len() - 1] < 50.0, "{bend_deg:?}");
    assert!(frames.iter().all(|frame| up(frame, "pelvis").z > 0.999), "{shown}");
    assert_eq!(posed.end("INT").await.code(), Some(0));
}
