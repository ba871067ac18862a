//! Sessions: what a recording gives when it is counted again, kept, reported and forgotten by the commands.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Output;

use posed_motion::exercise::{Exercise, Options, Stream, teach};
use posed_rig::{DEMO, Rig, demo, record};
use posed_stage::input::{Input, Model, Plan, Request};
use serde_json::{Value, json};

use crate::exercise::wearer;

/// The demo's person has curled five times, and was taught from it.
fn taught() -> (Rig, Exercise) {
    let (stage, mut rig) = demo();
    rig.run_until(13.5);
    let (columns, t_s, values) = wearer(&rig, &stage, 0.0..13.5);
    let stream = Stream { columns: &columns, t_s: &t_s, values: &values };
    let options = Options { name: "curl".into(), repetitions: 5, ..Options::default() };
    let exercise = teach(&stream, &options).unwrap().exercise;
    (rig, exercise)
}

/// The curl of the demo's person, taught from the joints of her body.
pub(crate) fn write_curl_of_a_body(path: &Path) {
    std::fs::write(path, taught().1.to_json().unwrap()).unwrap();
}

/// A recording of the demo's person, who curls in sets of five after she was taught from the first one, and its messages.
fn recorded(path: &Path) -> Vec<Value> {
    let (mut rig, exercise) = taught();
    let exercise = Box::new(exercise);
    rig.push(Input::Model(Model::Exercise { exercise }));
    let plan = Plan { repetitions: Some(3), sets: Some(2), rest_s: 3.0 };
    let (subject, exercises) = ("default".to_owned(), vec!["curl".to_owned()]);
    rig.push(Input::Request(Request::ExerciseSelect {
        subject,
        exercises,
        plan,
        sensors: BTreeMap::new(),
        body: None,
    }));
    rig.run_until(45.0);
    record(path, &rig.log, DEMO, "exercise")
}

/// `posed session` in a folder.
fn session(folder: &Path, args: &[&str]) -> Output {
    let mut posed = std::process::Command::new(env!("CARGO_BIN_EXE_posed"));
    posed.arg("session").args(args).current_dir(folder).output().unwrap()
}

fn answer(folder: &Path, args: &[&str]) -> Value {
    let output = session(folder, args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap_or(Value::Null)
}

#[test]
fn what_was_said_live_is_kept_from_the_recording_reported_exported_and_forgotten() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let messages = recorded(&at.join("take.mcap"));
    let counted: Vec<&Value> = messages.iter().filter(|message| message["event"] == "counted").collect();
    assert!(counted.len() >= 5, "{}", counted.len());

    let kept = answer(at, &["count", "take.mcap", "--person", "P-17", "--json"]);
    assert_eq!(kept["session"], 1);
    let repetitions = kept["repetitions"].as_array().unwrap().iter().map(|it| &it["repetition"]);
    let again: Vec<&Value> = repetitions.filter(|it| it.get("reason").is_none()).collect();
    assert_eq!(again.len(), counted.len());
    for (again, said) in again.iter().zip(&counted) {
        assert_eq!((&again["t_start_s"], &again["number"]), (&said["t_start_s"], &said["set_count"]));
        assert_eq!(again["score"]["total"], said["score"]["total"]);
        assert_eq!(again["t_end_s"], said["t_valid_s"]);
    }
    // Elbows bend and straighten, and the course says so.
    let elbow =
        again[1]["joints"].as_array().unwrap().iter().find(|it| it["name"] == "elbow_r_flexion_deg").unwrap();
    let range_deg = elbow["greatest_deg"].as_f64().unwrap() - elbow["least_deg"].as_f64().unwrap();
    assert!((100.0..150.0).contains(&range_deg), "{elbow}");

    let shown = answer(at, &["show", "1", "--json"]);
    let sizes: Vec<usize> = shown["training"]
        .as_array()
        .unwrap()
        .iter()
        .map(|set| set["repetitions"].as_array().unwrap().len())
        .collect();
    assert_eq!(sizes[0], 3, "{sizes:?}");
    assert_eq!(
        answer(at, &["verify", "1", "take.mcap", "--json"]),
        json!({"compared": kept["repetitions"].as_array().unwrap().len(), "differences": []})
    );
    assert_eq!(answer(at, &["accuracy", "--json"]), json!({"counted": []}), "nobody has looked yet");
    answer(at, &["correct", "1", "1", "4"]);
    // Truth for whoever wants to know how well sets are counted, now and then.
    let off_by_one = json!([{"exercise": "curl", "sets": 1, "exact": 0, "within_one": 1}]);
    let accuracy = answer(at, &["accuracy", "--recordings", ".", "--json"]);
    assert_eq!(accuracy, json!({"counted": off_by_one, "counted_again": off_by_one, "not_counted_again": 0}));
    assert_eq!(answer(at, &["show", "1", "--json"])["training"][0]["corrected"], 4);

    answer(at, &["report", "1", "-o", "today.html", "--language", "de"]);
    answer(at, &["report", "--person", "P-17", "-o", "weeks.html"]);
    let report = std::fs::read_to_string(at.join("today.html")).unwrap();
    assert!(report.contains("rechter Ellenbogen, Beugung") && report.contains("<polyline class=\"taught\""));
    assert!(std::fs::read_to_string(at.join("weeks.html")).unwrap().contains("1 session ·"));
    for file in ["all.json", "all.csv", "all.fhir.json"] {
        answer(at, &["export", "--person", "P-17", "-o", file]);
    }
    let lines = std::fs::read_to_string(at.join("all.csv")).unwrap().lines().count();
    assert_eq!(lines, 1 + kept["repetitions"].as_array().unwrap().len());
    let bundle: Value = serde_json::from_slice(&std::fs::read(at.join("all.fhir.json")).unwrap()).unwrap();
    let quantity = &bundle["entry"][1]["resource"]["component"][0]["valueQuantity"];
    assert_eq!(quantity["value"].as_f64(), Some(counted.len() as f64));

    let asked = session(at, &["forget", "P-17"]);
    assert_eq!(asked.status.code(), Some(2), "what becomes of the recordings has to be said");
    answer(at, &["forget", "P-17", "--recordings", ".", "--json"]);
    assert!(!at.join("take.mcap").exists());
    assert_eq!(answer(at, &["people", "--json"]), json!([]));
    assert_eq!(answer(at, &["list", "--json"]), json!([]));
}

#[test]
fn plans_and_what_is_not_there_are_reported_in_words() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let failed = |args: &[&str]| {
        let output = session(at, args);
        assert_eq!(output.status.code(), Some(1), "{args:?}");
        String::from_utf8(output.stderr).unwrap()
    };
    assert!(failed(&["list"]).contains("give the daemon's folder with --data"));
    let plan = json!({"name": "week 3", "steps": [{"exercise": "curl", "sets": 3, "repetitions": 8, "rest_s": 60.0}]});
    std::fs::write(at.join("plan.json"), plan.to_string()).unwrap();
    answer(at, &["plan", "--save", "plan.json"]);
    assert_eq!(answer(at, &["plan", "--json"]), json!([plan]));
    std::fs::write(at.join("plan.json"), plan.to_string().replace("\"sets\":3", "\"sets\":0")).unwrap();
    assert!(failed(&["plan", "--save", "plan.json"]).contains("steps[0].sets"));
    answer(at, &["plan", "--delete", "week 3"]);
    assert!(failed(&["plan", "--delete", "week 3"]).contains("no plan called"));
    assert!(failed(&["show", "7"]).contains("no session 7"));
    assert!(failed(&["forget", "nobody"]).contains("nobody called"));
    std::fs::write(at.join("sessions.db"), "precious").unwrap();
    assert!(failed(&["list"]).contains("not a database"));
}
