//! What the computer around the daemon can do to it: each is named, and tracking goes on.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;

use serde_json::json;

use super::process::{Posed, all_ok, frames, ok, one_device, record_start, refused, two_devices, until};
use crate::cli::posed;

/// The limit on the size of files stands for the disk: it fails the same way and needs no rights.
#[tokio::test]
async fn a_full_disk_ends_the_recording_with_a_sentence_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "");
    let recording = folder.path().join("full.mcap");
    let script = format!(
        "ulimit -S -f 100; exec {} demo --listen 127.0.0.1:0 --stage {} --record {}",
        env!("CARGO_BIN_EXE_posed"),
        stage.display(),
        recording.display()
    );
    let posed_full = Posed::spawn(Command::new("bash").args(["-c", &script]));
    let mut client = posed_full.subscriber(&["status", "sensors"]).await;
    let status = until(&mut client, "a full disk", |message| {
        message["problems"].as_array().is_some_and(|problems| !problems.is_empty())
    })
    .await;
    assert_eq!(status["problems"][0]["code"], "recording");
    let sentence = status["problems"][0]["message"].as_str().unwrap();
    assert!(sentence.contains("full.mcap") && sentence.contains("disk is full"), "{sentence}");
    assert!(status["recording"].is_null(), "{status}");
    until(&mut client, "all sensors", all_ok).await;
    frames(&mut client, 20).await;
    // What fitted can be saved.
    assert_eq!(posed(["info".as_ref(), recording.as_os_str(), "--repair".as_ref()]).status.code(), Some(0));
    assert_eq!(posed_full.end("INT").await.code(), Some(0));
}

/// A pipe that is full before the daemon begins, as one to a program that has stopped reading.
#[tokio::test]
async fn a_stderr_that_nobody_reads_makes_nobody_wait() {
    let folder = tempfile::tempdir().unwrap();
    let unplug = "[[simulation.device.fault]]\nkind = \"unplug\"\nat_s = 4.0\nduration_s = 1.0\n";
    let stage = two_devices(folder.path(), unplug);
    let script = format!(
        "mkfifo {pipe} && exec 2<>{pipe}; head -c 65536 /dev/zero >&2; \
         exec {} --log debug demo --listen 127.0.0.1:0 --stage {}",
        env!("CARGO_BIN_EXE_posed"),
        stage.display(),
        pipe = folder.path().join("full").display(),
    );
    let posed = Posed::spawn(Command::new("bash").args(["-c", &script]));
    let mut client = posed.subscriber(&["status", "sensors"]).await;
    let is_away = |message: &serde_json::Value| message["devices"][0]["state"] == "connecting";
    until(&mut client, "all sensors", all_ok).await;
    until(&mut client, "a port is away, which is logged", is_away).await;
    until(&mut client, "all sensors again", all_ok).await;
    assert_eq!(posed.end("TERM").await.code(), Some(0));
}

/// A file system that is really full, in a mount namespace of the daemon's own, and then has room again.
#[tokio::test]
async fn a_disk_that_is_full_is_named_and_used_again_once_there_is_room() {
    let unshare = ["--map-root-user", "--mount"];
    let folder = tempfile::tempdir().unwrap();
    let disk = folder.path().join("disk");
    fs::create_dir(&disk).unwrap();
    let mount = format!("mount -t tmpfs -o size=128k tmpfs {}", disk.display());
    let may_mount = Command::new("unshare").args(unshare).args(["sh", "-c", &mount]).output();
    if !may_mount.is_ok_and(|tried| tried.status.success()) {
        println!("skipped: this user may not mount anything, not even in a namespace");
        return;
    }
    let stage = two_devices(folder.path(), &format!("[recording]\nfolder = \"{}\"\n", disk.display()));
    let exe = env!("CARGO_BIN_EXE_posed");
    let script = format!("{mount}; exec {exe} demo --listen 127.0.0.1:0 --stage {}", stage.display());
    let posed_full = Posed::spawn(Command::new("unshare").args(unshare).args(["sh", "-c", &script]));
    // The daemon's disk, as it sees it.
    let seen = Path::new("/proc").join(posed_full.child.id().to_string()).join("root");
    let seen = seen.join(disk.strip_prefix("/").unwrap());
    let mut client = posed_full.subscriber(&["status", "sensors"]).await;
    ok(&mut client, record_start("full")).await;
    let status = until(&mut client, "a full disk", |message| {
        message["problems"].as_array().is_some_and(|problems| !problems.is_empty())
    })
    .await;
    let sentence = status["problems"][0]["message"].as_str().unwrap();
    assert!(sentence.contains("full.mcap") && sentence.contains("disk is full"), "{sentence}");
    frames(&mut client, 20).await;
    // Not a byte is left for another one.
    let mut filler = fs::File::create(seen.join("filler")).unwrap();
    while std::io::Write::write(&mut filler, &[0; 512]).is_ok() {}
    let (code, sentence) = refused(&mut client, record_start("none")).await;
    assert!(code == "failed" && sentence.contains("disk is full"), "{sentence}");
    assert!(!seen.join("none.mcap").exists(), "nothing is left of it");

    drop(filler);
    fs::remove_file(seen.join("filler")).unwrap();
    fs::copy(seen.join("full.mcap"), folder.path().join("full.mcap")).unwrap();
    fs::remove_file(seen.join("full.mcap")).unwrap();
    ok(&mut client, record_start("again")).await;
    until(&mut client, "nothing is wrong", |message| {
        message["type"] == "status" && message["problems"].as_array().unwrap().is_empty()
    })
    .await;
    frames(&mut client, 20).await;
    ok(&mut client, json!({"type": "record.stop"})).await;
    fs::copy(seen.join("again.mcap"), folder.path().join("again.mcap")).unwrap();
    assert_eq!(posed_full.end("INT").await.code(), Some(0));
    let info = |name: &str, more: &[&str]| {
        let path = folder.path().join(name);
        posed([&["info", path.to_str().unwrap()], more].concat()).status.code()
    };
    assert_eq!(info("again.mcap", &[]), Some(0));
    assert_eq!(info("full.mcap", &["--repair"]), Some(0), "what fitted can be saved");
}

#[tokio::test]
async fn folders_that_are_missing_are_made_and_those_that_refuse_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "[recording]\nfolder = \"a/b\"\n");
    let posed_two = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut client = posed_two.subscriber(&["sensors"]).await;
    ok(&mut client, record_start("one")).await;
    ok(&mut client, json!({"type": "record.stop"})).await;
    assert!(folder.path().join("a/b/one.mcap").exists());
    let (code, sentence) = refused(&mut client, record_start("one")).await;
    assert!(code == "failed" && sentence.contains("choose another name"), "{sentence}");
    assert_eq!(posed_two.end("INT").await.code(), Some(0));

    // Not even root may write here.
    let stage = two_devices(folder.path(), "[recording]\nfolder = \"/proc\"\n");
    let posed_two = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut client = posed_two.subscriber(&["sensors"]).await;
    let (_, sentence) = refused(&mut client, record_start("one")).await;
    assert!(sentence.contains("cannot record to /proc/one.mcap"), "{sentence}");
    until(&mut client, "tracking goes on", all_ok).await;
    let output = posed(["demo", "--listen", "127.0.0.1:0", "--record", "/no/such/folder/a.mcap"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("make it first"));
}

#[test]
fn corrupt_recordings_and_stage_files_are_refused_with_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("bad.mcap");
    fs::write(&recording, b"\x89MCAP0\r\nnot much of a recording").unwrap();
    let path = recording.to_str().unwrap();
    let out = folder.path().join("out.csv");
    for args in [
        vec!["info", path],
        vec!["info", path, "--repair"],
        vec!["replay", path],
        vec!["replay", path, "-o", out.to_str().unwrap()],
        vec!["export", path, "--to", "csv", "-o", out.to_str().unwrap()],
    ] {
        let output = posed(&args);
        let emitted = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{args:?}: {emitted}");
        assert!(emitted.starts_with("posed: ") && emitted.contains("recording"), "{args:?}: {emitted}");
        assert!(!out.exists());
    }
    let stage = folder.path().join("bad.toml");
    fs::write(&stage, "name = \"A\"\nfrme_wait_ms = 3\n").unwrap();
    let output = posed(["run", stage.to_str().unwrap()]);
    let emitted = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(1) && emitted.contains("line 2: frme_wait_ms"), "{emitted}");
}

#[tokio::test]
async fn a_port_that_is_missing_at_the_start_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let stage = one_device(folder.path(), "/dev/no-such-port", "");
    let posed = Posed::start(["run", stage.to_str().unwrap()]);
    let mut client = posed.subscriber(&["status"]).await;
    let status = until(&mut client, "a reason", |message| {
        message["devices"][0]["reason"]
            .as_str()
            .is_some_and(|reason| reason.contains("/dev/no-such-port does not exist"))
    })
    .await;
    assert_eq!(status["devices"][0]["state"], "connecting");
    assert_eq!(posed.end("INT").await.code(), Some(0));
}

/// `run` and `doctor` as a user who may not open the port.
#[tokio::test]
async fn a_port_without_permission_names_the_group_to_join() {
    if !rustix::process::geteuid().is_root() {
        println!("skipped: only root can run `posed` as another user");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let open = |path: &Path, mode| fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
    open(folder.path(), 0o755);
    let program = folder.path().join("posed");
    fs::copy(env!("CARGO_BIN_EXE_posed"), &program).unwrap();
    open(&program, 0o755);
    let port = folder.path().join("port");
    fs::write(&port, "").unwrap();
    open(&port, 0o600);
    let stage = one_device(folder.path(), port.to_str().unwrap(), "");
    let nobody = |args: &[&str]| {
        let mut command = Command::new("setpriv");
        command.args(["--reuid", "65534", "--regid", "65534", "--clear-groups"]).arg(&program).args(args);
        command
    };
    let doctor = nobody(&["doctor", port.to_str().unwrap(), "--json"]).output().unwrap();
    let emitted = String::from_utf8_lossy(&doctor.stdout).into_owned();
    assert!(doctor.status.code() == Some(1) && emitted.contains("dialout"), "{emitted}");
    let posed = Posed::spawn(&mut nobody(&["run", stage.to_str().unwrap(), "--listen", "127.0.0.1:0"]));
    let mut client = posed.subscriber(&["status"]).await;
    until(&mut client, "the group", |message| {
        message["devices"][0]["reason"].as_str().is_some_and(|reason| reason.contains("dialout"))
    })
    .await;
    assert_eq!(posed.end("INT").await.code(), Some(0));
}
