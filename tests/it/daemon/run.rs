//! `posed demo` and `posed run` from the first line to the exit code.

use std::path::Path;
use std::process::Command;

use posed_recording::Info;
use serde_json::{Value, json};

use super::process::{Posed, all_ok, frames, ok, one_device, two_devices, until};
use crate::simulated::Simulation;

fn vector(value: &Value) -> [f64; 3] {
    std::array::from_fn(|i| value[i].as_f64().unwrap())
}

#[tokio::test]
async fn a_demo_serves_poses_near_the_truth_and_ends_in_order() {
    for signal in ["INT", "TERM"] {
        let folder = tempfile::tempdir().unwrap();
        let stage = two_devices(folder.path(), "");
        let recording = folder.path().join("take.mcap");
        let posed = Posed::start([
            "demo",
            "--stage",
            stage.to_str().unwrap(),
            "--record",
            recording.to_str().unwrap(),
        ]);
        let health = posed.get("/health").await;
        assert!(health.starts_with("HTTP/1.1 200"), "{health}");
        let mut client = posed.subscriber(&["sensors", "truth"]).await;
        until(&mut client, "all sensors", all_ok).await;
        let (mut truths, mut compared) = (Vec::new(), 0);
        while compared < 100 {
            let message = client.next().await;
            if message["type"] == "truth" {
                truths.push(message);
                continue;
            }
            if message["type"] != "sensors" {
                continue;
            }
            for sensor in
                message["sensors"].as_array().unwrap().iter().filter(|sensor| sensor["state"] == "ok")
            {
                let t_s = message["t_s"].as_f64().unwrap();
                let of_sensor = |truth: &Value| {
                    let near = (truth["t_s"].as_f64().unwrap() - t_s).abs() < 2e-3;
                    let named = |of: &&Value| of["name"] == sensor["name"];
                    near.then(|| truth["sensors"].as_array().unwrap().iter().find(named).cloned()).flatten()
                };
                let Some(truth) = truths.iter().rev().take(20).find_map(of_sensor) else { continue };
                let (got, real) = (vector(&sensor["position_m"]), vector(&truth["position_m"]));
                let off_m = got.iter().zip(real).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
                assert!(off_m < 0.02, "{sensor} is not {truth}");
                compared += 1;
            }
        }
        assert_eq!(posed.end(signal).await.code(), Some(0), "SIG{signal}");
        assert_eq!(client.closed().await.0, 1001);
        let info = Info::read(&recording, |_| ()).unwrap();
        assert!(info.complete && !info.mid_run && info.topics["/input/truth"] > 10, "{info:?}");
    }
}

#[tokio::test]
async fn a_run_tracks_a_unit_on_a_port() {
    let folder = tempfile::tempdir().unwrap();
    let awake = "[[simulation.device]]\nname = \"flock\"\nboot_ms = 0.0\n";
    let stage = one_device(folder.path(), "auto", awake);
    let simulation = Simulation::start(&stage, &[]);
    let port = format!("flock={}", simulation.port());
    let posed = Posed::start(["run", stage.to_str().unwrap(), "--port", &port]);
    let mut client = posed.subscriber(&["sensors", "status"]).await;
    until(&mut client, "a good pose", all_ok).await;
    frames(&mut client, 50).await;
    let status = until(&mut client, "a rate", |message| message["devices"][0]["rate_hz"].is_number()).await;
    assert_eq!(status["devices"][0]["state"], "streaming");
    assert_eq!(posed.end("INT").await.code(), Some(0));
    assert_eq!(simulation.interrupt().code(), Some(0));
}

/// A unit that starts is not reported as silent: a newcomer sees no warning.
#[tokio::test]
async fn a_unit_that_starts_is_no_silent_one() {
    let posed = Posed::start(["demo"]);
    let mut client = posed.subscriber(&["status"]).await;
    loop {
        let status = until(&mut client, "status", |message| message["type"] == "status").await;
        let state = status["devices"][0]["state"].as_str().unwrap();
        assert!(state == "connecting" || state == "streaming", "{status}");
        assert!(status["problems"].as_array().unwrap().is_empty(), "{status}");
        if state == "streaming" {
            break;
        }
    }
}

/// What lies in a folder, by name.
fn left(path: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(path).unwrap();
    let mut names =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect::<Vec<_>>();
    names.sort();
    names
}

/// Who only looks finds nothing in the folder afterwards but the recording that was asked for, which is named here.
async fn look(folder: &Path, args: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_posed"));
    let posed =
        Posed::spawn(command.args(["demo", "--listen", "127.0.0.1:0"]).args(args).current_dir(folder));
    let mut client = posed.client().await;
    ok(&mut client, json!({"type": "session.begin", "person": "P-1"})).await;
    ok(&mut client, json!({"type": "session.end"})).await;
    let listed = ok(&mut client, json!({"type": "session.list"})).await;
    assert_eq!(listed["sessions"].as_array().unwrap().len(), 1);
    let begun = ok(&mut client, json!({"type": "record.start", "name": "take"})).await;
    ok(&mut client, json!({"type": "record.stop"})).await;
    assert_eq!(posed.end("INT").await.code(), Some(0));
    begun["name"].as_str().unwrap().to_owned()
}

#[tokio::test]
async fn the_demo_leaves_nothing_behind_but_recordings() {
    let folder = tempfile::tempdir().unwrap();
    let take = look(folder.path(), &[]).await;
    assert_eq!(left(folder.path()), ["recordings"]);
    assert_eq!(left(&folder.path().join("recordings")), [take]);
}

#[tokio::test]
async fn nor_does_that_of_a_stage_file() {
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "");
    let before = left(folder.path());
    let take = look(folder.path(), &["--stage", stage.to_str().unwrap()]).await;
    assert_eq!(left(&folder.path().join("recordings")), [take]);
    std::fs::remove_dir_all(folder.path().join("recordings")).unwrap();
    assert_eq!(left(folder.path()), before);
}

/// Who writes a trainer sees counts without a person, and without teaching.
#[tokio::test]
async fn the_demos_person_does_an_exercise_that_is_counted_listed_and_shown() {
    let posed = Posed::start(["demo", "--exercise", "squat"]);
    let mut client = posed.subscriber(&["exercise"]).await;
    assert_eq!(ok(&mut client, json!({"type": "exercise.list"})).await["exercises"][0]["name"], "squat");
    let shown = ok(&mut client, json!({"type": "exercise.demonstration", "exercise": "squat"})).await;
    assert!(shown["angles"].as_array().unwrap().contains(&json!("knee_r_flexion_deg")), "{shown}");
    let counted = until(&mut client, "a repetition", |message| message["event"] == "counted").await;
    assert_eq!((&counted["exercise"], &counted["count"]), (&json!("squat"), &json!(1)));
    assert_eq!(posed.end("INT").await.code(), Some(0));
}
