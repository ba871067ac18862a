//! The recipes of `examples/recipes`, as they stand there, on takes that are played from files.
//!
//! In Python where `POSED_TEST_READERS` names the folder that `tests/readers/install` has filled, in TypeScript where the packages of `clients/typescript` and
//! `examples/trainer` are installed.

use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use posed_rig::{Rig, people_toml, record};
use posed_simulator::body::Activity;
use posed_stage::Stage;
use serde_json::{Value, json};

use crate::exercise::live_messages;

/// How much faster they are played than they happened.
const SPEED: f64 = 10.0;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).to_owned()
}

/// Messages as a file that can be played in a tenth of the time.
fn write(path: &Path, messages: &[Value]) {
    let mut lines = String::new();
    for message in messages {
        let mut message = message.clone();
        message["t_s"] = json!(message["t_s"].as_f64().unwrap() / SPEED);
        lines += &format!("{message}\n");
    }
    std::fs::write(path, lines).unwrap();
}

/// What `python RECIPE ARGUMENTS` prints; `None` where there is no Python with what the client needs.
fn python(recipe: &str, arguments: &[&str]) -> Option<String> {
    let Some(readers) = std::env::var_os("POSED_TEST_READERS") else {
        println!("skipped: set POSED_TEST_READERS to the folder that tests/readers/install has filled");
        return None;
    };
    let done = Command::new(Path::new(&readers).join("client/bin/python"))
        .arg(root().join("examples/recipes").join(recipe))
        .args(arguments)
        .env("PYTHONPATH", root().join("clients/python/src"))
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .output()
        .unwrap();
    assert!(done.status.success(), "{recipe}: {}", String::from_utf8_lossy(&done.stderr));
    Some(String::from_utf8(done.stdout).unwrap())
}

#[test]
fn each_is_below_thirty_lines_and_in_the_list() {
    let list = std::fs::read_to_string(root().join("examples/recipes/README.md")).unwrap();
    let mut count = 0;
    for entry in std::fs::read_dir(root().join("examples/recipes")).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if name != "README.md" {
            count += 1;
            let lines = std::fs::read_to_string(&path).unwrap().lines().count();
            assert!(lines < 30 && list.contains(&format!("({name})")), "{name}: {lines} lines");
        }
    }
    assert_eq!(count, 3);
}

#[test]
fn five_repetitions_are_counted_and_then_it_beeps() {
    let folder = tempfile::tempdir().unwrap();
    let take = folder.path().join("curls.jsonl");
    write(&take, &live_messages());
    let Some(said) = python("count_to_five.py", &[take.to_str().unwrap()]) else { return };
    let lines: Vec<&str> = said.lines().collect();
    assert_eq!(lines.len(), 6, "{said}");
    for (number, line) in (1..=5).zip(&lines) {
        assert!(line.starts_with(&format!("curl {number} ")), "{said}");
    }
    assert_eq!(lines[5], "\u{7}done");
}

#[test]
fn a_game_gets_the_angle_of_an_elbow() {
    let folder = tempfile::tempdir().unwrap();
    let (text, scenario) = people_toml(&[("anna", 1.8, Activity::Curls)]);
    let mut rig = Rig::new(&Stage::parse(&text).unwrap(), &scenario);
    rig.run_until(5.0);
    let bodies = record(&folder.path().join("take.mcap"), &rig.log, &text, "body");
    let take = folder.path().join("curls.jsonl");
    write(&take, &bodies);
    let game = UdpSocket::bind("127.0.0.1:0").unwrap();
    game.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    let address = game.local_addr().unwrap().to_string();
    let Some(said) = python("angle_to_game.py", &[take.to_str().unwrap(), &address]) else { return };
    assert_eq!(said.trim(), "the take is over");
    game.set_nonblocking(true).unwrap();
    let mut datagram = [0; 16];
    let values: Vec<f64> = std::iter::from_fn(|| {
        let length = game.recv(&mut datagram).ok()?;
        Some(std::str::from_utf8(&datagram[..length]).unwrap().parse().unwrap())
    })
    .collect();
    let (least, most) =
        values.iter().fold((1.0_f64, 0.0_f64), |(a, b), value| (a.min(*value), b.max(*value)));
    assert!(values.len() >= 8 && least < 0.2 && most > 0.6, "{values:?}");
}

/// Prints what the recipe says of the file that it is given.
const DRIVER: &str = r#"
import { readFileSync } from "node:fs";
import { alarm } from "./recipe.js";
import { Client, mockStage } from "./client.js";
const socket = mockStage(readFileSync(process.argv[2], "utf8"), { speed: Infinity, onEnd: () => client.close() });
const client = new Client("ws://mock", { socket });
const said = [];
alarm(client, (sentence) => said.push(sentence));
client.connect();
process.on("exit", () => console.log(JSON.stringify(said)));
"#;

#[test]
fn a_sensor_that_fails_raises_the_alarm_until_it_is_back() {
    let modules = ["clients/typescript", "examples/trainer"]
        .map(|folder| root().join(folder).join("node_modules/.bin"));
    let [compiler, esbuild] = [modules[0].join("tsc"), modules[1].join("esbuild")];
    if !compiler.exists() || !esbuild.exists() {
        println!(
            "skipped: run `npm ci --ignore-scripts` in clients/typescript and examples/trainer to test it"
        );
        return;
    }
    let recipe = root().join("examples/recipes/sensor_alarm.ts");
    let options = "--noEmit --strict --exactOptionalPropertyTypes --skipLibCheck --target ES2022 --module ESNext --moduleResolution bundler --lib ES2022,DOM";
    let checked = Command::new(compiler).args(options.split(' ')).arg(&recipe).output().unwrap();
    assert!(checked.status.success(), "{}", String::from_utf8_lossy(&checked.stdout));
    let build = tempfile::tempdir().unwrap();
    for (name, source) in [("recipe", recipe), ("client", root().join("clients/typescript/src/index.ts"))] {
        let out = format!("--outfile={}", build.path().join(name).with_extension("js").display());
        let bundled = Command::new(&esbuild)
            .arg(source)
            .args(["--bundle", "--format=esm", "--log-level=error", &out])
            .status();
        assert!(bundled.unwrap().success());
    }
    std::fs::write(build.path().join("package.json"), r#"{"type":"module"}"#).unwrap();
    std::fs::write(build.path().join("driver.js"), DRIVER).unwrap();
    let fault = |t_s: f64, id: u64, sensor: &str, active: bool| {
        json!({"type": "faults", "seq": 0, "dropped": 0, "t_s": t_s, "event_id": id, "t_valid_s": t_s,
            "event": "fault", "sensor": sensor, "cause": "stuck", "active": active})
    };
    let take = build.path().join("take.jsonl");
    let faults = [
        fault(1.0, 1, "wand", true),
        fault(2.0, 2, "chest", true),
        fault(3.0, 3, "wand", false),
        fault(4.0, 4, "chest", false),
    ];
    write(&take, &faults);
    let done = Command::new("node").arg(build.path().join("driver.js")).arg(&take).output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let said: Value = serde_json::from_slice(&done.stdout).unwrap();
    let expected = [
        "\u{7}wand fails: stuck (failing: wand)",
        "\u{7}chest fails: stuck (failing: chest, wand)",
        "wand is back (failing: chest)",
        "chest is back",
    ];
    assert_eq!(said, json!(expected));
}
