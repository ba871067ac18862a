//! Screens of other sizes in a real browser: the wall, read from afar, and a phone.

use serde_json::json;

use super::console::{barriers, prepare_for_axe};
use super::{LIVE, PAINTED, demo, done};
use crate::chromium::{self, Browser};
use crate::daemon::process::Posed;

#[tokio::test(flavor = "multi_thread")]
async fn the_wall_shows_large_numbers_and_nothing_to_press() {
    if !chromium::is_wanted() {
        return;
    }
    let posed = Posed::start(["demo"]);
    let mut browser = Browser::open(&format!("http://{}/#wall", posed.address)).await;
    browser.until("/[0-9]+\\s*\\/\\s*13/.test(document.getElementById('wall')?.textContent)").await;
    browser.until(&PAINTED.replace("#watch", "#wall")).await;
    browser.picture("wall").await;
    let seen = "[...document.querySelectorAll('button, input, select, a')].filter((each) => each.checkVisibility({ opacityProperty: true })).length";
    assert_eq!(browser.value(seen).await, 0);
    let large = "Math.min(...[...document.querySelectorAll('#wall .large')].map((each) => parseFloat(getComputedStyle(each).fontSize)))";
    assert!(browser.value(large).await.as_f64().unwrap() >= 48.0);
    prepare_for_axe(&mut browser).await;
    assert_eq!(barriers(&mut browser).await, Vec::<String>::new());
    browser.call("Input.dispatchKeyEvent", json!({"type": "keyDown", "key": "Escape"})).await;
    browser
        .until(
            "document.getElementById('wall') === null && document.getElementById('watch')?.offsetHeight > 0",
        )
        .await;
    browser.until(PAINTED).await;
    done(browser, posed).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_phone_starts_stops_and_marks() {
    let Some((_folder, posed, mut browser)) = demo().await else { return };
    let phone = json!({"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": true});
    browser.call("Emulation.setDeviceMetricsOverride", phone).await;
    browser.until(LIVE).await;
    // Nothing to press is too small for a finger, and nothing lies beside the screen.
    let small = "[...document.querySelectorAll('header :is(button, select), footer :is(button, input)')] \
        .filter((each) => each.offsetHeight > 0 && (each.offsetHeight < 44 || each.offsetWidth < 44)).map(({ id }) => id).join()";
    browser.until(&format!("{small} === ''")).await;
    browser.until("document.documentElement.scrollWidth === 390").await;
    browser.click("record-start").await;
    browser.until("document.getElementById('record-stop') !== null").await;
    browser.click("mark").await;
    browser.until("document.getElementById('marked').textContent === 'mark 1'").await;
    browser.click("record-stop").await;
    browser.until("document.getElementById('record-start') !== null").await;
    done(browser, posed).await;
}
