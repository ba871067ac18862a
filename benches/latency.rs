//! From the last byte of a frame to the `sensors` message at a local client, and beside it a bare relay of the same
//! bytes: the least that two sockets and two wake-ups cost.
//!
//! ```text
//! virtual Flock ──> tap ──socket pair──> daemon ──websocket──> client     "posed"
//!                    └────socket pair──> relay ──TCP─────────> client     "bare relay"
//! ```
//! Run: `cargo bench --bench latency -- [SECONDS] [DISTURBANCE ...]`; on a quiet machine. Eight birds at 100 Hz, 115200 baud, group mode. Each
//! disturbance is measured beside the undisturbed run: `peer` asks without end how the pipeline stands, as a hub that would fuse does;
//! `disk` hangs for SECONDS, under a recording.

#![allow(clippy::disallowed_methods, reason = "a bench measures time")]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use hdrhistogram::Histogram;
use posed_daemon::{Daemon, Options};
use posed_simulator::host::{Clock, Watcher, serve_stream};
use posed_simulator::scenario::{DeviceScenario, DeviceSpec, Scenario, SensorSpec, StageSpec};
use posed_simulator::stage::VirtualStage;
use posed_stage::Stage;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream, UnixStream};
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;

const BIRDS: u16 = 8;
/// Position and angles, and the address.
const RECORD_BYTES: usize = 13;
/// Set-up and the first half second, which the driver discards.
const WARM_UP: Duration = Duration::from_secs(8);

type Latencies = Arc<Mutex<Histogram<u64>>>;

fn main() {
    // Cargo passes `--bench`; of ours are a number and words.
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let seconds = arguments.iter().filter_map(|arg| arg.parse().ok()).next().unwrap_or(30);
    let length = Duration::from_secs(seconds);
    let has = |word: &str| arguments.iter().any(|arg| arg == word);
    for disturbance in ["peer", "disk"].into_iter().filter(|word| has(word)) {
        if has("--alone") {
            return print(disturbance, length);
        }
        // What is to go wrong is said by the environment, and read once.
        let ms = length.as_millis();
        let ended = Command::new(std::env::current_exe().expect("own path"))
            .args([&seconds.to_string(), disturbance, "--alone"])
            .env("POSED_FAULTS", format!("recorder=hang:{ms}@17,sync=hang:{ms}@17"))
            .status();
        assert!(ended.expect("a process of our own").success());
    }
    print("undisturbed", length);
}

fn print(disturbance: &str, length: Duration) {
    let (posed, relay) = measure(length, disturbance);
    let mut out = String::new();
    row(&mut out, &format!("posed: last byte to sensors message ({disturbance})"), &posed);
    row(&mut out, "bare relay: last byte to TCP client", &relay);
    std::io::Write::write_all(&mut std::io::stdout(), out.as_bytes()).expect("stdout");
}

fn new_histogram() -> Latencies {
    Arc::new(Mutex::new(Histogram::new_with_bounds(1, 60_000_000_000, 3).expect("bounds")))
}

fn row(out: &mut String, name: &str, latencies: &Latencies) {
    use std::fmt::Write;
    let latencies = latencies.lock().expect("not poisoned");
    let ms = |q: f64| latencies.value_at_quantile(q) as f64 * 1e-6;
    let (p50, p99, p999, max) = (ms(0.5), ms(0.99), ms(0.999), latencies.max() as f64 * 1e-6);
    writeln!(
        out,
        "{name}: n {} p50 {p50:.3} ms p99 {p99:.3} ms p99.9 {p999:.3} ms max {max:.3} ms",
        latencies.len()
    )
    .expect("a string");
}

fn measure(length: Duration, disturbance: &str) -> (Latencies, Latencies) {
    let origin = Instant::now();
    let posed: Latencies = new_histogram();
    let relay: Latencies = new_histogram();
    // When the last byte of the newest frame was written, ns since the origin.
    let frame_end = Arc::new(AtomicI64::new(0));
    let from = WARM_UP.as_nanos() as i64;

    let runtime =
        tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().expect("runtime");
    runtime.block_on(async {
        let (unit, mut tap) = UnixStream::pair().expect("socket pair");
        let (mut to_daemon, daemon_end) = UnixStream::pair().expect("socket pair");
        let (mut to_relay, relay_end) = UnixStream::pair().expect("socket pair");

        let folder = tempfile::tempdir().expect("a folder");
        let mut options = Options {
            listen: Some("127.0.0.1:0".into()),
            ..Options::new(stage(), String::new(), PathBuf::new())
        };
        options.record = (disturbance == "disk").then(|| folder.path().join("take.mcap"));
        let mut daemon = Daemon::start_without_ports(options).expect("daemon");
        daemon.attach(0, daemon_end);
        if disturbance == "peer" {
            let inbox = daemon.inbox();
            std::thread::spawn(move || while inbox.begin().is_ok() {});
        }

        // The unit and everybody who only watches have a runtime of their own.
        let end = Arc::clone(&frame_end);
        std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("runtime");
            runtime.block_on(async move {
                let device = virtual_flock();
                let watcher: Watcher = Arc::new(|_| {});
                let _ = tokio::join!(
                    async { serve_stream(device, unit, Clock::start(), watcher).await },
                    async {
                        let mut from_unit = [0; 256];
                        let mut from_daemon = [0; 256];
                        let mut at = 0;
                        loop {
                            tokio::select! {
                                n = tap.read(&mut from_unit) => {
                                    let Ok(n @ 1..) = n else { break };
                                    let bytes = &from_unit[..n];
                                    if ends_frame(bytes, &mut at) {
                                        end.store(origin.elapsed().as_nanos() as i64, Ordering::SeqCst);
                                    }
                                    if to_daemon.write_all(bytes).await.is_err() { break; }
                                    let _ = to_relay.write_all(bytes).await;
                                }
                                n = to_daemon.read(&mut from_daemon) => {
                                    match n { Ok(n) if n > 0 => _ = tap.write_all(&from_daemon[..n]).await, _ => break }
                                }
                            }
                        }
                    }
                );
            });
        });

        let listener = TcpListener::bind("127.0.0.1:0").await.expect("relay");
        let relay_address = listener.local_addr().expect("relay");
        tokio::spawn(bare_relay(relay_end, listener));
        tokio::spawn(relay_client(relay_address, origin, Arc::clone(&frame_end), from, Arc::clone(&relay)));
        tokio::spawn(client(daemon.url().to_owned(), origin, frame_end, from, Arc::clone(&posed)));
        tokio::time::sleep(WARM_UP + length).await;
        daemon.shutdown().await;
    });
    runtime.shutdown_background();
    (posed, relay)
}

/// Follows the group's records; true when the last byte of the last bird is among `bytes`.
fn ends_frame(bytes: &[u8], at: &mut usize) -> bool {
    let mut ended = false;
    for &byte in bytes {
        *at = if byte & 0x80 != 0 { 1 } else { *at + 1 };
        ended |= *at == RECORD_BYTES && u16::from(byte) == BIRDS;
    }
    ended
}

async fn bare_relay(mut bytes: UnixStream, listener: TcpListener) {
    let (mut client, _) = listener.accept().await.expect("client");
    client.set_nodelay(true).expect("nodelay");
    let mut buffer = [0; 4096];
    while let Ok(n) = bytes.read(&mut buffer).await {
        if n == 0 || client.write_all(&buffer[..n]).await.is_err() {
            return;
        }
    }
}

async fn relay_client(
    address: std::net::SocketAddr,
    origin: Instant,
    frame_end: Arc<AtomicI64>,
    from: i64,
    latencies: Latencies,
) {
    let mut stream = TcpStream::connect(address).await.expect("relay");
    let mut buffer = [0; 4096];
    let mut at = 0;
    while let Ok(n) = stream.read(&mut buffer).await {
        let now = origin.elapsed().as_nanos() as i64;
        if n == 0 {
            return;
        }
        if ends_frame(&buffer[..n], &mut at) && now > from {
            record(&latencies, now - frame_end.load(Ordering::SeqCst));
        }
    }
}

async fn client(url: String, origin: Instant, frame_end: Arc<AtomicI64>, from: i64, latencies: Latencies) {
    let address = url.trim_start_matches("http://").trim_end_matches('/').to_owned();
    let stream = TcpStream::connect(&address).await.expect("daemon");
    stream.set_nodelay(true).expect("nodelay");
    let mut request = format!("ws://{address}/ws").into_client_request().expect("request");
    request.headers_mut().insert("Sec-WebSocket-Protocol", "posed.v1".parse().expect("header"));
    let (mut socket, _) = tokio_tungstenite::client_async(request, stream).await.expect("websocket");
    socket
        .send(Message::text(r#"{"type":"subscribe","id":1,"topics":["sensors"]}"#))
        .await
        .expect("subscribe");
    while let Some(Ok(message)) = socket.next().await {
        let now = origin.elapsed().as_nanos() as i64;
        if message.to_text().is_ok_and(|text| text.starts_with("{\"type\":\"sensors\"")) && now > from {
            record(&latencies, now - frame_end.load(Ordering::SeqCst));
        }
    }
}

fn record(latencies: &Latencies, ns: i64) {
    latencies.lock().expect("not poisoned").saturating_record(ns.max(0) as u64);
}

fn stage() -> Stage {
    let mut text = String::from(
        "name = \"Latency\"\n[[device]]\nname = \"flock\"\ndriver = \"flock-of-birds\"\nport = \"auto\"\n\
         format = \"position-angles\"\n",
    );
    for address in 1..=BIRDS {
        text += &format!("[[sensor]]\nname = \"bird-{address}\"\ndevice = \"flock\"\naddress = {address}\n");
    }
    Stage::parse(&text).expect("a stage")
}

fn virtual_flock() -> posed_simulator::stage::VirtualDevice {
    let sensor = |address| SensorSpec { name: format!("bird-{address}"), device: "flock".into(), address };
    let spec = StageSpec {
        transmitter_in_room: None,
        devices: vec![DeviceSpec {
            name: "flock".into(),
            driver: "flock-of-birds".into(),
            baud: 115_200,
            ..DeviceSpec::default()
        }],
        sensors: (1..=BIRDS).map(sensor).collect(),
    };
    let scenario = Scenario {
        devices: vec![DeviceScenario { name: "flock".into(), rate_hz: 100.0, ..DeviceScenario::default() }],
        ..Scenario::default()
    };
    let stage = VirtualStage::new(&spec, &scenario, Path::new("")).expect("a scenario");
    stage.into_devices().remove(0)
}
