//! The example trainer: its session, compiled, on the messages of a simulated stage.
//!
//! Runs where Node and the example's packages are installed (`npm install` in `examples/trainer`), and says so where not.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::{Value, json};

use crate::exercise::live_messages;

/// Feeds messages to a session over a socket of its own, and prints the state.
const DRIVER: &str = r#"
import { Session } from "./examples/trainer/session.js";
import { Client } from "./clients/typescript/src/client.js";
import { createInterface } from "node:readline";
const sent = [];
const socket = { send: (text) => sent.push(JSON.parse(text)), close() {}, onopen: null, onmessage: null, onclose: null };
const client = new Client("ws://stage/ws", { socket: () => socket });
const session = new Session(client, () => {});
client.connect();
socket.onopen();
for await (const line of createInterface({ input: process.stdin })) socket.onmessage({ data: line });
session.select("curl", 10, 3, 60);
console.log(JSON.stringify({ state: session.state, sent }));
process.exit(0);
"#;

#[test]
fn it_shows_what_the_daemon_says_and_asks_what_the_daemon_understands() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/trainer");
    let lines = |file| std::fs::read_to_string(folder.join(file)).unwrap().lines().count();
    // It is to be read at one sitting.
    assert!(lines("session.ts") + lines("page.ts") < 200);
    let esbuild = folder.join("node_modules/.bin/esbuild");
    if !esbuild.exists() {
        println!("skipped: run `npm install` in examples/trainer to test it");
        return;
    }
    let checked =
        Command::new(folder.join("node_modules/.bin/tsc")).arg("--noEmit").current_dir(&folder).output();
    let checked = checked.unwrap();
    assert!(checked.status.success(), "{}", String::from_utf8_lossy(&checked.stdout));
    let build = tempfile::tempdir().unwrap();
    let out = format!("--outdir={}", build.path().display());
    let bundled = Command::new(esbuild)
        .args(["session.ts", "../../clients/typescript/src/client.ts", "--bundle", "--format=esm"])
        .args(["--log-level=error", &out])
        .current_dir(&folder)
        .status();
    assert!(bundled.unwrap().success());
    std::fs::write(build.path().join("driver.mjs"), DRIVER).unwrap();
    let mut node = Command::new("node")
        .arg(build.path().join("driver.mjs"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut input = node.stdin.take().unwrap();
    for message in live_messages() {
        writeln!(input, "{message}").unwrap();
    }
    drop(input);
    let output = node.wait_with_output().unwrap();
    let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(answer["state"]["known"], json!(["curl"]));
    let exercise = &answer["state"]["selected"]["exercises"][0];
    assert_eq!((&exercise["exercise"], &exercise["count"]), (&json!("curl"), &json!(6)));
    assert_eq!(answer["state"]["feedback"]["good"], true);
    for request in answer["sent"].as_array().unwrap() {
        let text = request.to_string();
        let parsed = posed_protocol::parse(posed_protocol::Encoding::Json, text.as_bytes());
        assert!(parsed.is_ok(), "{text}: {parsed:?}");
    }
}
