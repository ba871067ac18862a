//! Foxglove viewers: what they are offered and sent, who is refused, and what a bad one does to the others.

use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use posed_protocol::{Problem, Status};
use posed_stage::output::Output;
use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::handshake::client::Request;

use super::harness::{self, PATIENCE, Running, WATCH, config, estimate, stage, start};

/// What a viewer is sent.
#[derive(Debug)]
enum Said {
    Text(Value),
    /// Subscription, UTC in ns, payload.
    Data(u32, u64, Value),
    Time(u64),
}

struct Viewer {
    client: harness::Client,
    channels: Vec<Value>,
    info: Value,
}

fn request(server: &Running, path: &str, protocols: &str) -> Request {
    let mut request = format!("ws://{}{path}", server.address).into_client_request().unwrap();
    request.headers_mut().insert("sec-websocket-protocol", protocols.parse().unwrap());
    request
}

impl Viewer {
    async fn open(server: &Running, path: &str, protocols: &str) -> Self {
        let client = server.connect(request(server, path, protocols)).await.unwrap();
        let mut viewer = Self { client, channels: Vec::new(), info: Value::Null };
        viewer.info = viewer.text("serverInfo").await;
        viewer.channels = viewer.text("advertise").await["channels"].as_array().unwrap().clone();
        viewer
    }

    async fn new(server: &Running) -> Self {
        Self::open(server, "/", "foxglove.sdk.v1").await
    }

    fn channel(&self, topic: &str) -> u64 {
        let channel = self.channels.iter().find(|channel| channel["topic"] == topic);
        channel.unwrap_or_else(|| panic!("{topic}"))["id"].as_u64().unwrap()
    }

    async fn subscribe(&mut self, topics: &[&str]) {
        for (id, topic) in topics.iter().enumerate() {
            let subscription = json!({"id": id, "channelId": self.channel(topic)});
            self.client.send(json!({"op": "subscribe", "subscriptions": [subscription]})).await;
        }
        // Refused after them: they have been seen.
        self.client.send(json!({"op": "dance"})).await;
        self.text("status").await;
    }

    async fn next(&mut self) -> Said {
        loop {
            match tokio::time::timeout(PATIENCE, self.client.socket.next()).await.expect("a message") {
                Some(Ok(Message::Text(text))) => return Said::Text(serde_json::from_str(&text).unwrap()),
                Some(Ok(Message::Binary(bytes))) => {
                    let number = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
                    if bytes[0] == 2 {
                        assert_eq!(bytes.len(), 9);
                        return Said::Time(number(1));
                    }
                    assert_eq!(bytes[0], 1);
                    let subscription = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
                    return Said::Data(
                        subscription,
                        number(5),
                        serde_json::from_slice(&bytes[13..]).unwrap(),
                    );
                }
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => {}
                other => panic!("expected a message, got {other:?}"),
            }
        }
    }

    /// The next text of a kind; messages before it are passed over.
    async fn text(&mut self, op: &str) -> Value {
        loop {
            if let Said::Text(text) = self.next().await
                && text["op"] == op
            {
                return text;
            }
        }
    }

    async fn data(&mut self) -> (u32, u64, Value) {
        loop {
            if let Said::Data(subscription, utc_ns, payload) = self.next().await {
                return (subscription, utc_ns, payload);
            }
        }
    }
}

async fn reported(server: &Running, viewer: &mut Viewer) -> (u32, u64, Value) {
    server.frame(7);
    viewer.data().await
}

#[tokio::test]
async fn both_names_of_the_protocol_are_served_and_no_other() {
    let server = Running::plain();
    for (path, offered, chosen) in [
        ("/", "foxglove.websocket.v1", "foxglove.websocket.v1"),
        ("/", "foxglove.websocket.v1, foxglove.sdk.v1", "foxglove.sdk.v1"),
        ("/ws", "foxglove.sdk.v1", "foxglove.sdk.v1"),
    ] {
        let viewer = Viewer::open(&server, path, offered).await;
        assert_eq!(viewer.client.protocol.as_deref(), Some(chosen));
        assert_eq!(viewer.info["capabilities"], json!([]));
        assert_eq!(viewer.info["name"], "posed: Stage A");
        assert!(viewer.info["sessionId"].is_string());
        let topics: Vec<_> =
            viewer.channels.iter().map(|channel| channel["topic"].as_str().unwrap()).collect();
        assert_eq!(topics[..3], ["/tf", "/sensors/left/pose", "/sensors/right/pose"]);
        assert!(topics.contains(&"/posed/sensors") && topics.contains(&"/log"), "{topics:?}");
        for channel in &viewer.channels {
            assert_eq!(
                (&channel["encoding"], &channel["schemaEncoding"]),
                (&json!("json"), &json!("jsonschema"))
            );
            let schema: Value = serde_json::from_str(channel["schema"].as_str().unwrap()).unwrap();
            assert_eq!(schema["type"], "object");
        }
    }
    let (status, sentence) = server.refusal(request(&server, "/", "posed.v1")).await;
    assert!(status == 400 && sentence.contains("/ws"), "{sentence}");
    let page = harness::get(server.address, "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n").await;
    assert!(page.starts_with("HTTP/1.1 200"), "a page is still a page: {page}");
    assert!(server.connect(request(&server, "/ws", "foxglove.sdk.v2, posed.v1")).await.is_ok());
}

#[tokio::test]
async fn tokens_and_origins_hold_here_too() {
    let text = format!("[[server.token]]\nsecret = \"{WATCH}\"\nrole = \"watch\"");
    let server = start(&stage(&text), config());
    assert_eq!(server.refusal(request(&server, "/", "foxglove.sdk.v1")).await.0, 401);
    let mut foreign = request(&server, &format!("/?token={WATCH}"), "foxglove.sdk.v1");
    foreign.headers_mut().insert("origin", "https://app.foxglove.dev".parse().unwrap());
    let (status, sentence) = server.refusal(foreign).await;
    assert!(status == 403 && sentence.contains("allowed_origins"), "{sentence}");
    Viewer::open(&server, &format!("/?token={WATCH}"), "foxglove.sdk.v1").await;
}

#[tokio::test]
async fn poses_are_those_of_our_own_websocket() {
    let server = Running::plain();
    let mut own = server.client().await;
    own.subscribe(&["sensors"]).await;
    let mut viewer = Viewer::new(&server).await;
    viewer.subscribe(&["/tf", "/sensors/left/pose", "/posed/sensors"]).await;
    for frame in 1..50 {
        server.frame(frame);
        let expected = own.next().await;
        let entry = &expected["sensors"][0];
        let [x, y, z] = [0, 1, 2].map(|at| entry["position_m"][at].clone());
        let [w, i, j, k] = [0, 1, 2, 3].map(|at| entry["orientation_wxyz"][at].clone());
        let (position, orientation) =
            (json!({"x": x, "y": y, "z": z}), json!({"x": i, "y": j, "z": k, "w": w}));
        let utc_ns =
            1_700_000_000_000_000_001 + (expected["t_s"].as_f64().unwrap() * 1e6).round() as u64 * 1000;
        let time = json!({"sec": utc_ns / 1_000_000_000, "nsec": utc_ns % 1_000_000_000});
        let mut seen = [false; 3];
        while seen != [true; 3] {
            let (subscription, at_ns, payload) = viewer.data().await;
            assert_eq!(at_ns, utc_ns);
            seen[subscription as usize] = true;
            match subscription {
                0 => {
                    let of_left = &payload["transforms"][1];
                    assert_eq!(of_left["child_frame_id"], "sensors/left");
                    assert_eq!((&of_left["translation"], &of_left["rotation"]), (&position, &orientation));
                    assert_eq!(of_left["timestamp"], time);
                }
                1 => assert_eq!(payload["pose"], json!({"position": position, "orientation": orientation})),
                _ => {
                    assert_eq!((&payload["t_s"], &payload["type"]), (&expected["t_s"], &json!("sensors")));
                    assert_eq!(payload["sensors"][0]["position_m"], entry["position_m"]);
                }
            }
        }
    }
}

#[tokio::test]
async fn requests_that_cannot_be_served_get_a_sentence_and_the_connection_stays() {
    let server = Running::plain();
    let mut viewer = Viewer::new(&server).await;
    let tf = viewer.channel("/tf");
    let subscribe = |id: u32, channel: u64| json!({"op": "subscribe", "subscriptions": [{"id": id, "channelId": channel}]});
    viewer.client.send(subscribe(5, tf)).await;
    let ask = |id: u32| json!({"op": "unsubscribe", "subscriptionIds": [id]});
    for (request, level, word) in [
        (subscribe(5, tf + 1), 1, "in use"),
        (subscribe(6, tf), 1, "already"),
        (subscribe(7, 9999), 1, "does not exist"),
        (ask(77), 1, "no subscription 77"),
        (json!({"op": "getParameters", "parameterNames": []}), 2, "not served"),
        (json!({"op": "advertise", "channels": []}), 2, "not served"),
        (json!({"op": "?"}), 2, "no request"),
        (json!(5), 2, "op"),
    ] {
        viewer.client.send(request).await;
        let status = viewer.text("status").await;
        assert_eq!(status["level"], level, "{status}");
        assert!(status["message"].as_str().unwrap().contains(word), "{status}");
    }
    let many: Vec<_> = (100..1500).map(|id| json!({"id": id, "channelId": id})).collect();
    viewer.client.send(json!({"op": "subscribe", "subscriptions": many})).await;
    assert!(viewer.text("status").await["message"].as_str().unwrap().contains("1399 others"));
    viewer.client.socket.send(Message::Binary(vec![1, 2, 3].into())).await.unwrap();
    assert_eq!(viewer.text("status").await["level"], 2);
    viewer.client.socket.send(Message::Text("{".into())).await.unwrap();
    assert_eq!(viewer.text("status").await["level"], 2);
    assert_eq!(reported(&server, &mut viewer).await.0, 5);
    viewer.client.send(ask(5)).await;
    viewer.client.send(json!({"op": "dance"})).await;
    viewer.text("status").await;
    server.frame(8);
    server.fault(90, 0, true);
    viewer.client.send(subscribe(1, viewer.channel("/log"))).await;
    assert_eq!(viewer.data().await.2["name"], "left", "the log that was missed, and no frame");
    viewer.client.send(json!({"op": "x".repeat(70_000)})).await;
    assert_eq!(viewer.client.closed().await.0, 1009);
}

#[tokio::test]
async fn problems_of_the_stage_stand_until_they_are_over() {
    let server = Running::plain();
    let status = |messages: &[&str]| {
        let problem = |message: &&str| Problem::new("port", *message);
        let problems = messages.iter().map(problem).collect();
        server.hub.publish_status(Status { problems, ..Status::default() });
    };
    let mut early = Viewer::new(&server).await;
    early.subscribe(&["/posed/status"]).await;
    status(&["the port is away"]);
    let reported = early.text("status").await;
    assert_eq!((&reported["level"], &reported["message"]), (&json!(1), &json!("the port is away")));
    let mut late = Viewer::new(&server).await;
    assert_eq!(late.text("status").await, reported);
    // The newest state is reported to who subscribes later.
    let id = late.channel("/posed/status");
    late.client.send(json!({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": id}]})).await;
    assert_eq!(late.data().await.2["problems"][0]["code"], "port");
    status(&[]);
    for viewer in [&mut early, &mut late] {
        assert_eq!(viewer.text("removeStatus").await["statusIds"], json!([reported["id"]]));
    }
}

#[tokio::test]
async fn a_stalled_viewer_delays_nobody_and_loses_no_event() {
    let server = Running::plain();
    let mut stalled = Viewer::new(&server).await;
    let all: Vec<String> =
        stalled.channels.iter().map(|channel| channel["topic"].as_str().unwrap().to_owned()).collect();
    stalled.subscribe(&all.iter().map(String::as_str).collect::<Vec<_>>()).await;
    let mut viewer = Viewer::new(&server).await;
    viewer.subscribe(&["/sensors/left/pose"]).await;
    for frame in 1..3000 {
        server.frame(frame);
        if frame % 500 == 0 {
            server.fault(frame as i64 * 10, 0, frame % 1000 == 0);
        }
        let (_, utc_ns, _) = tokio::time::timeout(Duration::from_secs(5), viewer.data()).await.unwrap();
        assert_eq!((utc_ns - 1) / 10_000_000 % 100_000_000, frame % 100_000_000);
    }
    let mut events = 0;
    while events < 5 {
        if let (_, _, payload) = stalled.data().await
            && payload["type"] == "faults"
        {
            events += 1;
            assert_eq!(payload["event_id"], events);
        }
    }
}

#[tokio::test]
async fn the_clock_of_a_viewer_follows_a_replay_and_back_again() {
    let mut config = config();
    config.replay = true;
    let server = start(&stage(""), config);
    let mut viewer = Viewer::new(&server).await;
    assert_eq!(viewer.info["capabilities"], json!(["time"]));
    viewer.subscribe(&["/tf"]).await;
    for frame in [5, 6] {
        server.hub.publish(&Output::Estimate(&estimate(frame)));
        let Said::Time(utc_ns) = viewer.next().await else { panic!("the time comes first") };
        assert_eq!(utc_ns, 1_700_000_000_000_000_001 + frame * 10_000_000);
        assert_eq!(viewer.data().await.1, utc_ns);
    }
    server.hub.rewind();
    server.frame(1);
    let Said::Time(utc_ns) = viewer.next().await else { panic!("the time comes first") };
    assert_eq!(utc_ns, 1_700_000_000_000_000_001 + 10_000_000);
}
