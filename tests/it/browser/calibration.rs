//! Calibrations in a real browser: of the field, the body, the stage, an IMU, a chain.

use std::path::Path;

use nalgebra::{UnitQuaternion, Vector3};

use crate::chromium::{self, Browser};
use crate::daemon::process::{Posed, until};
use posed_rig::{leg, wand};

use super::{LIVE, PAINTED, done};

#[tokio::test(flavor = "multi_thread")]
async fn the_field_is_calibrated_in_the_browser_and_the_stage_shows_what_the_map_does() {
    if !chromium::is_wanted() {
        return;
    }
    // Maps are kept beside the stage file.
    let folder = tempfile::tempdir().unwrap();
    let stage = folder.path().join("pole.toml");
    std::fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/config/field-pole.toml"), &stage).unwrap();
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut browser = Browser::open(&format!("http://{}/#calibrate", posed.address)).await;
    browser.until(LIVE).await;
    let text = |id: &str| format!("document.getElementById('{id}').textContent");
    browser.until(&format!("{}.startsWith('Poses are the tracker')", text("field-map"))).await;
    let sensors = browser.value("document.getElementById('field-sensors').value").await;
    assert_eq!(sensors, "pole-1, pole-2, pole-3, pole-4, pole-5");
    browser.fill("#field-spacing", "0.15").await;
    browser.click("field-start").await;
    // It states what to do until there is enough.
    browser.until("document.getElementById('field-run') !== null").await;
    browser.until("document.getElementById('field-hint').className.includes('care')").await;
    browser.until("document.getElementById('field-cells').value > 0.5").await;
    browser.until("document.getElementById('field-hint').className.includes('good')").await;
    assert_eq!(browser.value("document.getElementById('field-directions').value").await, 1.0);
    browser.picture("calibration").await;
    browser.click("field-finish").await;
    browser.until("document.getElementById('field-outcome') !== null").await;
    assert_eq!(browser.value("document.getElementById('field-verdict').className").await, "good");
    let figure = async |browser: &mut Browser, row: usize| {
        let cells = browser.row("field-figures", row).await;
        cells[1].parse::<f64>().unwrap_or_else(|_| panic!("{cells:?}"))
    };
    let before_mm = figure(&mut browser, 0).await;
    let held_out_mm = figure(&mut browser, 2).await;
    assert!(before_mm > 1.0 && held_out_mm < 0.5 * before_mm, "{before_mm} {held_out_mm}");
    browser.click("field-accept").await;
    browser.until(&format!("{}.startsWith('Map 1 is in use')", text("field-map"))).await;
    browser.until("document.getElementById('field-accept').disabled").await;
    browser.click("tab-watch").await;
    browser.until(&format!("{}.includes('corrected by the map')", text("summary"))).await;
    browser.until(&format!("/^arrows [0-9]+ times/.test({})", text("field-arrows"))).await;
    // A slice of it, moved by hand.
    browser.click("layer-slice").await;
    browser.until("document.getElementById('slice') !== null").await;
    let middle = browser.value(&text("slice")).await;
    browser.fill("#slice-place", "0").await;
    let edge = browser.value(&text("slice")).await;
    assert!(middle != edge && edge.as_str().unwrap().ends_with(" mm"), "{middle} {edge}");
    browser.fill("#slice-place", "0.5").await;
    browser.until(PAINTED).await;
    browser.picture("field").await;
    browser.click("tab-calibrate").await;
    browser.click("field-rollback").await;
    browser.until(&format!("{}.startsWith('Poses are the tracker')", text("field-map"))).await;
    done(browser, posed).await;
}

/// Fifteen IMUs of a chain on somebody who holds the two poses in turn, and nobody knows how they sit.
pub(crate) fn posing(folder: &Path) -> std::path::PathBuf {
    let mounted = posed_stage::SEGMENTS.map(|segment| (segment, segment));
    strapped(folder, "poses", &mounted[..15])
}

/// IMUs of a chain, each with the segment that the stage file specifies and the one that it sits on.
fn strapped(folder: &Path, activity: &str, mounted: &[(&str, &str)]) -> std::path::PathBuf {
    let mut text = String::from(
        "name = \"posing\"\n[body]\nheight_m = 1.7\n[[device]]\nname = \"chain\"\ndriver = \"xbus\"\nport = \"auto\"\n\
         baud = 921600\n[simulation]\n[[simulation.body]]\nname = \"person\"\n[simulation.body.motion]\nkind = \"person\"\n\
         activity = \"ACTIVITY\"\nheight_m = 1.7\n[[simulation.device]]\nname = \"chain\"\nboot_ms = 0.0\nburst_ms = 1.0\n",
    )
    .replace("ACTIVITY", activity);
    for (index, (emitted, segment)) in mounted.iter().enumerate() {
        let rotation_rad = 0.4 * index as f64;
        let (sin, cos) = libm::sincos(rotation_rad);
        text += &format!(
            "[[sensor]]\nname = \"{emitted}\"\ndevice = \"chain\"\naddress = {}\n[[simulation.sensor]]\nname = \"{emitted}\"\n\
             body = \"person\"\nsegment = \"{segment}\"\nmount_quat_wxyz = [{cos}, {}, 0.0, {}]\n",
            index + 1,
            0.6 * sin,
            0.8 * sin,
        );
    }
    let path = folder.join("posing.toml");
    std::fs::write(&path, text).unwrap();
    path
}

/// The button that begins a calibration of the body, and what it prompts.
pub(super) const CALIBRATE: [&str; 2] = ["calibrate-body", "prompt"];

/// Begins what guides somebody, sees one of its steps, and waits for its end. Asked to begin again, as happens where a busy
/// machine's records have gaps, somebody does.
pub(super) async fn guided(browser: &mut Browser, [button, prompt]: [&str; 2], step: &str, end: &str) {
    for _ in 0..5 {
        browser.click(button).await;
        if carried_out(browser, [button, prompt], step, end).await {
            return;
        }
    }
    panic!("{step}: never to its end");
}

/// Sees a step of what was begun, and waits until it has ended; whether as it should.
async fn carried_out(browser: &mut Browser, [button, prompt]: [&str; 2], step: &str, end: &str) -> bool {
    let runs = format!("document.getElementById('{button}').disabled");
    let prompt = format!("document.getElementById('{prompt}').textContent");
    browser.until(&runs).await;
    let seen = format!("{prompt}.startsWith('{step}')");
    browser.until(&format!("!{runs} || {seen}")).await;
    let seen = browser.value(&seen).await == true;
    browser.until(&format!("!{runs}")).await;
    let said = browser.value(&prompt).await;
    let said = said.as_str().unwrap();
    assert!((seen && said.contains(end)) || said.contains("begin again"), "{step}: {seen}, then {said}");
    said.contains(end)
}

/// The page of a stage whose body is to be calibrated.
async fn calibrating(stage: &Path, how: &str) -> (Posed, Browser) {
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut browser = Browser::open(&format!("http://{}/#calibrate", posed.address)).await;
    browser.until("document.getElementById('problems').textContent.includes('calibrate the body')").await;
    browser.fill("#calibrate-how", how).await;
    (posed, browser)
}

#[tokio::test(flavor = "multi_thread")]
async fn swapped_sensors_are_found_in_the_browser() {
    if !chromium::is_wanted() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let swapped = [("upper_arm_r", "forearm_r"), ("forearm_r", "upper_arm_r")];
    let (posed, mut browser) = calibrating(&strapped(folder.path(), "movements", &swapped), "assign").await;
    let found = "upper_arm_r sits on forearm_r: the stage file has another segment";
    guided(&mut browser, CALIBRATE, "4 of 6: Bend the right elbow", found).await;
    assert_eq!(browser.row("mounting", 1).await[..2], ["upper_arm_r", "forearm_r"]);
    // The body shows who sits where, and goes on from there.
    let mut client = posed.subscriber(&["body"]).await;
    let body = until(&mut client, "a body", |message| message["type"] == "body").await;
    let sensor = |name: &str| {
        let segments = body["segments"].as_array().unwrap();
        segments.iter().find(|segment| segment["name"] == name).unwrap()["sensor"].clone()
    };
    assert_eq!(
        (sensor("upper_arm_r"), sensor("forearm_r")),
        ("forearm_r".into(), "upper_arm_r".into()),
        "{body}"
    );
    done(browser, posed).await;
}

/// The wand is turned in somebody's hand.
const TURNED: &str = r#"
[transmitter.pose_in_room]
position_m = [0.4, -0.2, 0.9]
orientation_wxyz = [0.996195, 0.0, 0.087156, 0.0]
[[simulation.body]]
name = "wand"
[simulation.body.motion]
kind = "orbit"
center_m = [0.9, -0.15, 0.9]
radius_m = [0.12, 0.2, 0.15]
period_s = 5.0
turn_deg = [55.0, 50.0, 60.0]
turn_period_s = 2.0
[[simulation.sensor]]
name = "hand"
body = "wand"
[[simulation.sensor]]
name = "hand_imu"
body = "wand"
offset_m = [0.021, -0.013, 0.034]
mount_quat_wxyz = [0.6633, 0.39826, -0.619515, 0.132753]
[[simulation.device]]
name = "flock"
boot_ms = 0.0
[[simulation.device]]
name = "imus"
boot_ms = 0.0
"#;

#[tokio::test(flavor = "multi_thread")]
async fn the_stage_is_aligned_in_the_browser() {
    if !chromium::is_wanted() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let stage = folder.path().join("wand.toml");
    let ports = wand::STAGE.replace("/dev/none2", "auto").replace("/dev/none", "auto");
    std::fs::write(&stage, ports + TURNED).unwrap();
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut browser = Browser::open(&format!("http://{}/#calibrate", posed.address)).await;
    browser.until(LIVE).await;
    // Tilted by ten degrees about y, and by nothing about x; the magnetometer decides on the heading.
    let right = |keys: &str| {
        let number = |key: &str, at: usize| -> f64 {
            let (_, list) = keys.split_once(&format!("{key} = [")).unwrap_or_else(|| panic!("{keys}"));
            list.split([',', ']']).nth(at).unwrap().trim().parse().unwrap()
        };
        let mut offset = [0.021, -0.013, 0.034].into_iter().enumerate();
        (number("orientation_wxyz", 2) - 0.0872).abs() < 0.0045
            && offset.all(|(at, truth_m)| (number("offset_m", at) - truth_m).abs() < 0.005)
    };
    let mut keys = String::new();
    // Records that come late on a busy machine cost accuracy: who is asked for it aligns again.
    for _ in 0..3 {
        guided(&mut browser, ["align", "align-prompt"], "turn the sensor", "it is known how").await;
        let shown = browser.value("document.getElementById('align-keys').textContent").await;
        shown.as_str().unwrap().clone_into(&mut keys);
        if right(&keys) {
            break;
        }
    }
    assert!(right(&keys), "{keys}");
    browser.value("document.getElementById('align-keys').scrollIntoView({ block: 'end' })").await;
    browser.picture("alignment").await;
    // A demo has no file of its own to keep it in, and says so.
    browser.click("align-keep").await;
    browser.until("document.getElementById('alignment-title').closest('section').textContent.includes('posed run --new')").await;
    done(browser, posed).await;
}

/// Somebody lays a bare unit down on its sides and corners, one after the other.
const TABLE: &str = r#"
name = "table"
[[device]]
name = "unit"
driver = "x-imu3"
port = "auto"
baud = 2000000
[[sensor]]
name = "watch"
device = "unit"
address = 0
[[simulation.body]]
name = "unit"
[simulation.body.motion]
kind = "imu-calibration"
rest_s = 1.5
turn_s = 0.6
[[simulation.sensor]]
name = "watch"
body = "unit"
[[simulation.device]]
name = "unit"
boot_ms = 0.0
imu = "mpu"
"#;

#[tokio::test(flavor = "multi_thread")]
async fn an_imu_is_calibrated_in_the_browser_and_its_file_kept() {
    if !chromium::is_wanted() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let stage = folder.path().join("table.toml");
    std::fs::write(&stage, TABLE).unwrap();
    let posed = Posed::demo_that_keeps(&stage);
    let mut browser = Browser::open(&format!("http://{}/#calibrate", posed.address)).await;
    browser.until(LIVE).await;
    browser.click("unit-calibrate").await;
    let text = |id: &str| format!("document.getElementById('{id}').textContent");
    browser.fill("#page-language", "de").await;
    browser.until(&format!("/^[0-9]+ von 12 Richtungen: /.test({})", text("unit-prompt"))).await;
    browser.fill("#page-language", "en").await;
    browser.until(&format!("/^[1-9] of 12 directions/.test({})", text("unit-prompt"))).await;
    browser.until("document.querySelectorAll('#unit-sides .good').length >= 3").await;
    browser.until("document.querySelectorAll('#unit-sides .care').length < 3").await;
    browser.until(&format!("{}.includes('in use')", text("unit-prompt"))).await;
    browser.until("document.getElementById('unit-figures').rows.length === 5").await;
    browser.picture("imu").await;
    let file = browser.row("unit-figures", 4).await;
    let kept = posed_stage::read_intrinsics(&folder.path().join("imus").join(&file[1])).unwrap();
    assert!(kept.directions >= 12 && kept.mag.is_some(), "{kept:?}");
    // Another daemon knows of it, and Set up says so.
    drop(browser);
    assert_eq!(posed.end("INT").await.code(), Some(0));
    let posed = Posed::demo_that_keeps(&stage);
    let mut browser = Browser::open(&format!("http://{}/#setup", posed.address)).await;
    browser.until(LIVE).await;
    browser.click("step-calibrate").await;
    browser.until("/1. IMU *done/.test(document.getElementById('setup').innerText)").await;
    done(browser, posed).await;
}

/// Two links on one hinge that rest for 12 s of every minute and move in all directions for the rest, as poses for the simulator.
fn write_links(path: &Path) {
    let about = |axis: Vector3<f64>, angle: f64| UnitQuaternion::from_scaled_axis(axis * angle);
    let mut text = String::from("t,sensor,x,y,z,qw,qx,qy,qz\n");
    for tick in 0..12_000 {
        let t_s = f64::from(tick) * 0.05;
        let t = (t_s % 60.0 - 12.0).max(0.0);
        let grow = (t / 3.0).min((48.0 - t) / 3.0).min(1.0).powi(2);
        let rotation_vector_rad =
            Vector3::new(libm::sin(0.9 * t), 0.6 * libm::sin(0.7 * t), 0.8 * libm::sin(1.1 * t));
        let upper = about(rotation_vector_rad, grow) * about(Vector3::x(), 1.57);
        let lower = upper * about(Vector3::z(), grow * (0.7 - 0.7 * libm::cos(1.3 * t)));
        for (name, q) in [("thigh", upper), ("shank", lower)] {
            text += &format!("{t_s:.2},{name},0.5,0.0,0.3,{:.7},{:.7},{:.7},{:.7}\n", q.w, q.i, q.j, q.k);
        }
    }
    std::fs::write(path, text).unwrap();
}

/// These two links in the place of a person's leg.
const LINKS: &str = r#"
[[simulation.body]]
name = "links"
[simulation.body.motion]
kind = "file"
path = "links.csv"
[[simulation.sensor]]
name = "upper"
body = "links"
segment = "thigh"
mount_quat_wxyz = [0.6, 0.0, 0.8, 0.0]
[[simulation.sensor]]
name = "lower"
body = "links"
segment = "shank"
mount_quat_wxyz = [0.48, 0.64, 0.0, 0.6]
[[simulation.device]]
name = "worn"
boot_ms = 0.0
"#;

/// Whoever presses before the page is connected is heard: it hears of its connection only then.
const AT_ONCE: &str = "let release; const pressed = new Promise((resolve) => (release = resolve)); \
    window.WebSocket = class extends WebSocket { \
        set onopen(heard) { super.onopen = (event) => pressed.then(() => heard(event)); } \
        set onmessage(heard) { super.onmessage = (event) => pressed.then(() => heard(event)); } }; \
    const waits = new MutationObserver(() => { const button = document.getElementById('calibrate-body'); \
        if (button) { waits.disconnect(); button.click(); release(); } }); \
    if (self === top) addEventListener('DOMContentLoaded', () => waits.observe(document, { childList: true, subtree: true }))";

#[tokio::test(flavor = "multi_thread")]
async fn a_chain_is_calibrated_in_the_browser_and_its_hinge_drawn() {
    if !chromium::is_wanted() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let stage = folder.path().join("leg.toml");
    std::fs::write(&stage, leg::STAGE.replace("/dev/none", "auto") + LINKS).unwrap();
    write_links(&folder.path().join("links.csv"));
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut browser = Browser::open_with(&format!("http://{}/#calibrate", posed.address), AT_ONCE).await;
    browser.until("/^[12] of 2/.test(document.getElementById('prompt').textContent)").await;
    let (step, end) = ("2 of 2: Bend every hinge", "axes of the chain are known");
    if !carried_out(&mut browser, CALIBRATE, step, end).await {
        guided(&mut browser, CALIBRATE, step, end).await;
    }
    assert_eq!(browser.row("mounting", 0).await[0], "knee");
    browser.click("tab-analyse").await;
    browser.until("document.getElementById('joint-choice').value === 'knee'").await;
    browser.until("document.querySelectorAll('.joint canvas').length === 1").await;
    browser.until("document.getElementById('problems').hidden").await;
    done(browser, posed).await;
}
