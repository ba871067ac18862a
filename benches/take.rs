//! How soon a take of an hour is there: opened, at any time of it, in a list.
//!
//! ```text
//! cargo bench --profile demo --bench take                 an hour of `posed demo`, made in minutes
//! cargo bench --profile demo --bench take -- 600          ten minutes
//! cargo bench --profile demo --bench take -- take.mcap    any recording
//! cargo bench --profile demo --bench take -- --keep take.mcap [SECONDS]   only makes it, for other benches
//! ```
//! The take is made in simulated time, with everything that a live stage records. Times are those of a client of `posed replay` on the same
//! machine: to its greeting, to the first poses, to the answer of `replay.look` at 300 times all over the take, and to the end of jumps, at once and after the
//! take was passed through once. `library.list` is of 300 copies (links) of it.
#![expect(clippy::print_stdout, reason = "the table is what it is for")]
#![expect(clippy::unwrap_used, clippy::disallowed_methods, reason = "a bench may panic, and measures time")]

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use posed_daemon::Playback;
use posed_drivers::Timestamp;
use posed_protocol::{Fields, Publisher};
use posed_recording::{Brief, Chunks, Header, Looker, Scribe, Snapshot};
use posed_stage::input::Entry;
use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

const DEMO: &str = include_str!("../config/demo.toml");
/// When the take begins, s.
const BEGUN_S: f64 = 20.0;
/// Looks, and takes in the list.
const MANY: usize = 300;
/// Distance of two looks: a client may send 50 messages a second.
const PACE: Duration = Duration::from_millis(25);

fn main() {
    let mut arguments = std::env::args().skip(1).skip_while(|argument| argument != "--keep");
    if let (Some(_), Some(path)) = (arguments.next(), arguments.next()) {
        let seconds = arguments.next().and_then(|argument| argument.parse().ok());
        return make(&PathBuf::from(path), seconds.unwrap_or(3600.0));
    }
    let argument = std::env::args().skip(1).find(|argument| !argument.starts_with("--"));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take-000.mcap");
    match argument.as_deref().map(|argument| (argument, argument.parse::<f64>())) {
        Some((recording, Err(_))) => _ = std::fs::copy(recording, &path).unwrap(),
        Some((_, Ok(seconds))) => make(&path, seconds),
        None => make(&path, 3600.0),
    }
    for number in 1..MANY {
        let copy = folder.path().join(format!("take-{number:03}.mcap"));
        std::fs::hard_link(&path, copy).unwrap();
    }
    let brief = Brief::read(&path).unwrap();
    let megabytes = path.metadata().unwrap().len() as f64 * 1e-6;
    println!("take: {:.0} s, {megabytes:.0} MB", brief.length_s.unwrap());
    tokio::runtime::Runtime::new().unwrap().block_on(measure(&path, &brief));
}

/// A take of `posed demo`, so many seconds long, in chunks of half a second; begun when all devices stream, as most are.
fn make(path: &PathBuf, seconds: f64) {
    let (stage, mut rig) = posed_rig::demo();
    rig.run_until(BEGUN_S);
    rig.forget();
    let publisher = Publisher::new(&stage, Fields::all());
    let snapshot = Snapshot {
        pipeline: rig.pipeline.snapshot(),
        publisher: rmp_serde::to_vec(&publisher.state()).unwrap(),
    };
    let header = Header {
        begun: Timestamp::from_secs_f64(BEGUN_S),
        models: rig.pipeline.models().clone(),
        snapshot: Some(snapshot),
        ..Header::new(&stage, DEMO, 1_700_000_000_000_000_000)
    };
    let mut scribe = Scribe::new(BufWriter::new(File::create(path).unwrap()), header).unwrap();
    let begun = Instant::now();
    for half_seconds in 1..=(2.0 * seconds) as u32 {
        rig.run_until(BEGUN_S + 0.5 * f64::from(half_seconds));
        let entry = |entry: &Entry| _ = scribe.entry(entry).unwrap();
        rig.log.iter().for_each(entry);
        rig.forget();
        scribe.flush().unwrap();
    }
    scribe.finish("the end").unwrap();
    println!("made in {:.0} s", begun.elapsed().as_secs_f64());
}

/// A client of the replay.
struct Client(WebSocketStream<MaybeTlsStream<tokio::net::TcpStream>>);

impl Client {
    async fn next(&mut self) -> Value {
        loop {
            if let Message::Text(text) = self.0.next().await.unwrap().unwrap() {
                return serde_json::from_str(&text).unwrap();
            }
        }
    }

    async fn until(&mut self, fits: impl Fn(&Value) -> bool) -> Value {
        loop {
            let message = self.next().await;
            if fits(&message) {
                return message;
            }
        }
    }

    /// The answer to a request, after so many ms.
    async fn ask(&mut self, mut request: Value) -> (Value, f64) {
        let since = Instant::now();
        request["id"] = json!(1);
        self.0.send(Message::text(request.to_string())).await.unwrap();
        let answer = self.until(|message| message["type"] == "ok" || message["type"] == "error").await;
        assert_eq!(answer["type"], "ok", "{answer}");
        (answer["result"].clone(), ms(since))
    }

    /// How long a jump to this time takes to its end, ms.
    async fn jump(&mut self, t_s: f64) -> f64 {
        let since = Instant::now();
        let (started, _) = self.ask(json!({"type": "replay.seek", "t_s": t_s})).await;
        let is_over = |message: &Value| {
            let jobs = message["jobs"].as_array();
            jobs.is_some_and(|jobs| {
                jobs.iter().any(|job| job["job"] == started["job"] && job["state"] != "running")
            })
        };
        self.until(is_over).await;
        ms(since)
    }
}

fn ms(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

/// Median, 99 % and longest.
fn spread(mut times_ms: Vec<f64>) -> String {
    times_ms.sort_by(f64::total_cmp);
    let at = |share: f64| times_ms[((times_ms.len() - 1) as f64 * share) as usize];
    format!("median {:.2} ms, 99 % {:.2} ms, longest {:.2} ms", at(0.5), at(0.99), at(1.0))
}

/// What a look takes by itself, all over the take.
fn look_alone(path: &Path, place: &impl Fn(f64) -> f64) -> (f64, Vec<f64>) {
    let since = Instant::now();
    let chunks = Arc::new(Chunks::read(path).unwrap().unwrap());
    let mut looker = Looker::new(chunks).unwrap();
    let opened_ms = ms(since);
    let look = |number: usize| {
        let since = Instant::now();
        let look = looker.at(Timestamp::from_secs_f64(place(number as f64 * 0.618 % 1.0))).unwrap();
        assert!(!look.sensors.is_empty());
        ms(since)
    };
    (opened_ms, (0..MANY).map(look).collect())
}

async fn measure(path: &Path, brief: &Brief) {
    let (begun_s, length_s) = (brief.begun.as_secs_f64(), brief.length_s.unwrap());
    let place = |share: f64| begun_s + share * length_s;
    let (opened_ms, alone) = look_alone(path, &place);
    println!("index {opened_ms:.0} ms; look by itself: {}", spread(alone));

    let since = Instant::now();
    let playback = Playback::start(path, Some("127.0.0.1:0".to_owned()), 1.0).unwrap();
    let opened_ms = ms(since);
    let url = playback.url().replace("http://", "ws://") + "ws";
    let (socket, _) = connect_async(url).await.unwrap();
    let mut client = Client(socket);
    client.until(|message| message["type"] == "hello").await;
    let greeted_ms = ms(since);
    client.ask(json!({"type": "subscribe", "topics": ["sensors", "jobs", "status"]})).await;
    client.until(|message| message["type"] == "sensors").await;
    println!("opened {opened_ms:.0} ms, greeted {greeted_ms:.0} ms, first poses {:.0} ms", ms(since));

    let mut scattered = Vec::new();
    let mut along = Vec::new();
    let mut pace = tokio::time::interval(PACE);
    for number in 0..MANY {
        pace.tick().await;
        // All over the take, never twice at one place; and as who drags along it, a minute in ten seconds.
        let (_, took_ms) = client.ask(look(place(number as f64 * 0.618 % 1.0))).await;
        scattered.push(took_ms);
        pace.tick().await;
        let (_, took_ms) = client.ask(look(place(0.4) + number as f64 * 0.2)).await;
        along.push(took_ms);
    }
    println!("look, anywhere: {}", spread(scattered));
    println!("look, along: {}", spread(along));

    println!("jump to 5/6 at once: {:.0} ms", client.jump(place(5.0 / 6.0)).await);
    let passed = |message: &Value| {
        message["replay"]["passed_s"].as_f64().is_some_and(|passed_s| passed_s >= place(0.99))
    };
    client.until(passed).await;
    println!("passed through after {:.0} s", ms(since) * 1e-3);
    let mut jumps = Vec::new();
    for number in 0..20 {
        jumps.push(client.jump(place(f64::from(number) * 0.618 % 1.0)).await);
    }
    println!("jump, anywhere, passed: {}", spread(jumps));

    let (listed, first_ms) = client.ask(json!({"type": "library.list"})).await;
    let (_, again_ms) = client.ask(json!({"type": "library.list"})).await;
    let count = listed["takes"].as_array().unwrap().len();
    println!("list of {count}: {first_ms:.0} ms, again {again_ms:.0} ms");
    playback.shutdown().await;
}

fn look(t_s: f64) -> Value {
    json!({"type": "replay.look", "t_s": t_s})
}
