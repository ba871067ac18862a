//! The operator's console in a real browser: what is chosen, measured, marked and kept; both languages, light and dark; no barriers.

use serde_json::{Value, json};

use super::{LIVE, PAINTED, demo, done};
use crate::chromium::{self, Browser};
use crate::daemon::process::Posed;

/// The views, in the order of their tabs.
pub(super) const VIEWS: [&str; 9] =
    ["watch", "setup", "calibrate", "coach", "exercise", "plan", "analyse", "takes", "check"];

/// Presses the button of a sensor in the rail.
async fn press(browser: &mut Browser, sensor: &str) {
    let button = format!(
        "[...document.querySelectorAll('#watch aside button[aria-pressed]')].find((each) => each.textContent.trim().startsWith('{sensor}'))"
    );
    browser.until(&format!("{button} !== undefined")).await;
    browser.value(&format!("{button}.click()")).await;
}

/// Clicks into the picture, at shares of its width and height.
async fn click_at(browser: &mut Browser, (right, down): (f64, f64)) {
    let place = format!(
        "(({{ x, y, width, height }}) => [x + {right} * width, y + {down} * height])(document.querySelector('#watch canvas').getBoundingClientRect())"
    );
    let [x, y]: [f64; 2] = serde_json::from_value(browser.value(&place).await).unwrap();
    for kind in ["mousePressed", "mouseReleased"] {
        let event = json!({"type": kind, "x": x, "y": y, "button": "left", "clickCount": 1});
        browser.call("Input.dispatchMouseEvent", event).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_chosen_in_one_place_is_chosen_in_all_and_measured_marked_and_kept() {
    let Some((_folder, posed, mut browser)) = demo().await else { return };
    browser.until(LIVE).await;
    press(&mut browser, "wand").await;
    browser.click("tab-analyse").await;
    browser.until("document.getElementById('sensor-choice').value === 'wand'").await;
    browser.click("tab-check").await;
    let chosen = "document.querySelector('#sensors tr[aria-selected=\"true\"]')?.cells[0].textContent";
    browser.until(&format!("{chosen} === 'wand'")).await;
    browser.click("tab-watch").await;
    press(&mut browser, "wand").await;
    let pressed = "document.querySelectorAll('#watch aside button[aria-pressed=\"true\"]').length";
    browser.until(&format!("{pressed} === 0")).await;
    // Into the picture, wherever the person stands just now.
    browser.until(PAINTED).await;
    let places = (0..6).flat_map(|row| {
        (0..7).map(move |column| (0.35 + 0.05 * f64::from(column), 0.3 + 0.1 * f64::from(row)))
    });
    for at in places.cycle().take(400) {
        click_at(&mut browser, at).await;
        if browser.value(&format!("{pressed} === 1")).await == true {
            break;
        }
    }
    browser.until(&format!("{pressed} === 1")).await;
    browser.click("measure").await;
    press(&mut browser, "wand").await;
    press(&mut browser, "imu_torso").await;
    browser
        .until("/wand to imu_torso: [1-9][0-9]+ mm/.test(document.getElementById('room').textContent)")
        .await;
    browser.picture("measure").await;

    // Whoever records knows whether there is room, and marks by key or by button.
    browser.until("/^[0-9.]+ GB free/.test(document.getElementById('free')?.textContent)").await;
    browser.click("record-start").await;
    browser.until("document.getElementById('recording').textContent.startsWith('take-01.mcap')").await;
    browser.value("window.dispatchEvent(new KeyboardEvent('keydown', { key: 'm' }))").await;
    browser.until("document.getElementById('marked').textContent === 'mark 1'").await;
    browser.fill("#mark-label", "pain here").await;
    browser.click("mark").await;
    browser.until("document.getElementById('marked').textContent === 'mark 2: pain here'").await;
    browser.click("record-stop").await;
    // A picture to keep, as a file.
    let keeps = "URL.createObjectURL = (blob) => { window.kept = [blob.type, blob.size]; return 'about:blank'; }; \
        HTMLAnchorElement.prototype.click = function () { window.named = this.download; };";
    browser.value(keeps).await;
    browser.click("snapshot").await;
    browser.until("window.named?.endsWith('.png') && kept[0] === 'image/png' && kept[1] > 5000").await;
    done(browser, posed).await;
}

/// Two trackers on somebody, the second with a battery that runs low.
const TRACKERS: &str = r#"
name = "trackers"
[body]
height_m = 1.7
[[device]]
name = "trackers"
driver = "slimevr"
port = "auto"
[[sensor]]
name = "torso"
device = "trackers"
address = 1
[[sensor]]
name = "pelvis"
device = "trackers"
address = 2
[simulation]
[[simulation.body]]
name = "person"
[simulation.body.motion]
kind = "person"
activity = "poses"
height_m = 1.7
[[simulation.sensor]]
name = "torso"
body = "person"
segment = "torso"
[[simulation.sensor]]
name = "pelvis"
body = "person"
segment = "pelvis"
[[simulation.device]]
name = "trackers"
boot_ms = 0.0
[[simulation.device.fault]]
kind = "low-battery"
address = 2
at_s = 3.0
"#;

#[tokio::test(flavor = "multi_thread")]
async fn a_battery_is_on_the_rail_and_a_low_one_a_problem_in_the_language_of_the_page() {
    if !chromium::is_wanted() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let stage = folder.path().join("trackers.toml");
    std::fs::write(&stage, TRACKERS).unwrap();
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut browser = Browser::open(&format!("http://{}/#watch", posed.address)).await;
    browser.until(LIVE).await;
    let charge =
        |says: &str| format!("document.querySelector('#watch aside [aria-label=\"{says}\"]') !== null");
    browser.until(&format!("{} && {}", charge("Battery: 90 %"), charge("Battery: 5 %"))).await;
    press(&mut browser, "pelvis").await;
    let chosen = "document.querySelector('#watch aside dl')?.textContent";
    browser.until(&format!("/5 %, 3.25 V/.test({chosen}) && /-58 dBm/.test({chosen})")).await;
    let problems = "document.getElementById('problems').textContent";
    browser.until(&format!("{problems}.includes('the battery of pelvis is at 5 %: charge it')")).await;
    browser.fill("#page-language", "de").await;
    browser
        .until(&format!("{problems}.includes('Der Akku von pelvis ist bei 5 %') && {problems}.includes('den Körper kalibrieren')"))
        .await;
    browser.until(&charge("Akku: 5 %")).await;
    done(browser, posed).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn language_and_light_are_chosen_and_stay() {
    if !chromium::is_wanted() {
        return;
    }
    let posed = Posed::start(["demo"]);
    let mut browser = Browser::open(&format!("http://{}/#check", posed.address)).await;
    browser.until(LIVE).await;
    browser.fill("#page-language", "de").await;
    browser.fill("#theme", "light").await;
    let german = "document.documentElement.lang === 'de' && document.getElementById('tab-watch').textContent === 'Ansehen'";
    let light = "getComputedStyle(document.body).backgroundColor === 'rgb(243, 244, 246)'";
    browser.until(&format!("{german} && {light}")).await;
    browser.reload().await;
    browser.until(LIVE).await;
    browser.until(&format!("{german} && {light}")).await;
    browser.fill("#theme", "dark").await;
    browser.until("getComputedStyle(document.body).backgroundColor === 'rgb(14, 17, 20)'").await;
    // Every view shows itself in German too, and the tabs are walked by the arrow keys.
    browser.value("document.getElementById('tab-check').focus()").await;
    for view in VIEWS {
        let key = json!({"type": "keyDown", "key": "ArrowRight", "code": "ArrowRight"});
        browser.call("Input.dispatchKeyEvent", key).await;
        let there = format!(
            "document.activeElement.id === 'tab-{view}' && document.getElementById('{view}')?.offsetHeight > 0"
        );
        browser.until(&there).await;
    }
    done(browser, posed).await;
}

/// Gives the page axe, and has it stand still.
pub(super) async fn prepare_for_axe(browser: &mut Browser) {
    let axe = concat!(env!("CARGO_MANIFEST_DIR"), "/viewer/node_modules/axe-core/axe.min.js");
    let axe = std::fs::read_to_string(axe).expect("the page's build has installed it");
    browser.value(&axe).await;
    // Colours that are still changing are none.
    let still = json!({"features": [{"name": "prefers-reduced-motion", "value": "reduce"}]});
    browser.call("Emulation.setEmulatedMedia", still).await;
    assert_eq!(browser.value("typeof axe.run").await, Value::from("function"));
}

/// What axe finds on the page as it is, each with where.
pub(super) async fn barriers(browser: &mut Browser) -> Vec<String> {
    let run = "window.found = undefined; axe.run(document, { resultTypes: ['violations'] }).then(({ violations }) => { \
        window.found = violations.map(({ id, nodes }) => `${id}: ${nodes.map(({ target }) => target.join(' ')).join(', ')}`); })";
    browser.value(run).await;
    browser.until("window.found !== undefined").await;
    serde_json::from_value(browser.value("window.found").await).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn no_view_has_a_barrier_in_light_or_dark() {
    if !chromium::is_wanted() {
        return;
    }
    let posed = Posed::start(["demo"]);
    let mut browser = Browser::open(&format!("http://{}/", posed.address)).await;
    browser.until(LIVE).await;
    prepare_for_axe(&mut browser).await;
    for theme in ["dark", "light"] {
        browser.fill("#theme", theme).await;
        for view in VIEWS {
            browser.click(&format!("tab-{view}")).await;
            browser.until(&format!("document.getElementById('{view}')?.offsetHeight > 0")).await;
            assert_eq!(barriers(&mut browser).await, Vec::<String>::new(), "{view}, {theme}");
        }
    }
    // It finds what is there to be found.
    browser.value("document.body.append(document.createElement('img'))").await;
    assert!(barriers(&mut browser).await.iter().any(|barrier| barrier.starts_with("image-alt")));
    done(browser, posed).await;
}
