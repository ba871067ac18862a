//! Bad clients, one kind per scenario. They go on until they are killed.

use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::Message;

use super::clients::{Socket, connect, subscribe};
use super::{hostile, vrpn};

pub(crate) fn run(kind: &str, url: &str) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    runtime.expect("a runtime").block_on(async {
        if let Some(address) = url.strip_prefix("vrpn://") {
            match kind {
                "stalled" => vrpn::stall(address).await,
                // It is sent away, and comes back.
                "flood" => loop {
                    vrpn::flood(address).await;
                    pause(100).await;
                },
                _ => half_greetings(url, b"vrpn: ver. 0").await,
            }
            return std::future::pending().await;
        }
        match kind {
            "stalled" => stall(url).await,
            "greeting" => half_greetings(url, b"GET /ws HTTP/1.1\r\nHost: local").await,
            "flood" => flood(url).await,
            "slow" => slow(url).await,
            "crowd" => crowd(url).await,
            "hostile" => hostile::run(url).await,
            other => panic!("there is no scenario {other}"),
        }
        std::future::pending::<()>().await;
    });
}

async fn subscribed(url: &str) -> Socket {
    let (mut socket, _) = connect(url, false).await;
    subscribe(&mut socket).await;
    socket
}

async fn stall(url: &str) {
    let _socket = subscribed(url).await;
    std::future::pending::<()>().await;
}

async fn half_greetings(url: &str, half: &[u8]) {
    loop {
        let mut streams = Vec::new();
        for _ in 0..50 {
            if let Ok(mut stream) = TcpStream::connect(address(url)).await {
                let _ = stream.write_all(half).await;
                streams.push(stream);
            }
        }
        pause(6000).await;
    }
}

async fn flood(url: &str) {
    loop {
        let mut socket = subscribed(url).await;
        let request = r#"{"type":"subscribe","id":1,"topics":["sensors","status"]}"#;
        while socket.feed(Message::Text(request.into())).await.is_ok() {}
        pause(100).await;
    }
}

async fn slow(url: &str) {
    let mut sockets = Vec::new();
    for _ in 0..5 {
        sockets.push(subscribed(url).await);
    }
    loop {
        for socket in &mut sockets {
            let _ = socket.next().await;
        }
        pause(200).await;
    }
}

async fn crowd(url: &str) {
    // All come from one address: who is measured takes places first.
    pause(1500).await;
    loop {
        let mut tasks = Vec::new();
        for _ in 0..500 {
            let address = address(url).to_owned();
            tasks.push(tokio::spawn(async move {
                let mut stream = TcpStream::connect(address).await?;
                stream.write_all(b"GET /ws HTTP/1.1\r\nHost: localhost\r\n\r\n").await?;
                let mut answer = String::new();
                stream.read_to_string(&mut answer).await
            }));
        }
        for task in tasks {
            let _ = task.await;
        }
        pause(500).await;
    }
}

/// `HOST:PORT` of a websocket address.
pub(super) fn address(url: &str) -> &str {
    let rest = url.split_once("://").map_or(url, |(_, rest)| rest);
    rest.split('/').next().unwrap_or(rest)
}

#[expect(clippy::disallowed_methods, reason = "this program owns its clock")]
pub(super) async fn pause(ms: u64) {
    tokio::time::sleep(Duration::from_millis(ms)).await;
}
