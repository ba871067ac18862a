//! What programs of ROS 2 see of a demo, by readers that others wrote: its topics, and messages that say what our own do.
//!
//! Runs where `POSED_TEST_READERS` names the folder into which `tests/readers/install` has put them. No ROS 2 runs: `tests/readers/ros2.py` is the router, and listens as
//! rmw_zenoh's sessions do.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use serde_json::{Value, json};

use crate::daemon::process::{Posed, ok, until};
use crate::server::harness::Client;

/// The node, `/tf`, the joints, and one of each of the demo's thirteen sensors.
const TOKENS: usize = 16;

/// The demo with `[ros2]`, in a folder of its own.
fn demo(folder: &Path, ros2: &str) -> Posed {
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
    for file in ["demo-moves.safetensors", "demo-field.json", "demo-faults.json"] {
        std::fs::copy(config.join(file), folder.join(file)).unwrap();
    }
    let text = std::fs::read_to_string(config.join("demo.toml")).unwrap();
    let stage = folder.join("stage.toml");
    std::fs::write(&stage, format!("{text}\n[ros2]\n{ros2}")).unwrap();
    Posed::demo_that_keeps(&stage)
}

/// What listens; killed when dropped.
struct Reader(Child);

impl Drop for Reader {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The code and the sentence of the one problem of ROS 2, in a status.
fn problem(status: &Value) -> Option<(String, String)> {
    let problems = status["problems"].as_array()?;
    let problem = problems.iter().find(|problem| problem["code"].as_str().unwrap().starts_with("ros2"))?;
    Some((problem["code"].as_str()?.to_owned(), problem["message"].as_str()?.to_owned()))
}

/// Time of a message of ROS 2, s since the stage's epoch.
fn stamp_s(message: &Value, epoch_utc_ns: i64) -> f64 {
    let stamp = &message["header"]["stamp"];
    let utc_ns = 1_000_000_000 * stamp["sec"].as_i64().unwrap() + stamp["nanosec"].as_i64().unwrap();
    (utc_ns - epoch_utc_ns) as f64 * 1e-9
}

/// Our own message of that type and time.
fn at<'a>(ours: &'a [Value], kind: &str, t_s: f64) -> &'a Value {
    let same =
        |message: &&Value| message["type"] == kind && (message["t_s"].as_f64().unwrap() - t_s).abs() < 2e-6;
    ours.iter().find(same).unwrap_or_else(|| panic!("no {kind} of {t_s} s"))
}

fn numbers(of: &Value, keys: &[&str]) -> Vec<f64> {
    keys.iter().map(|key| of[*key].as_f64().unwrap()).collect()
}

fn is_near(a: &[f64], b: &Value, tolerance: f64) -> bool {
    let b = b.as_array().unwrap();
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b.as_f64().unwrap()).abs() < tolerance)
}

#[tokio::test]
async fn programs_of_ros_2_find_topics_poses_and_joints_as_they_are_without_a_bridge() {
    let Some(readers) = std::env::var_os("POSED_TEST_READERS") else {
        println!("skipped: set POSED_TEST_READERS to the folder that tests/readers/install has filled");
        return;
    };
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let folder = tempfile::tempdir().unwrap();
    let ros2 = format!("connect = [\"tcp/127.0.0.1:{port}\"]\nnamespace = \"hall\"\n");
    let posed = demo(folder.path(), &ros2);
    let mut client: Client = posed.client().await;
    ok(&mut client, json!({"type": "subscribe", "topics": ["status", "sensors", "body"], "drop": "queue"}))
        .await;
    let has_none = |message: &Value| problem(message).is_some();
    let (code, message) = problem(&until(&mut client, "no router yet", has_none).await).unwrap();
    assert!(code == "ros2_router" && message.contains(&format!("tcp/127.0.0.1:{port}")), "{message}");

    let is_good = |sensors: &Value, name: &str| {
        let mut sensors = sensors["sensors"].as_array().into_iter().flatten();
        sensors.any(|sensor| sensor["name"] == name && sensor["state"] == "ok")
    };
    let booted = |message: &Value| is_good(message, "wand") && is_good(message, "imu_pelvis");
    until(&mut client, "what the reader is to see", booted).await;

    let reader = Command::new(Path::new(&readers).join("ros2/bin/python"))
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/readers/ros2.py"))
        .args([port.to_string(), TOKENS.to_string()])
        .stdout(Stdio::piped())
        .spawn();
    let mut reader = Reader(reader.unwrap());
    let mut said = BufReader::new(reader.0.stdout.take().unwrap()).lines();
    let listening = tokio::task::spawn_blocking(move || (said.next(), said));
    let mut ours = Vec::new();
    let (line, mut said) = {
        tokio::pin!(listening);
        loop {
            tokio::select! {
                heard = &mut listening => break heard.unwrap(),
                message = client.next() => ours.push(message),
            }
        }
    };
    let topics: Value = serde_json::from_str(&line.expect("the reader's messages").unwrap()).unwrap();
    // What the reader has may be on its way to us.
    let last_s = ours.iter().filter_map(|message| message["t_s"].as_f64()).fold(0.0, f64::max);
    while !matches!(ours.last(), Some(last) if last["type"] == "sensors" && last["t_s"].as_f64().unwrap() > last_s + 0.5)
    {
        ours.push(client.next().await);
    }
    assert_eq!(ours.iter().rev().find(|message| message["type"] == "status").and_then(problem), None);

    let epoch: jiff::Timestamp = client_epoch(&posed).await.parse().unwrap();
    let epoch_utc_ns = i64::try_from(epoch.as_nanosecond()).unwrap();
    let messages =
        |topic: &str| topics[topic]["messages"].as_array().unwrap_or_else(|| panic!("no {topic}: {topics}"));
    for pose in messages("/hall/wand/pose") {
        assert_eq!(pose["header"]["frame_id"], "map");
        let sensors = at(&ours, "sensors", stamp_s(pose, epoch_utc_ns))["sensors"].as_array().unwrap();
        let wand = sensors.iter().find(|sensor| sensor["name"] == "wand").unwrap();
        let (position, turn) = (&pose["pose"]["position"], &pose["pose"]["orientation"]);
        assert!(is_near(&numbers(position, &["x", "y", "z"]), &wand["position_m"], 2e-5), "{pose} {wand}");
        let turn = numbers(turn, &["w", "x", "y", "z"]);
        assert!(is_near(&turn, &wand["orientation_wxyz"], 2e-6), "{pose} {wand}");
    }
    for joints in messages("/hall/joint_states") {
        let angles = &at(&ours, "body", stamp_s(joints, epoch_utc_ns))["joints"];
        let names: Vec<&str> =
            joints["name"].as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect();
        let elbow = names.iter().position(|name| *name == "elbow_r_flexion").unwrap();
        let angle_deg = joints["position"][elbow].as_f64().unwrap().to_degrees();
        let joint = angles.as_array().unwrap().iter().find(|joint| joint["name"] == "elbow_r").unwrap();
        assert!(
            (angle_deg - joint["angles_deg"]["flexion"].as_f64().unwrap()).abs() < 2e-3,
            "{angle_deg} {joint}"
        );
    }
    for imu in messages("/hall/imu_pelvis/imu/data") {
        assert_eq!(imu["header"]["frame_id"], "hall/imu_pelvis");
        let force = numbers(&imu["linear_acceleration"], &["x", "y", "z"]);
        let force_m_s2 = force.iter().map(|x| x * x).sum::<f64>().sqrt();
        // The hips of somebody who trains are thrown about a little.
        assert!((force_m_s2 - 9.81).abs() < 4.0, "{imu}");
        // On a machine that is busy, a record may be late.
        let known = imu["orientation_covariance"][0].as_f64().unwrap();
        assert!(known > 0.0 || (known == -1.0 && imu["orientation"]["w"] == 1.0), "{imu}");
    }
    let frames: Vec<&Value> =
        messages("/tf").iter().flat_map(|message| message["transforms"].as_array().unwrap()).collect();
    assert!(frames.iter().all(|frame| frame["header"]["frame_id"] == "map"));
    assert!(frames.iter().any(|frame| {
        let child = frame["child_frame_id"].as_str().unwrap();
        child == "hall/wand" || child == "hall/person_pelvis"
    }));

    assert_eq!(posed.end("TERM").await.code(), Some(0));
    let gone = tokio::task::spawn_blocking(move || (said.next(), reader.0.wait())).await.unwrap();
    assert_eq!(gone.0.unwrap().unwrap(), "gone", "a stage that ends takes itself off the graph");
    assert!(gone.1.unwrap().success());
}

async fn client_epoch(posed: &Posed) -> String {
    let (socket, _) = tokio_tungstenite::connect_async(format!("ws://{}/ws", posed.address)).await.unwrap();
    let mut client = Client { socket, protocol: None };
    client.next().await["epoch_utc"].as_str().unwrap().to_owned()
}
