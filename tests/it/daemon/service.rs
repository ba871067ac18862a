//! As a service: what must not keep it from starting, and what nobody may read afterwards.

use std::fs;
use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use posed_recording::{Item, Reader};
use serde_json::Value;

use super::process::{Posed, frames, one_device, replays_alike, two_devices, until};
use crate::cli::posed;

const TOKEN: &str = "a-token-that-nobody-else-has";

fn token(key: &str, value: &str) -> String {
    format!("[[server.token]]\n{key} = \"{value}\"\nrole = \"operate\"\n")
}

/// `posed run STAGE --wait --listen ADDRESS`, once it has said why it waits.
fn waiting(stage: &Path, listen: &str) -> (Child, String) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_posed"))
        .args(["run".as_ref(), stage.as_os_str()])
        .args(["--wait", "--listen", listen])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let said =
        lines.find_map(|line| Some(line.unwrap()).filter(|line| line.contains("trying again"))).unwrap();
    // What it says later must go somewhere.
    tokio::task::spawn_blocking(move || lines.for_each(drop));
    (child, said)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_port_that_is_taken_is_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let stage = folder.path().join("stage.toml");
    fs::write(&stage, "name = \"x\"\n").unwrap();
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let (mut child, said) = waiting(&stage, &address);
    assert!(said.contains(&address), "{said}");
    drop(taken);
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    assert!(line.contains(&format!("http://{address}/")), "{line}");
    child.kill().unwrap();
    child.wait().unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn an_address_that_is_not_there_yet_is_waited_for_until_somebody_ends_it() {
    let folder = tempfile::tempdir().unwrap();
    let stage = folder.path().join("stage.toml");
    fs::write(&stage, format!("name = \"x\"\n{}", token("secret", TOKEN))).unwrap();
    // Of a network for documentation: no computer has it.
    let away = "192.0.2.7:8787";
    let at_once = posed(["run", stage.to_str().unwrap(), "--listen", away]);
    assert_eq!(at_once.status.code(), Some(1), "nobody waits who was not asked to");
    let (child, said) = waiting(&stage, away);
    assert!(said.contains(away), "{said}");
    let waits = Posed { child, address: away.parse().unwrap() };
    assert_eq!(waits.end("TERM").await.code(), Some(0));
}

#[tokio::test]
async fn damaged_files_that_are_kept_are_left_out_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    let stage = folder.path().join("stage.toml");
    let imu = "name = \"x\"\n[[device]]\nname = \"d\"\ndriver = \"xbus\"\nport = \"/dev/nowhere\"\n\
               [[sensor]]\nname = \"s\"\ndevice = \"d\"\naddress = 1\n";
    fs::write(&stage, imu).unwrap();
    let maps = folder.path().join("field-maps/x");
    for (file, text) in [
        (folder.path().join("imus/0123.json"), "{"),
        (maps.join("active"), "1\n"),
        (maps.join("0001.json"), "\0\0\0"),
    ] {
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(file, text).unwrap();
    }
    let runs = Posed::start(["run", stage.to_str().unwrap()]);
    let health = runs.get("/health").await;
    assert!(health.contains("\r\n\r\nok\n"), "{health}");
    assert!(health.ends_with("\nproblem: field_map\nproblem: imu_file\n"), "{health}");
    let mut client = runs.subscriber(&["status"]).await;
    let status = until(&mut client, "both problems", |message| {
        message["problems"].as_array().is_some_and(|problems| problems.len() == 2)
    })
    .await;
    let sentence = |index: usize| status["problems"][index]["message"].as_str().unwrap().to_owned();
    assert!(sentence(0).contains("0123.json") && sentence(1).contains("0001.json"), "{status}");
    assert_eq!(runs.end("INT").await.code(), Some(0));

    // What the stage file itself names is an error, as ever.
    let named = format!("{imu}[models]\nfield = \"field-maps/x/0001.json\"\n");
    fs::write(&stage, named).unwrap();
    assert_eq!(posed(["check", stage.to_str().unwrap()]).status.code(), Some(1));
    assert_eq!(posed(["run", stage.to_str().unwrap()]).status.code(), Some(1));
}

#[tokio::test]
async fn no_recording_holds_a_secret_and_it_replays_as_ever() {
    let folder = tempfile::tempdir().unwrap();
    let old = "a-token-of-last-year";
    let stage = two_devices(folder.path(), &format!("{}# secret = \"{old}\"\n", token("secret", TOKEN)));
    let recording = folder.path().join("take.mcap");
    let os = |path: &Path| path.as_os_str().to_owned();
    let demo = Posed::start(["demo".into(), "--stage".into(), os(&stage), "--record".into(), os(&recording)]);
    let mut client = demo.client_with(&format!("?token={TOKEN}")).await;
    client.subscribe(&["sensors"]).await;
    frames(&mut client, 50).await;
    assert_eq!(demo.end("INT").await.code(), Some(0));

    // As it lies there, and with its chunks unpacked.
    let mut bytes = fs::read(&recording).unwrap();
    for item in Reader::open(&recording).unwrap() {
        match item.unwrap() {
            Item::Entry(entry) => bytes.extend(format!("{entry:?}").bytes()),
            Item::Message(message) => bytes.extend(message.json),
            Item::Transmitted { bytes: sent, .. } => bytes.extend(sent),
        }
    }
    for secret in [TOKEN, old] {
        assert!(!bytes.windows(secret.len()).any(|part| part == secret.as_bytes()), "{secret}");
    }
    replays_alike(&recording);
    // It is served without the token, which it does not know.
    let replay = Posed::start(["replay".into(), os(&recording)]);
    replay.client().await;
}

#[tokio::test]
async fn secrets_come_from_files_and_from_the_credentials_of_the_service_first() {
    let folder = tempfile::tempdir().unwrap();
    let credentials = tempfile::tempdir().unwrap();
    let other = "a-token-beside-the-stage-file";
    fs::write(folder.path().join("token"), format!("{other}\n")).unwrap();
    let stage = one_device(folder.path(), "/dev/nowhere", &token("secret_file", "token"));
    let role = async |credentials: Option<&Path>, token: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_posed"));
        command.args(["run".as_ref(), stage.as_os_str()]).args(["--listen", "127.0.0.1:0"]);
        command.env_remove("CREDENTIALS_DIRECTORY");
        command.envs(credentials.map(|folder| ("CREDENTIALS_DIRECTORY", folder)));
        let runs = Posed::spawn(&mut command);
        runs.get(&format!("/metrics?token={token}")).await.lines().next().unwrap().to_owned()
    };
    assert_eq!(role(None, other).await, "HTTP/1.1 200 OK");
    assert_eq!(role(Some(credentials.path()), other).await, "HTTP/1.1 200 OK", "there is none of this name");
    fs::write(credentials.path().join("token"), TOKEN).unwrap();
    assert_eq!(role(Some(credentials.path()), TOKEN).await, "HTTP/1.1 200 OK");
    assert_eq!(role(Some(credentials.path()), other).await, "HTTP/1.1 401 Unauthorized");
}

#[test]
fn a_check_warns_of_secrets_that_everybody_may_read() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let stage = one_device(folder.path(), "/dev/nowhere", &token("secret", TOKEN));
    let warnings = |mode: u32| {
        fs::set_permissions(&stage, fs::Permissions::from_mode(mode)).unwrap();
        let output = posed(["check", stage.to_str().unwrap(), "--json"]);
        assert_eq!(output.status.code(), Some(0));
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        report["warnings"].as_array().unwrap().clone()
    };
    assert!(warnings(0o644)[0]["message"].as_str().unwrap().contains("it holds secrets"));
    assert_eq!(warnings(0o640), Vec::<Value>::new());
}
