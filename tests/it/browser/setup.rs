//! From two devices on unknown ports to a calibrated body, by what stands on the page alone.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use super::visible::{button, press, says};
use super::{LIVE, console, done};
use crate::chromium::{self, Browser};
use crate::daemon::setup::run;
use crate::simulated::Simulation;

/// Somebody who holds two poses in turn, with four IMUs on two chains. Where they sit nobody has written down.
fn two_chains(folder: &Path) -> PathBuf {
    let mut text = String::from(
        "name = \"devices\"\n[simulation]\n[[simulation.body]]\nname = \"person\"\n[simulation.body.motion]\nkind = \"person\"\n\
         activity = \"poses\"\nheight_m = 1.75\n",
    );
    for (device, segments) in [("one", ["torso", "pelvis"]), ("two", ["upper_arm_r", "upper_arm_l"])] {
        write!(
            text,
            "[[device]]\nname = \"{device}\"\ndriver = \"xbus\"\nport = \"/dev/{device}\"\nbaud = 460800\n\
             [[simulation.device]]\nname = \"{device}\"\nboot_ms = 0.0\nburst_ms = 1.0\n"
        )
        .unwrap();
        for (segment, address) in segments.into_iter().zip(1..) {
            write!(
                text,
                "[[sensor]]\nname = \"{device}-{address}\"\ndevice = \"{device}\"\naddress = {address}\n\
                 [[simulation.sensor]]\nname = \"{device}-{address}\"\nbody = \"person\"\nsegment = \"{segment}\"\n\
                 mount_quat_wxyz = [0.8, 0.0, 0.6, 0.0]\n"
            )
            .unwrap();
        }
    }
    let path = folder.join("devices.toml");
    std::fs::write(&path, text).unwrap();
    path
}

#[tokio::test(flavor = "multi_thread")]
async fn two_devices_on_unknown_ports_become_a_calibrated_body_by_the_page_alone() {
    if !chromium::is_wanted() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let ports = folder.path().join("ports");
    std::fs::create_dir(&ports).unwrap();
    let simulation = Simulation::start(&two_chains(folder.path()), &["--ports", ports.to_str().unwrap()]);
    let stage = folder.path().join("stage.toml");
    let posed = run(&stage, &ports);
    let mut browser = Browser::open(&format!("http://{}/", posed.address)).await;
    press(&mut browser, "Set up").await;
    press(&mut browser, "Look for devices").await;
    press(&mut browser, "Add all 2").await;
    says(&mut browser, "2 devices answer").await;
    press(&mut browser, "Save and start").await;
    browser.until(LIVE).await;
    // What is wrong stands beside the field: a name that another one has.
    press(&mut browser, "Next: Place the sensors").await;
    press(&mut browser, "Rename tracker-1").await;
    browser.fill("#setup-rename", "tracker-2").await;
    says(&mut browser, "is the name of another sensor").await;
    browser.until(&format!("{} === undefined", button("Save and start"))).await;
    press(&mut browser, "Discard").await;
    // The one that moves is distinguished from the others.
    says(&mut browser, "moves now").await;
    let worn = [
        ("tracker-1", "chest"),
        ("tracker-2", "pelvis"),
        ("chain-2-tracker-1", "right upper arm"),
        ("chain-2-tracker-2", "left upper arm"),
    ];
    for (at, (sensor, segment)) in worn.into_iter().enumerate() {
        // In either order.
        let presses = if at % 2 == 0 { [sensor, segment] } else { [segment, sensor] };
        for called in presses {
            press(&mut browser, called).await;
        }
        browser.until(&format!("{} !== undefined", button(&format!("{segment}: {sensor}")))).await;
    }
    browser.picture("setup-place").await;
    press(&mut browser, "Save and start").await;
    browser.until(LIVE).await;
    press(&mut browser, "Next: Check the line").await;
    let good = "document.querySelectorAll('#setup-line-list strong + .good').length === 2";
    browser.until(good).await;
    press(&mut browser, "Next: Calibrate").await;
    says(&mut browser, "calibrate the body").await;
    // What a body can do without comes before it, each with its picture; here it is left out.
    browser
        .until("document.querySelector('#setup section [data-asks=\"+z\"]')?.checkVisibility() === true")
        .await;
    press(&mut browser, "Leave out: IMU").await;
    browser.fill("#setup-calibrate-how", "quick").await;
    calibrate(&mut browser).await;
    says(&mut browser, "Good enough: every sensor agrees").await;
    press(&mut browser, "Next: Done").await;
    says(&mut browser, "It tracks: everything is good.").await;
    let text = std::fs::read_to_string(&stage).unwrap();
    let stage = posed_stage::Stage::parse(&text).unwrap();
    assert!(text.starts_with("# Every key is explained"), "{text}");
    assert_eq!((stage.devices.len(), stage.bodies.len()), (2, 1));
    let segments: Vec<&str> = stage.sensors.iter().map(posed_stage::Sensor::sits_on).collect();
    assert_eq!(segments, ["torso", "pelvis", "upper_arm_r", "upper_arm_l"]);
    done(browser, posed).await;
    simulation.interrupt();
}

/// Until it is known how the sensors sit: where a busy machine's records have gaps, somebody begins again.
async fn calibrate(browser: &mut Browser) {
    for _ in 0..5 {
        // The line above every view has a button of this name, too.
        browser.click("setup-calibrate-body").await;
        says(browser, "it begins in").await;
        browser.until("document.querySelector('[data-asks=n_pose], [data-asks=t_pose]') !== null").await;
        browser.picture("setup-calibrate").await;
        let ended =
            "/mounting is known|begin again/.test(document.getElementById('setup-prompt')?.textContent)";
        browser.until(ended).await;
        if browser
            .value("document.getElementById('setup-prompt').textContent.includes('mounting is known')")
            .await
            == true
        {
            return;
        }
    }
    panic!("never calibrated");
}

#[tokio::test(flavor = "multi_thread")]
async fn no_step_has_a_barrier_and_each_is_reached_by_the_keyboard() {
    if !chromium::is_wanted() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let stage = folder.path().join("stage.toml");
    std::fs::write(
        &stage,
        "name = \"s\"\n[body]\nheight_m = 1.7\n[[device]]\nname = \"a\"\ndriver = \"x-imu3\"\nport = \"/dev/none\"\n\
         [[sensor]]\nname = \"head\"\ndevice = \"a\"\naddress = 0\n",
    )
    .unwrap();
    let posed = run(&stage, folder.path());
    let mut browser = Browser::open(&format!("http://{}/#setup", posed.address)).await;
    browser.until("document.getElementById('setup-name')?.value === 's'").await;
    console::prepare_for_axe(&mut browser).await;
    for language in ["en", "de"] {
        browser.fill("#page-language", language).await;
        for step in ["find", "place", "line", "calibrate", "done"] {
            browser.value(&format!("document.getElementById('step-{step}').focus()")).await;
            let key = |kind: &str| serde_json::json!({"type": kind, "key": "Enter", "code": "Enter", "windowsVirtualKeyCode": 13, "text": "\r"});
            browser.call("Input.dispatchKeyEvent", key("keyDown")).await;
            browser.call("Input.dispatchKeyEvent", key("keyUp")).await;
            browser
                .until(&format!(
                    "document.getElementById('step-{step}').getAttribute('aria-current') === 'step'"
                ))
                .await;
            assert_eq!(console::barriers(&mut browser).await, Vec::<String>::new(), "{step}, {language}");
        }
    }
    done(browser, posed).await;
}
