//! Each part of a running daemon is made to panic or to hang: tracking goes on, or the program ends with a code and a sentence.

use std::path::Path;
use std::time::Duration;

use posed_recording::Info;
use serde_json::{Value, json};

use super::process::{
    Posed, all_ok, frames, ok, record_start, refused, replays_alike, succeed, two_devices, until,
};
use crate::server::harness::Client;

/// A daemon on two virtual devices, of which this is to go wrong; its log goes to `log` in the folder.
fn with(folder: &Path, faults: &str) -> Posed {
    Posed::demo_logged(&two_devices(folder, ""), &folder.join("log"), faults)
}

#[expect(clippy::disallowed_methods, reason = "how late a frame is, is measured")]
fn now() -> std::time::Instant {
    std::time::Instant::now()
}

/// Longest time between two frames, in their own time and as they come, s, until one fits that comes after `what`.
async fn longest_gaps(client: &mut Client, what: &str, fits: impl Fn(&Value) -> bool) -> (f64, f64) {
    let (mut last, mut gaps) = (None::<(f64, std::time::Instant)>, (0.0_f64, 0.0_f64));
    loop {
        let message = until(client, what, |_| true).await;
        if fits(&message) {
            return gaps;
        }
        if message["type"] == "sensors" {
            let (t_s, at) = (message["t_s"].as_f64().unwrap(), now());
            if let Some((before_s, before)) = last {
                assert!(t_s > before_s, "{what}: time goes back");
                gaps = (gaps.0.max(t_s - before_s), gaps.1.max(at.duration_since(before).as_secs_f64()));
            }
            last = Some((t_s, at));
        }
    }
}

fn has_problem(code: &'static str) -> impl Fn(&Value) -> bool {
    move |message| {
        message["problems"].as_array().is_some_and(|problems| problems.iter().any(|p| p["code"] == code))
    }
}

#[tokio::test]
async fn tracking_outlives_its_own_panics_and_a_replay_does_so_too() {
    let folder = tempfile::tempdir().unwrap();
    let posed = with(folder.path(), "pipeline=fail@1200,pipeline=fail@1500");
    let mut client = posed.subscriber(&["sensors", "status"]).await;
    until(&mut client, "all sensors", all_ok).await;
    ok(&mut client, record_start("take")).await;
    let (stage_s, wall_s) = longest_gaps(&mut client, "a problem", has_problem("tracking")).await;
    println!("tracking panicked: {stage_s:.3} s without a frame, {wall_s:.3} s at the client");
    until(&mut client, "both panics", |message| {
        message["problems"].as_array().is_some_and(|problems| {
            problems.iter().any(|p| p["message"].as_str().is_some_and(|text| text.contains("2 times")))
        })
    })
    .await;
    until(&mut client, "all sensors", all_ok).await;
    frames(&mut client, 20).await;
    let health = posed.get("/health").await;
    assert!(health.starts_with("HTTP/1.1 200") && health.contains("problem: tracking"), "{health}");
    ok(&mut client, json!({"type": "record.stop"})).await;
    assert_eq!(posed.end("INT").await.code(), Some(0));
    let log = std::fs::read_to_string(folder.path().join("log")).unwrap();
    assert!(log.contains("went on without what it panicked at"), "{log}");
    // The recording holds what brought the panics; a replay that does not panic at it is held by the unit's tests.
    assert!(Info::read(&folder.path().join("recordings/take.mcap"), |_| ()).unwrap().complete);
}

#[tokio::test]
async fn a_port_that_panics_begins_again_and_the_other_loses_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let posed = with(folder.path(), "port=panic@400");
    let mut client = posed.subscriber(&["sensors", "status"]).await;
    until(&mut client, "all sensors", all_ok).await;
    let is_away = |message: &Value| {
        message["devices"].as_array().is_some_and(|devices| {
            devices
                .iter()
                .any(|d| d["reason"].as_str().is_some_and(|reason| reason.contains("fault of its own")))
        })
    };
    until(&mut client, "a device whose port has panicked", is_away).await;
    let (stage_s, _) = longest_gaps(&mut client, "all again", all_ok).await;
    assert!(stage_s < 0.1, "the other one went on, and its frames came: {stage_s} s");
    assert_eq!(posed.end("INT").await.code(), Some(0));
}

#[tokio::test]
async fn a_request_that_panics_is_refused_and_the_next_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let posed = with(folder.path(), "call=panic@1");
    let mut client = posed.subscriber(&["sensors"]).await;
    let (code, _) = refused(&mut client, record_start("take")).await;
    assert_eq!(code, "unavailable");
    ok(&mut client, record_start("take")).await;
    until(&mut client, "all sensors", all_ok).await;
    assert_eq!(posed.end("INT").await.code(), Some(0));
}

#[tokio::test]
async fn a_recording_whose_threads_panic_or_whose_disk_fails_ends_with_a_reason() {
    for (fault, word) in
        [("recorder=panic@3", "crashed"), ("sync=panic@2", "crashed"), ("recorder=fail@3", "full")]
    {
        let folder = tempfile::tempdir().unwrap();
        let posed = with(folder.path(), fault);
        let mut client = posed.subscriber(&["sensors", "status"]).await;
        ok(&mut client, record_start("take")).await;
        let status = until(&mut client, fault, has_problem("recording")).await;
        // Beside whatever a slow machine makes the devices say.
        let problems = status["problems"].as_array().unwrap();
        let of_it = problems.iter().find(|problem| problem["code"] == "recording").unwrap();
        let sentence = of_it["message"].as_str().unwrap();
        assert!(sentence.contains(word), "{fault}: {sentence}");
        until(&mut client, "all sensors", all_ok).await;
        // What was written can be saved and replayed, and the next recording works.
        let torn = folder.path().join("recordings/take.mcap");
        succeed(["info".as_ref(), torn.as_os_str(), "--repair".as_ref()]);
        replays_alike(&torn);
        ok(&mut client, record_start("next")).await;
        frames(&mut client, 20).await;
        assert_eq!(posed.end("INT").await.code(), Some(0));
    }
}

#[tokio::test]
async fn what_cannot_go_on_ends_the_program_with_its_name() {
    for (fault, part) in
        [("fusion=panic@600", "tracking"), ("distributor=panic@200", "what sends to clients")]
    {
        let folder = tempfile::tempdir().unwrap();
        let mut posed = with(folder.path(), fault);
        let ended = tokio::task::spawn_blocking(move || posed.child.wait().unwrap());
        let code =
            tokio::time::timeout(super::process::PATIENCE, ended).await.expect("it ends").unwrap().code();
        let log = std::fs::read_to_string(folder.path().join("log")).unwrap();
        assert_eq!(code, Some(1), "{log}");
        assert!(log.contains(&format!("{part} ended by itself")), "{log}");
    }
}

/// Seconds that a disk hangs; 20 with `POSED_HANG_S=20`.
fn hang_s() -> f64 {
    std::env::var("POSED_HANG_S").ok().and_then(|text| text.parse().ok()).unwrap_or(2.0)
}

#[tokio::test]
async fn a_disk_that_hangs_holds_no_frame_back_and_leaves_no_hole() {
    let folder = tempfile::tempdir().unwrap();
    let posed = with(folder.path(), &format!("recorder=hang:{0}@4,sync=hang:{0}@6", hang_s() * 1e3));
    let mut client = posed.subscriber(&["sensors", "status"]).await;
    until(&mut client, "all sensors", all_ok).await;
    ok(&mut client, record_start("take")).await;
    let begun = frames(&mut client, 1).await[0]["t_s"].as_f64().unwrap();
    let over =
        |message: &Value| message["t_s"].as_f64().is_some_and(|t_s| t_s > begun + 2.0 * hang_s() + 4.0);
    let (stage_s, wall_s) = longest_gaps(&mut client, "the end of both", over).await;
    println!(
        "a disk hung for {} s twice: {stage_s:.4} s between frames at most, {wall_s:.4} s at the client",
        hang_s()
    );
    assert!(stage_s < 0.5, "frames stopped for {stage_s} s");
    ok(&mut client, json!({"type": "record.stop"})).await;
    assert_eq!(posed.end("INT").await.code(), Some(0));
    let take = folder.path().join("recordings/take.mcap");
    assert!(Info::read(&take, |_| ()).unwrap().complete);
    replays_alike(&take);
}

/// What `/health` answers once that is no longer ok.
async fn sick(posed: &Posed) -> String {
    let sick = async {
        // As a service manager asks: who asks without end is not answered.
        let mut beat = tokio::time::interval(Duration::from_millis(100));
        loop {
            beat.tick().await;
            let health = posed.get("/health").await;
            if health.starts_with("HTTP/1.1 503") {
                return health;
            }
        }
    };
    tokio::time::timeout(super::process::PATIENCE, sick).await.expect("it says so")
}

#[tokio::test]
async fn health_says_so_where_tracking_hangs() {
    let folder = tempfile::tempdir().unwrap();
    let posed = with(folder.path(), "fusion=hang:8000@600");
    let mut client = posed.subscriber(&["sensors"]).await;
    until(&mut client, "a frame", |message| message["type"] == "sensors").await;
    assert!(posed.get("/health").await.starts_with("HTTP/1.1 200"));
    let health = sick(&posed).await;
    assert!(health.contains("tracking has reported nothing"), "{health}");
    until(&mut client, "all sensors again", all_ok).await;
}

/// Sends so many requests at once; the answers, in whatever order they come.
async fn answers(client: &mut Client, request: &Value, count: usize) -> Vec<Value> {
    for id in 0..count {
        let mut request = request.clone();
        request["id"] = json!(id);
        client.send(request).await;
    }
    let mut answers = Vec::new();
    while answers.len() < count {
        let answer = |message: &Value| matches!(message["type"].as_str(), Some("ok" | "error"));
        answers.push(until(client, "an answer", answer).await);
    }
    answers
}

fn busy(answers: &[Value]) -> usize {
    answers.iter().filter(|answer| answer["code"] == "busy").count()
}

#[tokio::test]
async fn requests_for_a_disk_that_hangs_are_bounded_and_the_others_are_answered() {
    let folder = tempfile::tempdir().unwrap();
    let posed = with(folder.path(), "file=hang:3000@1");
    let (mut lists, mut other) = (posed.client().await, posed.subscriber(&["sensors"]).await);
    let listing =
        tokio::spawn(async move { answers(&mut lists, &json!({"type": "replay.list"}), 100).await });
    ok(&mut other, record_start("take")).await;
    frames(&mut other, 20).await;
    let answers = listing.await.unwrap();
    // One hangs and 64 wait; who came before the thread had taken the first finds one place less.
    assert!((35..=36).contains(&busy(&answers)), "{}", busy(&answers));
    assert!(answers.iter().all(|answer| answer["type"] == "ok" || answer["code"] == "busy"), "{answers:?}");
    assert_eq!(posed.end("INT").await.code(), Some(0));
}

#[tokio::test]
async fn requests_for_a_thread_that_hangs_are_bounded_and_tracking_goes_on_after_it() {
    let folder = tempfile::tempdir().unwrap();
    let posed = with(folder.path(), "fusion=hang:12000@600");
    let mut frames_of = posed.subscriber(&["sensors"]).await;
    let health = sick(&posed).await;
    assert!(health.contains("tracking has reported nothing"), "{health}");
    let (mut one, mut two) = (posed.client().await, posed.client().await);
    let request = json!({"type": "record.stop"});
    let (first, second) = tokio::join!(answers(&mut one, &request, 150), answers(&mut two, &request, 150));
    // 256 wait for the thread; fewer where they come faster than they are handed on.
    assert!(busy(&first) + busy(&second) >= 300 - 256);
    let is_answered =
        |answer: &Value| answer["code"] == "busy" || answer["message"] == "nothing is being recorded";
    assert!(first.iter().chain(&second).all(is_answered), "{first:?} {second:?}");
    until(&mut frames_of, "all sensors again", all_ok).await;
    assert_eq!(posed.end("INT").await.code(), Some(0));
}
