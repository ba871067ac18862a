//! `posed replay` to the websocket and to ports, and captures turned into recordings.

use std::fs;
use std::path::{Path, PathBuf};

use posed_recording::Info;
use serde_json::{Value, json};

use super::process::{Posed, ok, refused, replays_alike, succeed, until};
use crate::cli::posed;

/// A capture of one stand-alone unit, `records` long, 10 ms apart, as a recording.
fn recording(folder: &Path, name: &str, records: usize) -> PathBuf {
    let mut log = String::from("1000000000000.000 : (INFO) 1. command[1] ]\n");
    for n in 0..records {
        let t_ms = 10 * n;
        // Position 0.1 m along x and a bit more each time, no rotation: words of 14 bits, low seven bits first.
        let x = (0.1 + 1e-4 * n as f64) / (36.0 * 0.0254) * 32768.0;
        let words = [x as i16, 0, 0, 32767, 0, 0, 0];
        let mut bytes: Vec<u8> = words
            .iter()
            .flat_map(|word| [((*word as u16) >> 2 & 0x7F) as u8, ((*word as u16) >> 9) as u8])
            .collect();
        bytes[0] |= 0x80;
        let text: String = bytes.iter().map(|byte| format!("\\x{byte:02X}")).collect();
        log.push_str(&format!(
            "{}.{:03} : (INFO) {}. command[1] B\n{0}.{1:03} : (INFO) {2}. receive[14] {text}\n",
            1_000_000_000_000_u64 + t_ms as u64 / 1000,
            t_ms % 1000,
            n + 2
        ));
    }
    let capture = folder.join("capture.txt");
    fs::write(&capture, log).unwrap();
    let path = folder.join(name);
    succeed([
        "decode".as_ref(),
        "flock-of-birds".as_ref(),
        capture.as_os_str(),
        "-o".as_ref(),
        path.as_os_str(),
    ]);
    path
}

#[test]
fn a_capture_becomes_a_recording_that_replays() {
    let folder = tempfile::tempdir().unwrap();
    let path = recording(folder.path(), "capture.mcap", 300);
    let info = Info::read(&path, |_| ()).unwrap();
    assert!(info.complete && info.sensors == ["bird-0"], "{info:?}");
    assert_eq!((info.devices[0].bytes_in, info.devices[0].bytes_out), (300 * 14, 301));
    assert_eq!(info.topics["/input/flock/bytes"], 300);
    assert!((info.duration_s - 2.99).abs() < 0.2, "{info:?}");
    assert!(replays_alike(&path) > 200);
    let csv = folder.path().join("poses.csv");
    succeed([
        "export".as_ref(),
        path.as_os_str(),
        "--to".as_ref(),
        "csv".as_ref(),
        "-o".as_ref(),
        csv.as_os_str(),
    ]);
    let text = fs::read_to_string(&csv).unwrap();
    let good = text.lines().filter(|line| line.ends_with(",ok")).count();
    assert!(good > 200, "{good} good poses in\n{}", text.lines().take(20).collect::<Vec<_>>().join("\n"));
}

/// Sessions with real units: a tenth of a second each, too short for poses.
#[test]
fn real_captures_become_recordings_that_say_when_no_pose_follows() {
    let out = tempfile::tempdir().unwrap();
    for name in ["flockofbirds_stream_03_21_2006.txt", "flockofbirds_stream_06_06_2006.txt"] {
        let entry = posed_rig::recording("flock-of-birds", name);
        let path = out.path().join("session.mcap");
        let arguments = [
            "decode".as_ref(),
            "flock-of-birds".as_ref(),
            entry.as_os_str(),
            "-o".as_ref(),
            path.as_os_str(),
        ];
        let decoded = posed(arguments);
        assert!(decoded.status.success() && String::from_utf8_lossy(&decoded.stderr).contains("too short"));
        let info = Info::read(&path, |_| ()).unwrap();
        assert!(
            info.complete && info.devices[0].bytes_in > 100 && info.devices[0].bytes_out > 10,
            "{info:?}"
        );
        let replayed = out.path().join("out.jsonl");
        succeed(["replay".as_ref(), path.as_os_str(), "-o".as_ref(), replayed.as_os_str()]);
        let replayed = fs::read_to_string(replayed).unwrap();
        assert!(!replayed.contains(r#""type":"sensors""#), "it replays now: hold it against `replays_alike`");
    }
}

#[tokio::test]
async fn a_replay_is_steered_over_the_websocket() {
    let folder = tempfile::tempdir().unwrap();
    let path = recording(folder.path(), "a.mcap", 1500);
    recording(folder.path(), "b.mcap", 400);
    fs::write(folder.path().join("broken.mcap"), "nothing").unwrap();
    let posed = Posed::start(["replay", path.to_str().unwrap()]);
    let mut client = posed.subscriber(&["sensors", "status", "jobs"]).await;
    let status = until(&mut client, "status", |message| message["replay"].is_object()).await;
    assert_eq!((&status["replay"]["name"], &status["replay"]["speed"]), (&"a.mcap".into(), &1.0.into()));
    let listed = ok(&mut client, json!({"type": "replay.list"})).await;
    assert_eq!(listed["recordings"], json!(["a.mcap", "b.mcap", "broken.mcap"]));

    let pose_in = |from: f64, to: f64| {
        move |message: &serde_json::Value| {
            message["type"] == "sensors" && message["t_s"].as_f64().is_some_and(|t| t >= from && t < to)
        }
    };
    let seek = ok(&mut client, json!({"type": "replay.seek", "t_s": 10.0})).await;
    until(&mut client, "the job's end", |message| message["jobs"][0]["state"] == "done").await;
    let (code, sentence) = refused(&mut client, json!({"type": "job.cancel", "job": seek["job"]})).await;
    assert!(code == "no_such_job" && sentence.contains("ended already"), "{sentence}");
    until(&mut client, "poses from 10 s on", pose_in(9.9, 15.1)).await;
    ok(&mut client, json!({"type": "replay.seek", "t_s": 2.0})).await;
    until(&mut client, "poses from 2 s on", pose_in(1.9, 9.0)).await;
    ok(&mut client, json!({"type": "replay.speed", "speed": 0})).await;
    let paused = until(&mut client, "a pause", |message| message["replay"]["speed"] == 0.0).await;
    let again = until(&mut client, "a status", |message| message["replay"].is_object()).await;
    assert_eq!(paused["replay"]["t_s"], again["replay"]["t_s"]);
    ok(&mut client, json!({"type": "replay.seek", "t_s": 12.0})).await;
    until(&mut client, "the pose sought, in a pause", pose_in(11.9, 12.0)).await;
    ok(&mut client, json!({"type": "replay.speed", "speed": "max"})).await;
    until(&mut client, "the end", |message| message["replay"]["ended"].is_string()).await;
    ok(&mut client, json!({"type": "replay.speed", "speed": 1})).await;
    ok(&mut client, json!({"type": "replay.open", "name": "b.mcap"})).await;
    until(&mut client, "the other one", |message| message["replay"]["name"] == "b.mcap").await;
    until(&mut client, "its poses", pose_in(0.0, 4.1)).await;

    // Two runs side by side: channels of a whole recording at once.
    let columns = ok(&mut client, json!({"type": "replay.track", "name": "a.mcap"})).await["columns"].take();
    let x = columns[0].as_str().unwrap().to_owned();
    let track =
        ok(&mut client, json!({"type": "replay.track", "name": "a.mcap", "columns": [x, "no such"]})).await;
    let (t_s, values) = (track["t_s"].as_array().unwrap(), track["values"].as_array().unwrap());
    assert!(t_s.len() > 1000 && t_s.len() == values.len() && t_s.len() <= 2000, "{}", t_s.len());
    assert!(t_s.last().unwrap().as_f64().unwrap() > 13.0);
    assert!(values.iter().all(|row| row[1].is_null()) && values[500][0].is_f64());

    for (request, code, words) in [
        (json!({"type": "replay.track", "name": "../a.mcap"}), "not_found", "replay.list"),
        (json!({"type": "replay.track", "name": "broken.mcap"}), "failed", "no recording of posed"),
        (
            json!({"type": "replay.track", "name": "a.mcap", "columns": vec!["x"; 7]}),
            "bad_request",
            "6 at most",
        ),
        (json!({"type": "replay.open", "name": "c.mcap"}), "not_found", "replay.list"),
        (json!({"type": "replay.open", "name": "../a.mcap"}), "not_found", "replay.list"),
        (json!({"type": "replay.open", "name": "broken.mcap"}), "failed", "no recording of posed"),
        (json!({"type": "replay.speed", "speed": -1}), "bad_request", "0 or more"),
        (json!({"type": "record.start"}), "replay", "live stage"),
    ] {
        let (got, sentence) = refused(&mut client, request.clone()).await;
        assert!(got == code && sentence.contains(words), "{request}: {got} {sentence}");
    }
    assert_eq!(posed.end("INT").await.code(), Some(0));
}

/// Sought from a place near by, or back, the same is shown as when everything before is passed through.
#[tokio::test]
async fn a_jump_shows_what_a_whole_replay_shows() {
    let folder = tempfile::tempdir().unwrap();
    let path = recording(folder.path(), "a.mcap", 6000);
    let whole = folder.path().join("whole.jsonl");
    succeed(["replay".as_ref(), path.as_os_str(), "-o".as_ref(), whole.as_os_str()]);
    let whole: Vec<Value> = fs::read_to_string(whole)
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .filter(|message: &Value| message["type"] == "sensors")
        .collect();
    let posed = Posed::start(["replay", path.to_str().unwrap(), "--speed", "0.001"]);
    let mut client = posed.subscriber(&["sensors", "status", "jobs"]).await;
    until(&mut client, "all of it passed through", |message| {
        message["replay"].is_object() && message["replay"]["passed_s"] == message["replay"]["end_s"]
    })
    .await;
    for t_s in [55.0, 20.005, 40.3, 40.4, 1.3, 59.9] {
        ok(&mut client, json!({"type": "replay.seek", "t_s": t_s})).await;
        // Of the last tenth of a second a client gets what it can take, the newest first of all.
        let near = |message: &Value| message["t_s"].as_f64().is_some_and(|t| t >= t_s - 0.1 && t < t_s);
        let fits = |message: &Value| message["type"] == "sensors" && near(message);
        let shown = until(&mut client, "the pose sought", fits).await;
        let expected = whole.iter().find(|message| message["t_s"] == shown["t_s"]).unwrap();
        let (shown, expected) = (&shown["sensors"][0], &expected["sensors"][0]);
        assert!(shown.as_object().unwrap().len() > 4);
        for (field, value) in shown.as_object().unwrap() {
            assert_eq!(*value, expected[field], "{field} at {t_s} s");
        }
    }
}

#[tokio::test]
async fn a_live_daemon_says_how_to_replay() {
    let folder = tempfile::tempdir().unwrap();
    let stage = folder.path().join("empty.toml");
    fs::write(&stage, "name = \"Empty\"\n").unwrap();
    let posed = Posed::start(["run", stage.to_str().unwrap()]);
    let mut client = posed.client().await;
    assert_eq!(ok(&mut client, json!({"type": "replay.list"})).await, json!({"recordings": []}));
    for request in [
        json!({"type": "replay.open", "name": "a.mcap"}),
        json!({"type": "replay.seek", "t_s": 1.0}),
        json!({"type": "replay.speed", "speed": 1}),
    ] {
        let (code, sentence) = refused(&mut client, request).await;
        assert!(code == "live" && sentence.contains("posed replay FILE"), "{sentence}");
    }
    let (_, sentence) = refused(&mut client, json!({"type": "record.stop"})).await;
    assert!(sentence.contains("nothing is being recorded"));
}

/// The recorded bytes on a port, read by another daemon that only listens.
#[tokio::test]
async fn recorded_bytes_on_a_port_feed_another_daemon() {
    let folder = tempfile::tempdir().unwrap();
    let path = recording(folder.path(), "a.mcap", 6000);
    let mut ports = Ports::of(&path);
    let stage = folder.path().join("listen.toml");
    fs::write(
        &stage,
        format!(
            "name = \"Listen\"\n[[device]]\nname = \"flock\"\ndriver = \"flock-of-birds\"\nport = \"{}\"\nmode = \"listen\"\n\
             [[sensor]]\nname = \"a\"\ndevice = \"flock\"\naddress = 0\n",
            ports.first
        ),
    )
    .unwrap();
    let posed = Posed::start(["run", stage.to_str().unwrap()]);
    let mut client = posed.subscriber(&["sensors"]).await;
    until(&mut client, "a good pose", super::process::all_ok).await;
    assert_eq!(posed.end("INT").await.code(), Some(0));
    ports.child.kill().unwrap();
    ports.child.wait().unwrap();
}

/// A running `posed replay --pty`.
struct Ports {
    child: std::process::Child,
    first: String,
}

impl Ports {
    fn of(recording: &Path) -> Self {
        use std::io::{BufRead, BufReader};
        let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_posed"))
            .args(["replay", recording.to_str().unwrap(), "--pty", "--json"])
            .stdout(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let answer: serde_json::Value = serde_json::from_str(&line).unwrap();
        Self { child, first: answer["devices"][0]["port"].as_str().unwrap().to_owned() }
    }
}
