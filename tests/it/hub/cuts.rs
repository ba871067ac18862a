//! Links that are cut: a proxy lies between stage and hub, and what was missed is made up for.

use std::process::Command;
use std::sync::Arc;

use posed_mesh::zenoh::{Config, Session};
use serde_json::{Value, json};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;

use super::{client, events, free_port, hub, move_transmitter, stage, stages};
use crate::daemon::process::{Posed, frames, ok, until};

/// A TCP connection to somewhere that can be cut: then nothing passes and nobody is notified.
struct Proxy {
    port: u16,
    open: watch::Sender<bool>,
    /// Connections that pass bytes on.
    passing: watch::Sender<usize>,
}

impl Proxy {
    async fn to(port: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let own = listener.local_addr().unwrap().port();
        let (open, state) = watch::channel(true);
        let (passing, _) = watch::channel(0);
        let counted = passing.clone();
        tokio::spawn(async move {
            while let Ok((from, _)) = listener.accept().await {
                tokio::spawn(pass(from, port, state.clone(), counted.clone()));
            }
        });
        Self { port: own, open, passing }
    }

    /// Nothing passes any more when it returns: what is said from then on is not under way already.
    async fn cut(&self) {
        self.open.send_replace(false);
        self.passing.subscribe().wait_for(|passing| *passing == 0).await.unwrap();
    }
}

/// Passes bytes on while the proxy is open; what was open when it was cut stays silent until it is repaired, and then ends.
async fn pass(
    mut from: TcpStream,
    port: u16,
    mut open: watch::Receiver<bool>,
    passing: watch::Sender<usize>,
) {
    if *open.borrow_and_update() {
        let Ok(mut to) = TcpStream::connect(("127.0.0.1", port)).await else { return };
        let held = Arc::new((from.set_nodelay(true), to.set_nodelay(true)));
        passing.send_modify(|passing| *passing += 1);
        let ended = tokio::select! {
            _ = tokio::io::copy_bidirectional(&mut from, &mut to) => true,
            _ = open.wait_for(|open| !open) => false,
        };
        passing.send_modify(|passing| *passing -= 1);
        if ended {
            return;
        }
        let _ = open.wait_for(|open| *open).await;
        drop((held, to));
    } else {
        let _ = open.wait_for(|open| *open).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn no_event_is_lost_in_a_cut_and_poses_come_again() {
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let proxy = Proxy::to(port).await;
    let hub = hub(port, &[]);
    let stage = stage(folder.path(), proxy.port);
    let mut operator = stage.client().await;
    // Before the hub knows the stage: still true when it does.
    move_transmitter(&mut operator, 0.5).await;
    let mut all = client(hub.address, "/ws").await;
    let mut here = client(hub.address, "/two/ws").await;
    ok(&mut here, json!({"type": "subscribe", "topics": ["field", "faults", "sensors", "status"]})).await;
    let mut there = stage.subscriber(&["field", "faults"]).await;
    let event = until(&mut here, "what holds", |message| message["type"] == "field").await;
    let first = event["event_id"].as_u64().unwrap();

    proxy.cut().await;
    for n in 1..=5 {
        move_transmitter(&mut operator, f64::from(n)).await;
    }
    stages(&mut all, "the cut", |stage| stage["state"] == "gone").await;
    until(&mut here, "a word on the stage's own page", |message| {
        message["type"] == "status"
            && message["problems"].as_array().unwrap().iter().any(|problem| problem["code"] == "vanished")
    })
    .await;
    for n in 6..=8 {
        move_transmitter(&mut operator, f64::from(n)).await;
    }
    proxy.open.send_replace(true);
    let got = events(&mut here, first, 8).await;
    assert_eq!(got, events(&mut there, first, 8).await, "as at the stage");
    let last = first + got.len() as u64;
    assert_eq!(got, (first + 1..=last).collect::<Vec<_>>(), "each once and in order");
    frames(&mut here, 20).await;
    let back =
        stages(&mut all, "the fix", |stage| stage["state"] == "present" && stage["vanished"] == 1).await;
    assert_eq!(back["events_lost"], 0);
    // Who was away from the hub can ask it for what the stage said meanwhile.
    let mut later = client(hub.address, "/two/ws").await;
    let kept = ok(&mut later, json!({"type": "resume", "after": first})).await;
    // The stage may have had more to say since.
    assert!(kept["complete"] == true && kept["last_event_id"].as_u64() >= Some(last), "{kept}");
    assert_eq!(
        until(&mut later, "an event", |message| !message["event_id"].is_null()).await["event_id"],
        first + 1
    );
    assert_eq!(hub.end("INT").await.code(), Some(0));
}

/// A router between stages and hubs, set as the handbook says.
async fn router(port: u16) -> Session {
    let of = |region: &str| json!({"filters": [{"region_names": [region]}]});
    let mut config = Config::default();
    for (key, value) in [
        ("mode", "\"router\"".to_owned()),
        ("listen/endpoints", format!("[\"tcp/127.0.0.1:{port}\"]")),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("gateway", json!({"south": [of("posed-hub"), of("posed-stage")]}).to_string()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    posed_mesh::zenoh::open(config).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn behind_a_router_that_was_ended_in_order_a_stage_is_gone_and_returns_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let between = router(port).await;
    let to_router = format!("tcp/127.0.0.1:{port}");
    let args = ["hub", "--http", "127.0.0.1:0", "--connect", &to_router];
    let hub = Posed::spawn(Command::new(env!("CARGO_BIN_EXE_posed")).args(args));
    let _stage = stage(folder.path(), port);
    let mut all = client(hub.address, "/ws").await;
    let mut here = client(hub.address, "/two/ws").await;
    ok(&mut here, json!({"type": "subscribe", "topics": ["sensors"]})).await;
    frames(&mut here, 5).await;
    between.close().await.unwrap();
    stages(&mut all, "that nothing comes through", |stage| stage["state"] == "gone").await;
    let _again = router(port).await;
    stages(&mut all, "that it comes again", |stage| stage["state"] == "present").await;
    frames(&mut here, 20).await;
    assert_eq!(hub.end("INT").await.code(), Some(0));
}

/// All bytes of a message behind those that count what this one client was sent.
fn body(text: &str) -> &str {
    let (head, rest) = text.split_once(r#","dropped":"#).unwrap();
    assert!(head.starts_with(r#"{"type":""#) && head.contains(r#","seq":"#), "{head}");
    rest.split_once(',').unwrap().1
}

#[tokio::test(flavor = "multi_thread")]
async fn fused_elsewhere_a_stage_says_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let proxy = Proxy::to(port).await;
    let hub = hub(port, &["--fuse", "two"]);
    let stage = stage(folder.path(), proxy.port);
    let mut there = stage.client().await;
    let mut here = client(hub.address, "/two/ws").await;
    let subscribe = json!({"type": "subscribe", "topics": ["sensors", "field", "faults", "truth"], "drop": "queue",
        "fields": ["position_m", "orientation_wxyz", "measured", "covariance", "sigma_m", "velocity", "device"]});
    ok(&mut there, subscribe.clone()).await;
    ok(&mut here, subscribe).await;
    let key = |text: &str| {
        let message: Value = serde_json::from_str(text).unwrap();
        (message["type"].to_string(), message["t_s"].to_string())
    };
    let mut operator = stage.client().await;
    // A hub that begins late says nothing of what the stage said before: that is read off first.
    let begun_s = frames(&mut here, 20).await[0]["t_s"].as_f64();
    until(&mut there, "the hub's time", |message| {
        message["type"] == "sensors" && message["t_s"].as_f64() >= begun_s
    })
    .await;
    // Half a second of cut, which the log bridges.
    proxy.cut().await;
    move_transmitter(&mut operator, 0.25).await;
    frames(&mut there, 30).await;
    proxy.open.send_replace(true);
    move_transmitter(&mut operator, 0.75).await;
    let mut emitted = std::collections::BTreeMap::new();
    let (mut events, mut compared, mut read) = (0, 0, 0);
    while emitted.len() < 150 {
        let text = there.next_text().await;
        emitted.insert(key(&text), text);
    }
    while compared < 100 {
        let text = here.next_text().await;
        read += 1;
        assert!(read < 10_000, "the hub says {compared} of what the stage said");
        if let Some(expected) = emitted.remove(&key(&text)) {
            events += usize::from(text.starts_with(r#"{"type":"field""#));
            assert_eq!(body(&text), body(&expected), "byte for byte");
            compared += 1;
        }
    }
    assert!(events >= 1, "an event was among them");
    assert_eq!(hub.end("INT").await.code(), Some(0));
}
