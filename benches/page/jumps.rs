//! Jumps on the timeline of a take: how soon the picture shows the moment that was pressed, and how soon the replay goes on from there.

use std::time::Duration;

use serde_json::json;

use super::PROBE;
use super::chromium::{Browser, Screen};
use super::stage::Served;

/// Jumps, all over the take, none twice to the same place.
const JUMPS: usize = 40;
/// Longest wait for a jump's frames, s.
const PATIENCE_S: u32 = 120;

pub(crate) async fn run(served: &Served) {
    let url = format!("{}#watch", served.url);
    let mut browser = Browser::open_on(Screen::Full, &url, Some(PROBE)).await;
    browser.until("document.getElementById('timeline')?.ariaValueMax > 10 && probe.messages() > 100").await;
    let ruler = "(({ left, top, width }) => [left, top, width])(document.getElementById('timeline').getBoundingClientRect())";
    let [left, top, width]: [f64; 3] = serde_json::from_value(browser.value(ruler).await).unwrap();
    let (mut looked, mut arrived) = (Vec::new(), Vec::new());
    for number in 1..=JUMPS {
        let share = number as f64 * 0.618 % 1.0;
        browser.value("probe.jumps()").await;
        for kind in ["mousePressed", "mouseReleased"] {
            let event = json!({"type": kind, "x": left + share * width, "y": top + 6.0, "button": "left", "clickCount": 1});
            browser.call("Input.dispatchMouseEvent", event).await;
        }
        browser.until("probe.looked_ms() !== null").await;
        looked.push(browser.value("probe.looked_ms()").await.as_f64().unwrap());
        let waited = format!("probe.arrived_ms() !== null || probe.jumped_ms() > 1000 * {PATIENCE_S}");
        browser.until(&waited).await;
        arrived.push(browser.value("probe.arrived_ms()").await.as_f64().unwrap_or(f64::INFINITY));
        tokio::time::sleep(Duration::from_millis(300)).await;
    }
    println!("from the press to the picture of the moment: {}", spread(looked));
    println!("from the press to the first frames from there on: {}", spread(arrived));
    assert_eq!(browser.complaints, Vec::<String>::new());
}

/// Median, 90 % and longest, ms.
fn spread(mut all_ms: Vec<f64>) -> String {
    all_ms.sort_by(f64::total_cmp);
    let at = |share: f64| all_ms[((all_ms.len() - 1) as f64 * share) as usize];
    format!("median {:.0} ms, 90 % {:.0} ms, longest {:.0} ms", at(0.5), at(0.9), at(1.0))
}
