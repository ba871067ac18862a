//! The folder of recordings, as clients of a live stage and of a take see it.

use std::fs;
use std::path::Path;

use posed_protocol::Digest;
use posed_recording::{make_digest, read_digest};
use serde_json::{Value, json};
use tokio_tungstenite::connect_async;

use super::process::{Posed, all_ok, frames, ok, record_start, refused, two_devices, until};
use crate::server::harness::{Client, get_bytes};

/// Waits for the end of a job; what it has come to.
async fn ended(client: &mut Client, job: &Value) -> Value {
    client.subscribe(&["jobs"]).await;
    let find = |message: &Value| -> Option<Value> {
        let jobs = message["jobs"].as_array()?;
        jobs.iter().find(|listed| listed["job"] == *job && listed["state"] != "running").cloned()
    };
    find(&until(client, "the end of a job", |message| find(message).is_some()).await).unwrap()
}

/// Head and body of an answer.
async fn fetch(posed: &Posed, path: &str, more: &str) -> (String, Vec<u8>) {
    let head = format!("GET {path} HTTP/1.1\r\nHost: {}\r\n{more}\r\n", posed.address);
    let answer = get_bytes(posed.address, &head).await;
    let at = answer.windows(4).position(|window| window == b"\r\n\r\n").unwrap();
    (String::from_utf8(answer[..at].to_vec()).unwrap().to_lowercase(), answer[at + 4..].to_vec())
}

async fn watch(posed: &Posed, name: &str) -> Client {
    let (socket, _) = connect_async(format!("ws://{}/takes/{name}/ws", posed.address)).await.unwrap();
    let mut client = Client { socket, protocol: None };
    assert_eq!(client.next().await["type"], "hello");
    client
}

#[tokio::test]
async fn a_take_is_listed_described_exported_fetched_and_removed() {
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "");
    let posed = Posed::demo_that_keeps(&stage);
    let mut live = posed.subscriber(&["sensors"]).await;
    until(&mut live, "all sensors", all_ok).await;
    let name = ok(&mut live, record_start("first")).await["name"].as_str().unwrap().to_owned();
    assert_eq!(name, "first.mcap");
    frames(&mut live, 50).await;
    ok(&mut live, json!({"type": "mark", "label": "pain here"})).await;
    frames(&mut live, 150).await;
    let listed = ok(&mut live, json!({"type": "library.list"})).await;
    assert_eq!(listed["recording"], "first.mcap");
    assert_eq!((&listed["takes"][0]["name"], &listed["takes"][0]["complete"]), (&json!(name), &json!(false)));
    for request in [
        json!({"type": "library.remove", "name": name}),
        json!({"type": "library.rename", "name": name, "to": "other"}),
        json!({"type": "library.export", "name": name, "format": "csv"}),
        json!({"type": "library.digest", "name": name, "make": true}),
    ] {
        assert_eq!(refused(&mut live, request).await.0, "busy");
    }
    ok(&mut live, json!({"type": "record.stop"})).await;

    let listed = ok(&mut live, json!({"type": "library.list"})).await;
    let take = &listed["takes"][0];
    assert_eq!((&listed["recording"], &take["stage"]), (&Value::Null, &json!("Two")));
    assert_eq!((&take["complete"], &take["counts"]["marks"]), (&json!(true), &json!(1)));
    assert!(take["length_s"].as_f64().unwrap() > 1.0, "{take}");
    assert_eq!(take["picture"]["paths"][0]["name"], "of one");
    let path = folder.path().join("recordings").join(&name);
    let digest = ok(&mut live, json!({"type": "library.digest", "name": name})).await["digest"].clone();
    assert_eq!(digest["marks"][0]["label"], "pain here");
    // A replay finds the same as was seen live.
    let digest: Digest = serde_json::from_value(digest).unwrap();
    assert_eq!(make_digest(&path, |_| true).unwrap(), digest);

    let job = ok(&mut live, json!({"type": "library.export", "name": name, "format": "csv"})).await;
    let job = ended(&mut live, &job["job"]).await;
    assert_eq!((&job["state"], &job["result"]["file"]), (&json!("done"), &json!("first.csv")), "{job}");
    let (head, body) = fetch(&posed, "/exports/first.csv", "").await;
    assert!(
        head.starts_with("http/1.1 200") && head.contains("attachment; filename*=utf-8''first.csv"),
        "{head}"
    );
    assert_eq!(body, fs::read(path.with_file_name("exports").join("first.csv")).unwrap());
    assert_eq!(job["result"]["bytes"], body.len());
    let (head, body) = fetch(&posed, "/recordings/first.mcap", "").await;
    assert!(head.contains(&format!("content-length: {}", body.len())), "{head}");
    assert_eq!(body, fs::read(&path).unwrap());
    for elsewhere in [
        "/recordings/..%2Fstage.toml",
        "/recordings/bin",
        "/recordings/nobody.mcap",
        "/exports/..%2Ffirst.mcap",
        "/exports/..",
        "/exports/%2e%2e%2ffirst.mcap",
    ] {
        let (head, _) = fetch(&posed, elsewhere, "").await;
        assert!(head.starts_with("http/1.1 404"), "{elsewhere}: {head}");
    }
    let (head, _) = fetch(&posed, "/recordings/first.mcap", "Origin: http://evil.example\r\n").await;
    assert!(head.starts_with("http/1.1 403"), "{head}");

    // A take answers the same, shows where everything was, and stays as long as somebody watches it.
    let mut take = watch(&posed, &name).await;
    let seen = ok(&mut take, json!({"type": "library.list"})).await;
    assert_eq!(seen["takes"][0]["name"], json!(name));
    let look = ok(&mut take, json!({"type": "replay.look", "t_s": digest.marks[0].t_s})).await;
    assert!((look["t_s"].as_f64().unwrap() - digest.marks[0].t_s).abs() < 0.5, "{look}");
    let sensors = look["sensors"].as_array().unwrap();
    assert!(sensors.len() == 2 && sensors[0]["position_m"].is_array(), "{look}");
    assert_eq!(refused(&mut live, json!({"type": "replay.look", "t_s": 1})).await.0, "live");
    assert_eq!(refused(&mut live, json!({"type": "library.remove", "name": name})).await.0, "busy");
    assert_eq!(refused(&mut take, json!({"type": "health.history"})).await.0, "replay");
    let history = ok(&mut live, json!({"type": "health.history"})).await;
    assert_eq!((&history["bin_s"], &history["sensors"][1]["name"]), (&json!(10.0), &json!("of two")));
    drop(take);
    let removed = async {
        loop {
            // Until the daemon has noticed that nobody watches it any more.
            let answer = live.ask(json!({"type": "library.remove", "name": name})).await;
            if answer["type"] == "ok" {
                return;
            }
            assert_eq!(answer["code"], "busy", "{answer}");
        }
    };
    tokio::time::timeout(super::process::PATIENCE, removed)
        .await
        .expect("a take that nobody watches is let go");
    assert_eq!(
        ok(&mut live, json!({"type": "library.list", "bin": true})).await["takes"][0]["name"],
        json!(name)
    );
    ok(&mut live, json!({"type": "library.restore", "name": name})).await;
    let renamed = ok(&mut live, json!({"type": "library.rename", "name": name, "to": "second"})).await;
    assert_eq!(renamed, json!({"name": "second.mcap"}));
    assert_eq!(posed.end("INT").await.code(), Some(0));
}

#[tokio::test]
async fn a_take_that_was_torn_gets_a_digest_by_a_job_beside_a_replay() {
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "");
    let mut posed = Posed::demo_that_keeps(&stage);
    let mut live = posed.subscriber(&["sensors"]).await;
    until(&mut live, "all sensors", all_ok).await;
    ok(&mut live, record_start("torn")).await;
    ok(&mut live, json!({"type": "mark", "label": "here"})).await;
    frames(&mut live, 200).await;
    posed.child.kill().unwrap();
    posed.child.wait().unwrap();
    let path = folder.path().join("recordings/torn.mcap");
    assert_eq!(read_digest(&path).unwrap(), None);

    let replay = Posed::start(["replay".as_ref(), path.as_os_str()]);
    let mut client = replay.client().await;
    let listed = ok(&mut client, json!({"type": "library.list"})).await;
    let take = &listed["takes"][0];
    assert_eq!((&take["complete"], &take["length_s"]), (&json!(false), &Value::Null), "{take}");
    let ask = json!({"type": "library.digest", "name": "torn.mcap"});
    assert_eq!(ok(&mut client, ask.clone()).await, json!({"unknown": true}));
    let make = json!({"type": "library.digest", "name": "torn.mcap", "make": true});
    let job = ok(&mut client, make.clone()).await;
    let job = ended(&mut client, &job["job"]).await;
    assert_eq!(job["state"], "done", "{job}");
    let digest = ok(&mut client, ask).await["digest"].clone();
    assert_eq!(digest["marks"][0]["label"], "here");
    assert_eq!(ok(&mut client, make).await["digest"], digest, "it is made once");
    assert!(Path::new(&format!("{}.digest.json", path.display())).exists());
    let (_, sentence) = refused(&mut client, json!({"type": "replay.look", "t_s": 1})).await;
    assert!(sentence.contains("--repair"), "{sentence}");
    assert_eq!(refused(&mut client, json!({"type": "library.remove", "name": "torn.mcap"})).await.0, "busy");
    assert!(fetch(&replay, "/recordings/torn.mcap", "").await.0.starts_with("http/1.1 200"));
}

#[tokio::test]
async fn only_who_has_a_token_fetches_and_only_who_may_operate_moves() {
    let folder = tempfile::tempdir().unwrap();
    let token =
        |secret: &str, role: &str| format!("[[server.token]]\nsecret = \"{secret}\"\nrole = \"{role}\"\n");
    let more = token("watch-watch-watch", "watch") + &token("operate-operate-operate", "operate");
    let stage = two_devices(folder.path(), &more);
    fs::create_dir(folder.path().join("recordings")).unwrap();
    fs::write(folder.path().join("recordings/a.mcap"), "nothing").unwrap();
    let posed = Posed::demo_that_keeps(&stage);
    let (head, _) = fetch(&posed, "/recordings/a.mcap", "").await;
    assert!(head.starts_with("http/1.1 401"), "{head}");
    let (head, body) = fetch(&posed, "/recordings/a.mcap?token=watch-watch-watch", "").await;
    assert!(head.starts_with("http/1.1 200") && body == b"nothing", "{head}");
    let mut client = posed.client_with("?token=watch-watch-watch").await;
    assert_eq!(ok(&mut client, json!({"type": "library.list"})).await["takes"][0]["name"], "a.mcap");
    for request in [
        json!({"type": "library.digest", "name": "a.mcap", "make": true}),
        json!({"type": "library.remove", "name": "a.mcap"}),
        json!({"type": "library.empty_bin"}),
        json!({"type": "library.export", "name": "a.mcap", "format": "csv"}),
    ] {
        assert_eq!(refused(&mut client, request).await.0, "forbidden");
    }
}
