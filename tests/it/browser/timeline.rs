//! The timeline of a take in a real browser: what happens in it, play, scrub, loop, by pointer and by keys.

use std::time::Duration;

use serde_json::json;

use super::console::{barriers, prepare_for_axe};
use super::takes::record;
use super::{LIVE, demo, done};
use crate::chromium::Browser;

/// Presses the button of a speed.
pub(super) async fn press_speed(browser: &mut Browser, words: &str) {
    let button =
        format!("[...document.querySelectorAll('.speeds button')].find((b) => b.textContent === '{words}')");
    browser.until(&format!("{button} !== undefined && !{button}.disabled")).await;
    browser.value(&format!("{button}.click()")).await;
}

/// Presses a key where the focus is.
async fn press(browser: &mut Browser, key: &str) {
    for kind in ["keyDown", "keyUp"] {
        browser.call("Input.dispatchKeyEvent", json!({"type": kind, "key": key})).await;
    }
}

/// Where the cursor is, seconds from the beginning.
async fn stands_s(browser: &mut Browser) -> f64 {
    let at = browser.value("document.getElementById('timeline').ariaValueNow").await;
    at.as_str().unwrap().parse().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_take_is_played_scrubbed_and_looped_on_its_timeline() {
    let Some((_folder, posed, mut browser)) = demo().await else { return };
    browser.until(LIVE).await;
    record(&mut browser, "pain here").await;
    let take = format!("http://{}/takes/take-01.mcap/#check", posed.address);
    browser.call("Page.navigate", json!({"url": take})).await;
    browser.until("document.getElementById('timeline')?.ariaValueMax > 3").await;
    // Recordings belong to a live stage.
    browser.until("document.getElementById('record-start') === null").await;

    // So slow that it does not end meanwhile; had it ended, it begins anew.
    press_speed(&mut browser, "0.1 ×").await;
    browser
        .until(
            "[...document.querySelectorAll('.speeds button')].find((b) => b.textContent === '0.1 ×').ariaPressed === 'true' \
             && (({ textContent }) => textContent === 'live' || (textContent.includes('ends here') \
             && (document.getElementById('play').click(), false)))(document.getElementById('link'))",
        )
        .await;
    browser.click("play").await;
    browser.until("document.getElementById('link').textContent === 'paused'").await;

    // What was marked is in the list, and a key leads there.
    browser.click("items-open").await;
    browser.until("document.getElementById('items').textContent.includes('pain here')").await;
    // Of a halted take: while axe looks, no frame is drawn, and what is old is faded on purpose.
    prepare_for_axe(&mut browser).await;
    assert_eq!(barriers(&mut browser).await, Vec::<String>::new());
    browser.value("document.getElementById('items-list').hidePopover()").await;
    browser.value("document.getElementById('timeline').focus()").await;
    press(&mut browser, "Home").await;
    browser.until("document.getElementById('timeline').ariaValueNow === '0'").await;
    // And stays there, also when the pipeline has arrived.
    browser.until("document.getElementById('jobs').textContent.includes('replay.seek')").await;
    browser.pause(Duration::from_secs(1)).await;
    assert_eq!(stands_s(&mut browser).await, 0.0);
    press(&mut browser, "m").await;
    browser.until("document.getElementById('timeline').ariaValueNow > 1").await;

    // The hand scrubs along the ruler: the cursor follows it, and stays where it was let go.
    let place = "(({ left, top, width }) => [left, top, width])(document.getElementById('timeline').getBoundingClientRect())";
    let [left, top, width]: [f64; 3] = serde_json::from_value(browser.value(place).await).unwrap();
    let longest: f64 = browser
        .value("document.getElementById('timeline').ariaValueMax")
        .await
        .as_str()
        .unwrap()
        .parse()
        .unwrap();
    for (kind, share) in
        [("mousePressed", 0.25), ("mouseMoved", 0.5), ("mouseMoved", 0.75), ("mouseReleased", 0.75)]
    {
        let event = json!({"type": kind, "x": left + share * width, "y": top + 6.0, "button": "left", "buttons": 1, "clickCount": 1});
        browser.call("Input.dispatchMouseEvent", event).await;
        if kind == "mouseMoved" {
            let near = format!(
                "Math.abs(document.getElementById('timeline').ariaValueNow - {}) < 0.3",
                share * longest
            );
            browser.until(&near).await;
        }
    }
    let jumped = "document.getElementById('jobs').textContent.includes('replay.seek')";
    browser.until(jumped).await;
    assert!((stands_s(&mut browser).await - 0.75 * longest).abs() < 0.3);

    // What somebody says of a part has a lane of its own; of the loop, once there is one.
    press(&mut browser, "[").await;
    browser.click("label-open").await;
    browser.fill("#label", "squats with a pause").await;
    browser.click("label-save").await;
    browser
        .until("[...document.querySelectorAll('.names li')].some((lane) => lane.textContent === 'labels')")
        .await;
    assert_eq!(barriers(&mut browser).await, Vec::<String>::new());
    browser.value("document.getElementById('label-form').hidePopover()").await;
    browser.click("items-open").await;
    browser.until("document.getElementById('items').textContent.includes('squats with a pause')").await;
    browser.value("document.getElementById('items-list').hidePopover()").await;
    browser.picture("timeline").await;

    // Closer, and all of it again.
    press(&mut browser, "+").await;
    browser.until("!document.getElementById('zoom-all').disabled").await;
    // Until somebody says otherwise, whatever the daemon tells meanwhile: of how the stage is, once a second.
    browser.pause(Duration::from_millis(2500)).await;
    assert_eq!(browser.value("document.getElementById('zoom-all').disabled").await, false);
    press(&mut browser, "0").await;
    browser.until("document.getElementById('zoom-all').disabled").await;

    // On a screen that has become narrower the cursor is beside it until the next picture, and the page no wider for that.
    let wider_px = "((cursor, page) => { cursor.style.transform = 'translateX(3000px)'; return page.scrollWidth - page.clientWidth; }) \
        (document.querySelector('.cursor'), document.documentElement)";
    assert_eq!(browser.value(wider_px).await, 0);

    // A loop from the beginning to here: it never passes its end.
    press(&mut browser, "]").await;
    press(&mut browser, "Home").await;
    press(&mut browser, "[").await;
    let ends = "[...document.querySelectorAll('.handle')].map((handle) => Number(handle.ariaValueNow))";
    browser.until(&format!("{ends}.length === 2")).await;
    let [_, end_s]: [f64; 2] = serde_json::from_value(browser.value(ends).await).unwrap();
    assert!((end_s - 0.75 * longest).abs() < 0.3, "{end_s} of {longest}");
    press_speed(&mut browser, "4 ×").await;
    browser.until("document.getElementById('link').textContent === 'live'").await;
    let mut before_s = stands_s(&mut browser).await;
    let mut times = 0;
    // A busy machine takes its time to go back, and how far behind the loop's end its next frame lies, nobody can say.
    for _ in 0..1200 {
        browser.pause(Duration::from_millis(50)).await;
        let now_s = stands_s(&mut browser).await;
        times += usize::from(now_s < before_s);
        before_s = now_s;
        if times == 2 {
            break;
        }
    }
    assert_eq!(times, 2, "it begins anew");
    done(browser, posed).await;
}
