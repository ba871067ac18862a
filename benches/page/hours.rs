//! Hours of messages for one page: it is connected through a relay that keeps what the daemon answers in the first minute, and then says it
//! over and over with later times, as fast as the page takes it. Once an hour the connection breaks.

use std::time::{Duration, Instant};

use futures_util::{FutureExt, SinkExt, StreamExt};
use serde_json::{Value, json};
use tokio::net::{TcpListener, TcpStream};
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::handshake::server::{ErrorResponse, Request, Response};
use tokio_tungstenite::tungstenite::http::HeaderValue;
use tokio_tungstenite::{WebSocketStream, accept_hdr_async, connect_async};

use super::chromium::{Browser, Screen, resident_bytes};
use super::stage::Served;
use super::{PROBE, VIEWS};

/// How much of the daemon's own stream is kept.
const KEPT: Duration = Duration::from_secs(60);
/// The page never has more than so many messages before it.
const AHEAD: usize = 500;
const SUBPROTOCOL: &str = "posed.v1";

pub(crate) async fn run(served: &Served, hours: f64) {
    let relay = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = relay.local_addr().unwrap().port();
    let script = format!("window.probeUrl = 'ws://127.0.0.1:{port}/ws';\n{PROBE}");
    let mut browser = Browser::open_on(Screen::Full, &served.url, Some(&script)).await;
    let mut page = accept(&relay).await;
    println!("keeping {} s of the daemon's own messages", KEPT.as_secs());
    let kept = keep(&mut page, &served.url).await;
    let hello = kept.iter().find(|message| message["type"] == "hello").unwrap().clone();
    let stream: Vec<Value> = kept.into_iter().filter(|message| !is_answer(message)).collect();
    println!("{} messages a minute, over and over for {hours} hours\n", stream.len());
    println!(
        "| stage time, h | JavaScript heap, MB | nodes | listeners | page's process, MB | daemon, MB | wall time, s |"
    );
    println!("|---|---|---|---|---|---|---|");
    let began = Instant::now();
    let mut sent: u64 = 0;
    browser.value("probe.begin()").await;
    let minutes = (hours * 60.0) as u64;
    for minute in 1..=minutes {
        if minute % 60 == 31 {
            drop(page);
            page = accept(&relay).await;
            page.send(Message::text(hello.to_string())).await.unwrap();
            sent += 1;
        }
        if minute % 10 == 0 {
            browser.click(&format!("tab-{}", VIEWS[(minute / 10) as usize % VIEWS.len()])).await;
        }
        for chunk in stream.chunks(AHEAD) {
            answer(&mut page, &mut sent).await;
            for message in chunk {
                page.feed(Message::text(later(message.clone(), minute).to_string())).await.unwrap();
            }
            page.flush().await.unwrap();
            sent += chunk.len() as u64;
            browser.until(&format!("probe.messages() >= {sent}")).await;
        }
        if minute % 60 == 0 || minute == 10 || minute == minutes {
            row(&mut browser, served, minute, began.elapsed()).await;
        }
    }
    assert_eq!(browser.complaints, Vec::<String>::new());
}

async fn row(browser: &mut Browser, served: &Served, minute: u64, elapsed: Duration) {
    let heap = browser.heap_bytes().await;
    let counters = browser.call("Memory.getDOMCounters", json!({})).await;
    println!(
        "| {:.2} | {:.2} | {} | {} | {:.0} | {:.0} | {:.0} |",
        minute as f64 / 60.0,
        heap as f64 / 1e6,
        counters["nodes"],
        counters["jsEventListeners"],
        browser.renderer_bytes().await as f64 / 1e6,
        resident_bytes(served.pid()) as f64 / 1e6,
        elapsed.as_secs_f64(),
    );
}

type Page = WebSocketStream<TcpStream>;

async fn accept(relay: &TcpListener) -> Page {
    let (stream, _) = relay.accept().await.unwrap();
    #[expect(clippy::result_large_err, reason = "the signature is the library's")]
    let agree = |_: &Request, mut response: Response| -> Result<Response, ErrorResponse> {
        response.headers_mut().insert("Sec-WebSocket-Protocol", HeaderValue::from_static(SUBPROTOCOL));
        Ok(response)
    };
    accept_hdr_async(stream, agree).await.unwrap()
}

/// Relays between page and daemon, and keeps what the daemon reports.
async fn keep(page: &mut Page, url: &str) -> Vec<Value> {
    let mut request = url.replace("http://", "ws://").trim_end_matches('/').to_owned();
    request += "/ws";
    let mut request = request.into_client_request().unwrap();
    request.headers_mut().insert("Sec-WebSocket-Protocol", HeaderValue::from_static(SUBPROTOCOL));
    let (mut daemon, _) = connect_async(request).await.unwrap();
    let mut kept = Vec::new();
    let relayed = async {
        loop {
            tokio::select! {
                emitted = daemon.next() => {
                    let emitted = emitted.unwrap().unwrap();
                    if let Message::Text(text) = &emitted {
                        kept.push(serde_json::from_str(text).unwrap());
                    }
                    page.send(emitted).await.unwrap();
                }
                request = page.next() => daemon.send(request.unwrap().unwrap()).await.unwrap(),
            }
        }
    };
    let _ = tokio::time::timeout(KEPT, relayed).await;
    kept
}

/// Says yes to all that the page has asked for meanwhile.
async fn answer(page: &mut Page, sent: &mut u64) {
    while let Some(Some(Ok(request))) = page.next().now_or_never() {
        if let Message::Text(text) = request {
            let request: Value = serde_json::from_str(&text).unwrap();
            let reply = json!({"type": "ok", "id": request["id"], "result": null});
            page.send(Message::text(reply.to_string())).await.unwrap();
            *sent += 1;
        }
    }
}

fn is_answer(message: &Value) -> bool {
    ["hello", "ok", "error"].iter().any(|kind| message["type"] == *kind)
}

/// The message with all its times so many minutes later, and its numbers those of later events.
fn later(mut message: Value, minute: u64) -> Value {
    match &mut message {
        Value::Object(members) => {
            for (key, value) in members.iter_mut() {
                let taken = value.take();
                *value = match (key.as_str(), taken.as_f64(), taken.as_u64()) {
                    ("event_id" | "frame" | "segment", _, Some(n)) => json!(n + 1_000_000 * minute),
                    (key, Some(t_s), _) if key.starts_with("t_") && key.ends_with("_s") => {
                        json!(t_s + 60.0 * minute as f64)
                    }
                    _ => later(taken, minute),
                };
            }
        }
        Value::Array(items) => items.iter_mut().for_each(|item| *item = later(item.take(), minute)),
        _ => {}
    }
    message
}
