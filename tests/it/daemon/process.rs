//! A running `posed`, and what its clients ask of it.

use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

use posed_recording::{Comparison, Machine, Reader, verify};
use serde_json::{Value, json};
use tokio_tungstenite::connect_async;

use crate::cli::posed;
use crate::server::harness::{Client, get};

/// Longest wait for anything.
pub(crate) const PATIENCE: Duration = Duration::from_secs(120);

/// A daemon that serves; killed when dropped.
pub(crate) struct Posed {
    pub(crate) child: Child,
    pub(crate) address: SocketAddr,
}

impl Posed {
    /// `posed ARGS --listen` on a free port; returns once it has said its address.
    pub(crate) fn start<I: AsRef<std::ffi::OsStr>>(args: impl IntoIterator<Item = I>) -> Self {
        Self::spawn(Command::new(env!("CARGO_BIN_EXE_posed")).args(args).args(["--listen", "127.0.0.1:0"]))
    }

    /// The demo of a stage file that keeps what it learns beside that, as a daemon does.
    pub(crate) fn demo_that_keeps(stage: &Path) -> Self {
        let folder = stage.parent().unwrap();
        Self::start([
            "demo".as_ref(),
            "--stage".as_ref(),
            stage.as_os_str(),
            "--data".as_ref(),
            folder.as_os_str(),
        ])
    }

    /// A demo of a stage file whose log goes to a file, and of which this is to go wrong (`POSED_FAULTS`).
    pub(crate) fn demo_logged(stage: &Path, log: &Path, faults: &str) -> Self {
        let mut demo = Command::new(env!("CARGO_BIN_EXE_posed"));
        demo.args(["demo", "--listen", "127.0.0.1:0", "--stage"]).arg(stage).env("POSED_FAULTS", faults);
        Self::spawn_logged(&mut demo, File::create(log).unwrap().into())
    }

    /// Any command that prints the line with the address.
    pub(crate) fn spawn(command: &mut Command) -> Self {
        Self::spawn_logged(command, Stdio::null())
    }

    /// The same, with where its log goes.
    fn spawn_logged(command: &mut Command, log: Stdio) -> Self {
        let mut child = command.stdout(Stdio::piped()).stderr(log).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let address = line
            .strip_prefix("posed is running: open http://")
            .and_then(|rest| rest.split('/').next())
            .unwrap_or_else(|| panic!("no address in {line:?}"));
        Self { child, address: address.parse().unwrap() }
    }

    /// A client that has been greeted.
    pub(crate) async fn client(&self) -> Client {
        self.client_with("").await
    }

    /// The same for who has a token, as `?token=TOKEN`.
    pub(crate) async fn client_with(&self, query: &str) -> Client {
        let (socket, _) = connect_async(format!("ws://{}/ws{query}", self.address)).await.unwrap();
        let mut client = Client { socket, protocol: None };
        assert_eq!(client.next().await["type"], "hello");
        client
    }

    /// A client that gets these topics.
    pub(crate) async fn subscriber(&self, topics: &[&str]) -> Client {
        let mut client = self.client().await;
        client.subscribe(topics).await;
        client
    }

    /// The whole answer to a GET.
    pub(crate) async fn get(&self, path: &str) -> String {
        get(self.address, &format!("GET {path} HTTP/1.1\r\nHost: {}\r\n\r\n", self.address)).await
    }

    pub(crate) fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args([&format!("-{name}"), &pid]).status().unwrap().success());
    }

    /// Sends a signal and waits for the end.
    pub(crate) async fn end(self, signal: &str) -> ExitStatus {
        self.signal(signal);
        let ended = tokio::task::spawn_blocking(move || {
            let mut this = self;
            this.child.wait().unwrap()
        });
        tokio::time::timeout(PATIENCE, ended).await.expect("it ends").unwrap()
    }
}

impl Drop for Posed {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The first message that fits; fails with what was waited for.
pub(crate) async fn until(client: &mut Client, what: &str, fits: impl Fn(&Value) -> bool) -> Value {
    let found = async {
        loop {
            let message = client.next().await;
            if fits(&message) {
                return message;
            }
        }
    };
    tokio::time::timeout(PATIENCE, found).await.unwrap_or_else(|_| panic!("no message: {what}"))
}

/// So many more `sensors` messages.
pub(crate) async fn frames(client: &mut Client, count: usize) -> Vec<Value> {
    let mut frames = Vec::new();
    while frames.len() < count {
        frames.push(until(client, "sensors", |message| message["type"] == "sensors").await);
    }
    frames
}

pub(crate) async fn ok(client: &mut Client, request: Value) -> Value {
    let reply = client.ask(request.clone()).await;
    assert_eq!(reply["type"], "ok", "{request}: {reply}");
    reply["result"].clone()
}

/// The code and the sentence of an error.
pub(crate) async fn refused(client: &mut Client, request: Value) -> (String, String) {
    let reply = client.ask(request.clone()).await;
    assert_eq!(reply["type"], "error", "{request}: {reply}");
    let text = |key: &str| reply[key].as_str().unwrap().to_owned();
    (text("code"), text("message"))
}

/// A stage file for `posed demo --stage`: two devices with one bird each, awake at once, `more` behind it.
pub(crate) fn two_devices(folder: &Path, more: &str) -> PathBuf {
    let mut text = String::from("name = \"Two\"\n");
    for device in ["one", "two"] {
        text.push_str(&format!(
            "[[device]]\nname = \"{device}\"\ndriver = \"flock-of-birds\"\nport = \"/dev/{device}\"\n\
             [[sensor]]\nname = \"of {device}\"\ndevice = \"{device}\"\naddress = 1\n"
        ));
    }
    text.push_str("[[simulation.device]]\nname = \"two\"\nboot_ms = 0.0\n");
    text.push_str("[[simulation.device]]\nname = \"one\"\nboot_ms = 0.0\n");
    text.push_str(more);
    let path = folder.join("stage.toml");
    fs::write(&path, text).unwrap();
    path
}

/// A stage file with one device at `port`.
pub(crate) fn one_device(folder: &Path, port: &str, more: &str) -> PathBuf {
    let path = folder.join("one.toml");
    let text = format!(
        "name = \"One\"\n[[device]]\nname = \"flock\"\ndriver = \"flock-of-birds\"\nport = \"{port}\"\n\
         [[sensor]]\nname = \"a\"\ndevice = \"flock\"\naddress = 1\n{more}"
    );
    fs::write(&path, text).unwrap();
    path
}

/// Runs a command that must succeed.
pub(crate) fn succeed<I: AsRef<std::ffi::OsStr>>(args: impl IntoIterator<Item = I>) {
    let output = posed(args);
    let emitted = [output.stdout, output.stderr].concat();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&emitted));
}

/// Holds a recording with messages against its own replay in every way there is: byte for byte.
pub(crate) fn replays(recording: &Path) {
    let messages = replays_alike(recording);
    let mut reader = Reader::open(recording).unwrap();
    let (_, mut machine) = Machine::as_recorded(reader.header()).unwrap();
    let verdict = verify(&mut reader, &mut machine, Comparison { tolerance: None }).unwrap();
    assert_eq!(verdict.messages, messages);
}

/// Holds replays of any recording, on two kinds of processor, and its export against one another; the number of messages. So the one by
/// another build that `POSED_OTHER_BUILD` names (a path): `packaging/build static` names the static binary.
pub(crate) fn replays_alike(recording: &Path) -> u64 {
    let folder = tempfile::tempdir().unwrap();
    let [first, second, recorded] =
        ["1.jsonl", "2.jsonl", "recorded.jsonl"].map(|name| folder.path().join(name));
    let os = |path: &Path| path.as_os_str().to_owned();
    succeed(["replay".into(), os(recording), "-o".into(), os(&first)]);
    // On an older processor, as far as the C library can tell.
    let plain = Command::new(env!("CARGO_BIN_EXE_posed"))
        .args(["replay".as_ref(), recording.as_os_str(), "-o".as_ref(), second.as_os_str()])
        .env("GLIBC_TUNABLES", "glibc.cpu.hwcaps=-AVX2,-AVX,-FMA,-FMA4,-AVX512F,-SSE4_1")
        .output()
        .unwrap();
    assert!(plain.status.success(), "{}", String::from_utf8_lossy(&plain.stderr));
    if let Some(other) = std::env::var_os("POSED_OTHER_BUILD") {
        let output = Command::new(other)
            .arg("replay")
            .arg(recording)
            .args(["--expect".as_ref(), first.as_os_str()])
            .output()
            .unwrap();
        assert!(output.status.success(), "another build: {}", String::from_utf8_lossy(&output.stderr));
    }
    succeed(["export".into(), os(recording), "--to".into(), "jsonl".into(), "-o".into(), os(&recorded)]);
    succeed(["replay".into(), os(recording), "--expect".into(), os(&recorded)]);
    let [first, second, recorded] = [first, second, recorded].map(|path| fs::read(path).unwrap());
    assert!(!first.is_empty() && first == second && first == recorded);
    first.split(|&byte| byte == b'\n').count() as u64 - 1
}

/// A `sensors` message in which every sensor is good.
pub(crate) fn all_ok(message: &Value) -> bool {
    message["type"] == "sensors"
        && message["sensors"].as_array().unwrap().iter().all(|sensor| sensor["state"] == "ok")
}

pub(crate) fn record_start(name: &str) -> Value {
    json!({"type": "record.start", "name": name})
}
