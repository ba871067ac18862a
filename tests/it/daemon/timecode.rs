//! Time code that comes while a stage runs: on messages, in recordings, when it stops, and where it cannot be read.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use posed_recording::Info;
use posed_timecode::{Counting, Frame, ltc, mtc};
use serde_json::Value;

use super::process::{Posed, ok, record_start, replays, two_devices, until};
use super::recordings::FULL;
use crate::chromium::{self, Browser};
use crate::cli::posed;
use crate::server::harness::Client;

const COUNTING: Counting = Counting { frames_per_s: 25, drop: false };
const FIRST: Frame = Frame::new(10, 0, 0, 0);

/// A generator of 25 frames a second on a FIFO, from ten o'clock on; it ends when dropped.
struct Generator {
    /// When it was ten, s since 1970.
    began_s: f64,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Generator {
    /// Writes what is due, asked by the seconds since it began.
    #[expect(clippy::disallowed_methods, reason = "a generator sends in real time")]
    fn start(mut fifo: File, mut due: impl FnMut(f64) -> Vec<u8> + Send + 'static) -> Self {
        let ends = Arc::new(AtomicBool::new(false));
        let (began, asked) = (Instant::now(), Arc::clone(&ends));
        let began_s = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64();
        let thread = std::thread::spawn(move || {
            while !asked.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(5));
                if fifo.write_all(&due(began.elapsed().as_secs_f64())).is_err() {
                    return;
                }
            }
        });
        Self { began_s, ends, thread: Some(thread) }
    }

    /// Seconds of code at a moment, s since 1970.
    fn code_s(&self, utc_s: f64) -> f64 {
        10.0 * 3600.0 + utc_s - self.began_s
    }
}

/// Samples of a sound card.
fn sound() -> impl FnMut(f64) -> Vec<u8> {
    let mut encoder = ltc::Encoder::new(48_000.0, 25.0, COUNTING, FIRST);
    let mut written = 0;
    move |now_s| {
        let due = (now_s * 48_000.0) as u64;
        let samples = (written..due).flat_map(|_| ((encoder.sample() * 20_000.0) as i16).to_le_bytes());
        written = due;
        samples.collect()
    }
}

/// Quarter frames of a MIDI port.
fn midi() -> impl FnMut(f64) -> Vec<u8> {
    let first = COUNTING.number(FIRST).unwrap();
    let mut written = 0;
    move |now_s| {
        let due = (now_s * 100.0) as u32;
        let quarter = |at: u32| {
            let time = mtc::quarter_frames(COUNTING.frame(first + at / 8 * 2), COUNTING);
            time[at as usize % 8]
        };
        let bytes = (written..due).flat_map(quarter);
        written = due;
        bytes.collect()
    }
}

impl Drop for Generator {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn fifo(folder: &Path) -> PathBuf {
    let path = folder.join("ltc.pcm");
    assert!(Command::new("mkfifo").arg(&path).status().unwrap().success());
    path
}

/// Every row of an exported table has the code of its time.
fn in_a_table(folder: &Path, take: &Path, began_t_s: f64) {
    let table = folder.join("poses.csv");
    let export = ["export", take.to_str().unwrap(), "--to", "csv", "-o", table.to_str().unwrap()];
    assert!(posed(export).status.success());
    let text = std::fs::read_to_string(table).unwrap();
    let mut rows = text.lines();
    assert_eq!(rows.next(), Some("t,timecode,sensor,x,y,z,qw,qx,qy,qz,state"));
    let mut compared = 0;
    for row in rows {
        let cells: Vec<&str> = row.split(',').collect();
        if !cells[1].is_empty() {
            let off_s =
                label_s(&cells[1].into()) - 10.0 * 3600.0 - (cells[0].parse::<f64>().unwrap() - began_t_s);
            assert!(off_s.abs() < 0.04, "{off_s}: {row}");
            compared += 1;
        }
    }
    assert!(compared > 100, "{compared}");
}

/// Seconds that a label of 25 frames says.
fn label_s(label: &Value) -> f64 {
    let numbers: Vec<f64> =
        label.as_str().unwrap().splitn(4, ':').map(|number| number.parse().unwrap()).collect();
    numbers[0] * 3600.0 + numbers[1] * 60.0 + numbers[2] + numbers[3] / 25.0
}

fn names(status: &Value, sentence: &str) -> bool {
    let problems = status["problems"].as_array().into_iter().flatten();
    problems.into_iter().any(|problem| {
        problem["code"] == "timecode" && problem["message"].as_str().unwrap().contains(sentence)
    })
}

#[tokio::test]
async fn messages_and_takes_carry_the_code_and_a_generator_that_stops_is_carried_on() {
    let folder = tempfile::tempdir().unwrap();
    let fifo = fifo(folder.path());
    let stage = two_devices(folder.path(), &format!("[timecode]\npath = \"ltc.pcm\"\n{FULL}"));
    let posed = Posed::demo_that_keeps(&stage);
    let mut client = posed.client().await;
    client.subscribe(&["status"]).await;
    until(&mut client, "nothing comes", |message| names(message, "no samples come")).await;
    let epoch_s = epoch_s(&posed).await;
    client.subscribe(&["sensors", "timecode"]).await;
    let opens = move || OpenOptions::new().write(true).open(fifo).unwrap();
    let generator = Generator::start(tokio::task::spawn_blocking(opens).await.unwrap(), sound());
    let locked = |message: &Value| message["type"] == "timecode" && message["state"] == "locked";
    let code = until(&mut client, "locked", |message| locked(message) && message["rate"] == "25").await;
    assert!(code["sigma_s"].as_f64().unwrap() < 0.01 && code["jumps"] == 0, "{code}");
    ok(&mut client, record_start("take")).await;
    frames_have_it(&mut client, &generator, epoch_s).await;
    if chromium::is_wanted() {
        let mut browser = Browser::open(&format!("http://{}/", posed.address)).await;
        browser.until("document.getElementById('timecode')?.textContent.startsWith('10:0') === true").await;
        assert_eq!(browser.complaints, Vec::<String>::new());
    }
    let generator_began_s = generator.began_s;
    drop(generator);
    let held = until(&mut client, "holding", |message| message["state"] == "holding").await;
    assert!(held["timecode"].is_string() && held["sigma_s"].as_f64() > Some(0.0));
    until(&mut client, "it is said", |message| names(message, "nobody writes to")).await;
    until(&mut client, "carried on", |message| {
        message["type"] == "sensors" && message["timecode"].is_string()
    })
    .await;
    ok(&mut client, serde_json::json!({"type": "record.stop"})).await;
    assert_eq!(posed.end("INT").await.code(), Some(0));
    let take = folder.path().join("recordings/take.mcap");
    let info = Info::read(&take, |_| ()).unwrap();
    let timecode = info.timecode.unwrap();
    assert!(info.topics["/input/timecode"] > 10 && timecode.from.starts_with("10:00:0"), "{timecode:?}");
    replays(&take);
    in_a_table(folder.path(), &take, generator_began_s - epoch_s);
    lines_up(folder.path(), &take, generator_began_s - epoch_s);
}

/// A camera's sound that begins at one second past ten lies there in the take.
fn lines_up(folder: &Path, take: &Path, ten_s: f64) {
    let sound = folder.join("camera.wav");
    let spec = hound::WavSpec {
        channels: 2,
        sample_rate: 44_100,
        bits_per_sample: 24,
        sample_format: hound::SampleFormat::Int,
    };
    let mut file = hound::WavWriter::create(&sound, spec).unwrap();
    let mut encoder = ltc::Encoder::new(44_100.0, 25.0, COUNTING, Frame::new(10, 0, 1, 0));
    for _ in 0..3 * 44_100 {
        file.write_sample(0).unwrap();
        file.write_sample((f64::from(encoder.sample()) * 4e6) as i32).unwrap();
    }
    file.finalize().unwrap();
    let found = posed([
        "timecode".as_ref(),
        sound.as_os_str(),
        "--channel".as_ref(),
        "2".as_ref(),
        "--take".as_ref(),
        take.as_os_str(),
        "--json".as_ref(),
    ]);
    let found: Value = serde_json::from_slice(&found.stdout).unwrap();
    let off_s = found["begins_at_s"].as_f64().unwrap() - (ten_s + 1.0);
    assert!(off_s.abs() < 0.04, "{off_s}: {found}");
    assert_eq!((&found["stretches"][0]["rate"], &found["stretches"][0]["gaps"]), (&"25".into(), &0.into()));
    // On the other channel is nothing, and no sensor would have felt a clap.
    let silent = posed(["timecode".as_ref(), sound.as_os_str()]);
    let said = String::from_utf8(silent.stderr).unwrap();
    assert!(silent.status.code() == Some(1) && said.contains("--channel names another"), "{said}");
    let claps = posed(["timecode".as_ref(), take.as_os_str(), "--claps".as_ref()]);
    let said = String::from_utf8(claps.stderr).unwrap();
    assert!(claps.status.code() == Some(1) && said.contains("no sensor measures acceleration"), "{said}");
    let said = String::from_utf8(posed(["timecode".as_ref(), take.as_os_str()]).stdout).unwrap();
    assert!(said.starts_with("timecode  10:00:0") && said.contains(" at 25, "), "{said}");
}

/// When the stage's times are 0, s since 1970, as a new client is told.
async fn epoch_s(posed: &Posed) -> f64 {
    let (socket, _) = tokio_tungstenite::connect_async(format!("ws://{}/ws", posed.address)).await.unwrap();
    let hello = Client { socket, protocol: None }.next().await;
    let utc: jiff::Timestamp = hello["epoch_utc"].as_str().unwrap().parse().unwrap();
    utc.as_nanosecond() as f64 * 1e-9
}

/// A hundred frames have the generator's code.
async fn frames_have_it(client: &mut Client, generator: &Generator, epoch_s: f64) {
    for _ in 0..100 {
        let message = until(client, "a frame", |message| message["type"] == "sensors").await;
        let utc_s = epoch_s + message["t_s"].as_f64().unwrap();
        let off_s = label_s(&message["timecode"]) - generator.code_s(utc_s);
        // The generator writes 5 ms late, on a busy machine later: by how much a code may be off is measured elsewhere.
        assert!(off_s.abs() < 0.04, "{off_s}: {message}");
    }
}

#[tokio::test]
async fn midi_carries_the_code_and_what_reads_it_begins_again_after_a_panic() {
    let folder = tempfile::tempdir().unwrap();
    let fifo = fifo(folder.path());
    let stage = two_devices(folder.path(), "[timecode]\nsignal = \"mtc\"\npath = \"ltc.pcm\"\n");
    // A port outlives who reads it: open in both directions, a FIFO does, too.
    let port = OpenOptions::new().read(true).write(true).open(fifo).unwrap();
    let log = folder.path().join("log");
    let posed = Posed::demo_logged(&stage, &log, "timecode=panic@400");
    let mut client = posed.subscriber(&["sensors", "status", "timecode"]).await;
    until(&mut client, "nothing comes", |message| names(message, "the MIDI port is open")).await;
    let epoch_s = epoch_s(&posed).await;
    let generator = Generator::start(port, midi());
    let locked = |message: &Value| message["type"] == "timecode" && message["state"] == "locked";
    let code = until(&mut client, "locked", locked).await;
    assert!(code["rate"] == "25" && code["jumps"] == 0, "{code}");
    frames_have_it(&mut client, &generator, epoch_s).await;
    let panicked = |_: &Value| {
        std::fs::read_to_string(&log).unwrap().contains("time code: what reads it had a fault of its own")
    };
    until(&mut client, "the panic", panicked).await;
    until(&mut client, "carried on", |message| message["state"] == "holding").await;
    let again = until(&mut client, "locked again", locked).await;
    assert_eq!(again["jumps"], 0, "{again}");
    frames_have_it(&mut client, &generator, epoch_s).await;
    assert_eq!(posed.end("INT").await.code(), Some(0));
}

#[tokio::test]
async fn a_source_that_is_none_is_named_with_what_to_do_and_disturbs_nothing() {
    let cases = [
        ("command = [\"posed-no-such-program\"]", "install it"),
        ("command = [\"sh\", \"-c\", \"exit 3\"]", "run it by hand"),
        ("path = \"no-such-fifo\"", "check timecode.path"),
        ("path = \"stage.toml\"", "is a file"),
        ("command = [\"sh\", \"-c\", \"while head -c 9600 /dev/zero; do sleep 0.1; done\"]", "only silence"),
        ("command = [\"cat\", \"/dev/urandom\"]", "faster than time passes"),
    ];
    // All at once: it takes seconds until silence counts.
    let running = cases.map(|(timecode, sentence)| {
        let folder = tempfile::tempdir().unwrap();
        let stage = two_devices(folder.path(), &format!("[timecode]\n{timecode}\n"));
        (Posed::demo_that_keeps(&stage), folder, sentence)
    });
    for (posed, _folder, sentence) in &running {
        let mut client = posed.subscriber(&["sensors", "status"]).await;
        until(&mut client, sentence, |message| names(message, sentence)).await;
        let frame = until(&mut client, "a frame", super::process::all_ok).await;
        assert_eq!(frame["timecode"], Value::Null);
    }
}
