//! `posed body solve` of the human skeleton on files, from a simulated person.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use posed::table::TableReader;
use posed_simulator::body::{Activity, Build, Script, SensorErrors, Wearer, WearerSpec};

const STAGE: &str = r#"
name = "body"

[body]
height_m = 1.8

[[body.calibration]]
kind = "n_pose"
start_s = 0.2
end_s = 3.0

[[body.calibration]]
kind = "t_pose"
start_s = 5.2
end_s = 7.8

[[body.calibration]]
kind = "elbow_flexion_r"
start_s = 10.5
end_s = 15.5
"#;

/// Torso and right arm over 22 s: poses, both elbows' bending.
struct Recorded {
    folder: tempfile::TempDir,
    /// Time, flexion of the right elbow, degrees.
    truth: Vec<(f64, f64)>,
}

impl Recorded {
    fn new(stage: &str) -> Self {
        Self::of(stage, 2200, ["torso", "upper_arm_r", "forearm_r"])
    }

    /// So many samples of each of three sensors, named in the order of torso, upper arm and forearm.
    fn of(stage: &str, samples: usize, names: [&str; 3]) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let mut wearer = Wearer::new(WearerSpec {
            script: Script { activity: Activity::Curls, calibration: true, facing: -0.9 },
            build: Build::of_height(1.8),
            errors: SensorErrors::calibrated(),
            magnetometer: true,
            disturbances: Vec::new(),
            rate_hz: 100.0,
            clumsiness_rad: 0.0,
            seed: 9,
        });
        let mut text = String::from("t,sensor,ax,ay,az,gx,gy,gz,mx,my,mz\n");
        let mut truth = Vec::new();
        for _ in 0..samples {
            let (samples, at) = wearer.step();
            for (index, name) in [0, 2, 3].into_iter().zip(names) {
                let s = samples[index];
                let values = [s.accel_m_s2, s.gyro_rad_s, s.mag_ut.expect("it has a magnetometer")];
                let cells: Vec<String> = values.iter().flatten().map(|value| format!("{value:.5}")).collect();
                writeln!(text, "{},{name},{}", at.t_s, cells.join(",")).expect("a string takes it");
            }
            // The angle between the upper arm's and the forearm's long axes.
            let [above, below] = [2, 3].map(|k| at.body[k].axes.column(1).into_owned());
            truth.push((at.t_s, above.angle(&below).to_degrees()));
        }
        std::fs::write(folder.path().join("imus.csv"), text).expect("the folder is ours");
        std::fs::write(folder.path().join("body.toml"), stage).expect("the folder is ours");
        Self { folder, truth }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn solve(&self, output: &Path) -> Output {
        self.solve_with(&[], output)
    }

    fn solve_with(&self, args: &[&str], output: &Path) -> Output {
        Command::new(env!("CARGO_BIN_EXE_posed"))
            .args(["body", "solve", "--json"])
            .args(args)
            .arg("--stage")
            .args([&self.path("body.toml"), &self.path("imus.csv")])
            .arg("-o")
            .arg(output)
            .output()
            .expect("the binary runs")
    }
}

#[test]
fn an_arm_is_calibrated_and_solved_from_file_to_file() {
    let recorded = Recorded::new(STAGE);
    let angles = recorded.path("angles.csv");
    let done = recorded.solve(&angles);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let summary: serde_json::Value = serde_json::from_slice(&done.stdout).expect("one object");
    assert_eq!(summary["epochs"], 2200);
    assert_eq!(summary["heading_held_s"], 0.0);
    let sensors = summary["sensors"].as_array().expect("a list");
    assert_eq!(sensors.len(), 3);
    assert!(
        sensors.iter().all(|sensor| sensor["quality_deg"].as_f64().is_some_and(|q| q < 5.0)),
        "{summary}"
    );

    let mut table = TableReader::open(&angles).expect("it opens");
    let columns = table.require(["t", "elbow_r_flexion_deg", "forearm_r_qw", "shoulder_r_elevation_deg"]);
    let columns = columns.expect("these columns");
    assert_eq!(table.column("knee_r_flexion_deg").expect("no clash"), None);
    let mut squares = 0.0;
    let mut rows = 0;
    for (t, expected) in &recorded.truth {
        assert!(table.next_row().expect("it reads"));
        assert_eq!(table.number(columns[0]).expect("a number"), Some(*t));
        let flexion = table.number(columns[1]).expect("a number").expect("a value");
        if *t > 10.0 {
            squares += (flexion - expected).powi(2);
            rows += 1;
        }
    }
    assert!(!table.next_row().expect("it reads"));
    let rms = f64::sqrt(squares / f64::from(rows));
    assert!(rms < 2.0, "{rms} degrees");

    for name in ["take.bvh", "take.trc", "take.glb"] {
        let done = recorded.solve(&recorded.path(name));
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        assert!(recorded.path(name).metadata().expect("it is there").len() > 100_000);
    }
}

#[test]
fn sensors_that_were_strapped_on_anywhere_are_assigned_from_file_to_file() {
    // The forearm's sensor was taken for the torso's, and so round.
    let stage = format!(
        "{STAGE}[[body.calibration]]\nkind = \"shoulder_flexion_r\"\nstart_s = 34.5\nend_s = 39.5\n\
         [[device]]\nname = \"chain\"\ndriver = \"xbus\"\nport = \"auto\"\n\
         [[sensor]]\nname = \"a\"\ndevice = \"chain\"\naddress = 1\nsegment = \"upper_arm_r\"\n\
         [[sensor]]\nname = \"b\"\ndevice = \"chain\"\naddress = 2\nsegment = \"forearm_r\"\n\
         [[sensor]]\nname = \"c\"\ndevice = \"chain\"\naddress = 3\nsegment = \"torso\"\n"
    );
    let recorded = Recorded::of(&stage, 4100, ["a", "b", "c"]);
    let angles = recorded.path("angles.csv");
    let done = recorded.solve_with(&["--assign"], &angles);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let summary: serde_json::Value = serde_json::from_slice(&done.stdout).expect("one object");
    let found: Vec<_> =
        summary["sensors"].as_array().expect("a list").iter().map(|s| (&s["name"], &s["segment"])).collect();
    let expected = [("a", "torso"), ("b", "upper_arm_r"), ("c", "forearm_r")];
    assert!(
        found.iter().zip(expected).all(|(found, (name, segment))| found.0 == name && found.1 == segment),
        "{summary}"
    );
    // Without the movement that tells the upper arm from the torso, nobody guesses.
    let recorded =
        Recorded::of(&stage.replace("shoulder_flexion_r", "elbow_pronation_r"), 4100, ["a", "b", "c"]);
    let angles = recorded.path("angles.csv");
    let done = recorded.solve_with(&["--assign"], &angles);
    let told = String::from_utf8_lossy(&done.stderr).into_owned();
    assert!(done.status.code() == Some(1) && told.contains("moved alike: add a movement of one"), "{told}");
    assert!(!angles.exists());
}

#[test]
fn what_a_stage_lacks_is_named_and_nothing_is_written() {
    let without_height = STAGE.replace("height_m = 1.8", "");
    let facing = STAGE.split("[[body.calibration]]").take(2).collect::<Vec<_>>().join("[[body.calibration]]");
    let given = STAGE.replace("height_m = 1.8", "height_m = 1.8\nmounting = \"given\"");
    for (stage, expected) in [
        (without_height.as_str(), "lacks `height_m`"),
        (&facing, "nothing shows which way the body faces: add a `t_pose`"),
        (&given, "has no `mount_quat_wxyz` in the stage file"),
    ] {
        let recorded = Recorded::new(stage);
        let angles = recorded.path("angles.csv");
        let done = recorded.solve(&angles);
        let told = String::from_utf8_lossy(&done.stderr).into_owned();
        assert_eq!(done.status.code(), Some(1), "{told}");
        assert!(told.contains(expected), "{told}");
        assert!(!angles.exists());
    }
}
