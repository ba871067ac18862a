//! The page in a real browser.
//!
//! Runs where `POSED_TEST_BROWSER` is set, and fails there without Chromium. With `POSED_BLESS` it also takes the
//! picture in `docs/pictures/`.

pub(crate) mod calibration;
mod console;
mod looks;
mod people;
mod phone;
mod report;
mod screens;
mod setup;
mod takes;
mod timeline;
mod trainer;
mod visible;

use std::time::Duration;

use crate::chromium::{self, Browser};
use crate::daemon::process::{Posed, two_devices};

/// A demo that keeps what it records, in a folder of its own, and its page; `None` where no browser is wanted.
async fn demo() -> Option<(tempfile::TempDir, Posed, Browser)> {
    if !chromium::is_wanted() {
        return None;
    }
    let folder = tempfile::tempdir().unwrap();
    posed_rig::copy_demo(folder.path());
    let posed = Posed::demo_that_keeps(&folder.path().join("demo.toml"));
    let browser = Browser::open(&format!("http://{}/", posed.address)).await;
    Some((folder, posed, browser))
}

/// The page has complained about nothing, and the daemon ends as it should.
async fn done(browser: Browser, posed: Posed) {
    assert_eq!(browser.complaints, Vec::<String>::new());
    drop(browser);
    assert_eq!(posed.end("INT").await.code(), Some(0));
}

const DATA_OLD: &str = "document.body.classList.contains('stale') \
    && document.getElementById('link').textContent.includes('no frame for')";
const LIVE: &str =
    "document.getElementById('link').textContent === 'live' && !document.body.classList.contains('stale')";

/// The 3-D picture is more than one colour.
const PAINTED: &str = "(() => { const from = document.querySelector('#watch canvas'); \
    const to = document.createElement('canvas'); [to.width, to.height] = [64, 64]; \
    const draw = to.getContext('2d'); draw.drawImage(from, 0, 0, 64, 64); \
    return new Set(new Uint32Array(draw.getImageData(0, 0, 64, 64).data.buffer)).size > 8; })()";

#[tokio::test(flavor = "multi_thread")]
async fn a_token_does_not_stay_in_the_address() {
    if !chromium::is_wanted() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let token = "a-token-for-this-page";
    let stage =
        two_devices(folder.path(), &format!("[[server.token]]\nsecret = \"{token}\"\nrole = \"watch\"\n"));
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    for address in [format!("?token={token}#check"), format!("#token={token}")] {
        let mut browser = Browser::open(&format!("http://{}/{address}", posed.address)).await;
        browser.until(LIVE).await;
        assert_eq!(browser.value("location.href.includes('token')").await, false);
        // The tab still has it.
        browser.reload().await;
        browser.until(LIVE).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_lives_says_when_data_are_old_and_lives_again() {
    if !chromium::is_wanted() {
        return;
    }
    let posed = Posed::start(["demo"]);
    let mut browser = Browser::open(&format!("http://{}/#check", posed.address)).await;
    browser.until(LIVE).await;
    // Three magnetic sensors, ten IMUs; positions change.
    let before = browser.row("sensors", 2).await;
    assert_eq!((before[0].as_str(), before.len()), ("wand", 14));
    browser
        .until(&format!(
            "document.getElementById('sensors').rows[2].cells[4].textContent !== '{}'",
            before[4]
        ))
        .await;
    // Rate and losses, age and clock are numbers once the first second of stream is over.
    browser
        .until("[4, 5, 6].every((cell) => !isNaN(parseFloat(document.getElementById('devices').rows[0].cells[cell].textContent)))")
        .await;
    let device = browser.row("devices", 0).await;
    assert!(device[4].parse::<f64>().unwrap() > 50.0, "{device:?}");
    browser
        .until("[0, 1, 2].every((row) => parseFloat(document.getElementById('sensors').rows[row].cells[2].textContent) > 0)")
        .await;
    for row in 0..3 {
        let sensor = browser.row("sensors", row).await;
        let lost = sensor[13].trim_end_matches(" ~");
        assert!(lost.parse::<u64>().is_ok() && sensor[4].parse::<f64>().is_ok(), "{sensor:?}");
        let [rate_hz, age_ms] = [2, 3].map(|cell| sensor[cell].parse::<f64>().unwrap());
        assert!(rate_hz > 0.0 && age_ms >= 0.0, "{sensor:?}");
    }
    browser.click("tab-watch").await;
    let all_good =
        "document.getElementById('summary').textContent === '13 of 13 are good, corrected by the map'";
    browser.until(all_good).await;
    browser
        .until("document.getElementById('body-summary').textContent === 'body: 10 of 10 segments measured'")
        .await;
    browser.until(PAINTED).await;
    let nothing_to_do = "document.querySelector('#tab-check .badge') === null";
    browser.picture_when("stage", &format!("{all_good} && {nothing_to_do}")).await;
    // The therapist's picture, and the angles behind it.
    browser.click("tab-coach").await;
    browser.until(&PAINTED.replace("#watch", "#avatar")).await;
    browser.picture("trainer").await;
    browser.click("tab-analyse").await;
    browser.until("document.getElementById('joint-choice').options.length === 9").await;
    browser.until("document.querySelectorAll('.joint canvas').length === 1").await;
    // What the person does has a name, if only so it seems.
    browser.until("document.querySelectorAll('#segments-provisional .segment, #segments-confirmed .segment').length > 0").await;
    browser.value("document.getElementById('segments-title').scrollIntoView()").await;
    browser.picture("segments").await;
    // The demo has learnt a fault map, and watches the wand for key poses.
    browser.until("document.querySelectorAll('#fault-map .cell').length === 441").await;
    browser.until("document.querySelectorAll('#fault-map .cell.clean').length > 20").await;
    browser.until("document.querySelectorAll('#fault-map .winner').length === 1").await;
    browser.fill("#sensor-choice", "wand").await;
    browser.until("document.querySelectorAll('#change-curve:not([hidden]) canvas').length === 1").await;
    browser.click("tab-watch").await;
    posed.signal("STOP");
    browser.until(DATA_OLD).await;
    // What is old stays as easy to read, in light and dark.
    console::prepare_for_axe(&mut browser).await;
    let faded = "getComputedStyle(document.querySelector('#watch canvas')).opacity === '0.45'";
    assert_eq!(browser.value(faded).await, true);
    let leans =
        "getComputedStyle(document.getElementById('sensors').rows[0].cells[4]).fontStyle === 'italic'";
    for (view, theme) in [("watch", "dark"), ("check", "dark"), ("check", "light"), ("analyse", "light")] {
        browser.click(&format!("tab-{view}")).await;
        browser.fill("#theme", theme).await;
        assert_eq!(console::barriers(&mut browser).await, Vec::<String>::new(), "{view}, {theme}");
    }
    assert_eq!(browser.value(leans).await, true);
    browser.click("tab-check").await;
    browser
        .until("document.getElementById('findings').textContent.includes('all that is shown is old')")
        .await;
    assert_eq!(browser.value("document.getElementById('all-well')").await, serde_json::Value::Null);
    browser.click("tab-watch").await;
    posed.signal("CONT");
    browser.until(LIVE).await;
    // Put away, it draws nothing; brought back, it is current at once.
    browser.value("window.drawn = 0; (function count() { drawn++; requestAnimationFrame(count); })()").await;
    browser.until("drawn > 5").await;
    browser.hide(true).await;
    browser.until("document.hidden").await;
    let before = browser.value("drawn").await.as_u64().unwrap();
    browser.pause(Duration::from_secs(2)).await;
    let after = browser.value("drawn").await.as_u64().unwrap();
    assert!(after <= before + 1, "{before} {after}");
    browser.hide(false).await;
    browser.until(&format!("drawn > {after} && {LIVE}")).await;
    done(browser, posed).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_view_shows_numbers_and_a_recording_is_made_and_replayed_in_the_browser() {
    if !chromium::is_wanted() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "");
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut browser = Browser::open(&format!("http://{}/", posed.address)).await;
    browser.until(LIVE).await;
    // One view at a time takes room.
    for view in console::VIEWS.into_iter().rev() {
        browser.click(&format!("tab-{view}")).await;
        let shown =
            "[...document.querySelectorAll('[role=tabpanel]')].filter((each) => each.offsetHeight > 0)";
        browser.until(&format!("{shown}.map(({{ id }}) => id).join() === '{view}'")).await;
    }
    browser.click("tab-check").await;
    browser.until("document.getElementById('latency').rows.length >= 1").await;
    browser.picture("health").await;
    browser.fill("#record-name", "curls").await;
    browser.click("record-start").await;
    browser.until("document.getElementById('recording').textContent.startsWith('curls-01.mcap')").await;
    browser.click("tab-analyse").await;
    browser.until("document.querySelectorAll('.curve canvas').length === 3").await;
    browser.until("document.getElementById('sensor-choice').options.length === 2").await;
    browser.picture("analysis").await;
    // Nothing is labelled yet, and it says so.
    browser.click("segments-train").await;
    browser
        .until("document.getElementById('segments-says').textContent.includes('has labels beside it')")
        .await;
    // So long that slow motion of it is seen between one status and the next, however quick the steps above were.
    browser.pause(Duration::from_secs(2)).await;
    browser.click("record-stop").await;
    browser.until("document.getElementById('jobs').textContent.includes('curls-01.mcap is complete')").await;
    // The next one has the next number, and a page that is opened now knows it too.
    browser.until("document.getElementById('record-number').value === '2'").await;
    browser.reload().await;
    browser.fill("#record-name", "curls").await;
    browser.until("document.getElementById('record-number').value === '2'").await;
    browser.click("tab-calibrate").await;
    browser.picture("calibrate").await;
    // It is watched while the stage goes on, and back again.
    browser.click("tab-takes").await;
    browser.until("document.querySelector('#takes-list .watch') !== null").await;
    browser.value("document.querySelector('#takes-list .watch').click()").await;
    browser.until("location.pathname === '/takes/curls-01.mcap/'").await;
    browser.until("document.getElementById('timeline')?.ariaValueMax > 0").await;
    browser.until("document.getElementById('to-stage') !== null").await;
    browser.click("to-stage").await;
    browser.until("location.pathname === '/'").await;
    browser.until(LIVE).await;
    done(browser, posed).await;

    let recording = folder.path().join("recordings/curls-01.mcap");
    let replay = Posed::start(["replay", recording.to_str().unwrap()]);
    let mut browser = Browser::open(&format!("http://{}/#takes", replay.address)).await;
    browser.until("document.querySelector('#takes-list [data-name=\"curls-01.mcap\"]') !== null").await;
    browser.until("document.getElementById('timeline') !== null").await;
    let ends = "document.getElementById('link').textContent === 'the recording ends here'";
    browser.until(ends).await;
    // Whoever chooses a speed at its end sees it again, so slowly that also a busy machine sees it before it ends.
    timeline::press_speed(&mut browser, "0.1 ×").await;
    browser.until("document.getElementById('link').textContent === 'live'").await;
    browser.picture("replay").await;
    browser.click("play").await;
    browser.until("document.getElementById('link').textContent === 'paused'").await;
    // Halted is not old.
    browser.until("!document.body.classList.contains('stale')").await;
    timeline::press_speed(&mut browser, "max").await;
    browser.until(ends).await;
    // The recording and a copy of it lie on one another, unless one is shifted.
    browser.until("document.getElementById('compare-channel').options.length > 6").await;
    browser.fill("#compare-channel", "of two_x_m").await;
    browser.click("compare").await;
    browser.until("document.getElementById('compare-verdict').textContent.includes(': 0.0000 apart')").await;
    browser.fill("#compare-shift", "0.05").await;
    browser
        .until("/: 0\\.[0-9]*[1-9][0-9]* apart/.test(document.getElementById('compare-verdict').textContent)")
        .await;
    done(browser, replay).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_of_faults_is_learnt_and_a_cell_named_in_the_browser() {
    if !chromium::is_wanted() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "");
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut browser = Browser::open(&format!("http://{}/#check", posed.address)).await;
    browser.until(LIVE).await;
    let learnt = "document.getElementById('fault-map')?.children.length === 441";
    let shown_s = "parseFloat(document.getElementById('frame').textContent.split(' ')[2])";
    // Three seconds are enough to learn from; a busy machine has too few frames then, and the page says so.
    for enough_s in [4.5, 10.0, 20.0, 40.0] {
        browser.click("tab-check").await;
        browser.until(&format!("{shown_s} > {enough_s}")).await;
        browser.click("tab-analyse").await;
        if browser.value(learnt).await == true {
            break;
        }
        browser.until("document.getElementById('fault-map') === null").await;
        browser.click("faults-train").await;
        let refused = "document.getElementById('faults-learnt').textContent.includes('too few')";
        browser.until(&format!("{learnt} || {refused}")).await;
    }
    browser.until(learnt).await;
    browser.until("document.querySelectorAll('#fault-map .winner').length === 1").await;
    let label = browser.row("fault-labels", 1).await;
    assert_eq!((label[0].as_str(), label.len()), ("of two", 5));
    browser.value("document.getElementById('fault-map').children[0].click()").await;
    browser.fill("#cell-class", "anomalous").await;
    browser.click("name-cell").await;
    browser.until("document.getElementById('fault-map').children[0].classList.contains('anomalous')").await;
    browser.picture("faults").await;
    done(browser, posed).await;
}
