//! Who else is on the network: twins, whoever lacks certificate or password, and floods in a stage's name.

use std::process::Command;

use serde_json::{Value, json};

use super::{client, events, free_port, hub, move_transmitter, stage, stages, zenoh_client};
use crate::daemon::process::{Posed, frames, ok, succeed, until};
use crate::server::harness::Client;

/// The first status in which the daemon sees another one under its key, or sees none.
async fn twin(client: &mut Client, expected: bool) {
    let is_twin =
        |problem: &Value| problem["message"].as_str().unwrap().contains("another daemon runs under");
    until(client, if expected { "a twin" } else { "no twin" }, |message| {
        let problems = message["problems"].as_array();
        problems.is_some_and(|problems| problems.iter().any(is_twin) == expected)
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn two_daemons_with_one_key_notice_each_other() {
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let at_hub = free_port();
    let direct = free_port();
    let start = |folder: &tempfile::TempDir, ends: String| {
        let file = folder.path().join("stage.toml");
        std::fs::write(&file, format!("name = \"Two\"\n[zenoh]\n{ends}\n")).unwrap();
        Posed::start(["run".as_ref(), file.as_os_str()])
    };
    // Through a hub, which neither listens to ...
    let hub = hub(at_hub, &[]);
    let connect = |port: u16| format!("connect = [\"tcp/127.0.0.1:{port}\"]");
    let listen = |port: u16| format!("listen = [\"tcp/127.0.0.1:{port}\"]");
    let first = start(&folders[0], format!("{}\n{}", connect(at_hub), listen(direct)));
    let mut reported = first.subscriber(&["status"]).await;
    twin(&mut reported, false).await;
    let second = start(&folders[1], connect(at_hub));
    twin(&mut reported, true).await;
    twin(&mut second.subscriber(&["status"]).await, true).await;
    assert_eq!(second.end("INT").await.code(), Some(0));
    twin(&mut reported, false).await;
    // ... and face to face.
    assert_eq!(hub.end("INT").await.code(), Some(0));
    let third = start(&folders[1], connect(direct));
    twin(&mut reported, true).await;
    twin(&mut third.subscriber(&["status"]).await, true).await;
}

/// Certificates of an authority of their own for these computers.
fn certificates(folder: &std::path::Path, computers: &[&str]) {
    let mut command = vec!["hub".to_owned(), "--certificates".to_owned(), folder.display().to_string()];
    command.extend(computers.iter().flat_map(|computer| ["--for".to_owned(), (*computer).to_owned()]));
    succeed(command);
}

/// Links that are encrypted and want names and passwords: who has all of it is let in, and everybody else says what is wrong.
#[tokio::test(flavor = "multi_thread")]
async fn only_who_has_certificate_and_password_is_let_in_and_the_others_say_what_they_lack() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    certificates(&path("ours"), &["127.0.0.1", "stage"]);
    certificates(&path("theirs"), &["stage"]);
    std::fs::write(path("users"), "stage:a-long-enough-password\n").unwrap();
    let (port, plain) = (free_port(), free_port());
    let tls = |of: &str, name: &str| {
        format!(
            "tls = {{authority = \"{of}/authority.pem\", certificate = \"{of}/{name}.pem\", key = \"{of}/{name}-key.pem\"}}"
        )
    };
    let (password, wrong) = ("password = \"a-long-enough-password\"", "password = \"another-long-password\"");
    let user = "user = \"stage\"";
    let write = |name: &str, zenoh: &[&str]| {
        let file = path(&format!("{name}.toml"));
        std::fs::write(&file, format!("name = \"{name}\"\n[zenoh]\n{}\n", zenoh.join("\n"))).unwrap();
        file
    };
    let listen = format!("listen = [\"tls/127.0.0.1:{port}\", \"tcp/127.0.0.1:{plain}\"]");
    let hub_toml = write("Hall", &[&listen, "users = \"users\"", &tls("ours", "127.0.0.1")]);
    let args = ["hub".as_ref(), hub_toml.as_os_str(), "--http".as_ref(), "127.0.0.1:0".as_ref()];
    let hub = Posed::spawn(Command::new(env!("CARGO_BIN_EXE_posed")).args(args));
    let start = |name: &str, address: String, more: &[&str]| {
        let connect = format!("connect = [\"{address}\"]");
        Posed::start(["run".as_ref(), write(name, &[&[&*connect], more].concat()).as_os_str()])
    };
    let (encrypted, unencrypted) = (format!("tls/127.0.0.1:{port}"), format!("tcp/127.0.0.1:{plain}"));
    let (ours, theirs) = (tls("ours", "stage"), tls("theirs", "stage"));
    let refused = [
        ("zenoh_password", start("password", encrypted.clone(), &[user, wrong, &ours])),
        ("zenoh_password", start("plain-password", unencrypted.clone(), &[user, wrong])),
        ("zenoh_refused", start("nobody", unencrypted.clone(), &[])),
        ("zenoh_certificate", start("stranger", encrypted.clone(), &[user, password, &theirs])),
        ("zenoh_speaks_tls", start("plain", format!("tcp/127.0.0.1:{port}"), &[user, password])),
        ("zenoh_speaks_plain", start("tls", format!("tls/127.0.0.1:{plain}"), &[user, password, &ours])),
        ("zenoh_unreachable", start("alone", format!("tcp/127.0.0.1:{}", free_port()), &[])),
    ];
    let _right = start("right", encrypted, &[user, password, &ours]);
    for (code, stage) in &refused {
        let status = until(&mut stage.subscriber(&["status"]).await, code, |message| {
            message["problems"]
                .as_array()
                .is_some_and(|problems| problems.iter().any(|problem| problem["code"] == *code))
        })
        .await;
        let text = status.to_string();
        assert!(!text.contains("long-enough") && !text.contains("another-long"), "{text}");
    }
    let mut all = client(hub.address, "/ws").await;
    stages(&mut all, "the one that has everything", |stage| {
        stage["id"] == "right" && stage["state"] == "present"
    })
    .await;
    // After some more attempts of the others.
    for _ in 0..2 {
        let reported = until(&mut all, "stages", |message| message["type"] == "stages").await;
        assert_eq!(reported["stages"].as_array().unwrap().len(), 1, "{reported}");
    }
    assert_eq!(hub.end("INT").await.code(), Some(0));
}

#[tokio::test(flavor = "multi_thread")]
async fn stages_that_are_declared_without_end_keep_no_real_one_out() {
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let hub = hub(port, &[]);
    let mut board = client(hub.address, "/ws").await;
    let stranger = zenoh_client(port).await;
    let mut tokens = Vec::new();
    for n in 0..300 {
        let token = format!("posed/fake-{n:03}/posed-stage");
        tokens.push(stranger.liveliness().declare_token(token).await.unwrap());
    }
    stages(&mut board, "the strangers", |stage| stage["id"] == "fake-255").await;
    let real = stage(folder.path(), port);
    let message = until(&mut board, "the real one", |message| {
        let stages = message["stages"].as_array();
        stages.is_some_and(|stages| stages.iter().any(|stage| stage["state"] == "present"))
    })
    .await;
    assert_eq!(message["stages"].as_array().unwrap().len(), 256);
    assert_eq!(real.end("INT").await.code(), Some(0));
    assert_eq!(hub.end("INT").await.code(), Some(0));
}

#[tokio::test(flavor = "multi_thread")]
async fn messages_without_end_in_a_stages_name_cost_neither_an_event_nor_the_poses() {
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let hub = hub(port, &[]);
    let stage = stage(folder.path(), port);
    let mut operator = stage.client().await;
    let mut here = client(hub.address, "/two/ws").await;
    ok(&mut here, json!({"type": "subscribe", "topics": ["field", "faults", "sensors"]})).await;
    let mut there = stage.subscriber(&["field", "faults"]).await;
    let stranger = zenoh_client(port).await;
    let flood = async {
        for _ in 0..40 * 1024 {
            stranger.put("posed/two/feed/states", vec![7_u8; 256]).await.unwrap();
        }
    };
    let moves = async {
        for n in 1..=20 {
            move_transmitter(&mut operator, f64::from(n)).await;
        }
    };
    tokio::join!(flood, moves);
    let got = events(&mut here, 0, 20).await;
    assert_eq!(got, events(&mut there, 0, 20).await, "as at the stage");
    frames(&mut here, 20).await;
    assert_eq!(stage.end("INT").await.code(), Some(0));
    assert_eq!(hub.end("INT").await.code(), Some(0));
}
