//! Greeting, subscriptions, events, calls.

use futures_util::SinkExt;
use posed_protocol::{Answer, Call, RecordingBegun, Status};
use serde_json::json;
use tokio_tungstenite::tungstenite::Message;

use super::harness::{Running, config, estimate, stage, start};

#[tokio::test]
async fn greets_with_the_stage() {
    let server = Running::plain();
    let mut client = server.connect(server.request("")).await.unwrap();
    let mut hello = client.next().await;
    assert_eq!(hello["version"].take(), env!("CARGO_PKG_VERSION"));
    insta::assert_json_snapshot!("hello", hello);
}

#[tokio::test]
async fn a_subscriber_gets_the_last_state_and_then_every_frame() {
    let server = Running::plain();
    server.frame(1);
    let mut client = server.client().await;
    client.subscribe(&["sensors", "status"]).await;
    let first = client.next().await;
    insta::assert_json_snapshot!("sensors", first);
    server.frame(2);
    let second = client.next().await;
    assert_eq!((&second["seq"], &second["dropped"], &second["t_s"]), (&json!(1), &json!(0), &json!(0.02)));
    server.hub.publish_status(Status { t_s: 1.5, ..Status::default() });
    let status = client.next().await;
    assert_eq!((&status["type"], &status["seq"], &status["t_s"]), (&json!("status"), &json!(0), &json!(1.5)));
    let reply = client.ask(json!({"type": "unsubscribe", "topics": ["sensors"]})).await;
    assert_eq!(reply["type"], "ok");
    server.frame(3);
    server.hub.publish_status(Status { t_s: 1.0, ..Status::default() });
    let status = client.next().await;
    assert_eq!(status["type"], "status", "no more frames");
    assert_eq!(status["t_s"], 1.500001, "times rise within a topic, even if a clock does not");
}

#[tokio::test]
async fn fields_sensors_and_rate_are_the_clients_choice() {
    let server = Running::plain();
    let mut all = server.client().await;
    let fields = json!(["position_m", "measured", "covariance", "velocity", "quality"]);
    let reply = all.ask(json!({"type": "subscribe", "topics": ["sensors"], "fields": fields})).await;
    assert_eq!(reply["type"], "ok");
    let mut few = server.client().await;
    let request = json!({"type": "subscribe", "topics": ["sensors"], "sensors": ["right"], "fields": [], "max_rate_hz": 50});
    assert_eq!(few.ask(request).await["type"], "ok");
    for frame in 1..=5 {
        server.frame(frame);
    }
    insta::assert_json_snapshot!("sensors_with_all_fields", all.next().await);
    for (seq, t_s) in [0.01, 0.03, 0.05].into_iter().enumerate() {
        let message = few.next().await;
        assert_eq!(message["sensors"], json!([{"name": "right", "state": "missing"}]));
        assert_eq!((&message["seq"], &message["t_s"]), (&json!(seq), &json!(t_s)));
    }
}

#[tokio::test]
async fn message_pack_says_the_same() {
    let server = Running::plain();
    let mut request = server.request("");
    request.headers_mut().insert("sec-websocket-protocol", "posed.v1.msgpack".parse().unwrap());
    let mut packed = server.connect(request).await.unwrap();
    assert_eq!(packed.protocol.as_deref(), Some("posed.v1.msgpack"));
    let mut request = server.request("");
    request.headers_mut().insert("sec-websocket-protocol", "posed.v1".parse().unwrap());
    let mut text = server.connect(request).await.unwrap();
    assert_eq!(text.protocol.as_deref(), Some("posed.v1"));
    assert_eq!(packed.next().await, text.next().await);
    let subscribe = json!({"type": "subscribe", "id": 1, "topics": ["sensors", "faults"]});
    packed.socket.send(Message::Binary(rmp_serde::to_vec(&subscribe).unwrap().into())).await.unwrap();
    text.send(subscribe).await;
    assert_eq!(packed.next().await, text.next().await);
    server.fault(10, 1, true);
    assert_eq!(packed.next().await, text.next().await);
    server.frame(1);
    assert_eq!(packed.next().await, text.next().await);
}

#[tokio::test]
async fn bad_messages_get_an_error_and_no_hang_up() {
    let server = Running::plain();
    let mut client = server.client().await;
    for (text, code) in [
        ("{", "bad_message"),
        ("[1]", "bad_message"),
        (r#"{"type":"subscribe","topics":["sensors"]}"#, "bad_request"),
        (r#"{"type":"subscribe","id":1,"topics":["weather"]}"#, "bad_request"),
        (r#"{"type":"subscribe","id":1,"topics":["sensors"],"max_rate_hz":0}"#, "bad_request"),
        (r#"{"type":"subscribe","id":1,"topics":["sensors"],"sensors":["middle"]}"#, "unknown_sensor"),
        (r#"{"type":"fly","id":1}"#, "unknown_type"),
        (r#"{"type":"resume","id":1,"after":99}"#, "unknown_event"),
    ] {
        client.socket.send(Message::Text(text.into())).await.unwrap();
        let reply = client.next().await;
        assert_eq!((&reply["type"], &reply["code"]), (&json!("error"), &json!(code)), "{text}: {reply}");
    }
    client.subscribe(&["body", "sensors"]).await;
}

#[tokio::test]
async fn events_are_kept_for_who_comes_back() {
    let server = Running::plain();
    let mut client = server.client().await;
    client.subscribe(&["faults"]).await;
    server.fault(10, 0, true);
    server.fault(10, 1, true);
    insta::assert_json_snapshot!("fault", client.next().await);
    let second = client.next().await;
    assert_eq!((&second["event_id"], &second["t_s"]), (&json!(2), &json!(0.010001)), "rises strictly");
    drop(client);
    server.fault(20, 0, false);

    let mut client = server.client().await;
    client.subscribe(&["faults"]).await;
    assert_eq!(client.next().await["event_id"], 2, "what still holds");
    server.fault(30, 0, true);
    assert_eq!(client.next().await["event_id"], 4);
    let reply = client.ask(json!({"type": "resume", "after": 2})).await;
    assert_eq!(reply["result"], json!({"complete": true, "last_event_id": 4}));
    let missed = client.next().await;
    assert_eq!((&missed["event_id"], &missed["active"]), (&json!(3), &json!(false)));
    server.fault(40, 0, false);
    assert_eq!(client.next().await["event_id"], 5, "4 had come by itself");
}

#[tokio::test]
async fn events_older_than_ten_minutes_are_gone() {
    let server = Running::plain();
    server.fault(0, 0, true);
    server.fault(600_001, 0, false);
    let mut client = server.client().await;
    let reply = client.ask(json!({"type": "resume", "after": 0})).await;
    assert_eq!(reply["result"]["complete"], false);
    assert_eq!(client.next().await["event_id"], 2);
}

#[tokio::test]
async fn calls_reach_the_daemon_and_come_back() {
    let mut server = Running::plain();
    let mut client = server.client().await;
    client.send(json!({"type": "record.start", "id": "r", "name": "take-1"})).await;
    let call = server.calls.recv().await.unwrap();
    assert_eq!(call.call, Call::RecordStart { name: Some("take-1".into()) });
    let recorded = RecordingBegun { name: "take-1.mcap".into(), job: 1 };
    call.reply.ok(Some(Answer::RecordingBegun(recorded)));
    let reply = client.next().await;
    assert_eq!(reply, json!({"type": "ok", "id": "r", "result": {"name": "take-1.mcap", "job": 1}}));
    client.send(json!({"type": "record.stop", "id": 2})).await;
    drop(server.calls.recv().await.unwrap());
    let reply = client.next().await;
    assert_eq!(
        (&reply["type"], &reply["id"], &reply["code"]),
        (&json!("error"), &json!(2), &json!("unavailable"))
    );
}

#[tokio::test]
async fn a_pose_that_is_no_number_is_never_shown_as_good() {
    let server = Running::plain();
    let mut client = server.client().await;
    client.subscribe(&["sensors"]).await;
    let mut broken = estimate(1);
    broken.sensors[0].pose.as_mut().unwrap().position_m.as_mut().unwrap()[1] = f64::NAN;
    // As the pipeline does with every estimate.
    broken.sensors[0].withhold_non_finite();
    server.hub.publish_estimate(&broken);
    let left = &client.next().await["sensors"][0];
    assert_eq!((&left["state"], &left["position_m"]), (&json!("suspect"), &json!(null)));
}

#[tokio::test]
async fn shutdown_says_goodbye() {
    let mut server = start(&stage(""), config());
    let mut client = server.client().await;
    server.stop();
    assert_eq!(client.closed().await.0, 1001);
    drop(client);
    server.task.await.unwrap();
}
