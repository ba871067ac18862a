//! `posed segments` from file to file.

use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output};

use posed_stage::input::Input;

use posed_rig::{DEMO, demo, record};

fn posed(folder: &Path, words: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_posed"))
        .current_dir(folder)
        .args(words.split_whitespace())
        .output()
        .unwrap()
}

fn ok(folder: &Path, words: &str) -> serde_json::Value {
    let output = posed(folder, words);
    assert!(output.status.success(), "{words}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap_or_default()
}

/// Two hands and a head, y up, in metres at 30 Hz: one hand or the other is lifted, 3 s each.
fn write_sequence(path: &Path, seed: u32, labelled: bool) -> Vec<&'static str> {
    let mut text = String::from("head_x,head_y,head_z,hand_l_x,hand_l_y,hand_l_z,hand_r_x,hand_r_y,hand_r_z");
    text += if labelled { ",label\n" } else { "\n" };
    let mut labels = Vec::new();
    for frame in 0..900_u32 {
        let label = if (frame / 90 + seed).is_multiple_of(2) { "left up" } else { "right up" };
        let swing = 0.1 * libm::sin(f64::from(frame + 7 * seed) * 0.37);
        let lift = |wanted: &str| if label == wanted { 1.4 + swing } else { 0.9 };
        let walk = 0.01 * f64::from(frame);
        let (left, right) = (lift("left up"), lift("right up"));
        write!(text, "{walk},1.7,0,{walk},{left},-0.3,{walk},{right},0.3").unwrap();
        text += &if labelled { format!(",{label}\n") } else { "\n".to_owned() };
        labels.push(label);
    }
    std::fs::write(path, text).unwrap();
    labels
}

#[test]
fn a_folder_is_learned_a_file_is_labelled_and_the_labels_are_learned_from() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (train, again) = (folder.join("train"), folder.join("again"));
    std::fs::create_dir(&train).unwrap();
    std::fs::create_dir(&again).unwrap();
    write_sequence(&train.join("a.csv"), 0, true);
    write_sequence(&train.join("b.csv"), 1, true);
    let truth = write_sequence(&again.join("new.csv"), 3, false);

    let options = "--rate-hz 30 --filters 8,8,16 --epochs 12 --json";
    let summary = ok(folder, &format!("segments train train {options} -o m.safetensors"));
    assert_eq!(summary["labels"], serde_json::json!(["left up", "right up"]));
    assert!(!folder.join("m.safetensors.training").exists());
    let judged = ok(folder, "segments evaluate m.safetensors train --rate-hz 30 --picture bands.svg --json");
    assert!(judged["accuracy"].as_f64().unwrap() > 90.0, "{judged}");
    assert!(std::fs::read_to_string(folder.join("bands.svg")).unwrap().contains("left up"));

    ok(folder, "segments label m.safetensors again/new.csv --rate-hz 30 -o again/new.labels.csv");
    let labels = std::fs::read_to_string(again.join("new.labels.csv")).unwrap();
    assert!(labels.starts_with("frame,t,label,confidence\n"));
    let named: Vec<&str> = labels.lines().skip(1).map(|line| line.split(',').nth(2).unwrap()).collect();
    assert_eq!(named.len(), truth.len());
    let right = named.iter().zip(&truth).filter(|(named, truth)| named == truth).count();
    assert!(right > 800, "{right}");
    // Both kinds of label files are taken, beside a sequence without labels of its own.
    let judged = ok(folder, "segments evaluate m.safetensors again --rate-hz 30 --json");
    assert!(judged["accuracy"].as_f64().unwrap() > 99.9, "{judged}");
    std::fs::remove_file(again.join("new.labels.csv")).unwrap();
    ok(folder, "segments label m.safetensors again/new.csv --rate-hz 30 -o again/new.eaf");
    let judged = ok(folder, "segments evaluate m.safetensors again --rate-hz 30 --json");
    assert!(judged["accuracy"].as_f64().unwrap() > 99.9, "{judged}");
}

#[test]
fn wrong_files_are_refused_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_sequence(&folder.join("a.csv"), 0, true);
    ok(folder, "segments train a.csv --rate-hz 30 --filters 4 --epochs 1 --json -o m.safetensors");
    let refused = |words: &str, reason: &str| {
        let output = posed(folder, words);
        assert_eq!(output.status.code(), Some(1), "{words}");
        let emitted = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(emitted.contains(reason), "{emitted}");
    };
    refused("segments label m.safetensors a.csv --rate-hz 30 --unit mm -o l.csv", "--unit");
    refused("segments label a.csv a.csv --rate-hz 30 -o l.csv", "no model");
    write_sequence(&folder.join("b.csv"), 0, false);
    refused("segments train b.csv --rate-hz 30 -o n.safetensors", "no frame has a label");
    std::fs::write(folder.join("c.csv"), "foot_x,foot_y,foot_z,label\n0,0,0,x\n0,0,1,y\n").unwrap();
    refused("segments evaluate m.safetensors c.csv --rate-hz 30", "expected the joints head");
    assert!(!folder.join("l.csv").exists() && !folder.join("n.safetensors").exists());
}

/// The demo's person curls from 1.5, 16.5 and 31.5 s on for ten seconds each, reaches from 46.5 to 60.5 s, and then squats
/// until 74.8 s.
#[test]
fn the_demo_is_named_live_and_from_its_recording_alike() {
    let model = include_bytes!("../../config/demo-moves.safetensors");
    let (_, mut rig) = demo();
    rig.push(Input::SegmentationNetwork(model.to_vec()));
    rig.run_until(82.0);
    let folder = tempfile::tempdir().unwrap();
    let live = record(&folder.path().join("take.mcap"), &rig.log, DEMO, "segments");
    let confirmed: Vec<(&str, f64)> = live
        .iter()
        .filter(|message| message["event"] == "confirmed")
        .map(|message| (message["label"].as_str().unwrap(), message["t_valid_s"].as_f64().unwrap()))
        .collect();
    // Curls are known before the first set is over, though one begins with them.
    assert!(confirmed.iter().any(|(label, t_s)| *label == "curls" && *t_s < 12.0), "{confirmed:?}");
    for (label, start_s) in
        [("curls", 16.5), ("standing", 26.5), ("reaching", 46.5), ("squats", 60.5), ("standing", 74.8)]
    {
        let near = |(named, t_s): &(&str, f64)| *named == label && (t_s - start_s).abs() < 1.8;
        assert!(confirmed.iter().any(near), "{label}: {confirmed:?}");
    }
    std::fs::write(folder.path().join("moves.safetensors"), model).unwrap();
    let named = ok(folder.path(), "segments label moves.safetensors take.mcap -o take.labels.csv --json");
    let segments = named["segments"].as_array().unwrap();
    for (label, start_s) in confirmed.iter().skip(1) {
        let same = |segment: &serde_json::Value| {
            segment["label"] == *label && (segment["t_start_s"].as_f64().unwrap() - start_s).abs() < 0.1
        };
        assert!(segments.iter().any(same), "{label} at {start_s}: {segments:?}");
    }
}

#[test]
fn a_bench_reports_the_parameters_of_what_it_times() {
    let folder = tempfile::tempdir().unwrap();
    let counts = |words: &str| {
        let answer = ok(folder.path(), &format!("segments bench --frames 2 --repeat 1 --json {words}"));
        ["parameters", "labelling_parameters"].map(|key| answer[key].as_u64().unwrap())
    };
    assert_eq!(counts("--rows 19"), [545_482; 2]);
    assert_eq!(counts("--rows 224"), [663_562; 2]);
    assert_eq!(counts("--rows 224 --joints 19"), [663_562, 545_482]);
}
