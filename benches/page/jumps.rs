//! Jumps on the timeline of a take: how soon the picture shows the moment that was pressed, and how soon the replay goes on from there.

use std::time::{Duration, Instant};

use serde_json::json;

use super::PROBE;
use super::chromium::{Browser, Screen};
use super::stage::Served;

/// Jumps, all over the take, none twice to the same place.
const JUMPS: usize = 40;
/// How long a hand scrubs.
const SCRUBS: Duration = Duration::from_secs(5);
/// Longest wait for a jump's frames, s: what nobody has passed through takes its replay.
const PATIENCE_S: u32 = 4;

pub(crate) async fn run(served: &Served) {
    let url = format!("{}#watch", served.url);
    let mut browser = Browser::open_on(Screen::Full, &url, Some(PROBE)).await;
    browser.until("document.getElementById('timeline')?.ariaValueMax > 10 && probe.messages() > 100 && probe.first_ms() !== null").await;
    println!(
        "from opening the page to the first picture: {:.0} ms",
        browser.value("probe.first_ms()").await.as_f64().unwrap()
    );
    let ruler = "(({ left, top, width }) => [left, top, width])(document.getElementById('timeline').getBoundingClientRect())";
    let [left, top, width]: [f64; 3] = serde_json::from_value(browser.value(ruler).await).unwrap();
    for view in ["watch", "check"] {
        scrub(&mut browser, view, [left, top, width]).await;
    }
    browser.click("tab-watch").await;
    let (mut answered, mut looked, mut arrived) = (Vec::new(), Vec::new(), Vec::new());
    for number in 1..=JUMPS {
        let share = number as f64 * 0.618 % 1.0;
        browser.value("probe.jumps()").await;
        for kind in ["mousePressed", "mouseReleased"] {
            let event = json!({"type": kind, "x": left + share * width, "y": top + 6.0, "button": "left", "clickCount": 1});
            browser.call("Input.dispatchMouseEvent", event).await;
        }
        browser.until("probe.looked_ms() !== null").await;
        answered.push(browser.value("probe.answered_ms()").await.as_f64().unwrap());
        looked.push(browser.value("probe.looked_ms()").await.as_f64().unwrap());
        let waited = format!("probe.arrived_ms() !== null || probe.jumped_ms() > 1000 * {PATIENCE_S}");
        browser.until(&waited).await;
        arrived.extend(browser.value("probe.arrived_ms()").await.as_f64());
        tokio::time::sleep(Duration::from_millis(300)).await;
    }
    println!("from the press to the daemon's answer: {}", spread(answered));
    println!("from the press to the picture of the moment: {}", spread(looked));
    let (there, all) = (arrived.len(), JUMPS);
    println!(
        "first frames from there on within {PATIENCE_S} s: {there} of {all}; of these {}",
        spread(arrived)
    );
    assert_eq!(browser.complaints, Vec::<String>::new());
}

/// A hand that goes over what nobody has looked at, for some seconds: how many pictures are drawn, and how many moments come.
async fn scrub(browser: &mut Browser, view: &str, [left, top, width]: [f64; 3]) {
    browser.click(&format!("tab-{view}")).await;
    tokio::time::sleep(Duration::from_secs(2)).await;
    let mouse = |kind: &str, share: f64| json!({"type": kind, "x": left + share * width, "y": top + 6.0, "button": "left", "buttons": 1, "clickCount": 1});
    // Each view over another part of it.
    let from = if view == "watch" { 0.05 } else { 0.5 };
    browser.value("probe.jumps()").await;
    browser.call("Input.dispatchMouseEvent", mouse("mousePressed", from)).await;
    browser.value("probe.begin()").await;
    let begun = Instant::now();
    let mut pace = tokio::time::interval(Duration::from_millis(16));
    while begun.elapsed() < SCRUBS {
        pace.tick().await;
        let share = from + 0.4 * begun.elapsed().as_secs_f64() / SCRUBS.as_secs_f64();
        browser.call("Input.dispatchMouseEvent", mouse("mouseMoved", share)).await;
    }
    let seconds = begun.elapsed().as_secs_f64();
    let reported = browser.value("probe.reported()").await;
    let looks = browser.value("probe.looks()").await.as_f64().unwrap();
    browser.call("Input.dispatchMouseEvent", mouse("mouseReleased", from + 0.4)).await;
    println!(
        "scrubbing in {view}: {:.0} frames and {:.0} new moments a second",
        reported["frames"].as_f64().unwrap() / seconds,
        looks / seconds
    );
    tokio::time::sleep(Duration::from_secs(2)).await;
}

/// Median, 90 % and longest, ms.
fn spread(mut all_ms: Vec<f64>) -> String {
    if all_ms.is_empty() {
        return "none".to_owned();
    }
    all_ms.sort_by(f64::total_cmp);
    let at = |share: f64| all_ms[((all_ms.len() - 1) as f64 * share) as usize];
    format!("median {:.0} ms, 90 % {:.0} ms, longest {:.0} ms", at(0.5), at(0.9), at(1.0))
}
