//! The examples for boards, run on this computer against as much of their machines as they use: what they send is what the session reads.

use std::net::SocketAddr;
use std::path::Path;
use std::process::{Command, Output};

use posed_drivers::datagram::Datagram;
use posed_drivers::open_imu::{Carrier, OpenImuSession, Settings};
use posed_drivers::{LineEvent, Measurement, Output as Said, Session, Timestamp};

fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Datagrams of ten seconds, one a line in hexadecimal.
fn datagrams(output: &Output) -> Vec<Vec<u8>> {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = std::str::from_utf8(&output.stdout).unwrap();
    let words = text.lines().filter_map(|line| line.split(' ').next_back());
    words.filter_map(bytes).collect()
}

fn bytes(hexadecimal: &str) -> Option<Vec<u8>> {
    let pairs = (0..hexadecimal.len()).step_by(2).map(|at| hexadecimal.get(at..at + 2));
    pairs.map(|pair| u8::from_str_radix(pair?, 16).ok()).collect()
}

/// What the session makes of a board's ten seconds at 100 Hz.
fn holds(datagrams: &[Vec<u8>], id: &str) {
    let settings = Settings { devices: vec![id.to_owned()], ..Settings::default() };
    let mut session =
        OpenImuSession::new(settings, Carrier::Envelopes { port: 9301, websocket: 0 }, &[1]).unwrap();
    session.handle_line(Timestamp::ZERO, &LineEvent::Opened { modem_lines: false });
    let peer = SocketAddr::from(([192, 0, 2, 7], 9302));
    let (mut samples, mut answers) = (Vec::new(), 0);
    for (k, data) in (0..).zip(datagrams) {
        let now = Timestamp::from_secs_f64(0.01 * f64::from(k));
        session.handle_bytes(now, &Datagram { peer, data }.encode());
        while let Some(said) = session.poll_output() {
            match said {
                Said::Sample(sample) => samples.push(sample),
                Said::Transmit(_) => answers += 1,
                Said::Warning(warning) => panic!("{warning}"),
                _ => {}
            }
        }
    }
    assert_eq!((answers, session.counters().rejected, session.losses()[0].lost), (1, 0, 0));
    assert!(samples.len() > 990, "{}", samples.len());
    assert_eq!(session.rate_hz(), Some(100.0));
    let force = Some([0.0, 0.0, 1.0]);
    assert!(samples.iter().all(|sample| match sample.measurement {
        Measurement::Imu { specific_force_m_s2, .. } => {
            specific_force_m_s2.map(|force| force.map(|value| (value / 9.80665).round())) == force
        }
        Measurement::Pose { .. } => false,
    }));
}

#[test]
fn the_arduino_sketch_compiles_and_sends_the_format() {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("board");
    let stubs = repository().join("tests/boards");
    let include = |path: &Path| format!("-I{}", path.display());
    let compiled = Command::new("c++")
        .args(["-std=c++17", "-Wall", "-Wextra", "-Werror"])
        .args([include(&stubs), include(&repository().join("examples/open-imu"))])
        .arg(stubs.join("main.cpp"))
        .arg("-o")
        .arg(&program)
        .output()
        .expect("a C++ compiler: build-essential");
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    holds(&datagrams(&Command::new(program).output().unwrap()), "esp-12345678");
}

#[test]
fn the_micropython_sketch_runs_and_sends_the_format() {
    let ran = Command::new("python3")
        .arg(repository().join("tests/boards/micropython.py"))
        .arg(repository().join("examples/open-imu/board.py"))
        .output()
        .expect("python3");
    holds(&datagrams(&ran), "mp-5678abcd");
}

#[test]
fn the_examples_are_short() {
    for name in ["board.ino", "board.py"] {
        let text = std::fs::read_to_string(repository().join("examples/open-imu").join(name)).unwrap();
        assert!(text.lines().count() < 100, "{name}");
    }
}
