//! `posed keyframes` and `posed faults` from file to file.

use std::path::Path;
use std::process::{Command, Output};

use posed_simulator::gesture::{Gesture, count_errors};

fn posed(folder: &Path, words: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_posed"))
        .current_dir(folder)
        .args(words.split_whitespace())
        .output()
        .unwrap()
}

/// The same, which goes well.
fn done(folder: &Path, words: &str) -> Output {
    let output = posed(folder, words);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output
}

fn write_poses(path: &Path) {
    let mut text = String::from("t,sensor,x,y,z,qw,qx,qy,qz\n");
    for (k, pose) in Gesture::of_the_table(2).noisy((0.001, 0.2)).iter().enumerate() {
        let (p, q) = (pose.translation.vector, pose.rotation);
        for (sensor, shift) in [("a", 2.0), ("b", 2.5)] {
            let t = k as f64 / 100.0;
            text +=
                &format!("{t},{sensor},{},{},{},{},{},{},{}\n", p.x + shift, p.y, p.z, q.w, q.i, q.j, q.k);
        }
    }
    std::fs::write(path, text).unwrap();
}

#[test]
fn keyframes_writes_keys_path_and_picture() {
    let folder = tempfile::tempdir().unwrap();
    write_poses(&folder.path().join("poses.csv"));
    let words = "keyframes poses.csv -o keys.csv --resample path.csv --picture keys.svg --animation motion.glb --json";
    let output = done(folder.path(), words);
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["frames"], 1000);
    let keys = std::fs::read_to_string(folder.path().join("keys.csv")).unwrap();
    assert!(keys.starts_with("frame,t,t_decided,score,sensor,corner\n"));
    let frames: Vec<usize> = keys
        .lines()
        .filter(|line| line.contains(",a,"))
        .map(|line| line.split(',').next().unwrap().parse().unwrap())
        .collect();
    let (alarms, misses) = count_errors(frames);
    assert!(alarms <= 1 && misses == 0, "{keys}");
    let path = std::fs::read_to_string(folder.path().join("path.csv")).unwrap();
    assert_eq!(path.lines().count(), 2001);
    assert!(std::fs::read_to_string(folder.path().join("keys.svg")).unwrap().contains("</svg>"));
    let animation = std::fs::read(folder.path().join("motion.glb")).unwrap();
    let text = String::from_utf8_lossy(&animation);
    for name in ["recorded path", "spline path", "screws path", "axis of frames 0 to 140"] {
        assert!(text.contains(name), "{name}");
    }
}

#[test]
fn faults_are_trained_and_found_and_other_sensors_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    write_poses(&folder.path().join("poses.csv"));
    let train = "faults train poses.csv -o FAULTS.json --labels auto.csv --neurons 11 --side 5 --epochs 5";
    done(folder.path(), train);
    let detect =
        "faults detect FAULTS.json poses.csv -o labels.csv --picture map.svg --repaired good.csv --json";
    let output = done(folder.path(), detect);
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(summary["classes"]["clean"].as_u64().unwrap() >= 990, "{summary}");
    let labels = std::fs::read_to_string(folder.path().join("labels.csv")).unwrap();
    assert!(labels.starts_with("t,frame,sensor,label,cause,distance,repaired\n"));
    assert_eq!(labels.lines().count(), 3001);
    // What is clean is written as it was.
    let clean = labels.lines().skip(1).filter(|row| !row.contains(",*,") && row.contains(",clean,")).count();
    let good = std::fs::read_to_string(folder.path().join("good.csv")).unwrap();
    assert_eq!(good.lines().count(), 1 + clean);
    let poses = std::fs::read_to_string(folder.path().join("poses.csv")).unwrap();
    std::fs::write(folder.path().join("other.csv"), poses.replace(",b,", ",c,")).unwrap();
    let output = posed(folder.path(), "faults detect FAULTS.json other.csv -o none.csv");
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("expected the sensors a,b, found a,c"));
    assert!(!folder.path().join("none.csv").exists());
}

#[test]
fn maps_are_studied_against_the_truth_of_a_generated_session() {
    let folder = tempfile::tempdir().unwrap();
    let json = |words: &str| {
        serde_json::from_slice::<serde_json::Value>(&done(folder.path(), words).stdout).unwrap_or_default()
    };
    json("faults generate -o s.csv --truth truth.csv --seed 3");
    let sizes = " --neurons 11,21 --sides 11 --json";
    let study = json(&format!("faults study s.csv --truth truth.csv --repetitions 2{sizes}"));
    let runs = study["sizes"].as_array().unwrap();
    assert_eq!(runs.len(), 4);
    assert!(runs[0]["seed"] == 1 && runs[1]["seed"] == 2 && runs[2]["neurons"] == 21, "{study}");
    for run in runs {
        assert!(run["purity"].as_f64().unwrap() > 0.9 && run["seconds"].as_f64().unwrap() > 0.0, "{run}");
        // Faults of 0.5 to 3 s in half of 13.6 s: their borders, as the truth has them.
        assert!((4..40).contains(&run["changeovers"].as_u64().unwrap()), "{run}");
    }
    for how in ["centre", "sphere"] {
        let rule = "--rule paper --as-published --epochs 5";
        let study = json(&format!("faults study s.csv --truth truth.csv --preprocess {how} {rule}{sizes}"));
        assert_eq!(study["sizes"].as_array().unwrap().len(), 2, "{how}");
    }
    std::fs::write(folder.path().join("bad.csv"), "t,class\n0,odd\n").unwrap();
    let refused = posed(folder.path(), "faults study s.csv --truth bad.csv");
    let why = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(
        refused.status.code() == Some(1) && why.contains("clean, inverted, anomalous or unknown"),
        "{why}"
    );
    std::fs::write(folder.path().join("other.csv"), "t,class\n999,clean\n").unwrap();
    assert_eq!(posed(folder.path(), "faults study s.csv --truth other.csv").status.code(), Some(1));
}

#[test]
fn tables_with_columns_for_each_joint_are_frames_too() {
    let folder = tempfile::tempdir().unwrap();
    done(folder.path(), "segments generate made-up --sequences 1");
    done(folder.path(), "faults train made-up/00001.csv.gz -o map.json --neurons 5 --side 3 --epochs 2");
    let output = done(folder.path(), "faults detect map.json made-up/00001.csv.gz -o labels.csv");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains(" frames: "), "{said}");
    let labels = std::fs::read_to_string(folder.path().join("labels.csv")).unwrap();
    assert!(labels.contains(",head,"), "joints are the sensors");
}
