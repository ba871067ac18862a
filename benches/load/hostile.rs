//! A thousand hostile connections of ten kinds at once, each kind from an address of its own, until they are killed. Who is sent away comes
//! back.

use std::net::SocketAddr;

use futures_util::{SinkExt, StreamExt};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::{WebSocketStream, client_async};

use super::bullies::{address, pause};

/// Connections of each kind.
const OF_A_KIND: usize = 100;
/// What they do.
const KINDS: [&str; 10] =
    ["stalled", "silent", "half", "flood", "slow", "fragments", "visits", "large", "garbage", "views"];

pub(super) async fn run(url: &str) {
    // Who is measured comes first: a daemon without tokens lets everybody in until it is full.
    pause(1500).await;
    for (number, kind) in KINDS.into_iter().enumerate() {
        for _ in 0..OF_A_KIND {
            let url = url.to_owned();
            tokio::spawn(async move {
                loop {
                    // Whatever ends it, it comes again.
                    let _ = attack(kind, &url, number as u8 + 1).await;
                    pause(200).await;
                }
            });
        }
    }
}

type Failed = Box<dyn std::error::Error + Send + Sync>;

async fn stream(url: &str, network: u8) -> Result<TcpStream, Failed> {
    let socket = TcpSocket::new_v4()?;
    socket.bind(SocketAddr::from(([127, 0, network, 1], 0)))?;
    Ok(socket.connect(address(url).parse()?).await?)
}

async fn websocket(url: &str, network: u8) -> Result<WebSocketStream<TcpStream>, Failed> {
    let mut request = url.into_client_request()?;
    request.headers_mut().insert("sec-websocket-protocol", "posed.v1".parse()?);
    Ok(client_async(request, stream(url, network).await?).await?.0)
}

fn subscribe(sensor: usize) -> Message {
    let text = format!(r#"{{"type":"subscribe","id":1,"topics":["sensors"],"sensors":["bird-{sensor}"]}}"#);
    Message::Text(text.into())
}

async fn attack(kind: &str, url: &str, network: u8) -> Result<(), Failed> {
    let all = Message::Text(r#"{"type":"subscribe","id":1,"topics":["sensors","status"]}"#.into());
    match kind {
        // Subscribes, and reads nothing any more.
        "stalled" => {
            let mut socket = websocket(url, network).await?;
            socket.send(all).await?;
            std::future::pending().await
        }
        "silent" => {
            let mut stream = stream(url, network).await?;
            stream.read_to_end(&mut Vec::new()).await?;
        }
        "half" => {
            let mut stream = stream(url, network).await?;
            stream.write_all(b"GET /ws HTTP/1.1\r\nHost: local").await?;
            stream.read_to_end(&mut Vec::new()).await?;
        }
        "flood" => {
            let mut socket = websocket(url, network).await?;
            loop {
                socket.send(all.clone()).await?;
            }
        }
        "slow" => {
            let mut socket = websocket(url, network).await?;
            socket.send(all).await?;
            while let Some(message) = socket.next().await {
                message?;
                pause(1000).await;
            }
        }
        // A message that never ends, of fragments that hold nothing.
        "fragments" => {
            let mut socket = websocket(url, network).await?;
            let stream = socket.get_mut();
            stream.write_all(&[0x01, 0x80, 0, 0, 0, 0]).await?;
            loop {
                stream.write_all(&[0x00, 0x80, 0, 0, 0, 0].repeat(1000)).await?;
            }
        }
        "visits" => {
            let mut stream = stream(url, network).await?;
            stream.write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n").await?;
            stream.read_to_end(&mut Vec::new()).await?;
        }
        "large" => {
            let mut socket = websocket(url, network).await?;
            socket.send(Message::Text(" ".repeat(4 << 20).into())).await?;
        }
        "garbage" => {
            let mut stream = stream(url, network).await?;
            let bytes: Vec<u8> =
                (0..65_536_u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
            loop {
                stream.write_all(&bytes).await?;
            }
        }
        // Another choice of sensors each time, within what a client may ask for.
        "views" => {
            let mut socket = websocket(url, network).await?;
            for sensor in (0..).map(|n| n % 13) {
                socket.send(subscribe(sensor)).await?;
                pause(50).await;
                while let Ok(Some(message)) =
                    tokio::time::timeout(std::time::Duration::ZERO, socket.next()).await
                {
                    message?;
                }
            }
        }
        other => return Err(format!("there is no kind {other}").into()),
    }
    Ok(())
}
