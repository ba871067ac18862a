//! The client for TypeScript, compiled, on a stage that runs.
//!
//! Runs where Node and the client's packages are installed (`npm ci --ignore-scripts` in `clients/typescript`), and says so where not.

use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};

use crate::daemon::process::Posed;

#[tokio::test]
async fn it_streams_asks_is_refused_and_misses_no_event_of_a_broken_connection() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("clients/typescript");
    let compiler = folder.join("node_modules/.bin/tsc");
    if !compiler.exists() {
        println!("skipped: run `npm ci --ignore-scripts` in clients/typescript to test it");
        return;
    }
    let build = tempfile::tempdir().unwrap();
    // Beside the modules: what is compiled is imported as it would be from the package.
    std::fs::write(build.path().join("package.json"), r#"{"type":"module"}"#).unwrap();
    let compiled =
        Command::new(compiler).arg("--outDir").arg(build.path()).current_dir(&folder).output().unwrap();
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stdout));
    plays_a_take_in_the_place_of_a_stage(&folder, &build.path().join("index.js"));
    let posed = Posed::start(["demo"]);
    let seen = Command::new("node")
        .arg("test/live.mjs")
        .arg(format!("http://{}/", posed.address))
        .arg(build.path().join("index.js"))
        .current_dir(&folder)
        .output()
        .unwrap();
    assert!(seen.status.success(), "{}", String::from_utf8_lossy(&seen.stderr));
    let seen: Value = serde_json::from_slice(&seen.stdout).unwrap();
    let frames = seen["frames"].as_array().unwrap();
    let times: Vec<f64> = frames.iter().map(|frame| frame["t_s"].as_f64().unwrap()).collect();
    assert!(times.windows(2).all(|pair| pair[0] < pair[1]), "{times:?}");
    for frame in frames {
        assert_eq!((&frame["sensors"][0]["name"], &frame["sensors"][1]), (&json!("wand"), &Value::Null));
        assert_eq!(frame["sensors"][0]["position_m"].as_array().unwrap().len(), 3);
    }
    // The clock of this computer and the stage's are one.
    assert!(seen["age_s"].as_f64().unwrap().abs() < 30.0, "{}", seen["age_s"]);
    assert_eq!(seen["refused"], json!([true, "no_such_job"]));
    assert_eq!(seen["lost"], "lost");
    assert_eq!(seen["marks"], json!(["before", "meanwhile"]));
    assert!(seen["after"].as_f64().unwrap() > times[4]);
    assert_eq!(seen["closing"], json!(["lost", 0]));
    let again = ["lost", "connecting", "open"];
    assert_eq!(seen["states"], json!([&["connecting", "open"][..], &again, &again].concat()));
    assert_eq!((&seen["done"], &seen["closed"]), (&json!(true), &json!("lost")));
    assert_eq!(posed.end("TERM").await.code(), Some(0));
}

/// Without a daemon.
fn plays_a_take_in_the_place_of_a_stage(folder: &Path, client: &Path) {
    let seen = Command::new("node").arg("test/mock.mjs").arg(client).current_dir(folder).output().unwrap();
    assert!(seen.status.success(), "{}", String::from_utf8_lossy(&seen.stderr));
    let seen: Value = serde_json::from_slice(&seen.stdout).unwrap();
    for played in [&seen["fast"], &seen["timed"]] {
        assert_eq!(played["topics"], json!(["sensors", "marks"]));
        assert_eq!(played["stage"][1], json!({"name": "wand", "device": "flock", "magnetic": true}));
        assert_eq!((&played["refused"], &played["marks"]), (&json!([true, "mock"]), &json!([1, 2])));
        assert_eq!(played["states"], json!(["connecting", "open"]));
        // A second at 20 Hz of 100, with one sensor of two, numbered anew.
        let numbers: Vec<usize> = serde_json::from_value(played["seq"].clone()).unwrap();
        assert!(
            (19..=22).contains(&numbers.len()) && numbers.iter().copied().eq(0..numbers.len()),
            "{numbers:?}"
        );
        let first = &played["first"];
        assert_eq!((&first["t_s"], &first["dropped"]), (&json!(290), &json!(0)));
        assert_eq!(first["sensors"].as_array().unwrap().len(), 1);
    }
    // 1.2 s, four times as fast.
    assert!(seen["timed"]["ms"].as_f64().unwrap() > 250.0, "{seen}");
    assert_eq!(
        seen["why"],
        json!([null, "line 204 is no message", "line 204 is no message", "line 204 is no message"])
    );
}
