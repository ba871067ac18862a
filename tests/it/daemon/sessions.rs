//! Sessions on a running daemon: begun and ended, a plan that selects by itself, and what is left when it is killed.

use std::path::Path;

use serde_json::{Value, json};

use super::exercises::write;
use super::process::{PATIENCE, Posed, ok, refused, two_devices, until};
use crate::server::harness::Client;

fn start(folder: &Path) -> Posed {
    Posed::demo_that_keeps(&two_devices(folder, ""))
}

/// What goes on, as the topic says it.
async fn goes_on(client: &mut Client, fits: impl Fn(&Value) -> bool) -> Value {
    let message =
        until(client, "a session", |message| message["type"] == "session" && fits(&message["sessions"]))
            .await;
    message["sessions"][0].clone()
}

#[tokio::test]
async fn a_session_goes_on_by_its_plan_and_outlives_a_daemon_that_is_killed() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("exercises")).unwrap();
    write(&folder.path().join("exercises/curl-001.json"), "curl");
    let posed = start(folder.path());
    let mut client = posed.client().await;
    // Who asks may be notified before the answer comes.
    let mut watcher = posed.subscriber(&["session"]).await;
    assert_eq!(ok(&mut client, json!({"type": "session.list"})).await, json!({"sessions": []}));

    // Free training of somebody, ended by hand.
    let begun = ok(&mut client, json!({"type": "session.begin", "person": "P-1", "subject": "left"})).await;
    assert_eq!(begun, json!({"session": 1}));
    let shown = goes_on(&mut watcher, |sessions| sessions[0]["session"] == 1).await;
    assert_eq!(
        (&shown["person"], &shown["subject"], &shown["counted"]),
        (&json!("P-1"), &json!("left"), &json!(0))
    );
    let again = json!({"type": "session.begin", "person": "P-2", "subject": "left"});
    assert_eq!(refused(&mut client, again).await.0, "already");
    ok(&mut client, json!({"type": "session.end", "subject": "left"})).await;
    goes_on(&mut watcher, |sessions| sessions == &json!([])).await;
    assert_eq!(refused(&mut client, json!({"type": "session.end", "subject": "left"})).await.0, "not_found");

    // A plan selects its first exercise by itself; one that the stage does not have is said.
    let step = |exercise: &str| json!({"exercise": exercise, "sets": 2, "repetitions": 5, "rest_s": 30});
    for exercise in ["curl", "lunge"] {
        let plan = json!({"name": exercise, "steps": [step(exercise)]});
        ok(&mut client, json!({"type": "session.save_plan", "plan": plan})).await;
    }
    let mut counted = posed.subscriber(&["exercise"]).await;
    ok(&mut client, json!({"type": "session.begin", "person": "P-2", "plan": "curl"})).await;
    let state = until(&mut counted, "what is selected", |message| message["state"]["repetitions"] == 5).await;
    assert_eq!(state["state"]["exercises"][0]["exercise"], "curl");
    let lunge = json!({"type": "session.begin", "person": "P-3", "plan": "lunge", "subject": "other"});
    ok(&mut client, lunge).await;
    let problem =
        |sessions: &Value| sessions[1]["problem"].as_str().is_some_and(|problem| problem.contains("lunge"));
    goes_on(&mut watcher, problem).await;
    let unknown = json!({"type": "session.begin", "person": "P-4", "plan": "none", "subject": "third"});
    assert_eq!(refused(&mut client, unknown).await.0, "not_found");
    let report =
        ok(&mut client, json!({"type": "session.report", "person": "P-2", "language": "german"})).await;
    assert!(
        report["html"].as_str().unwrap().contains("Die Sitzung")
            || report["html"].as_str().unwrap().contains("Sitzung")
    );

    // Nobody ends them.
    posed.signal("KILL");
    drop(posed);
    let posed = start(folder.path());
    let mut client = posed.client().await;
    let ended_by = async |client: &mut Client| {
        let list = ok(client, json!({"type": "session.list"})).await;
        let of = |session: &Value| (session["person"].clone(), session["ended_by"].clone());
        list["sessions"].as_array().unwrap().iter().map(of).collect::<Vec<_>>()
    };
    let pair = |person: &str, ended_by: &str| (json!(person), json!(ended_by));
    let expected = vec![pair("P-3", "interruption"), pair("P-2", "interruption"), pair("P-1", "request")];
    // The thread ends them as it begins.
    let found = async { while ended_by(&mut client).await != expected {} };
    tokio::time::timeout(PATIENCE, found).await.expect("they are ended");
    // Somebody is forgotten in the middle of a session; another one's ends with the daemon.
    ok(&mut client, json!({"type": "session.begin", "person": "P-1", "subject": "left"})).await;
    ok(&mut client, json!({"type": "session.begin", "person": "P-5"})).await;
    let forgotten =
        ok(&mut client, json!({"type": "session.forget", "person": "P-1", "recordings": false})).await;
    assert_eq!(forgotten, json!({"sessions": 2, "recordings": [], "erasure": "done"}));
    let people = ok(&mut client, json!({"type": "session.people"})).await;
    let names: Vec<&Value> =
        people["people"].as_array().unwrap().iter().map(|person| &person["name"]).collect();
    assert_eq!(names, ["P-2", "P-3", "P-5"]);
    assert_eq!(posed.end("INT").await.code(), Some(0));
    let posed = start(folder.path());
    let mut client = posed.client().await;
    assert_eq!(ended_by(&mut client).await[0], pair("P-5", "daemon"));
}
