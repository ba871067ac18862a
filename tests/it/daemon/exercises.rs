//! Exercises on a running daemon: loaded from the stage file and from the folder, selected, taught.

use std::fs;
use std::path::Path;

use serde_json::json;

use super::process::{Posed, all_ok, ok, refused, two_devices, until};
use crate::exercise::CURL;

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
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
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
