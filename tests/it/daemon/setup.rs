//! Setting up a stage over the websocket: found, changed, begun anew at the same address, and never worse off than before.

use std::fs;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::{Value, json};

use super::process::{Posed, all_ok, frames, ok, record_start, refused, two_devices, until};
use crate::server::harness::Client;
use crate::simulated::Simulation;

/// `posed run` on a stage file, with the ports in a folder beside those of this computer.
pub(crate) fn run(stage: &Path, ports: &Path) -> Posed {
    let mut command = Command::new(env!("CARGO_BIN_EXE_posed"));
    command.args(["run".as_ref(), "--new".as_ref(), stage.as_os_str()]).args(["--listen", "127.0.0.1:0"]);
    Posed::spawn(command.env("POSED_PORTS", ports))
}

/// What the stage file says with these changes.
async fn read(client: &mut Client, changes: Value) -> Value {
    ok(client, json!({"type": "setup.read", "changes": changes})).await
}

async fn save(client: &mut Client, changes: &Value) {
    let revision = read(client, json!([])).await["revision"].clone();
    ok(client, json!({"type": "setup.save", "changes": changes, "revision": revision})).await;
    assert_eq!(client.closed().await.0, 1012);
}

fn named(name: &str) -> Value {
    json!([{"change": "name_stage", "name": name}])
}

fn kept(stage: &Path) -> PathBuf {
    stage.with_extension("toml~")
}

#[tokio::test]
async fn devices_are_found_added_and_tracked_without_an_end_of_the_daemon() {
    let folder = tempfile::tempdir().unwrap();
    let ports = folder.path().join("ports");
    fs::create_dir(&ports).unwrap();
    let simulation =
        Simulation::start(&two_devices(folder.path(), ""), &["--ports", ports.to_str().unwrap()]);
    let stage = folder.path().join("new.toml");
    let posed = run(&stage, &ports);
    let mut client = posed.subscriber(&["jobs"]).await;
    let empty = read(&mut client, json!([])).await;
    assert_eq!(
        (&empty["devices"], &empty["problems"], &empty["why_not"]),
        (&json!([]), &json!([]), &Value::Null)
    );
    let job = ok(&mut client, json!({"type": "setup.find"})).await["job"].clone();
    let ended = until(&mut client, "what was found", |message| {
        let jobs = message["jobs"].as_array();
        jobs.is_some_and(|jobs| jobs.iter().any(|each| each["job"] == job && each["state"] == "done"))
    })
    .await;
    let found = ended["jobs"].as_array().unwrap().iter().find(|each| each["job"] == job).unwrap();
    let mine = |port: &&Value| port["port"].as_str().unwrap().starts_with(ports.to_str().unwrap());
    let mine: Vec<&Value> = found["result"]["ports"].as_array().unwrap().iter().filter(mine).collect();
    assert_eq!(mine.len(), 2, "{found}");
    let adds: Vec<&Value> = mine.iter().flat_map(|port| port["adds"].as_array().unwrap()).collect();
    let changes = json!(adds);
    let changed = read(&mut client, changes.clone()).await;
    assert_eq!(
        (changed["devices"].as_array().unwrap().len(), &changed["problems"]),
        (2, &json!([])),
        "{changed}"
    );
    save(&mut client, &changes).await;
    // The same daemon, at the same address, has another stage.
    let mut client = posed.subscriber(&["sensors"]).await;
    until(&mut client, "all sensors", |message| {
        all_ok(message) && message["sensors"].as_array().unwrap().len() == 2
    })
    .await;
    // What it has it asks no more.
    let job = ok(&mut client, json!({"type": "setup.find", "port": mine[0]["port"]})).await["job"].clone();
    client.subscribe(&["jobs"]).await;
    let refused = until(&mut client, "whose it is", |message| {
        let jobs = message["jobs"].as_array();
        jobs.is_some_and(|jobs| jobs.iter().any(|each| each["job"] == job && each["state"] == "failed"))
    })
    .await;
    assert!(refused.to_string().contains("belongs to flock"), "{refused}");
    frames(&mut client, 20).await;
    assert_eq!(posed.end("INT").await.code(), Some(0));
    simulation.interrupt();
}

#[tokio::test]
async fn a_stage_is_changed_only_where_it_may_be_and_the_file_of_before_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let stage = folder.path().join("stage.toml");
    let text = "# Ours.\nname = \"old\" # for now\n[[server.token]]\nsecret = \"sixteen-letters-x\"\nrole = \"operate\"\n";
    fs::write(&stage, text).unwrap();
    let posed = run(&stage, folder.path());
    let token = "?token=sixteen-letters-x";
    let mut client = posed.client_with(token).await;
    let setup = read(&mut client, named("new")).await;
    assert_eq!((&setup["name"], &setup["file"]), (&"new".into(), &"stage.toml".into()));
    // Who reads it sees no secret; the file is as it was.
    assert!(!setup.to_string().contains("sixteen"), "{setup}");
    assert_eq!(fs::read_to_string(&stage).unwrap(), text);
    let request = |changes: Value, revision: &Value| json!({"type": "setup.save", "changes": changes, "revision": revision});
    let (revision, stale) = (setup["revision"].clone(), Value::from("0123"));
    let port = json!([
        {"change": "add", "table": "device", "keys": {"name": "a", "driver": "fastrak", "port": "usb"}},
        {"change": "add", "table": "sensor", "keys": {"name": "x", "device": "a", "address": 1}},
    ]);
    let problem = &read(&mut client, port.clone()).await["problems"][0];
    assert_eq!(
        (&problem["key"], &problem["table"], &problem["name"]),
        (&"port".into(), &"device".into(), &"a".into())
    );
    assert_eq!(refused(&mut client, request(port, &revision)).await.0, "failed");
    let other = json!([{"change": "remove", "table": "sensor", "name": "b"}]);
    assert_eq!(refused(&mut client, request(other, &revision)).await.0, "bad_request");
    assert_eq!(refused(&mut client, request(named("new"), &stale)).await.0, "changed");
    ok(&mut client, record_start("take")).await;
    assert_eq!(refused(&mut client, request(named("new"), &revision)).await.0, "busy");
    ok(&mut client, json!({"type": "record.stop"})).await;
    let mut changes = named("new");
    changes.as_array_mut().unwrap().push(json!({
        "change": "place_transmitter", "position_m": [0.5, 0.0, 1.0], "orientation_wxyz": [1.0, 0.0, 0.0, 0.0],
    }));
    save(&mut client, &changes).await;
    let mut client = posed.client_with(token).await;
    assert_eq!(read(&mut client, json!([])).await["name"], "new");
    let placed = "\n[transmitter.pose_in_room]\nposition_m = [0.5, 0.0, 1.0]\norientation_wxyz = [1.0, 0.0, 0.0, 0.0]\n";
    assert_eq!(fs::read_to_string(&stage).unwrap(), text.replace("\"old\"", "\"new\"") + placed);
    assert_eq!(fs::read_to_string(kept(&stage)).unwrap(), text);
    assert_eq!(posed.end("TERM").await.code(), Some(0));
}

#[tokio::test]
async fn a_changed_stage_that_does_not_start_leaves_the_one_before() {
    let folder = tempfile::tempdir().unwrap();
    let stage = folder.path().join("stage.toml");
    let posed = run(&stage, folder.path());
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    // Somebody wants another server's address, in an editor.
    let wanted = format!("name = \"s\"\n[vrpn]\nlisten = \"{}\"\n", taken.local_addr().unwrap());
    fs::write(&stage, &wanted).unwrap();
    let mut client = posed.client().await;
    save(&mut client, &named("new")).await;
    let mut client = posed.subscriber(&["status"]).await;
    let status = until(&mut client, "why", |message| message["problems"][0]["code"] == "stage").await;
    assert!(status["problems"][0]["message"].as_str().unwrap().contains("VRPN"), "{status}");
    assert_eq!(fs::read_to_string(&stage).unwrap(), wanted);
    // And when it can, it does.
    drop(taken);
    save(&mut client, &named("new")).await;
    let mut client = posed.subscriber(&["status"]).await;
    let status = until(&mut client, "a status", |message| message["type"] == "status").await;
    assert_eq!(status["problems"], json!([]));
    assert_eq!(posed.end("INT").await.code(), Some(0));
}

#[tokio::test]
async fn a_stage_that_cannot_be_changed_says_why() {
    let demo = Posed::start(["demo"]);
    let mut client = demo.client().await;
    let setup = read(&mut client, json!([])).await;
    assert!(
        setup["why_not"].as_str().unwrap().contains("--new")
            && setup["sensors"].as_array().unwrap().len() > 10
    );
    let save = json!({"type": "setup.save", "changes": named("x"), "revision": setup["revision"]});
    assert_eq!(refused(&mut client, save).await.0, "read_only");
    assert_eq!(demo.end("INT").await.code(), Some(0));
}
