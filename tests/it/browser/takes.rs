//! The library in a real browser: a take is found, named, exported, binned and brought back, by what is visible.

use std::time::Duration;

use super::{LIVE, PAINTED, demo, done, visible};
use crate::chromium::Browser;

/// Records `take-01.mcap` for some seconds, with a mark in the middle.
pub(super) async fn record(browser: &mut Browser, mark: &str) {
    browser.click("record-start").await;
    browser.until("document.getElementById('recording').textContent.startsWith('take-01.mcap')").await;
    browser.pause(Duration::from_secs(2)).await;
    browser.fill("#mark-label", mark).await;
    browser.click("mark").await;
    browser.until("document.getElementById('marked').textContent.startsWith('mark 1')").await;
    browser.pause(Duration::from_secs(2)).await;
    browser.click("record-stop").await;
    browser.until("document.getElementById('jobs').textContent.includes('take-01.mcap is complete')").await;
}

/// What is listed, by name.
const LISTED: &str =
    "[...document.querySelectorAll('#takes-list h3')].map((each) => each.textContent.trim()).join()";

/// Presses what has a class in the first take.
async fn press(browser: &mut Browser, class: &str) {
    let button = format!("document.querySelector('#takes-list .{class}')");
    browser.until(&format!("{button} !== null && !{button}.disabled")).await;
    browser.value(&format!("{button}.click()")).await;
}

/// How many bytes a link of the page leads to.
async fn fetched(browser: &mut Browser, link: &str) -> u64 {
    let fetch = format!(
        "window.fetched = undefined; fetch(document.querySelector('{link}').href).then(async (answer) => {{ \
            window.fetched = answer.ok ? (await answer.blob()).size : 0; }})"
    );
    browser.value(&fetch).await;
    browser.until("window.fetched !== undefined").await;
    browser.value("window.fetched").await.as_u64().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_newcomer_records_watches_and_exports_a_take_of_the_demo_by_the_page_alone() {
    let Some((_folder, posed, mut browser)) = demo().await else { return };
    visible::press(&mut browser, "Record").await;
    browser.until(&format!("{} !== undefined", visible::button("Stop"))).await;
    browser.pause(Duration::from_secs(3)).await;
    visible::press(&mut browser, "Stop").await;
    visible::press(&mut browser, "Takes").await;
    visible::press(&mut browser, "Watch take-01.mcap").await;
    // It plays by itself, over a timeline.
    visible::says(&mut browser, "Replay of take-01.mcap").await;
    visible::press(&mut browser, "Watch").await;
    browser.until(PAINTED).await;
    browser
        .until(
            "document.querySelector('[role=slider][aria-label=\"Time in the recording\"]')?.ariaValueNow > 0",
        )
        .await;
    visible::press(&mut browser, "Back to the live stage").await;
    browser.until(LIVE).await;
    visible::press(&mut browser, "Takes").await;
    visible::press(&mut browser, "Export").await;
    visible::press(&mut browser, "Make the file").await;
    visible::says(&mut browser, "take-01.csv (").await;
    let file = "a[download=\"take-01.csv\"]";
    assert!(fetched(&mut browser, file).await > 1000);
    done(browser, posed).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_take_is_found_named_exported_binned_and_brought_back() {
    let Some((_folder, posed, mut browser)) = demo().await else { return };
    browser.until(LIVE).await;
    browser.click("tab-takes").await;
    browser.until("document.getElementById('takes').textContent.includes('No take yet')").await;
    record(&mut browser, "here").await;
    browser.until(&format!("{LISTED} === 'take-01'")).await;
    // What happened in it, and a picture of where sensors went.
    browser.until("document.getElementById('takes-list').textContent.includes('1 mark')").await;
    browser.until("document.querySelector('#takes-list polyline') !== null").await;
    browser.picture("takes").await;
    browser.fill("#library-search", "squats").await;
    browser.until(&format!("{LISTED} === ''")).await;
    browser.fill("#library-search", "TAKE").await;
    browser.until(&format!("{LISTED} === 'take-01'")).await;
    browser.fill("#library-search", "").await;

    press(&mut browser, "begin-rename").await;
    browser.fill("#takes-list .rename", "first try").await;
    browser.value("document.querySelector('#takes-list .rename').form.requestSubmit()").await;
    browser.until(&format!("{LISTED} === 'first try'")).await;

    press(&mut browser, "export").await;
    browser.fill("#takes-list .format", "bvh").await;
    press(&mut browser, "make").await;
    browser.until("document.querySelector('#takes-list .made')?.textContent.includes('first try.bvh')").await;
    assert!(fetched(&mut browser, "#takes-list .made").await > 1000);
    assert!(fetched(&mut browser, "#takes-list .download").await > 100_000);

    press(&mut browser, "remove").await;
    browser.until(&format!("{LISTED} === ''")).await;
    browser.click("library-bin").await;
    browser.until(&format!("{LISTED} === 'first try'")).await;
    press(&mut browser, "restore").await;
    browser
        .until(&format!("{LISTED} === 'first try' && document.getElementById('library-bin') === null"))
        .await;
    press(&mut browser, "remove").await;
    browser.click("library-bin").await;
    browser.value("window.confirm = () => true").await;
    browser.click("library-empty").await;
    browser.until("document.getElementById('takes').textContent.includes('No take yet')").await;

    // By now the daemon knows how the sensors were: a page that is opened late shows it too.
    let mut late = Browser::open(&format!("http://{}/#check", posed.address)).await;
    late.until("document.getElementById('health')?.rows.length === 13").await;
    assert_eq!(late.complaints, Vec::<String>::new());
    drop(late);
    done(browser, posed).await;
}
