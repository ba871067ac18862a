//! The fault map on a running daemon: learnt from what is tracked, renamed, kept, loaded from the stage file.

use std::fs;

use serde_json::json;

use super::process::{Posed, frames, ok, refused, two_devices, until};
use crate::cli::posed;

#[tokio::test]
async fn a_map_is_learnt_named_kept_and_loaded() {
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "");
    let daemon = Posed::demo_that_keeps(&stage);
    let mut client = daemon.subscriber(&["faults", "jobs"]).await;
    ok(&mut client, json!({"type": "subscribe", "topics": ["sensors"], "fields": ["fault", "raw"]})).await;
    let cell = json!({"type": "faults.name_cell", "row": 0, "column": 0, "class": "anomalous"});
    let (code, sentence) = refused(&mut client, cell.clone()).await;
    assert_eq!((code.as_str(), sentence.contains("no fault map")), ("failed", true), "{sentence}");
    let (code, _) = refused(&mut client, json!({"type": "faults.train", "recording": "none.mcap"})).await;
    assert_eq!(code, "bad_request");
    let frame = until(&mut client, "records", |message| {
        message["type"] == "sensors"
            && message["sensors"].as_array().unwrap().iter().all(|sensor| !sensor["measured"].is_null())
    })
    .await;
    assert!(frame["fault"].is_null() && frame["sensors"][0]["fault"].is_null(), "{frame}");

    // Frames, not seconds: on a busy machine a second has fewer, and a map wants three hundred.
    frames(&mut client, 400).await;
    // Another asks: the event may come before the answer.
    let mut operator = daemon.subscriber(&["status"]).await;
    ok(&mut operator, json!({"type": "faults.train"})).await;
    let map = until(&mut client, "the map", |message| message["event"] == "map").await;
    assert_eq!((&map["revision"], &map["rows"]), (&json!(1), &json!(21)));
    assert_eq!(map["sensors"], json!(["of one", "of two"]));
    assert_eq!(map["cells"].as_array().unwrap().len(), 441);
    let frame = until(&mut client, "its labels", |message| !message["fault"]["cell"].is_null()).await;
    assert!(frame["sensors"][0]["fault"]["label"].is_string(), "{frame}");

    let named = ok(&mut operator, cell).await;
    assert_eq!(named, json!({"revision": 2, "file": "faults-002.json"}));
    let map = until(&mut client, "the renamed map", |message| message["event"] == "map").await;
    assert_eq!((&map["revision"], &map["cells"][0]), (&json!(2), &json!("anomalous")));
    let outside = json!({"type": "faults.name_cell", "row": 21, "column": 0, "class": "clean"});
    assert!(refused(&mut client, outside).await.1.contains("a row below 21"));
    assert_eq!(daemon.end("INT").await.code(), Some(0));

    // The file serves the next run, and is refused for other sensors.
    let stage = two_devices(folder.path(), "[models]\nfaults = \"faults/faults-002.json\"\n");
    let daemon = Posed::demo_that_keeps(&stage);
    let mut client = daemon.subscriber(&["faults"]).await;
    let map = until(&mut client, "the loaded map", |message| message["event"] == "map").await;
    assert_eq!((&map["revision"], &map["cells"][0]), (&json!(2), &json!("anomalous")));
    assert_eq!(daemon.end("INT").await.code(), Some(0));
    let text = fs::read_to_string(&stage).unwrap().replace("of two", "of three");
    fs::write(&stage, text).unwrap();
    let output = posed([std::ffi::OsStr::new("check"), stage.as_os_str()]);
    let emitted = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(1));
    assert!(emitted.contains("expected the sensors of one,of two, found of one,of three"), "{emitted}");
}
