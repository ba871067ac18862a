//! What the page costs the browser at 50 sensors, what a hidden tab does, and that hours do not make it grow.
//!
//! ```text
//! cargo bench --bench page                  scripting and drawing calls per frame, by view; then a hidden tab
//! cargo bench --bench page -- --demo        the same with the 13 sensors and the body of `posed demo` as it is
//! cargo bench --bench page -- --take a.mcap jumps on the timeline of a take, from the press to the picture of that moment
//! cargo bench --bench page -- --openings 10 from opening the page to a moving body, each in a fresh browser
//! cargo bench --bench page -- --hours 8     memory over so many hours of messages, as fast as the page takes them
//! ```
//! The stage is that of `posed demo`, a person with ten IMUs and three trackers, and 37 birds of a MotionStar beside it. A frame's cost is the
//! time in the callbacks of the websocket since the last frame and in that of the frame itself. Needs Chromium; on a
//! quiet machine.

#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a bench tells what it measured, or stops")]
#![allow(clippy::disallowed_methods, reason = "a bench measures time")]

#[path = "../../tests/chromium/mod.rs"]
mod chromium;
mod hours;
mod jumps;
mod stage;

use std::time::Duration;

use chromium::{Browser, Screen};
use clap::Parser;

#[derive(Parser)]
struct Args {
    /// Hours of messages, in place of the other figures.
    #[arg(long)]
    hours: Option<f64>,
    /// The stage of `posed demo`, without the birds.
    #[arg(long)]
    demo: bool,
    /// Jumps in this take, in place of the other figures.
    #[arg(long)]
    take: Option<std::path::PathBuf>,
    /// So many openings of the page of `posed demo`, in place of the other figures.
    #[arg(long)]
    openings: Option<usize>,
    /// Seconds in each view.
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Given by cargo.
    #[arg(long, hide = true)]
    bench: bool,
}

/// Times the callbacks of the page, and lets a bench put another websocket in the place of the daemon's.
const PROBE: &str = include_str!("probe.js");

/// The views, by the word in the address.
const VIEWS: [&str; 6] = ["watch", "coach", "check", "calibrate", "analyse", "takes"];

#[tokio::main]
async fn main() {
    let args = Args::parse();
    if let Some(take) = args.take {
        return jumps::run(&stage::Served::replay(&take)).await;
    }
    if let Some(count) = args.openings {
        return openings(&stage::Served::demo(), count).await;
    }
    let (served, sensors) =
        if args.demo { (stage::Served::demo(), 13) } else { (stage::Served::start(), 50) };
    match args.hours {
        Some(hours) => hours::run(&served, hours).await,
        None => frames(&served, sensors, Duration::from_secs_f64(args.seconds)).await,
    }
}

/// From opening the page to the first frame in which the body has moved.
async fn openings(served: &stage::Served, count: usize) {
    let mut all_ms = Vec::new();
    for _ in 0..count {
        let mut browser = Browser::open_on(Screen::Full, &served.url, Some(PROBE)).await;
        browser.until("probe.moved_ms() !== null").await;
        all_ms.push(browser.value("probe.moved_ms()").await.as_f64().unwrap());
    }
    all_ms.sort_by(f64::total_cmp);
    let [first, middle, last] = [0, count / 2, count - 1].map(|at| all_ms[at] / 1e3);
    println!("{count} openings: {middle:.2} s to a moving body (median), {first:.2} to {last:.2} s");
}

async fn frames(served: &stage::Served, sensors: u32, each: Duration) {
    let mut browser = Browser::open_on(Screen::Full, &served.url, Some(PROBE)).await;
    browser
        .until(&format!("document.getElementById('summary').textContent.includes('of {sensors} are good')"))
        .await;
    println!("| view | frames per second | messages per second | median, ms | 95 %, ms | 99 %, ms |");
    println!("|---|---|---|---|---|---|");
    for view in VIEWS {
        browser.click(&format!("tab-{view}")).await;
        // What is made once when a view is first shown is not what a frame costs.
        tokio::time::sleep(Duration::from_secs(3)).await;
        browser.value("probe.begin()").await;
        tokio::time::sleep(each).await;
        let reported = browser.value("probe.reported()").await;
        let number = |key: &str| reported[key].as_f64().unwrap();
        println!(
            "| {view} | {:.0} | {:.0} | {:.1} | {:.1} | {:.1} |",
            number("frames") / each.as_secs_f64(),
            number("messages") / each.as_secs_f64(),
            number("p50_ms"),
            number("p95_ms"),
            number("p99_ms"),
        );
    }
    hidden(&mut browser, each).await;
    assert_eq!(browser.complaints, Vec::<String>::new());
}

/// A tab that nobody sees: what it draws, how it grows, how soon it is current once it is seen again.
async fn hidden(browser: &mut Browser, each: Duration) {
    browser.click("tab-check").await;
    browser.hide(true).await;
    browser.until("document.hidden").await;
    let before = browser.heap_bytes().await;
    browser.value("probe.begin()").await;
    tokio::time::sleep(3 * each).await;
    let reported = browser.value("probe.reported()").await;
    let grown = browser.heap_bytes().await - before;
    browser.hide(false).await;
    browser.until("!document.hidden").await;
    // From being shown to the first drawing of a frame of the stage that is younger than that.
    browser.until("probe.current_ms() !== null").await;
    let current = browser.value("probe.current_ms()").await;
    println!(
        "\nhidden for {:.0} s: {} frames drawn, {} messages taken, heap {grown:+} bytes; current {current} ms after its return",
        3.0 * each.as_secs_f64(),
        reported["frames"],
        reported["messages"],
    );
}
