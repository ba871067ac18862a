//! Slow, silent, flooding and too many clients.

use futures_util::SinkExt;
use posed_stage::Limits;
use serde_json::json;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::Message;

use super::harness::{PATIENCE, Running, config, estimate, get, stage, start};

fn with(limits: Limits) -> Running {
    let mut stage = stage("");
    stage.server.limits = limits;
    start(&stage, config())
}

/// A connection that has asked for a websocket, for whoever wants to write frames by hand.
async fn upgraded(server: &Running) -> TcpStream {
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    let head = format!(
        "GET /ws HTTP/1.1\r\nHost: {}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n",
        server.address
    );
    stream.write_all(head.as_bytes()).await.unwrap();
    stream
}

/// Writes the same bytes until the connection is cut; how many were taken.
async fn flood(stream: &mut TcpStream, bytes: &[u8]) -> usize {
    let mut taken = 0;
    tokio::time::timeout(PATIENCE, async {
        while let Ok(more) = stream.write(bytes).await {
            taken += more;
        }
    })
    .await
    .expect("it is never cut");
    taken
}

#[tokio::test]
async fn frames_of_nothing_without_end_are_cut_by_their_bytes() {
    let server = with(Limits { byte_burst: 65_536.0, ..Limits::default() });
    let mut stream = upgraded(&server).await;
    // The first fragment of a text, and then empty ones: a message that never ends, and that no count of messages sees.
    stream.write_all(&[0x01, 0x80, 0, 0, 0, 0]).await.unwrap();
    flood(&mut stream, &[0x00, 0x80, 0, 0, 0, 0].repeat(1000)).await;
    let mut other = server.client().await;
    other.subscribe(&["sensors"]).await;
}

#[tokio::test]
async fn a_request_without_end_is_cut() {
    let server = with(Limits { byte_burst: 65_536.0, ..Limits::default() });
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    flood(&mut stream, &b"GET / HTTP/1.1\r\nA: b\r\n".repeat(100)).await;
}

#[tokio::test]
async fn a_large_message_closes_with_1009() {
    let server = Running::plain();
    let large = |bytes| Message::Text(" ".repeat(bytes).into());
    let mut client = server.client().await;
    client.socket.send(large(65 * 1024)).await.unwrap();
    assert_eq!(client.closed().await.0, 1009);
    // The line may be cut while such a message is still being written.
    let mut client = server.client().await;
    let _ = client.socket.send(large(10 * 1024 * 1024)).await;
    assert!(client.ended().await.is_none_or(|(code, _)| code == 1009));
}

#[tokio::test]
async fn a_flood_closes_with_1008() {
    let server = Running::plain();
    let mut flooding = server.client().await;
    let mut other = server.client().await;
    other.subscribe(&["sensors"]).await;
    for id in 0..400 {
        if flooding.socket.feed(Message::Text(json!({"id": id}).to_string().into())).await.is_err() {
            break;
        }
    }
    let _ = flooding.socket.flush().await;
    let (code, reason) = flooding.closed().await;
    assert_eq!((code, reason.as_str()), (1008, "too many messages per second"));
    server.frame(1);
    assert_eq!(other.next().await["type"], "sensors");
}

#[tokio::test]
async fn a_stalled_client_loses_old_frames_and_nobody_else_does() {
    let sensors: String = (3..=100)
        .map(|n| format!("[[sensor]]\nname = \"bird-{n}\"\ndevice = \"flock\"\naddress = {n}\n"))
        .collect();
    let server = start(&stage(&sensors), config());
    let mut stalled = server.client().await;
    stalled.subscribe(&["sensors"]).await;
    let mut other = server.client().await;
    other.subscribe(&["sensors"]).await;
    // 15 kB each: more than the socket buffers of both sides hold.
    let frames = 1000;
    for frame in 1..=frames {
        let mut wide = estimate(frame);
        wide.sensors = vec![wide.sensors[0]; 100];
        server.hub.publish_estimate(&wide);
        let message = other.next().await;
        assert_eq!((&message["seq"], &message["dropped"]), (&json!(frame - 1), &json!(0)));
    }
    let mut seq = None;
    let mut received = 0;
    let mut dropped = 0;
    while seq != Some(frames - 1) {
        let message = stalled.next().await;
        let now = message["seq"].as_u64().unwrap();
        assert!(seq.is_none_or(|before| before < now));
        assert!(message["dropped"].as_u64().unwrap() >= dropped, "counts up");
        dropped = message["dropped"].as_u64().unwrap();
        seq = Some(now);
        received += 1;
    }
    assert!(dropped > 0, "it was slow");
    assert_eq!(received + dropped, frames, "every message was received or is counted");
}

#[tokio::test]
async fn a_silent_client_is_dropped() {
    let server = with(Limits { ping_interval_s: 0.02, silence_timeout_s: 0.2, ..Limits::default() });
    let mut other = server.client().await;
    other.subscribe(&["sensors"]).await;
    let mut silent = upgraded(&server).await;
    let mut all = Vec::new();
    // Another one has nothing to say either, and answers as it is asked.
    tokio::select! {
        read = tokio::time::timeout(PATIENCE, silent.read_to_end(&mut all)) => assert!(read.unwrap().is_ok()),
        message = other.next() => panic!("nothing was published: {message}"),
    }
    assert!(all.windows(18).any(|text| text == b"no answer to pings"));
    server.frame(1);
    assert_eq!(other.next().await["type"], "sensors");
}

#[tokio::test]
async fn half_a_greeting_is_cut() {
    let server = with(Limits { greeting_timeout_s: 0.1, ..Limits::default() });
    let mut other = server.client().await;
    other.subscribe(&["sensors"]).await;
    let mut slow = TcpStream::connect(server.address).await.unwrap();
    slow.write_all(b"GET /ws HTTP/1.1\r\nHost: localh").await.unwrap();
    let mut all = Vec::new();
    tokio::time::timeout(PATIENCE, slow.read_to_end(&mut all)).await.unwrap().unwrap();
    server.frame(1);
    assert_eq!(other.next().await["type"], "sensors");
}

#[tokio::test]
async fn one_connection_too_many_is_informed() {
    let server = start(&stage("[server.limits]\nconnections = 2"), config());
    let mut one = server.client().await;
    let two = server.client().await;
    let (status, answer) = server.refusal(server.request("")).await;
    assert!(status == 503 && answer.contains("2 connections at most"), "{status} {answer}");
    // The page and how the daemon is are for everybody.
    let health =
        get(server.address, &format!("GET /health HTTP/1.1\r\nHost: {}\r\n\r\n", server.address)).await;
    assert!(health.starts_with("HTTP/1.1 200"), "{health}");
    one.subscribe(&["sensors"]).await;
    drop(two);
    // The place is free again once the server has noticed.
    tokio::time::timeout(PATIENCE, async {
        while server.connect(server.request("")).await.is_err() {
            tokio::task::yield_now().await;
        }
    })
    .await
    .unwrap();
}

#[tokio::test]
async fn who_lets_replies_pile_up_is_disconnected() {
    let server = with(Limits { lossless_messages: 0, ..Limits::default() });
    let mut client = server.connect(server.request("")).await.unwrap();
    let (code, reason) = client.closed().await;
    assert_eq!(code, 1008);
    assert!(reason.starts_with("too slow"), "{reason}");
}

#[tokio::test]
async fn connections_that_say_nothing_keep_nobody_out() {
    let server = with(Limits { waiting: 4, ..Limits::default() });
    // As many as there are places that wait, and then as many again: the first ones are closed.
    let mut silent = Vec::new();
    for _ in 0..8 {
        silent.push(TcpStream::connect(server.address).await.unwrap());
    }
    let mut client = server.client().await;
    client.subscribe(&["sensors"]).await;
    let mut all = Vec::new();
    tokio::time::timeout(PATIENCE, silent[0].read_to_end(&mut all)).await.unwrap().unwrap();
    assert!(all.is_empty());
}

#[tokio::test]
async fn who_comes_again_and_again_is_sent_away_unheard_and_who_is_there_stays() {
    let server = with(Limits { connections_per_s: 1.0, connection_burst: 16.0, ..Limits::default() });
    let mut other = server.client().await;
    other.subscribe(&["sensors"]).await;
    // Cut for what it sent, it has spent what its network may.
    let mut flooding = server.client().await;
    flooding.socket.send(Message::Text(" ".repeat(65 * 1024).into())).await.unwrap();
    assert_eq!(flooding.closed().await.0, 1009);
    let mut all = Vec::new();
    let mut again = TcpStream::connect(server.address).await.unwrap();
    // Nothing is read of it: it is closed, or reset where something was on its way.
    let _ = tokio::time::timeout(PATIENCE, again.read_to_end(&mut all)).await.unwrap();
    assert!(all.is_empty());
    server.frame(1);
    assert_eq!(other.next().await["type"], "sensors");
}

#[tokio::test]
async fn a_network_is_heard_no_more_often_for_many_connections() {
    let limits =
        Limits { messages_per_s_per_address: 1.0, message_burst_per_address: 20.0, ..Limits::default() };
    let server = with(limits);
    let (mut first, mut second) = (server.client().await, server.client().await);
    for _ in 0..15 {
        first.subscribe(&["sensors"]).await;
    }
    for id in 0..15 {
        let _ = second.socket.send(Message::Text(json!({"id": id}).to_string().into())).await;
    }
    let (code, reason) = second.closed().await;
    assert_eq!((code, reason.as_str()), (1008, "too many messages per second"));
}
