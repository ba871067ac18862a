//! Segments on a running daemon: learnt from a labelled recording, kept, swapped in, recorded and replayed.

use std::fs;

use posed_recording::table::write_elan;
use serde_json::json;

use super::process::{Posed, ok, record_start, refused, replays, two_devices, until};

#[tokio::test]
async fn a_labelled_recording_is_learnt_and_named_by_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), super::recordings::FULL);
    let daemon = Posed::demo_that_keeps(&stage);
    let mut client = daemon.subscriber(&["sensors", "segments", "jobs"]).await;
    let ended = |message: &serde_json::Value, state: &str| {
        let last = message["jobs"].as_array().and_then(|jobs| jobs.last().cloned());
        last.filter(|job| job["state"] == state && job["kind"] == "segments.train").is_some()
    };
    ok(&mut client, record_start("take")).await;
    let frame = until(&mut client, "a frame", |message| message["type"] == "sensors").await;
    let enough = frame["t_s"].as_f64().unwrap() + 4.0;
    until(&mut client, "more", |message| message["t_s"].as_f64().is_some_and(|t_s| t_s > enough)).await;
    ok(&mut client, json!({"type": "record.stop"})).await;

    for wrong in
        [json!({"type": "segments.train", "epochs": 0}), json!({"type": "segments.train", "look_ahead": 500})]
    {
        assert_eq!(refused(&mut client, wrong).await.0, "bad_request");
    }
    ok(&mut client, json!({"type": "segments.train"})).await;
    let jobs = until(&mut client, "the refusal", |message| ended(message, "failed")).await;
    let why = jobs["jobs"].as_array().unwrap().last().unwrap()["message"].as_str().unwrap().to_owned();
    assert!(why.contains("has labels beside it"), "{why}");

    let labels = write_elan([("swing", 0.0, 2.0), ("rest", 2.0, 5.0)]);
    fs::write(folder.path().join("recordings/take.eaf"), labels).unwrap();
    ok(&mut client, record_start("learnt")).await;
    for revision in 1..=2 {
        ok(&mut client, json!({"type": "segments.train", "epochs": 1, "look_ahead": 0})).await;
        let jobs = until(&mut client, "the model", |message| ended(message, "done")).await;
        let result = &jobs["jobs"].as_array().unwrap().last().unwrap()["result"];
        assert_eq!(result["labels"], json!(["rest", "swing"]), "{result}");
        assert_eq!(result["file"], format!("segments-00{revision}.safetensors"));
        until(&mut client, "a name", |message| message["event"] == "provisional").await;
    }
    ok(&mut client, json!({"type": "record.stop"})).await;
    assert_eq!(daemon.end("INT").await.code(), Some(0));
    replays(&folder.path().join("recordings/learnt.mcap"));

    // The file serves the next run.
    let stage = two_devices(folder.path(), "[segments]\nmodel = \"segments/segments-002.safetensors\"\n");
    let daemon = Posed::demo_that_keeps(&stage);
    let mut client = daemon.subscriber(&["segments"]).await;
    until(&mut client, "a name", |message| message["event"] == "provisional").await;
    assert_eq!(daemon.end("INT").await.code(), Some(0));
}
