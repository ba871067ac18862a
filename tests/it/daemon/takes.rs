//! Recordings that are watched beside the live stage that made them.

use std::fs;

use serde_json::{Value, json};
use tokio_tungstenite::{connect_async, tungstenite};

use super::process::{Posed, all_ok, frames, ok, record_start, two_devices, until};
use crate::server::harness::Client;

/// A client of a take that has been greeted, or why there is none.
async fn watch(posed: &Posed, name: &str) -> Result<Client, (u16, String)> {
    match connect_async(format!("ws://{}/takes/{name}/ws", posed.address)).await {
        Ok((socket, _)) => {
            let mut client = Client { socket, protocol: None };
            let hello = client.next().await;
            assert_eq!((&hello["type"], &hello["stage"]), (&json!("hello"), &json!("Two")));
            Ok(client)
        }
        Err(tungstenite::Error::Http(response)) => {
            let sentence = String::from_utf8(response.body().clone().unwrap_or_default()).unwrap();
            Err((response.status().as_u16(), sentence))
        }
        Err(error) => panic!("{error}"),
    }
}

async fn at_s(client: &mut Client) -> f64 {
    let status = until(client, "where it stands", |message| message["type"] == "status").await;
    status["replay"]["t_s"].as_f64().unwrap()
}

#[tokio::test]
async fn a_take_is_watched_while_the_stage_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "");
    let posed = Posed::demo_that_keeps(&stage);
    let mut live = posed.subscriber(&["sensors"]).await;
    until(&mut live, "all sensors", all_ok).await;
    let name = ok(&mut live, record_start("first")).await["name"].as_str().unwrap().to_owned();
    frames(&mut live, 200).await;
    ok(&mut live, json!({"type": "record.stop"})).await;

    let page = posed.get(&format!("/takes/{name}/")).await;
    assert!(page.contains("<script"), "{page}");
    let moved = posed.get(&format!("/takes/{name}?token=x")).await;
    assert!(moved.contains(&format!("location: ./{name}/?token=x")), "{moved}");
    let mut take = watch(&posed, &name).await.unwrap();
    take.subscribe(&["sensors", "status"]).await;
    frames(&mut take, 20).await;
    // The live stage goes on meanwhile, and is asked nothing of this.
    let before = frames(&mut live, 1).await[0]["t_s"].as_f64().unwrap();
    ok(&mut take, json!({"type": "replay.speed", "speed": 0.0})).await;
    ok(&mut take, json!({"type": "replay.seek", "t_s": 0.0})).await;
    let after = frames(&mut live, 50).await.pop().unwrap()["t_s"].as_f64().unwrap();
    assert!(after > before + 0.4, "{before} {after}");
    let refused = live.ask(json!({"type": "replay.speed", "speed": 1.0})).await;
    assert_eq!(refused["type"], "error", "{refused}");

    // Who comes soon after the last one has gone finds it where it was left: in a pause.
    let stood = at_s(&mut take).await;
    drop(take);
    let mut take = watch(&posed, &name).await.unwrap();
    take.subscribe(&["status"]).await;
    let stands = at_s(&mut take).await;
    assert!((stands - stood).abs() < 0.01, "{stood} {stands}");
    let status = until(&mut take, "the speed", |message| message["type"] == "status").await;
    assert_eq!(status["replay"]["speed"], json!(0.0));
    let (code, sentence) = super::process::refused(&mut take, record_start("second")).await;
    assert_eq!(code, "replay", "{sentence}");
    assert_eq!(posed.end("INT").await.code(), Some(0));
}

#[tokio::test]
async fn what_is_no_take_cannot_be_watched_nor_are_too_many_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "");
    let posed = Posed::demo_that_keeps(&stage);
    let mut live = posed.subscriber(&["sensors"]).await;
    let name = ok(&mut live, record_start("take")).await["name"].as_str().unwrap().to_owned();
    frames(&mut live, 50).await;
    ok(&mut live, json!({"type": "record.stop"})).await;
    let recordings = folder.path().join("recordings");
    fs::write(recordings.join("broken.mcap"), b"nothing of the kind").unwrap();
    fs::copy(&stage, recordings.join("stage.toml")).unwrap();
    for other in ["nobody.mcap", "stage.toml", "..%2Fstage.toml", "%2e%2e"] {
        let (status, sentence) = watch(&posed, other).await.err().unwrap();
        assert_eq!(status, 404, "{other}: {sentence}");
    }
    let (status, sentence) = watch(&posed, "broken.mcap").await.err().unwrap();
    assert_eq!(status, 422, "{sentence}");
    let mut watched: Vec<(Client, Value)> = Vec::new();
    for copy in 0..4 {
        let copied = format!("copy-{copy}.mcap");
        fs::copy(recordings.join(&name), recordings.join(&copied)).unwrap();
        watched.push((watch(&posed, &copied).await.unwrap(), json!(copied)));
    }
    let (status, sentence) = watch(&posed, &name).await.err().unwrap();
    assert!(status == 503 && sentence.contains("4 recordings are open"), "{sentence}");
    for (client, copied) in &mut watched {
        client.subscribe(&["status"]).await;
        let status = until(client, "its name", |message| message["type"] == "status").await;
        assert_eq!(status["replay"]["name"], *copied);
    }
    frames(&mut live, 20).await;
}
