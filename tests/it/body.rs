//! `posed body solve` of the human skeleton on files, from a simulated person.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use posed_recording::table::TableReader;
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
            script: Script { activity: Activity::Curls, calibration: true, facing: -0.9, mistake: None },
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

    let rms = elbow_error_deg(&recorded, &angles);
    assert!(rms < 2.0, "{rms} degrees");

    let exported = |name: &str| {
        let done = recorded.solve(&recorded.path(name));
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        std::fs::read(recorded.path(name)).expect("it is there")
    };
    let text = |name: &str| String::from_utf8(exported(name)).expect("it is text");
    markers_bend_as_the_arm_did(&text("take.trc"), &recorded.truth);
    frames_of_joints(&text("take.bvh"), recorded.truth.len());
    animation_of_every_frame(&exported("take.glb"), &recorded.truth);
}

#[test]
fn an_arm_is_solved_by_the_published_limbs_too() {
    let recorded = Recorded::new(STAGE);
    let angles = recorded.path("angles.csv");
    let done = recorded.solve_with(&["--limbs", "euler"], &angles);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let by_euler = elbow_error_deg(&recorded, &angles);
    recorded.solve(&angles);
    let by_joints = elbow_error_deg(&recorded, &angles);
    assert!(by_euler < 4.0 && by_euler != by_joints, "{by_euler} and {by_joints} degrees");
}

/// Root mean square error of the elbow's flexion in a table of angles, after the first ten seconds, degrees.
fn elbow_error_deg(recorded: &Recorded, angles: &Path) -> f64 {
    let mut table = TableReader::open(angles).expect("it opens");
    let columns = table.require(["t", "elbow_r_flexion_deg", "forearm_r_qw", "shoulder_r_elevation_deg"]);
    let columns = columns.expect("these columns");
    assert_eq!(table.column("knee_r_flexion_deg").expect("no clash"), None);
    let mut squares = 0.0;
    let mut rows = 0;
    for (t, expected) in &recorded.truth {
        assert!(table.next_row().expect("it reads"));
        assert_eq!(table.number(columns[0]).expect("a number"), Some(*t));
        if *t > 10.0 {
            let flexion = table.number(columns[1]).expect("a number").expect("a value");
            squares += (flexion - expected).powi(2);
            rows += 1;
        }
    }
    assert!(!table.next_row().expect("it reads"));
    f64::sqrt(squares / f64::from(rows))
}

/// A TRC: every time of the recording, and at the elbow's marker the angle that the true elbow had.
fn markers_bend_as_the_arm_did(text: &str, truth: &[(f64, f64)]) {
    let lines: Vec<&str> = text.lines().collect();
    let names: Vec<&str> = lines[3].split('\t').collect();
    let rows: Vec<Vec<f64>> = lines[6..]
        .iter()
        .map(|line| line.split('\t').map(|cell| cell.parse().expect("a number")).collect())
        .collect();
    assert_eq!(rows.len(), truth.len());
    let mut squares = 0.0;
    let mut compared = 0;
    for (row, (t_s, flexion_deg)) in rows.iter().zip(truth) {
        assert!((row[1] - t_s).abs() < 1e-6, "{} is not {t_s}", row[1]);
        let marker = |name: &str| {
            let at = names.iter().position(|column| *column == name).expect("the marker is there");
            nalgebra::Vector3::new(row[at], row[at + 1], row[at + 2])
        };
        let [shoulder, elbow, wrist] = ["shoulder_r", "elbow_r", "wrist_r"].map(marker);
        if *t_s > 10.0 {
            squares += ((elbow - shoulder).angle(&(wrist - elbow)).to_degrees() - flexion_deg).powi(2);
            compared += 1;
        }
    }
    let rms_deg = f64::sqrt(squares / f64::from(compared));
    assert!(compared >= 1199 && rms_deg < 2.0, "{rms_deg} degrees over {compared} rows");
}

/// A BVH: as many rows as there were samples, in each as many numbers as its joints have channels.
fn frames_of_joints(text: &str, samples: usize) {
    let (hierarchy, motion) = text.split_once("MOTION\n").expect("both parts");
    let channels: usize = hierarchy
        .lines()
        .filter_map(|line| line.trim().strip_prefix("CHANNELS ")?.split(' ').next()?.parse::<usize>().ok())
        .sum();
    let joints = hierarchy.lines().filter(|line| line.trim().starts_with("JOINT ")).count();
    assert_eq!(channels, 6 + 3 * joints);
    let mut lines = motion.lines();
    assert_eq!(lines.next(), Some(format!("Frames: {samples}").as_str()));
    let step_s = lines.next().and_then(|line| line.strip_prefix("Frame Time: ")).expect("a step");
    assert!((step_s.parse::<f64>().expect("a number") - 0.01).abs() < 1e-6, "{step_s} s");
    let rows: Vec<Vec<f64>> =
        lines.map(|line| line.split(' ').map(|cell| cell.parse().expect("a number")).collect()).collect();
    assert_eq!(rows.len(), samples);
    assert!(rows.iter().all(|row| row.len() == channels && row.iter().all(|value| value.is_finite())));
    assert!(rows.iter().any(|row| *row != rows[0]), "nothing moves");
}

/// A binary glTF: its parts as long as they say, and an animation from the first to the last time of the recording.
fn animation_of_every_frame(bytes: &[u8], truth: &[(f64, f64)]) {
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes")) as usize;
    assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
    let json = 20 + word(12);
    assert_eq!((&bytes[16..20], &bytes[json + 4..json + 8]), (&b"JSON"[..], &b"BIN\0"[..]));
    assert_eq!(json + 8 + word(json), bytes.len());
    let gltf: serde_json::Value = serde_json::from_slice(&bytes[20..json]).expect("it is JSON");
    let animation = &gltf["animations"][0];
    let channels = animation["channels"].as_array().expect("channels");
    let rotations = channels.iter().filter(|channel| channel["target"]["path"] == "rotation").count();
    assert!(rotations >= 10, "{rotations} joints turn");
    for sampler in animation["samplers"].as_array().expect("samplers") {
        let [input, output] = ["input", "output"]
            .map(|key| &gltf["accessors"][sampler[key].as_u64().expect("an accessor") as usize]);
        assert_eq!((&input["count"], &output["count"]), (&truth.len().into(), &truth.len().into()));
        let length_s =
            input["max"][0].as_f64().expect("a number") - input["min"][0].as_f64().expect("a number");
        let expected_s = truth[truth.len() - 1].0 - truth[0].0;
        assert!((length_s - expected_s).abs() < 1e-3, "{length_s} s");
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
    let reported = String::from_utf8_lossy(&done.stderr).into_owned();
    assert!(
        done.status.code() == Some(1) && reported.contains("moved in the same way: add a movement of one"),
        "{reported}"
    );
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
        let reported = String::from_utf8_lossy(&done.stderr).into_owned();
        assert_eq!(done.status.code(), Some(1), "{reported}");
        assert!(reported.contains(expected), "{reported}");
        assert!(!angles.exists());
    }
}
