//! A hub and its stages: real processes, zenoh over loopback, and a proxy between them that can be cut.

use std::net::SocketAddr;
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

use serde_json::{Value, json};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio_tungstenite::connect_async;

use crate::chromium::{self, Browser};
use crate::daemon::process::{PATIENCE, Posed, frames, ok, refused, succeed, two_devices, until};
use crate::server::harness::{Client, get};

/// A port that was free a moment ago.
fn free_port() -> u16 {
    std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn hub(zenoh_port: u16, more: &[&str]) -> Posed {
    let listen = format!("tcp/127.0.0.1:{zenoh_port}");
    let args = ["hub", "--http", "127.0.0.1:0", "--listen", &listen];
    Posed::spawn(Command::new(env!("CARGO_BIN_EXE_posed")).args(args).args(more))
}

/// A simulated stage that connects there.
fn stage(folder: &std::path::Path, zenoh_port: u16) -> Posed {
    let more = format!("[zenoh]\nconnect = [\"tcp/127.0.0.1:{zenoh_port}\"]\n");
    let file = two_devices(folder, &more);
    Posed::start(["demo".as_ref(), "--stage".as_ref(), file.as_os_str()])
}

/// A client of one of the hub's websockets, greeted.
async fn client(address: SocketAddr, path: &str) -> Client {
    let connected = async {
        loop {
            // The stage has its websocket here once it has joined.
            if let Ok((socket, _)) = connect_async(format!("ws://{address}{path}")).await {
                return Client { socket, protocol: None };
            }
            tokio::task::yield_now().await;
        }
    };
    let mut client = tokio::time::timeout(PATIENCE, connected).await.expect("the stage joins");
    assert_eq!(client.next().await["type"], "hello");
    client
}

/// The next word about all stages in which this one fits.
async fn stages(client: &mut Client, what: &str, fits: impl Fn(&Value) -> bool) -> Value {
    let message = until(client, what, |message| {
        message["type"] == "stages" && message["stages"].as_array().unwrap().iter().any(&fits)
    })
    .await;
    message["stages"].as_array().unwrap().iter().find(|stage| fits(stage)).unwrap().clone()
}

/// A program on the network that is no part of posed.
async fn zenoh_client(port: u16) -> posed_mesh::zenoh::Session {
    let mut config = posed_mesh::zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"client\"".to_owned()),
        ("connect/endpoints", format!("[\"tcp/127.0.0.1:{port}\"]")),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    posed_mesh::zenoh::open(config).await.unwrap()
}

/// An event: somebody states where the transmitter stands.
async fn move_transmitter(client: &mut Client, x_m: f64) {
    let model = json!({"kind": "transmitter", "position_m": [x_m, 0, 0], "orientation_wxyz": [1, 0, 0, 0]});
    ok(client, json!({"type": "model.load", "model": model})).await;
}

/// Numbers of all events after one, up to so many that came of a moved transmitter.
async fn events(client: &mut Client, after: u64, moves: usize) -> Vec<u64> {
    let (mut numbers, mut moved) = (Vec::new(), 0);
    while moved < moves {
        let later = |message: &Value| message["event_id"].as_u64().is_some_and(|id| id > after);
        let event = until(client, "an event", later).await;
        numbers.push(event["event_id"].as_u64().unwrap());
        moved += usize::from(event["type"] == "field");
    }
    numbers
}

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
async fn a_hub_says_what_its_stages_say_and_what_became_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let stage = stage(folder.path(), port);
    // The stage waits for its hub.
    let hub = hub(port, &[]);
    let mut all = client(hub.address, "/ws").await;
    // The quickest of the round trips so far bounds it.
    let related =
        |stage: &Value| stage["clock"]["uncertainty_s"].as_f64().is_some_and(|bound_s| bound_s < 0.25);
    let seen = stages(&mut all, "the stage and its clock", related).await;
    assert_eq!(
        (&seen["id"], &seen["name"], &seen["state"]),
        (&json!("two"), &json!("Two"), &json!("present"))
    );
    // Two clocks of one computer: their difference is that of the epochs.
    assert!(seen["clock"]["offset_s"].as_f64().unwrap() < 0.0, "{seen}");

    // The same messages in both places, field by field.
    let subscribe = json!({"type": "subscribe", "topics": ["sensors", "field"], "drop": "queue",
        "fields": ["position_m", "orientation_wxyz", "measured", "covariance", "sigma_m", "device"]});
    let mut there = stage.client().await;
    let mut here = client(hub.address, "/two/ws").await;
    ok(&mut there, subscribe.clone()).await;
    ok(&mut here, subscribe.clone()).await;
    let mut subscribe_two = subscribe;
    subscribe_two["stages"] = json!(["two"]);
    ok(&mut all, subscribe_two).await;
    let plain = |mut message: Value| {
        let map = message.as_object_mut().unwrap();
        map.retain(|key, _| !["seq", "dropped", "stage"].contains(&key.as_str()));
        message
    };
    let mut frames_there = frames(&mut there, 80).await.into_iter().map(plain).collect::<Vec<_>>();
    frames_there.retain(|frame| frame["type"] == "sensors");
    for client in [&mut here, &mut all] {
        let got = frames(client, 40).await;
        let common = got.into_iter().map(plain).filter(|frame| {
            let at = frames_there.iter().find(|other| other["t_s"] == frame["t_s"]);
            at.is_some_and(|other| {
                assert_eq!(other, frame);
                true
            })
        });
        assert!(common.count() > 10, "they overlap");
    }
    // The one websocket for all says whose each message is.
    let frame = until(&mut all, "a frame", |message| message["type"] == "sensors").await;
    assert_eq!(frame["stage"], "two");

    // A hub only shows.
    let (code, _) = refused(&mut here, json!({"type": "record.start"})).await;
    assert_eq!(code, "hub");
    let (code, _) = refused(&mut all, json!({"type": "resume", "after": 0})).await;
    assert_eq!(code, "bad_request");
    let page = get(hub.address, &format!("GET /two/ HTTP/1.1\r\nHost: {}\r\n\r\n", hub.address)).await;
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("<title>posed</title>"), "{page}");
    for (path, status) in
        [("/", 200), ("/two", 307), ("/two/metrics", 200), ("/metrics", 200), ("/nobody/", 404)]
    {
        let answer = get(hub.address, &format!("GET {path} HTTP/1.1\r\nHost: {}\r\n\r\n", hub.address)).await;
        assert!(answer.starts_with(&format!("HTTP/1.1 {status}")), "{path}: {answer}");
    }
    let foreign = get(hub.address, "GET /two/ HTTP/1.1\r\nHost: rebound.example\r\n\r\n").await;
    assert!(foreign.starts_with("HTTP/1.1 421"), "{foreign}");

    // A stage that ends is said to have gone, and one that is started anew is followed with its new epoch.
    let epoch = seen["epoch_utc"].clone();
    assert_eq!(stage.end("INT").await.code(), Some(0));
    stages(&mut all, "the stage is gone", |stage| stage["state"] == "gone").await;
    let stage = self::stage(folder.path(), port);
    let back = stages(&mut all, "the stage is back", |stage| {
        stage["state"] == "present" && stage["epoch_utc"] != epoch
    })
    .await;
    assert_eq!(back["vanished"], 1);
    until(&mut all, "frames of the new run, still subscribed", |message| message["type"] == "sensors").await;
    assert_eq!(hub.end("TERM").await.code(), Some(0));
    assert_eq!(stage.end("INT").await.code(), Some(0));
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

#[tokio::test(flavor = "multi_thread")]
async fn programs_on_the_network_get_messages_status_and_recordings() {
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let token = "a-token-of-this-stage";
    let more = format!(
        "[zenoh]\nlisten = [\"tcp/127.0.0.1:{port}\"]\nkey = \"hall/left\"\n[recording]\nfolder = \"kept\"\n\
         [[server.token]]\nsecret = \"{token}\"\nrole = \"operate\"\n"
    );
    let file = two_devices(folder.path(), &more);
    let stage = Posed::start(["demo".as_ref(), "--stage".as_ref(), file.as_os_str()]);
    let mut operator = stage.client_with(&format!("?token={token}")).await;
    operator.subscribe(&["sensors"]).await;
    ok(&mut operator, json!({"type": "record.start", "name": "one"})).await;
    frames(&mut operator, 50).await;
    ok(&mut operator, json!({"type": "record.stop"})).await;

    let session = zenoh_client(port).await;
    let subscriber = session.declare_subscriber("hall/left/topics/sensors").await.unwrap();
    let sample = tokio::time::timeout(PATIENCE, subscriber.recv_async()).await.unwrap().unwrap();
    let message: Value = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
    assert_eq!((&message["type"], message["sensors"].as_array().unwrap().len()), (&json!("sensors"), 2));

    let ask = async |selector: &str| {
        let replies = session.get(selector).timeout(Duration::from_secs(10)).await.unwrap();
        let reply = replies.recv_async().await.unwrap();
        reply
            .into_result()
            .map(|sample| sample.payload().to_bytes().into_owned())
            .map_err(|error| String::from_utf8(error.payload().to_bytes().into_owned()).unwrap())
    };
    let status: Value = serde_json::from_slice(&ask("hall/left/status").await.unwrap()).unwrap();
    assert_eq!((&status["type"], status["devices"].as_array().unwrap().len()), (&json!("status"), 2));
    let list: Value = serde_json::from_slice(&ask("hall/left/recordings").await.unwrap()).unwrap();
    let kept = std::fs::read(folder.path().join("kept/one.mcap")).unwrap();
    assert_eq!(list, json!([{"name": "one.mcap", "bytes": kept.len()}]));
    let mut got = Vec::new();
    loop {
        let piece =
            ask(&format!("hall/left/recordings/one.mcap?offset={};bytes=50000", got.len())).await.unwrap();
        if piece.is_empty() {
            break;
        }
        got.extend(piece);
    }
    assert!(got == kept, "byte for byte");
    for selector in ["status", "ask/join", "ask/log", "ask/begin"] {
        got.extend(ask(&format!("hall/left/{selector}")).await.unwrap());
    }
    let part = token.as_bytes();
    assert!(
        !got.windows(part.len()).any(|window| window == part),
        "nothing that is handed out holds the token"
    );
    assert!(ask("hall/left/recordings/two.mcap").await.unwrap_err().contains("there is no recording"));
    assert!(ask("hall/left/recordings/one.mcap?offset=x").await.unwrap_err().contains("offset"));
    session.close().await.unwrap();
    assert_eq!(stage.end("INT").await.code(), Some(0));
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
async fn the_hubs_page_leads_to_the_stages_page() {
    if !chromium::is_wanted() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let stage = stage(folder.path(), port);
    let north = folder.path().join("north.toml");
    let more = format!("[zenoh]\nconnect = [\"tcp/127.0.0.1:{port}\"]\n");
    std::fs::write(&north, format!("name = \"North\"\n{more}")).unwrap();
    let north = Posed::start(["run".as_ref(), north.as_os_str()]);
    let hub = hub(port, &[]);
    let mut operator = stage.client().await;
    ok(&mut operator, json!({"type": "record.start", "name": "of two"})).await;
    operator.subscribe(&["sensors"]).await;
    frames(&mut operator, 20).await;
    ok(&mut operator, json!({"type": "record.stop"})).await;
    let mut browser = Browser::open(&format!("http://{}/", hub.address)).await;
    let cell = |stage: &str, column: usize| {
        format!("document.querySelector('#stages a[href=\"{stage}/\"]')?.closest('tr').cells[{column}]")
    };
    for stage in ["two", "north"] {
        browser.until(&format!("{}?.className === 'good'", cell(stage, 1))).await;
        browser.until(&format!("{}.textContent.startsWith('there for')", cell(stage, 1))).await;
    }
    browser.until(&format!("{}.textContent.includes('±')", cell("two", 4))).await;
    browser.until(&format!("{}.offsetHeight < 60", cell("two", 0))).await;
    // One that has ended stays in the table, and is said to have vanished.
    assert_eq!(north.end("INT").await.code(), Some(0));
    browser.until(&format!("{}.className === 'bad'", cell("north", 1))).await;
    browser.until(&format!("{}.textContent.startsWith('vanished')", cell("north", 1))).await;
    // A list of two needs no more.
    let size = serde_json::json!({"width": 1000, "height": 240, "deviceScaleFactor": 1, "mobile": false});
    browser.call("Emulation.setDeviceMetricsOverride", size).await;
    browser.picture("hub").await;
    browser.value("document.querySelector('#stages a[href=\"two/\"]').click()").await;
    browser.until("document.getElementById('link')?.textContent === 'live'").await;
    browser.until("document.getElementById('stage').textContent === 'Two'").await;
    // What was recorded there is fetched here, to the byte.
    browser.click("tab-takes").await;
    let link = "document.querySelector('#takes-remote a[download=\"of two.mcap\"]')";
    browser.until(&format!("{link} !== null")).await;
    let fetch = format!(
        "fetch({link}.href).then((answer) => answer.arrayBuffer()).then(({{ byteLength }}) => (window.fetched = byteLength))"
    );
    browser.value(&fetch).await;
    let bytes = folder.path().join("recordings/of two.mcap").metadata().unwrap().len();
    browser.until(&format!("window.fetched === {bytes}")).await;
    assert!(hub.get("/two/recordings/none.mcap").await.starts_with("HTTP/1.1 404"));
    assert_eq!(browser.complaints, Vec::<String>::new());
    drop(browser);
    assert_eq!(stage.end("INT").await.code(), Some(0));
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

/// Frames that a stage has written for hubs.
struct Written(tokio::sync::mpsc::UnboundedReceiver<usize>);

impl Written {
    /// Those since it was last asked, by their bytes.
    fn new_ones(&mut self) -> Vec<usize> {
        std::iter::from_fn(|| self.0.try_recv().ok()).collect()
    }
}

/// Seconds of stage time between the first and the last of these.
fn lasted_s(frames: &[Value]) -> f64 {
    let t_s = |frame: Option<&Value>| frame.unwrap()["t_s"].as_f64().unwrap();
    t_s(frames.last()) - t_s(frames.first())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stage_is_followed_only_while_somebody_looks_and_only_as_much_as_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let (port, direct) = (free_port(), free_port());
    let hub = hub(port, &[]);
    let more =
        format!("[zenoh]\nconnect = [\"tcp/127.0.0.1:{port}\"]\nlisten = [\"tcp/127.0.0.1:{direct}\"]\n");
    let file = two_devices(folder.path(), &more);
    let stage = Posed::start(["demo".as_ref(), "--stage".as_ref(), file.as_os_str()]);
    // A program that hears all that is written, and asks for nonsense.
    let stranger = zenoh_client(direct).await;
    let (written_in, written) = tokio::sync::mpsc::unbounded_channel();
    let mut written = Written(written);
    let _frames = stranger
        .declare_subscriber("posed/two/feed/frames")
        .callback(move |sample| _ = written_in.send(sample.payload().len()))
        .await
        .unwrap();
    let wishes =
        stranger.liveliness().declare_subscriber("posed/two/posed-wish/**").history(true).await.unwrap();
    let mut nonsense = Vec::new();
    for wish in
        [r#"{"topics":{"sensors":0}}"#, r#"{"topics":{"sensors":-5}}"#, "{{{{", "60", &"9".repeat(20_000)]
    {
        let token = format!("posed/two/posed-wish/stranger/{wish}");
        nonsense.push(stranger.liveliness().declare_token(token).await.unwrap());
    }
    let mut all = client(hub.address, "/ws").await;
    let frames_hz = |stage: &Value| stage["frames_hz"].as_f64().unwrap();
    stages(&mut all, "that it is well", |stage| frames_hz(stage) > 50.0 && stage["streaming"] == 2).await;
    assert_eq!(written.new_ones(), [0; 0], "nobody looks");

    // Little is asked for, and no more is written. Everything that lasts is there at once.
    let mut little = client(hub.address, "/two/ws").await;
    ok(&mut little, json!({"type": "subscribe", "topics": ["status"]})).await;
    assert_eq!(little.next().await["type"], "status");
    let sensor = name_of_one(&stage).await;
    ok(
        &mut little,
        json!({"type": "subscribe", "topics": ["sensors"], "fields": ["position_m"], "sensors": [sensor],
            "max_rate_hz": 20, "drop": "queue"}),
    )
    .await;
    let got = frames(&mut little, 20).await;
    let bytes = written.new_ones();
    assert!((19..=30).contains(&bytes.len()), "{} frames are written for 20", bytes.len());
    assert!(bytes.iter().all(|bytes| *bytes < 150), "{bytes:?}");
    let rate_hz = 19.0 / lasted_s(&got);
    assert!((15.0..=20.5).contains(&rate_hz), "{rate_hz} Hz");
    assert_eq!(got[0]["sensors"].as_array().unwrap().len(), 1);
    // Another one wants more, and both get what they have asked for.
    let mut much = client(hub.address, "/two/ws").await;
    ok(
        &mut much,
        json!({"type": "subscribe", "topics": ["sensors"], "fields": ["covariance"], "drop": "queue"}),
    )
    .await;
    let got = frames(&mut much, 50).await;
    assert!(49.0 / lasted_s(&got) > 60.0, "as many as there are");
    let whole = |frame: &Value| {
        frame["sensors"].as_array().unwrap().iter().all(|of| of["covariance"][0].as_f64() > Some(0.0))
    };
    assert!(got.iter().all(whole), "none is shown before it is there: {}", got[0]);
    let got = frames(&mut little, 20).await;
    assert!(got.iter().all(|frame| frame["sensors"][0]["covariance"].is_null()));
    assert!(written.new_ones().iter().any(|bytes| *bytes > 400));

    // All leave: a while later it ends, and who comes then gets nothing old.
    let newest_s = got.last().unwrap()["t_s"].as_f64().unwrap();
    drop((little, much));
    let is_hubs = |token: &str| !token.contains("/stranger/");
    let mut present = std::collections::BTreeSet::new();
    let until_none = async {
        loop {
            let sample = wishes.recv_async().await.unwrap();
            let token = sample.key_expr().as_str().to_owned();
            match sample.kind() {
                posed_mesh::zenoh::sample::SampleKind::Put => _ = present.insert(token),
                posed_mesh::zenoh::sample::SampleKind::Delete => _ = present.remove(&token),
            }
            if sample.kind() == posed_mesh::zenoh::sample::SampleKind::Delete
                && !present.iter().any(|token| is_hubs(token))
            {
                return;
            }
        }
    };
    tokio::time::timeout(PATIENCE, until_none).await.expect("nothing is wished for any more");
    stages(&mut all, "a second later", |_| true).await;
    written.new_ones();
    stages(&mut all, "still well", |stage| frames_hz(stage) > 50.0).await;
    assert_eq!(written.new_ones(), [0; 0], "nobody looks any more");
    // The websocket for all stages asks as well.
    ok(&mut all, json!({"type": "subscribe", "topics": ["sensors"], "stages": ["two"]})).await;
    let first = until(&mut all, "a frame", |message| message["type"] == "sensors").await;
    assert!(first["t_s"].as_f64().unwrap() > newest_s + 1.0, "none that is old");
    // A hub that is killed wants nothing, and its next one what is asked for there.
    hub.signal("KILL");
    drop(hub);
    let hub = self::hub(port, &[]);
    let mut again = client(hub.address, "/two/ws").await;
    ok(&mut again, json!({"type": "subscribe", "topics": ["truth", "sensors"]})).await;
    until(&mut again, "truth", |message| message["type"] == "truth").await;
    frames(&mut again, 5).await;
    assert_eq!(hub.end("INT").await.code(), Some(0));
    assert_eq!(stage.end("INT").await.code(), Some(0));
}

/// Name of a sensor of a stage.
async fn name_of_one(stage: &Posed) -> Value {
    let mut client = stage.subscriber(&["sensors"]).await;
    frames(&mut client, 1).await[0]["sensors"][0]["name"].clone()
}
