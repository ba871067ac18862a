//! A port that goes away and comes back, beside one that stays.

use std::fs;
use std::os::unix::fs::symlink;

use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use serde_json::Value;

use super::process::{Posed, all_ok, one_device, two_devices, until};
use crate::simulated::Simulation;

#[tokio::test]
async fn a_port_that_returns_has_poses_again_and_the_other_device_loses_nothing() {
    let folder = tempfile::tempdir().unwrap();
    // Behind the last table, device "one".
    let unplug = "[[simulation.device.fault]]\nkind = \"unplug\"\nat_s = 8.0\nduration_s = 2.0\n";
    let stage = two_devices(folder.path(), unplug);
    let log = folder.path().join("log");
    let posed = Posed::demo_logged(&stage, &log, "");
    let mut client = posed.subscriber(&["status", "sensors"]).await;
    until(&mut client, "both devices", all_ok).await;
    let device = |status: &Value, index: usize, key: &str| status["devices"][index][key].clone();
    let away = until(&mut client, "the port is away", |message| {
        message["type"] == "status"
            && device(message, 0, "reason").as_str().is_some_and(|reason| reason.contains("port is gone"))
    })
    .await;
    assert_eq!((device(&away, 0, "name"), device(&away, 1, "name")), ("one".into(), "two".into()));
    assert_eq!(
        (device(&away, 0, "state"), device(&away, 1, "state")),
        ("connecting".into(), "streaming".into())
    );
    let missing = until(&mut client, "the port is missing", |message| {
        device(message, 0, "reason").as_str().is_some_and(|reason| reason.contains("does not exist"))
    })
    .await;
    assert_eq!(device(&missing, 1, "state"), "streaming");
    // To whoever asks only whether it is well, too; without names, for anybody is answered.
    let health = posed.get("/health").await;
    assert!(health.contains("\nok\ndevices: 1 of 2 streaming\n"), "{health}");
    until(&mut client, "poses again", all_ok).await;
    let back = until(&mut client, "a status after it", |message| {
        message["type"] == "status" && device(message, 0, "state") == "streaming"
    })
    .await;
    // The other device: every record came, none was refused, and none of its bytes was left over.
    for key in ["rejected", "bytes_skipped"] {
        assert_eq!(device(&back, 1, key), device(&away, 1, key), "{key}");
    }
    let sensor = |status: &Value, key: &str| status["sensors"][1][key].as_u64().unwrap();
    assert_eq!(back["sensors"][1]["name"], "of two");
    let count = |status: &Value| device(status, 1, "records").as_f64().unwrap();
    let seconds = back["t_s"].as_f64().unwrap() - away["t_s"].as_f64().unwrap();
    let expected = 103.3 * seconds;
    let records = count(&back) - count(&away);
    println!("{records} records in {seconds} s, {expected:.1} expected");
    // It goes on, as fast as a busy machine lets the simulator send and the pipeline follow. That not one is lost is held in
    // simulated time, by `acceptance::many`.
    assert!(seconds > 1.5 && records > 0.5 * expected, "{records} records in {seconds} s");
    let samples = sensor(&back, "samples") - sensor(&away, "samples");
    assert!(samples as f64 > 0.5 * expected, "{samples} samples in {seconds} s");
    assert_eq!(posed.end("TERM").await.code(), Some(0));
    // Whoever reads the log of two alike learns which cable it is.
    let log = fs::read_to_string(log).unwrap();
    let gone = log.lines().filter(|line| line.contains("the port is gone")).collect::<Vec<_>>();
    assert!(!gone.is_empty() && gone.iter().all(|line| line.contains("device=\"one\"")), "{log}");
}

/// An adapter that comes back under its old name is another device file; the handle of the first one may stay open, and silent.
#[tokio::test]
async fn a_handle_that_outlives_its_port_is_opened_anew() {
    let folder = tempfile::tempdir().unwrap();
    let silent = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&silent).unwrap();
    unlockpt(&silent).unwrap();
    let port = folder.path().join("tracker");
    symlink(ptsname(&silent, Vec::new()).unwrap().to_str().unwrap(), &port).unwrap();
    let simulation = "[[simulation.device]]\nname = \"flock\"\nboot_ms = 0.0\n";
    let stage = one_device(folder.path(), port.to_str().unwrap(), simulation);
    let posed = Posed::start(["run".as_ref(), stage.as_os_str()]);
    let mut client = posed.subscriber(&["status", "sensors"]).await;
    until(&mut client, "nothing answers", |message| message["devices"][0]["state"] == "silent").await;
    let simulation = Simulation::start(&stage, &[]);
    fs::remove_file(&port).unwrap();
    symlink(simulation.port(), &port).unwrap();
    until(&mut client, "poses", all_ok).await;
    assert_eq!(posed.end("TERM").await.code(), Some(0));
    assert_eq!(simulation.interrupt().code(), Some(0));
}
