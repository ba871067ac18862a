//! The trainer in a real browser: an exercise is taught and counted, and a session goes by its plan to its report.

use std::path::Path;

use serde_json::json;

use crate::chromium::{self, Browser};
use crate::daemon::process::{Posed, ok, two_devices, until};
use crate::sessions::write_curl_of_a_body;

use super::{LIVE, done};

/// An arm that curls five times and rests for twelve seconds, again and again; as poses for the simulator.
fn write_curls(path: &Path) {
    let mut text = String::from("t,sensor,x,y,z,qw,qx,qy,qz\n");
    for tick in 0..12_000 {
        let t_s = f64::from(tick) * 0.05;
        let since_s = t_s % 22.0;
        let bend = if since_s < 10.0 { 1.0 - libm::cos(std::f64::consts::TAU * since_s / 2.0) } else { 0.0 };
        let (s, c) = libm::sincos(bend);
        let (half_s, half_c) = libm::sincos(0.5 * bend);
        let (x, z) = (0.5 + 0.25 * s, 0.3 - 0.25 * c);
        text += &format!("{t_s:.2},forearm,{x:.5},0.1,{z:.5},{half_c:.6},0,{:.6},0\n", -half_s);
    }
    std::fs::write(path, text).unwrap();
}

/// Waits until a sensor has rested for two seconds: a busy machine may be late with anything but that.
async fn rests(posed: &Posed, sensor: usize) {
    let mut client = posed.subscriber(&["sensors"]).await;
    let (mut rested_at_m, mut since_s) = ([0.0; 3], f64::INFINITY);
    loop {
        let frame = until(&mut client, "sensors", |message| message["type"] == "sensors").await;
        let at_m = &frame["sensors"][sensor]["position_m"];
        let Some(at_m) = at_m.as_array() else { continue };
        let at_m: [f64; 3] = std::array::from_fn(|axis| at_m[axis].as_f64().unwrap());
        let t_s = frame["t_s"].as_f64().unwrap();
        let moved = at_m.iter().zip(rested_at_m).any(|(now, then)| (now - then).abs() > 0.01);
        if moved {
            (rested_at_m, since_s) = (at_m, t_s);
        } else if t_s - since_s > 2.0 {
            return;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_exercise_is_taught_and_counted_in_the_browser_and_an_unplugged_device_named() {
    if !chromium::is_wanted() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    write_curls(&folder.path().join("arm.csv"));
    let mut simulation = String::new();
    for at_s in (20..600).step_by(20) {
        simulation +=
            &format!("[[simulation.device.fault]]\nkind = \"unplug\"\nat_s = {at_s}.0\nduration_s = 4.0\n");
    }
    simulation += "[[simulation.body]]\nname = \"arm\"\n[simulation.body.motion]\nkind = \"file\"\npath = \"arm.csv\"\n\
        [[simulation.sensor]]\nname = \"of two\"\nbody = \"arm\"\nsegment = \"forearm\"\n";
    let stage = two_devices(folder.path(), &simulation);
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut browser = Browser::open(&format!("http://{}/#coach", posed.address)).await;
    browser.until(LIVE).await;
    let text = |id: &str| format!("document.getElementById('{id}').textContent");
    browser.fill("#teach-name", "curl").await;
    rests(&posed, 1).await;
    browser.click("teach").await;
    // The other device goes away meanwhile: named at the top and under Check, with what to check.
    browser.click("tab-check").await;
    let first =
        "[...document.getElementById('devices').rows[0].cells].map((cell) => cell.textContent).join(' ')";
    browser.until(&format!("/^one .*connecting: .*check the cable/.test({first})")).await;
    browser.until(&format!("/^one .*streaming/.test({first})")).await;
    browser.until(&format!("{}.includes('exercise.teach · done')", text("jobs"))).await;
    browser.click("tab-coach").await;
    browser.until("document.querySelectorAll('#exercises input').length === 1").await;
    browser.value("document.querySelector('#exercises input:not(:checked)')?.click()").await;
    browser.fill("#target", "3").await;
    // Who does as was taught is praised, in the language that is wished, and aloud if that is.
    browser
        .value("speechSynthesis.speak = ({ text, lang }) => { window.spoken = `${lang}: ${text}`; }")
        .await;
    browser.fill("#language", "de").await;
    browser.click("aloud").await;
    browser.click("select").await;
    browser.until("document.querySelectorAll('.bars .done').length === 3").await;
    browser
        .until(&format!("{} === 'Gut gemacht.' && window.spoken === 'de: Gut gemacht.'", text("feedback")))
        .await;
    browser.until(&format!("/^[0-9]+ von 100: Ausmaß [0-9]+, Tempo/.test({})", text("score"))).await;
    // A session by a plan, from its making to its report, without a hand on it between.
    browser.click("tab-plan").await;
    browser.fill("#plan-name", "week 1").await;
    browser.fill(".step-exercise", "curl").await;
    browser.fill("#plan-steps input[aria-label='sets']", "1").await;
    browser.fill("#plan-steps input[aria-label='repetitions']", "2").await;
    browser.click("plan-save").await;
    browser.until("document.getElementById('session-plan').value === 'week 1'").await;
    browser.fill("#session-person", "P-17").await;
    browser.click("session-begin").await;
    browser.until(&format!("/^P-17 trains .*step 1 of 1: curl/.test({})", text("session-now"))).await;
    browser.until("/P-17.*week 1 *1 *2 /.test([...(document.getElementById('session-list').rows[0]?.cells ?? [])].map((cell) => cell.textContent).join(' '))").await;
    browser.until(&format!("{} === 'Nobody trains now.'", text("session-now"))).await;
    browser.value("document.querySelector('#session-list button').click()").await;
    browser
        .until("document.getElementById('report').srcdoc.includes('2 repetitions counted (planned 2)')")
        .await;
    // Each repetition over its lesson; and a count that is put right is kept beside the daemon's.
    browser.value("document.querySelectorAll('#session-list button')[1].click()").await;
    browser.until(&format!("{} === 'Session 1 of P-17'", text("sets-title"))).await;
    browser.value("document.querySelector('#session-sets td:last-child button:not(.quiet)').click()").await;
    browser.until(&format!("/^Repetition 1 of set 1, [0-9.]+ s/.test({})", text("repetition-summary"))).await;
    browser.fill("#session-sets input", "3").await;
    browser.value("document.querySelector('#session-sets form button').click()").await;
    browser.until(&format!("{}.includes('put right')", text("session-sets"))).await;
    browser.until("document.querySelector('#session-sets input').value === '3'").await;
    browser.click("tab-analyse").await;
    let counted = "[...document.getElementById('repetitions').rows].map((row) => [...row.cells].map((cell) => \
        cell.textContent)).filter((cells) => cells[1] === 'curl' && cells[4] === 'counted')";
    browser.until(&format!("{counted}.length >= 3")).await;
    // The longest: the device is unplugged every 20 s, which cuts those that it falls into, and a busy machine's first record of one may be late.
    let longest = "reduce((a, b) => Math.max(a, b))";
    let repetition =
        browser.value(&format!("{counted}.slice(0, 3).map((cells) => Number(cells[2])).{longest}")).await;
    // Of the two seconds the slow ones at either end are rest.
    assert!((0.5..2.5).contains(&repetition.as_f64().unwrap()), "{repetition}");
    done(browser, posed).await;
}

/// Beside the person who trains stands a figure that does what is to be done.
#[tokio::test(flavor = "multi_thread")]
async fn the_demonstration_stands_beside_the_person() {
    if !chromium::is_wanted() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    posed_rig::copy_demo(folder.path());
    std::fs::create_dir(folder.path().join("exercises")).unwrap();
    write_curl_of_a_body(&folder.path().join("exercises/curl-001.json"));
    let posed = Posed::demo_that_keeps(&folder.path().join("demo.toml"));
    let mut browser = Browser::open(&format!("http://{}/#exercise", posed.address)).await;
    browser.until(LIVE).await;
    let shows = "document.getElementById('exercise-figure').dataset.demonstrates";
    browser.until("document.querySelector('#exercise-figure canvas') !== null").await;
    let mut client = posed.client().await;
    ok(&mut client, json!({"type": "exercise.select", "exercises": ["curl"]})).await;
    browser.until(&format!("{shows} === 'curl'")).await;
    browser.until("document.getElementById('exercise-title').textContent === 'curl'").await;
    ok(&mut client, json!({"type": "exercise.select", "exercises": []})).await;
    browser.until(&format!("{shows} === ''")).await;
    done(browser, posed).await;
}
