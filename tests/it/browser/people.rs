//! Two people on one stage, in a real browser: whom the page is about, and whose sensors are calibrated.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use serde_json::json;

use super::calibration::{CALIBRATE, guided};
use super::{LIVE, done};
use crate::chromium::{self, Browser};
use crate::cli::posed;
use crate::daemon::process::{Posed, ok, record_start, refused, replays_alike, until};

/// Two who hold the poses of a calibration in turn, with four IMUs each on one chain, and nobody knows how they sit.
fn two_posing(folder: &Path) -> PathBuf {
    let mut text = String::from(
        "name = \"clinic\"\n[[device]]\nname = \"chain\"\ndriver = \"xbus\"\nport = \"auto\"\nbaud = 921600\n\
         [simulation]\n[[simulation.device]]\nname = \"chain\"\nboot_ms = 0.0\nburst_ms = 1.0\n",
    );
    let mut address = 0;
    for (name, height_m, x_m) in [("anna", 1.6, -0.6), ("bert", 1.9, 0.6)] {
        write!(
            text,
            "[[body]]\nname = \"{name}\"\nheight_m = {height_m}\n[[simulation.body]]\nname = \"{name}\"\n\
             [simulation.body.motion]\nkind = \"person\"\nactivity = \"poses\"\nheight_m = {height_m}\nposition_m = [{x_m}, 0.0, 0.0]\n"
        )
        .unwrap();
        for segment in ["torso", "pelvis", "upper_arm_r", "upper_arm_l"] {
            address += 1;
            write!(
                text,
                "[[sensor]]\nname = \"{name}-{segment}\"\ndevice = \"chain\"\naddress = {address}\nbody = \"{name}\"\n\
                 segment = \"{segment}\"\n[[simulation.sensor]]\nname = \"{name}-{segment}\"\nbody = \"{name}\"\n\
                 segment = \"{segment}\"\nmount_quat_wxyz = [0.8, 0.0, 0.6, 0.0]\n"
            )
            .unwrap();
        }
    }
    let path = folder.join("clinic.toml");
    std::fs::write(&path, text).unwrap();
    path
}

#[tokio::test(flavor = "multi_thread")]
async fn one_of_two_people_is_chosen_calibrated_and_exported() {
    if !chromium::is_wanted() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("bert.bvh");
    let daemon = Posed::start(["demo", "--stage", two_posing(folder.path()).to_str().unwrap()]);
    let mut browser = Browser::open(&format!("http://{}/#calibrate", daemon.address)).await;
    browser.until(LIVE).await;
    // The first one, unless the address says otherwise.
    let chosen = "document.getElementById('person-choice').value";
    browser.until(&format!("{chosen} === 'anna' && !document.getElementById('person').hidden")).await;
    browser.fill("#person-choice", "bert").await;
    browser.until("location.search === '?person=bert' && location.hash === '#calibrate'").await;
    browser.until(LIVE).await;
    browser.until(&format!("{chosen} === 'bert'")).await;
    browser.fill("#calibrate-how", "quick").await;
    guided(&mut browser, CALIBRATE, "2 of 2: Raise both arms", "mounting is known").await;
    browser.until("document.getElementById('mounting').rows.length === 4").await;
    assert!(browser.row("mounting", 1).await[1].starts_with("bert-"));
    browser.picture("mounting").await;
    browser.click("tab-watch").await;
    browser.until("document.getElementById('body-summary').textContent.startsWith('bert: 4 of 10 segments measured')").await;
    // Of her nothing is known yet, and that is said by her name.
    let problems = "document.getElementById('problems').textContent";
    browser
        .until(&format!("{problems}.includes('anna: It is not known') && !{problems}.includes('bert:')"))
        .await;
    browser.picture("people").await;

    let mut client = daemon.subscriber(&["body"]).await;
    let body = until(&mut client, "a body", |message| message["type"] == "body").await;
    assert_eq!(body["name"], "bert");
    let (code, sentence) = refused(&mut client, json!({"type": "body.calibrate"})).await;
    assert!(code == "bad_request" && sentence.contains("name one of anna, bert"), "{code}: {sentence}");
    ok(&mut client, record_start("take")).await;
    for _ in 0..30 {
        until(&mut client, "a body", |message| message["type"] == "body").await;
    }
    ok(&mut client, json!({"type": "record.stop"})).await;
    done(browser, daemon).await;
    let take = folder.path().join("recordings/take.mcap");
    let export = |of: &[&str]| {
        let mut command = vec!["export", take.to_str().unwrap(), "--to", "bvh", "-o", out.to_str().unwrap()];
        command.extend_from_slice(of);
        let output = posed(&command);
        (output.status.success(), String::from_utf8(output.stderr).unwrap())
    };
    let (_, sentence) = export(&[]);
    assert!(sentence.contains("name one of `anna`, `bert`"), "{sentence}");
    let (_, sentence) = export(&["--body", "anna"]);
    assert!(sentence.contains("holds no such body"), "{sentence}");
    assert!(export(&["--body", "bert"]).0);
    assert!(replays_alike(&take) > 30);
}
