//! The commands, run as a user runs them.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

/// Runs `posed` with arguments and gives back what it said.
pub(crate) fn posed<I: AsRef<std::ffi::OsStr>>(args: impl IntoIterator<Item = I>) -> Output {
    Command::new(env!("CARGO_BIN_EXE_posed")).args(args).env_remove("POSED_LOG").output().unwrap()
}

fn stdout(output: &Output) -> &str {
    std::str::from_utf8(&output.stdout).unwrap()
}

fn stderr(output: &Output) -> &str {
    std::str::from_utf8(&output.stderr).unwrap()
}

/// The one JSON object on stdout.
pub(crate) fn json(output: &Output) -> Value {
    let text = stdout(output);
    assert_eq!(text.lines().count(), 1, "{text}{}", stderr(output));
    serde_json::from_str(text).unwrap()
}

fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

#[test]
fn wrong_use_is_exit_code_two() {
    assert_eq!(posed(["no-such-command"]).status.code(), Some(2));
    assert_eq!(posed::<&str>([]).status.code(), Some(2));
    let log = posed(["--log", "posed=loud", "completions", "bash"]);
    assert_eq!(log.status.code(), Some(2));
    assert!(stderr(&log).contains("--log"), "{}", stderr(&log));
    assert_eq!(posed(["--help"]).status.code(), Some(0));
}

#[test]
fn completions_know_the_commands() {
    for shell in ["bash", "zsh", "fish"] {
        let output = posed(["completions", shell]);
        assert_eq!(output.status.code(), Some(0));
        assert!(stdout(&output).contains("check"), "{shell}");
    }
}

/// A reader that has seen enough is no error.
#[test]
fn a_closed_pipe_is_quiet() {
    // The reader is gone before the first byte is written.
    let program = env!("CARGO_BIN_EXE_posed");
    let script = format!("{{ sleep 0.1; {program} completions bash; echo $? >&2; }} | true");
    let output = Command::new("bash").args(["-c", &script]).output().unwrap();
    assert_eq!(stderr(&output), "0\n");
}

#[test]
fn check_says_right_and_wrong() {
    let right = posed(["check".as_ref(), repository("config/flock-group.toml").as_os_str()]);
    assert_eq!(right.status.code(), Some(0), "{}", stdout(&right));
    let path = repository("tests/broken-stages/baud-not-a-rate.toml");
    let wrong = posed(["check".as_ref(), path.as_os_str()]);
    assert_eq!(wrong.status.code(), Some(1));
    assert!(stdout(&wrong).contains("baud-not-a-rate.toml:8: baud: "), "{}", stdout(&wrong));
    let json = json(&posed(["check".as_ref(), path.as_os_str(), "--json".as_ref()]));
    assert_eq!(json["ok"], false);
    assert_eq!((&json["problems"][0]["line"], &json["problems"][0]["key"]), (&8.into(), &"baud".into()));
    let absent = posed(["check", "/no/such/stage.toml"]);
    assert_eq!(absent.status.code(), Some(1));
    assert!(stderr(&absent).contains("/no/such/stage.toml"));
}

#[test]
fn check_takes_any_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("latin-1.toml");
    std::fs::write(&path, b"# a stage\nname = \"B\xfchne\"\n").unwrap();
    let output = posed(["check".as_ref(), path.as_os_str(), "--json".as_ref()]);
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(json(&output)["problems"][0]["line"], 2);
}

/// A log of one stand-alone unit, shortened from the form that real sessions have.
const LOG: &str = "\
24431916642.047222  :    (DEBUG) # recorded Tue Mar 21 14:30:42 2006

24431916642.051052  :    (INFO) 1. command[2] O\\x01
24431916642.05558  :    (INFO) 1. receive[2] \\x03<
24431916642.064899  :    (INFO) 4. command[1] ]
24431916642.098454  :    (INFO) 5. command[1] B
24431916642.108955  :    (INFO) 5. receive[14] \\x96\\x13=\\x05^\\x02S\\x06,9H\\x1BG\\x01
";

#[test]
fn decode_writes_every_record_with_the_digits_of_its_time() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("session.txt");
    std::fs::write(&log, LOG).unwrap();
    let csv = folder.path().join("poses.csv");
    let output = posed([
        "decode".as_ref(),
        "flock-of-birds".as_ref(),
        log.as_os_str(),
        "-o".as_ref(),
        csv.as_os_str(),
        "--json".as_ref(),
    ]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let summary = json(&output);
    let counts =
        ["records", "rejected", "bytes_skipped", "answers"].map(|key| summary[key].as_u64().unwrap());
    assert_eq!(counts, [1, 0, 0, 1]);
    let text = std::fs::read_to_string(&csv).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("t,sensor,x,y,z,qw,qx,qy,qz,format,button"));
    let row: Vec<&str> = lines.next().unwrap().split(',').collect();
    assert_eq!((row[0], row[1]), ("24431916642.108955", "bird-0"));
    assert_eq!((row[9], row[10], lines.next()), ("position-quaternion", "", None));
    let numbers: Vec<f64> = row[2..9].iter().map(|field| field.parse().unwrap()).collect();
    // The values that the protocol's description quotes: inches, and the vendor's quaternion, conjugated.
    let expected = [10.784 * 0.0254, 3.081 * 0.0254, 1.538 * 0.0254, 0.1039, -0.8960, -0.4307, -0.0243];
    for (number, expected) in numbers.iter().zip(expected) {
        assert!((number - expected).abs() < 3e-4, "{number} is not {expected}");
    }

    let jsonl = folder.path().join("poses.jsonl");
    assert!(
        posed([
            "decode".as_ref(),
            "flock-of-birds".as_ref(),
            log.as_os_str(),
            "-o".as_ref(),
            jsonl.as_os_str()
        ])
        .status
        .success()
    );
    let text = std::fs::read_to_string(&jsonl).unwrap();
    assert!(text.starts_with("{\"t\":24431916642.108955,\"sensor\":\"bird-0\""), "{text}");
    let line: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(line["orientation_wxyz"].as_array().map(Vec::len), Some(4));

    let piped = posed(["decode".as_ref(), "flock-of-birds".as_ref(), log.as_os_str()]);
    assert_eq!(stdout(&piped), std::fs::read_to_string(&csv).unwrap());
}

#[test]
fn a_table_of_an_xbus_capture_has_measurements_only_and_orient_takes_it() {
    let folder = tempfile::tempdir().unwrap();
    // A device with a satellite receiver: its messages with a fix alone have times that lie behind.
    for session in ["1", "2", "4"] {
        let capture = repository(&format!("tests/recordings/xbus/einride-mtig710/{session}/output.bin"));
        let (csv, poses) = (folder.path().join("imu.csv"), folder.path().join("orientation.csv"));
        let run = |command: &[&str], input: &Path, output: &Path| {
            let said = posed(command.iter().map(|word| word.as_ref()).chain([
                input.as_os_str(),
                "-o".as_ref(),
                output.as_os_str(),
            ]));
            assert!(said.status.success(), "{session}: {}", stderr(&said));
        };
        run(&["decode", "xbus"], &capture, &csv);
        let text = std::fs::read_to_string(&csv).unwrap();
        let rows: Vec<&str> = text.lines().skip(1).collect();
        assert!(rows.len() > 90, "{session}: {} rows", rows.len());
        let times: Vec<f64> =
            rows.iter().map(|row| row.split(',').next().unwrap().parse().unwrap()).collect();
        assert!(times.is_sorted(), "{session}");
        assert!(rows.iter().all(|row| row.split(',').skip(2).any(|cell| !cell.is_empty())), "{session}");
        run(&["orient"], &csv, &poses);
    }
}

#[test]
fn decode_of_nothing_fails_and_writes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let empty = folder.path().join("empty.bin");
    std::fs::write(&empty, b"").unwrap();
    let csv = folder.path().join("out.csv");
    for input in [empty.as_path(), Path::new("/no/such/capture")] {
        let output = posed([
            "decode".as_ref(),
            "flock-of-birds".as_ref(),
            input.as_os_str(),
            "-o".as_ref(),
            csv.as_os_str(),
        ]);
        assert_eq!(output.status.code(), Some(1));
        assert!(!stderr(&output).is_empty() && !csv.exists());
    }
    let unknown = folder.path().join("out.xyz");
    let output = posed([
        "decode".as_ref(),
        "flock-of-birds".as_ref(),
        empty.as_os_str(),
        "-o".as_ref(),
        unknown.as_os_str(),
    ]);
    assert_eq!(output.status.code(), Some(2));
}
