//! The clients that are measured: subscribe, receive, take the time.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use futures_util::{SinkExt, StreamExt};
use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream};

use super::wakes::{Wakes, utc_s};
use super::{Args, vrpn};

/// Time before the measurement begins, s.
pub(crate) const WARM_UP_S: f64 = 1.0;

/// What all clients together saw.
#[derive(Serialize, Deserialize)]
pub(crate) struct Report {
    messages_per_s: f64,
    megabytes_per_s: f64,
    p50_ms: f64,
    p99_ms: f64,
    p999_ms: f64,
    max_ms: f64,
    pause_ms: f64,
    dropped: u64,
    pub(crate) cpu_percent: f64,
    /// When the measurement began, UTC.
    pub(crate) begins_utc_s: f64,
    /// By how much the clients' runtime itself came too late, ms.
    pub(crate) late_ms: f64,
}

impl Report {
    pub(crate) fn to_line(&self) -> String {
        serde_json::to_string(self).expect("numbers")
    }

    pub(crate) fn from_line(line: &str) -> Self {
        serde_json::from_str(line).expect("the clients' report")
    }

    pub(crate) fn row(&self) -> String {
        format!(
            "{:>9.0} {:>8.1} {:>7.2} {:>7.2} {:>7.2} {:>7.2} {:>8.1} {:>7}",
            self.messages_per_s,
            self.megabytes_per_s,
            self.p50_ms,
            self.p99_ms,
            self.p999_ms,
            self.max_ms,
            self.pause_ms,
            self.dropped
        )
    }
}

/// What one client saw: latencies in microseconds.
pub(crate) struct Received {
    latency_us: Histogram<u64>,
    bytes: u64,
    /// Longest time between two messages.
    gap: Duration,
    dropped: u64,
    begins: Instant,
    ends: Instant,
    last: Option<Instant>,
}

impl Received {
    #[expect(clippy::disallowed_methods, reason = "this program owns its clock")]
    pub(crate) fn new(seconds: f64) -> Self {
        let begins = Instant::now() + Duration::from_secs_f64(WARM_UP_S);
        Self {
            latency_us: Histogram::new(3).expect("three digits"),
            bytes: 0,
            gap: Duration::ZERO,
            dropped: 0,
            begins,
            ends: begins + Duration::from_secs_f64(seconds),
            last: None,
        }
    }

    /// A frame that was true at this UTC has come, with so many bytes; whether there are enough of them.
    #[expect(clippy::disallowed_methods, reason = "this program owns its clock")]
    pub(crate) fn frame(&mut self, utc_s: f64, bytes: usize) -> bool {
        let utc = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let now = Instant::now();
        if now < self.begins {
            return false;
        }
        let latency_us = (utc.as_secs_f64() - utc_s) * 1e6;
        self.latency_us.record(latency_us.max(1.0) as u64).expect("it grows by itself");
        self.bytes += bytes as u64;
        if let Some(last) = self.last {
            self.gap = self.gap.max(now - last);
        }
        self.last = Some(now);
        now >= self.ends
    }
}

pub(crate) type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

/// Runs all clients and sums up.
pub(crate) fn run(args: &Args, url: &str) -> Report {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    runtime.expect("a runtime").block_on(async {
        let mut tasks = Vec::new();
        for _ in 0..args.clients {
            let seconds = args.seconds;
            if let Some(address) = url.strip_prefix("vrpn://") {
                let (stream, last) = (vrpn::connect(address).await, i32::from(args.sensors) - 1);
                tasks.push(tokio::spawn(async move { vrpn::listen(stream, last, seconds).await }));
                continue;
            }
            let (mut socket, epoch_s) = connect(url, args.msgpack).await;
            subscribe(&mut socket).await;
            tasks.push(tokio::spawn(async move { listen(socket, epoch_s, seconds).await }));
        }
        let mut all = Histogram::<u64>::new(3).expect("three digits");
        let (mut bytes, mut gap, mut dropped) = (0, Duration::ZERO, 0);
        let cpu_before = super::cpu_s(std::process::id());
        let begins_utc_s = utc_s() + WARM_UP_S;
        let wakes = Wakes::default();
        tokio::spawn(wakes.clone().watch());
        for task in tasks {
            let seen = task.await.expect("a client");
            all.add(&seen.latency_us).expect("equal precision");
            bytes += seen.bytes;
            gap = gap.max(seen.gap);
            dropped += seen.dropped;
        }
        let cpu_s = super::cpu_s(std::process::id()) - cpu_before;
        let ms = |us: u64| us as f64 / 1e3;
        Report {
            messages_per_s: all.len() as f64 / args.seconds,
            megabytes_per_s: bytes as f64 / 1e6 / args.seconds,
            p50_ms: ms(all.value_at_quantile(0.5)),
            p99_ms: ms(all.value_at_quantile(0.99)),
            p999_ms: ms(all.value_at_quantile(0.999)),
            max_ms: ms(all.max()),
            pause_ms: gap.as_secs_f64() * 1e3,
            dropped,
            cpu_percent: 100.0 * cpu_s / (args.seconds + WARM_UP_S),
            begins_utc_s,
            late_ms: wakes.late_ms(begins_utc_s, args.seconds),
        }
    })
}

/// A greeted connection, and the UTC of its stage's epoch in seconds.
pub(crate) async fn connect(url: &str, msgpack: bool) -> (Socket, f64) {
    let mut request = url.into_client_request().expect("a websocket address");
    let protocol = if msgpack { "posed.v1.msgpack" } else { "posed.v1" };
    request.headers_mut().insert("sec-websocket-protocol", protocol.parse().expect("a word"));
    let (mut socket, _) = tokio_tungstenite::connect_async(request).await.expect("a connection");
    let hello: serde_json::Value = match socket.next().await {
        Some(Ok(Message::Text(text))) => serde_json::from_str(&text).expect("JSON"),
        Some(Ok(Message::Binary(bytes))) => rmp_serde::from_slice(&bytes).expect("MessagePack"),
        other => panic!("expected a greeting, got {other:?}"),
    };
    let epoch: jiff::Timestamp = hello["epoch_utc"].as_str().expect("an epoch").parse().expect("RFC 3339");
    (socket, epoch.as_nanosecond() as f64 * 1e-9)
}

/// Subscribes to `sensors` with the default fields.
pub(crate) async fn subscribe(socket: &mut Socket) {
    let request = r#"{"type":"subscribe","id":1,"topics":["sensors"]}"#;
    socket.send(Message::Text(request.into())).await.expect("a connection");
}

async fn listen(mut socket: Socket, epoch_s: f64, seconds: f64) -> Received {
    let mut seen = Received::new(seconds);
    loop {
        let (t_s, dropped, bytes) = match socket.next().await {
            Some(Ok(Message::Text(text))) => match json_head(&text) {
                Some((t_s, dropped)) => (t_s, dropped, text.len()),
                None => continue,
            },
            Some(Ok(Message::Binary(packed))) => match packed_head(&packed) {
                Some((t_s, dropped)) => (t_s, dropped, packed.len()),
                None => continue,
            },
            Some(Ok(_)) => continue,
            other => panic!("the server ended it: {other:?}"),
        };
        seen.dropped = dropped;
        if seen.frame(epoch_s + t_s, bytes) {
            return seen;
        }
    }
}

/// Time and drops of a `sensors` message: `{"type":"sensors","seq":N,"dropped":D,"t_s":T,...`.
fn json_head(text: &str) -> Option<(f64, u64)> {
    let head = text.strip_prefix(r#"{"type":"sensors","seq":"#)?;
    let (_, rest) = head.split_once(r#","dropped":"#)?;
    let (dropped, rest) = rest.split_once(r#","t_s":"#)?;
    let (t_s, _) = rest.split_once(',')?;
    Some((t_s.parse().ok()?, dropped.parse().ok()?))
}

/// The same of a MessagePack message.
fn packed_head(bytes: &[u8]) -> Option<(f64, u64)> {
    #[derive(Deserialize)]
    struct Head {
        dropped: u64,
        t_s: f64,
    }
    rmp_serde::from_slice::<Head>(bytes).ok().map(|head| (head.t_s, head.dropped))
}
