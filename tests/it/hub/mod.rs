//! A hub and its stages: real processes, zenoh over loopback.

mod cuts;
mod demand;
mod strangers;

use std::net::SocketAddr;
use std::process::Command;
use std::time::Duration;

use serde_json::{Value, json};
use tokio_tungstenite::connect_async;

use crate::chromium::{self, Browser};
use crate::daemon::process::{PATIENCE, Posed, frames, ok, refused, two_devices, until};
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
