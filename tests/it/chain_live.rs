//! A chain of hinges as the pipeline reports it: thigh and shank of a simulated person who walks, without magnetometers.

use std::fmt::Write;
use std::path::Path;

use posed_fusion::body::BodySegment;
use posed_fusion::chain;
use posed_fusion::chain::calibrate;
use posed_pipeline::Pipeline;
use posed_recording::table::TableReader;
use posed_simulator::body::{Activity, Build, Script, SensorErrors, Wearer, WearerSpec};
use posed_simulator::truth::TruthCycle;
use posed_stage::Stage;
use posed_stage::input::{Input, Model};
use posed_stage::layout::ChainLayout;
use posed_stage::output::Body;
use posed_stage::signals;

use crate::cli::posed;
use posed_rig::leg::{MOUNTS, STAGE, epochs, leg};
use posed_rig::{Rig, Said, record, replay};

/// True knee flexion at a time, rad, from straight.
fn truth_rad(rig: &Rig, t_s: f64) -> Option<f64> {
    let after = rig.host.truth.partition_point(|cycle| cycle.t.as_secs_f64() < t_s);
    let near = [after.checked_sub(1)?, after].map(|at| rig.host.truth.get(at));
    let off_s = |cycle: &&TruthCycle| (cycle.t.as_secs_f64() - t_s).abs();
    let cycle = near.into_iter().flatten().min_by(|a, b| off_s(a).total_cmp(&off_s(b)))?;
    let mount = |wxyz: [f64; 4]| posed_geometry::orientation_from_wxyz(wxyz).unwrap();
    let segment = |sensor: usize, wxyz| {
        let row = cycle.sensors.iter().find(|row| row.sensor == sensor)?;
        Some(row.pose.rotation * mount(wxyz).inverse())
    };
    let (thigh, shank) = (segment(0, MOUNTS[0])?, segment(1, MOUNTS[1])?);
    Some((thigh.inverse() * shank).angle())
}

fn bodies(emitted: &[Said]) -> Vec<&Body> {
    emitted
        .iter()
        .filter_map(|emitted| match emitted {
            Said::Body(body) => Some(&**body),
            _ => None,
        })
        .collect()
}

#[test]
fn a_chain_is_calibrated_and_then_followed_as_well_as_a_file_of_it() {
    let mut rig = leg(2);
    rig.run_until(36.0);
    assert!(bodies(&rig.emitted).is_empty(), "nothing is said before the axes are known");
    assert!(!rig.pipeline.status().bodies[0].as_ref().unwrap().mounted);
    let stage = Stage::parse(STAGE).unwrap();
    let layout = ChainLayout::of(&stage, 0).unwrap();
    let calibration = Box::new(calibrate(&layout.segments, &epochs(&rig)).unwrap());
    let quality_deg = calibration.segments[1].hinge.unwrap().quality_deg;
    assert!(quality_deg < 3.0, "{quality_deg} degrees");
    rig.push(Input::Model(Model::Chain { body: None, calibration: calibration.clone() }));
    assert_eq!(rig.pipeline.status().models_refused, 0);
    let swapped = rig.host.now;
    rig.run_until(60.0);

    let offline = chain::solve(&layout.segments, &epochs(&rig)).unwrap();
    let (mut live, mut file, mut expected, mut count) = (0.0, 0.0, 0.0, 0.0);
    let zero = |angles: &mut dyn Iterator<Item = (f64, f64)>| {
        let (sum, n) = angles.fold((0.0, 0.0), |(sum, n), (found, truth)| (sum + found - truth, n + 1.0));
        sum / n
    };
    let late = |t_s: &f64| *t_s > swapped.as_secs_f64() + 4.0;
    let pairs = |of: Vec<(f64, f64)>| -> Vec<(f64, f64)> {
        of.into_iter()
            .filter(|(t_s, _)| late(t_s))
            .filter_map(|(t_s, found)| Some((found, truth_rad(&rig, t_s)?)))
            .collect()
    };
    let of_live = pairs(
        bodies(&rig.emitted)
            .iter()
            .filter_map(|body| Some((body.t_valid.as_secs_f64(), body.angles_rad[1]?)))
            .collect(),
    );
    let of_file = pairs(offline.poses.iter().map(|pose| (pose.t_s, pose.flexion_rad[1])).collect());
    let [zero_live, zero_file] = [&of_live, &of_file].map(|pairs| zero(&mut pairs.iter().copied()));
    for (found, truth) in &of_live {
        live += (found - truth - zero_live).powi(2);
        count += 1.0;
    }
    for (found, truth) in &of_file {
        file += (found - truth - zero_file).powi(2);
    }
    for body in bodies(&rig.emitted).iter().filter(|body| late(&body.t_valid.as_secs_f64())) {
        expected += body.spread.sigma_rad[1].powi(2);
    }
    let rms = |sum: f64, n: f64| (sum / n).sqrt().to_degrees();
    let (live, file) = (rms(live, count), rms(file, of_file.len() as f64));
    let expected = rms(expected, count);
    println!(
        "live {live:.3}, file {file:.3}, stated {expected:.3} degrees, zero {:.3} {:.3}, quality {quality_deg:.3}",
        zero_live.to_degrees(),
        zero_file.to_degrees()
    );
    assert!(count > 1500.0 && live < 0.8 && file < 0.4, "live {live}, file {file}, {count} bodies");
    assert!(zero_live.to_degrees().abs() < 4.0, "{zero_live} rad");
    assert!((0.5..4.0).contains(&(expected / live)), "stated {expected}, is {live}");

    // Recorded and replayed alike, from the middle too; and its angle is a channel of exercises.
    let middle = rig.log.partition_point(|entry| entry.t.as_secs_f64() < 44.0);
    let mut pipeline = Pipeline::new(&stage).unwrap();
    let before = replay(&mut pipeline, &rig.log[..middle]).len();
    let mut restored = Pipeline::restore(&stage, pipeline.models(), &pipeline.snapshot()).unwrap();
    assert!(replay(&mut restored, &rig.log[middle..]) == rig.emitted[before..]);
    assert!(signals::columns_of(&stage).iter().any(|column| column == "knee_flexion_deg"));

    // A recording is solved as it is, by the stage that it knows.
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    record(Path::new(&path("take.mcap")), &rig.log, STAGE, "");
    let done = posed(["body", "solve", &path("take.mcap"), "-o", &path("angles.csv")]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let mut table = TableReader::open(Path::new(&path("angles.csv"))).unwrap();
    let [t, knee, sigma] = table.require(["t", "knee_flexion_deg", "knee_flexion_sigma_deg"]).unwrap();
    let mut solved = Vec::new();
    while table.next_row().unwrap() {
        assert!((0.4..3.0).contains(&table.required_number(sigma).unwrap()));
        solved.push((table.required_number(t).unwrap(), table.required_number(knee).unwrap().to_radians()));
    }
    let expected: Vec<_> = offline.poses.iter().map(|pose| (pose.t_s, pose.flexion_rad[1])).collect();
    assert_eq!(solved.len(), expected.len());
    for (solved, expected) in solved.iter().zip(&expected) {
        assert!((solved.0 - expected.0).abs() < 1e-5 && (solved.1 - expected.1).abs() < 1e-4);
    }
    let done = posed(["body", "solve", &path("take.mcap"), "-o", &path("take.bvh")]);
    assert!(!done.status.success() && !folder.path().join("take.bvh").exists(), "a chain has no lengths");
    let done = posed(["orient", &path("take.mcap"), "-o", &path("q.csv")]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let done = posed(["imu", "calibrate", &path("take.mcap"), "--sensor", "upper", "-o", &path("imu.json")]);
    assert!(String::from_utf8_lossy(&done.stderr).contains("directions were held at rest"), "{done:?}");
}

#[test]
fn a_calibration_of_another_chain_is_refused() {
    let mut rig = leg(3);
    rig.run_until(34.0);
    let stage = Stage::parse(STAGE).unwrap();
    let layout = ChainLayout::of(&stage, 0).unwrap();
    let mut calibration = Box::new(calibrate(&layout.segments, &epochs(&rig)).unwrap());
    calibration.segments[1].name = "foot".into();
    rig.push(Input::Model(Model::Chain { body: None, calibration: calibration.clone() }));
    calibration.segments[1].quat_wxyz = [0.0; 4];
    rig.push(Input::Model(Model::Chain { body: None, calibration }));
    assert_eq!(rig.pipeline.status().models_refused, 2);
    // A ball joint is not followed live, nor a segment without an IMU.
    let ball = STAGE.replace("\"hinge\"", "\"ball\"");
    assert_eq!(ChainLayout::of(&Stage::parse(&ball).unwrap(), 0), None);
    let bare = STAGE.replace("segment = \"shank\"\n", "");
    assert_eq!(ChainLayout::of(&Stage::parse(&bare).unwrap(), 0), None);
}

/// What hangs on the leg's shank, and is no hinge: another person's shank.
const LOOSE: &str = r#"
[[body.segments]]
name = "other"
parent = "shank"
joint = "ankle"
kind = "hinge"
"#;

/// A minute of somebody's leg: the rows of these sensors.
fn rows(activity: Activity, sensors: &[(BodySegment, &str)]) -> String {
    let mut wearer = Wearer::new(WearerSpec {
        script: Script { activity, calibration: false, facing: 0.4, mistake: None },
        build: Build::of_height(1.8),
        errors: SensorErrors::calibrated(),
        magnetometer: false,
        disturbances: Vec::new(),
        rate_hz: 100.0,
        clumsiness_rad: 0.0,
        seed: 4,
    });
    let mut rows = String::new();
    for k in 0..6000 {
        let (samples, _) = wearer.step();
        for (segment, name) in sensors {
            let sample = samples[segment.index()];
            let (t_s, a, w) = (f64::from(k) / 100.0, sample.accel_m_s2, sample.gyro_rad_s);
            writeln!(rows, "{t_s},{name},{},{},{},{},{},{}", a.x, a.y, a.z, w.x, w.y, w.z).unwrap();
        }
    }
    rows
}

/// A squat bends every joint about axes that stay level: nothing shows whether a shank bends against its thigh or goes along with it, and
/// nothing is written. Where one hinge of several is none, the cells behind it are empty.
#[test]
fn an_angle_that_a_file_does_not_show_is_no_number() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let solve = |stage: &str, rows: &str| {
        std::fs::write(path("imus.csv"), format!("t,sensor,ax,ay,az,gx,gy,gz\n{rows}")).unwrap();
        std::fs::write(path("stage.toml"), stage).unwrap();
        let (imus, stage, angles) = (path("imus.csv"), path("stage.toml"), path("angles.csv"));
        posed(["body", "solve", &imus, "--stage", &stage, "-o", &angles, "--json"])
    };
    let leg = [(BodySegment::ThighR, "upper"), (BodySegment::ShankR, "lower")];
    let done = solve(STAGE, &rows(Activity::Squats, &leg));
    let said = String::from_utf8_lossy(&done.stderr).into_owned();
    assert!(
        done.status.code() == Some(1) && said.contains("`knee`: its axis is known to 90 degrees only"),
        "{said}"
    );
    assert!(!Path::new(&path("angles.csv")).exists());

    let walking = rows(Activity::Walking, &leg) + &rows(Activity::Squats, &[(BodySegment::ShankL, "other")]);
    let done = solve(&format!("{STAGE}{LOOSE}"), &walking);
    assert_eq!(done.status.code(), Some(0), "{}", String::from_utf8_lossy(&done.stderr));
    let answer: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    let quality_deg = |at: usize| answer["joints"][at]["quality_deg"].as_f64().unwrap();
    let play_deg = |at: usize| answer["joints"][at]["play_deg"].as_f64().unwrap();
    assert!(quality_deg(0) < 5.0 && play_deg(0) < 2.0 && play_deg(1) > 10.0, "{answer}");
    assert!(answer["warnings"][0].as_str().unwrap().contains("`ankle`"), "{answer}");
    let mut table = TableReader::open(Path::new(&path("angles.csv"))).unwrap();
    let known = ["thigh_qw", "shank_qw", "knee_flexion_deg", "knee_flexion_sigma_deg"];
    let known = table.require(known).unwrap();
    let unknown = table.require(["other_qw", "ankle_flexion_deg", "ankle_flexion_sigma_deg"]).unwrap();
    while table.next_row().unwrap() {
        assert!(known.iter().all(|column| table.number(*column).unwrap().is_some()));
        assert!(unknown.iter().all(|column| table.number(*column).unwrap().is_none()));
    }
}
