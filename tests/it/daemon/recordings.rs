//! Recordings made by a running daemon: from the start, in the middle, and torn.

use std::collections::BTreeMap;
use std::path::Path;

use posed_recording::{Header, Info, Item, Reader, Scribe, Take};
use posed_stage::RecordingContent;
use posed_stage::input::Input;
use serde_json::{Value, json};

use super::process::{
    Posed, all_ok, frames, ok, record_start, refused, replays, replays_alike, succeed, two_devices, until,
};
use crate::cli::posed;

/// In a stage file: messages beside the log, to hold the replay against.
pub(crate) const FULL: &str = "[recording]\ncontent = \"full\"\n";

#[tokio::test]
async fn a_recording_from_the_start_replays_byte_for_byte() {
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), FULL);
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
    let stage = two_devices(folder.path(), FULL);
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

#[tokio::test(flavor = "multi_thread")]
async fn a_mark_is_heard_at_once_and_again_in_every_replay() {
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), FULL);
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut client = posed.client().await;
    let mut listener = posed.subscriber(&["marks", "sensors", "status"]).await;
    // Who is to record knows whether there is room.
    let has_room = |message: &Value| message["free_bytes"].as_u64().is_some_and(|free| free > 0);
    until(&mut listener, "free space", has_room).await;
    let frame = frames(&mut listener, 1).await.remove(0);
    ok(&mut client, record_start("take")).await;
    ok(&mut client, json!({"type": "mark", "label": "pain here"})).await;
    let mark = until(&mut listener, "the mark", |message| message["type"] == "marks").await;
    assert_eq!(mark["label"], "pain here");
    assert!(mark["t_valid_s"].as_f64().unwrap() >= frame["t_s"].as_f64().unwrap(), "{mark} {frame}");
    let (_, sentence) = refused(&mut client, json!({"type": "mark", "label": "x".repeat(201)})).await;
    assert!(sentence.contains("at most 200 bytes"), "{sentence}");
    ok(&mut client, json!({"type": "mark"})).await;
    let is_bare = |message: &Value| message["type"] == "marks" && message["label"] == "";
    until(&mut listener, "a mark without a label", is_bare).await;
    ok(&mut client, json!({"type": "record.stop"})).await;
    assert_eq!(posed.end("INT").await.code(), Some(0));
    let take = folder.path().join("recordings/take.mcap");
    replays_alike(&take);
    let out = folder.path().join("take.jsonl");
    succeed(["replay".as_ref(), take.as_os_str(), "-o".as_ref(), out.as_os_str()]);
    let said = std::fs::read_to_string(&out).unwrap();
    assert_eq!(said.matches(r#""type":"marks""#).count(), 2, "{said}");
    assert!(said.contains("pain here"));
}

/// `POSED_KILLS=100` is the number of the criteria.
#[tokio::test]
async fn killed_at_any_moment_a_recording_lacks_a_second_at_most_and_has_no_hole() {
    let kills = std::env::var("POSED_KILLS").ok().and_then(|text| text.parse().ok()).unwrap_or(2_usize);
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "");
    let mut lost = Vec::new();
    for kill in 0..kills {
        let mut daemon = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
        let mut client = daemon.subscriber(&["sensors"]).await;
        until(&mut client, "a frame", |message| message["type"] == "sensors").await;
        let name = format!("torn-{kill}");
        let begun = ok(&mut client, record_start(&name)).await;
        // Anywhere in the first two and a half seconds, which hold five flushes.
        let seen = frames(&mut client, 1 + kill * 97 % 250).await;
        daemon.child.kill().unwrap();
        daemon.child.wait().unwrap();
        let torn = folder.path().join("recordings").join(begun["name"].as_str().unwrap());
        succeed(["info".as_ref(), torn.as_os_str(), "--repair".as_ref()]);
        let info = Info::read(&torn, |_| ()).unwrap();
        assert!(info.complete, "kill {kill}: {info:?}");
        let last_s = seen.last().unwrap()["t_s"].as_f64().unwrap();
        let end_s = info.begun_s + info.duration_s;
        lost.push(last_s - end_s);
        assert!(end_s > last_s - 1.0, "kill {kill}: it ends at {end_s} s, the client saw {last_s} s");
        // What the client saw follows from the log, frame by frame and number by number.
        let again = folder.path().join("again.jsonl");
        succeed(["replay".as_ref(), torn.as_os_str(), "-o".as_ref(), again.as_os_str()]);
        let again = std::fs::read_to_string(again).unwrap();
        let again: Vec<Value> = again.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        let shown =
            |message: &Value| (message["t_s"].as_f64().unwrap(), message["sensors"][0]["position_m"].clone());
        let mut again: Vec<_> =
            again.iter().filter(|message| message["type"] == "sensors").map(shown).collect();
        let mut seen: Vec<_> = seen.iter().map(shown).collect();
        // What both have in time.
        again.retain(|(t_s, _)| *t_s >= seen[0].0);
        seen.retain(|(t_s, _)| again.last().is_some_and(|(end_s, _)| t_s <= end_s));
        assert_eq!(again, seen, "kill {kill}");
    }
    lost.sort_by(f64::total_cmp);
    println!("{kills} kills: median {:.2} s lost, worst {:.2} s", lost[kills / 2], lost[kills - 1]);
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

/// A full recording of the demo, its log alone, and the full one that is made of that: the same in every export, and to viewers.
#[tokio::test]
async fn the_demo_s_log_alone_gives_everything_that_was_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    posed_rig::copy_demo(folder.path());
    let text = std::fs::read_to_string(path("demo.toml")).unwrap() + FULL;
    std::fs::write(path("demo.toml"), text).unwrap();
    let daemon = Posed::start([
        "demo".as_ref(),
        "--stage".as_ref(),
        path("demo.toml").as_os_str(),
        "--record".as_ref(),
        path("full.mcap").as_os_str(),
    ]);
    let mut client = daemon.subscriber(&["body"]).await;
    let trackers = |message: &Value| message["position_source"] == "trackers";
    until(&mut client, "a body with a place", trackers).await;
    for _ in 0..150 {
        until(&mut client, "a body", |message| message["type"] == "body").await;
    }
    assert_eq!(daemon.end("INT").await.code(), Some(0));
    let device_bytes = log_alone(&path("full.mcap"), &path("log.mcap"), true);
    log_alone(&path("full.mcap"), &path("bare.mcap"), false);
    let size = |name: &str| std::fs::metadata(path(name)).unwrap().len();
    let (bare, columns) = (size("bare.mcap"), size("log.mcap") - size("bare.mcap"));
    // What devices send hardly compresses; the network of segments stands in front.
    assert!(bare < device_bytes * 3 / 2 + 300_000, "{bare} for {device_bytes}");
    // Every sensor and segment has numbers a hundred times a second, and each byte counts.
    assert!(columns < device_bytes, "{columns} for {device_bytes}");
    assert!(size("full.mcap") > 3 * size("log.mcap"), "{} {}", size("full.mcap"), size("log.mcap"));

    let export = |from: &str, to: &str, name: &str| {
        let (from, to_path) = (path(from), path(name));
        let done = posed([
            "export".as_ref(),
            from.as_os_str(),
            "--to".as_ref(),
            to.as_ref(),
            "-o".as_ref(),
            to_path.as_os_str(),
        ]);
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        std::fs::read(to_path).unwrap()
    };
    for to in ["jsonl", "csv", "bvh"] {
        assert!(export("full.mcap", to, "a") == export("log.mcap", to, "b"), "{to}");
    }
    let (live, made) = (std::fs::read(path("full.mcap")).unwrap(), export("log.mcap", "mcap", "made.mcap"));
    let mut made = messages(&made);
    for (topic, live) in messages(&live) {
        assert!(made.remove(&topic) == Some(live), "{topic}");
    }
    assert!(made.is_empty(), "{:?}", made.keys());
    viewed(&path("log.mcap"));

    // Who did not ask for columns has none, until they are asked for.
    let columns = |file: &[u8]| messages(file).remove("/columns");
    assert!(columns(&std::fs::read(path("bare.mcap")).unwrap()).is_none());
    let live = columns(&live);
    assert!(live.is_some() && columns(&export("bare.mcap", "columns", "asked.mcap")) == live);
}

/// Writes the log of a recording as one that holds no more, or no more than its columns beside it; the number of bytes of its devices.
fn log_alone(full: &Path, lean: &Path, columns: bool) -> u64 {
    let mut reader = Reader::open(full).unwrap();
    let mut header = Header { content: RecordingContent::Log, ..reader.header().clone() };
    if !columns {
        assert!(header.stage_toml.ends_with(FULL));
        header.stage_toml += "columns = false\n";
    }
    let mut scribe = Scribe::new(std::fs::File::create(lean).unwrap(), header).unwrap();
    let mut device_bytes = 0;
    for item in reader.by_ref() {
        match item.unwrap() {
            Item::Entry(entry) => {
                if let Input::Bytes { bytes, .. } = &entry.input {
                    device_bytes += bytes.len() as u64;
                }
                scribe.entry(&entry).unwrap();
            }
            Item::Transmitted { device, t, bytes } => scribe.transmitted(device, t, &bytes).unwrap(),
            Item::Message(_) => {}
        }
    }
    scribe.finish(reader.end_reason().unwrap()).unwrap();
    device_bytes
}

/// Times and data of a file's messages, by topic.
fn messages(file: &[u8]) -> BTreeMap<String, Vec<(u64, Vec<u8>)>> {
    let mut messages = BTreeMap::<String, Vec<_>>::new();
    for message in mcap::MessageStream::new(file).unwrap() {
        let message = message.unwrap();
        let of_topic = messages.entry(message.channel.topic.clone()).or_default();
        of_topic.push((message.log_time, message.data.into_owned()));
    }
    messages
}

/// A viewer opens what holds no more than the log, and sees the sensors and the body move.
fn viewed(lean: &Path) {
    let messages = messages(&std::fs::read(lean).unwrap());
    let topics: Vec<&str> = messages.keys().map(String::as_str).collect();
    assert_eq!(topics, ["/columns", "/input/log", "/log", "/scene/body", "/scene/sensors", "/tf"]);
    let bodies = &messages["/scene/body"];
    let seconds = (bodies.last().unwrap().0 - bodies[0].0) as f64 * 1e-9;
    assert!((4.0..6.0).contains(&(bodies.len() as f64 / seconds)), "{} in {seconds} s", bodies.len());
    let last: Value = serde_json::from_slice(&messages["/tf"].last().unwrap().1).unwrap();
    assert!(last["transforms"].as_array().unwrap().len() > 5, "{last}");
}

/// As the daemon writes it where nobody asks for more.
#[tokio::test]
async fn by_default_a_recording_holds_its_log_and_replays_to_what_clients_saw() {
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "");
    let daemon = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut client = daemon.subscriber(&["sensors"]).await;
    until(&mut client, "all sensors", all_ok).await;
    ok(&mut client, record_start("take")).await;
    let seen = frames(&mut client, 200).await;
    ok(&mut client, json!({"type": "record.stop"})).await;
    assert_eq!(daemon.end("INT").await.code(), Some(0));
    let take = folder.path().join("recordings/take.mcap");
    let info = Info::read(&take, |_| ()).unwrap();
    assert!(info.complete && info.mid_run && info.content == RecordingContent::Log, "{info:?}");
    assert!(info.topics["/input/one/bytes"] > 100 && !info.topics.contains_key("/posed/sensors"), "{info:?}");
    let replayed: Vec<Value> = Take::open(&take)
        .unwrap()
        .filter_map(|item| match item.unwrap() {
            Item::Message(message) if &*message.topic == "sensors" => {
                Some(serde_json::from_slice(&message.json).unwrap())
            }
            _ => None,
        })
        .collect();
    let of = |message: &Value| (message["t_s"].clone(), message["sensors"][0]["position_m"].clone());
    let replayed: Vec<_> = replayed.iter().map(of).collect();
    let same = seen.iter().filter(|message| replayed.contains(&of(message))).count();
    assert!(same > 150, "{same} of {} frames", seen.len());
}
