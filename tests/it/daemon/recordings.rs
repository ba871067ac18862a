//! Recordings made by a running daemon: from the start, in the middle, and torn.

use std::path::Path;

use posed_recording::Info;
use serde_json::{Value, json};

use super::process::{Posed, all_ok, frames, ok, record_start, replays, two_devices, until};
use crate::cli::posed;

#[tokio::test]
async fn a_recording_from_the_start_replays_byte_for_byte() {
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "");
    let recording = folder.path().join("take.mcap");
    let posed =
        Posed::start(["demo", "--stage", stage.to_str().unwrap(), "--record", recording.to_str().unwrap()]);
    let mut client = posed.subscriber(&["sensors"]).await;
    until(&mut client, "all sensors", all_ok).await;
    frames(&mut client, 100).await;
    assert_eq!(posed.end("INT").await.code(), Some(0));
    replays(&recording);
    shown(&recording);
}

/// Viewers find the poses of our own messages in schemas that they know.
fn shown(recording: &Path) {
    let bytes = std::fs::read(recording).unwrap();
    let (mut ours, mut theirs) = (Vec::new(), Vec::new());
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let json = || serde_json::from_slice::<Value>(&message.data).unwrap();
        let schema = message.channel.schema.as_ref().map_or("", |schema| schema.name.as_str());
        match (message.channel.topic.as_str(), schema) {
            ("/posed/sensors", "posed.sensors") => {
                let sensors = json()["sensors"].as_array().unwrap().clone();
                let good = sensors.into_iter().filter(|sensor| sensor["state"] == "ok");
                ours.extend(good.map(|sensor| (message.log_time, sensor["position_m"][2].clone())));
            }
            ("/tf", "foxglove.FrameTransforms") => {
                for frame in json()["transforms"].as_array().unwrap() {
                    let name = frame["child_frame_id"].as_str().unwrap();
                    if name.starts_with("sensors/") {
                        theirs.push((message.log_time, frame["translation"]["z"].clone()));
                    }
                }
            }
            _ => {}
        }
    }
    assert!(ours.len() >= 100);
    assert_eq!(ours, theirs);
}

#[tokio::test]
async fn a_recording_begun_mid_run_with_a_model_swapped_in_replays_and_a_killed_one_is_mended() {
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "");
    let mut daemon = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut client = daemon.subscriber(&["sensors"]).await;
    until(&mut client, "all sensors", all_ok).await;
    ok(&mut client, record_start("middle")).await;
    frames(&mut client, 100).await;
    let model = json!({"kind": "transmitter", "position_m": [0.0, 0.0, 2.0], "orientation_wxyz": [1.0, 0.0, 0.0, 0.0]});
    ok(&mut client, json!({"type": "model.load", "model": model})).await;
    frames(&mut client, 100).await;
    ok(&mut client, json!({"type": "record.stop"})).await;
    // The answer means that the file is whole, and the next one may begin at once.
    let middle = folder.path().join("recordings/middle.mcap");
    let info = Info::read(&middle, |_| ()).unwrap();
    assert!(info.complete && info.mid_run && info.topics["/input/model"] == 1, "{info:?}");
    ok(&mut client, record_start("torn")).await;
    let last = frames(&mut client, 300).await.pop().unwrap()["t_s"].as_f64().unwrap();
    daemon.child.kill().unwrap();
    daemon.child.wait().unwrap();
    replays(&middle);
    healthy_again(&stage).await;
    let torn = folder.path().join("recordings/torn.mcap");
    let info = Info::read(&torn, |_| ()).unwrap();
    assert!(info.problem.as_deref().unwrap().contains("breaks off"), "{info:?}");
    let end_s = info.begun_s + info.duration_s;
    assert!(end_s > last - 1.0, "the recording ends at {end_s} s, the client saw {last} s");
    repaired(&torn);
}

/// Started again where one was killed in the middle of a recording: it tracks, records, and has nothing to complain of.
async fn healthy_again(stage: &Path) {
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut client = posed.subscriber(&["sensors", "status"]).await;
    until(&mut client, "all sensors", all_ok).await;
    ok(&mut client, record_start("after")).await;
    let status = until(&mut client, "a status", |message| !message["recording"].is_null()).await;
    assert_eq!(status["problems"], json!([]));
    frames(&mut client, 20).await;
    assert_eq!(posed.end("INT").await.code(), Some(0));
    assert!(Info::read(&stage.with_file_name("recordings/after.mcap"), |_| ()).unwrap().complete);
}

#[tokio::test]
async fn a_recording_is_a_job_and_one_that_is_cancelled_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "");
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut client = posed.subscriber(&["sensors", "jobs"]).await;
    let started = ok(&mut client, record_start("take")).await;
    assert_eq!(started["name"], "take.mcap");
    frames(&mut client, 20).await;
    ok(&mut client, json!({"type": "job.cancel", "job": started["job"]})).await;
    let jobs = until(&mut client, "its end", |message| message["jobs"][0]["state"] == "cancelled").await;
    assert_eq!(jobs["jobs"][0]["job"], started["job"]);
    assert_eq!(jobs["jobs"][0]["message"], "take.mcap is complete");
    assert!(Info::read(&folder.path().join("recordings/take.mcap"), |_| ()).unwrap().complete);
    ok(&mut client, record_start("next")).await;
    assert_eq!(posed.end("INT").await.code(), Some(0));
    assert!(Info::read(&folder.path().join("recordings/next.mcap"), |_| ()).unwrap().complete);
}

/// A torn recording replays, is completed by the repair, and replays the same.
fn repaired(torn: &Path) {
    let output = torn.with_extension("jsonl");
    let replay = || {
        let replayed = posed(["replay".as_ref(), torn.as_os_str(), "-o".as_ref(), output.as_os_str()]);
        assert!(replayed.status.success());
        std::fs::read(&output).unwrap()
    };
    let before = replay();
    let info = |more: &[&str]| posed([&["info", torn.to_str().unwrap()], more].concat());
    assert_eq!(info(&[]).status.code(), Some(1));
    assert_eq!(info(&["--repair"]).status.code(), Some(0));
    assert_eq!(info(&[]).status.code(), Some(0));
    assert!(!before.is_empty() && replay() == before);
    replays(torn);
}
