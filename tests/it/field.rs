//! The field, calibrated in simulated scenes whose truth is known, and through the commands.

#[path = "../../benches/field/scenes.rs"]
#[allow(dead_code, reason = "the bench uses the rest")]
mod scenes;

#[path = "../../benches/field/session.rs"]
mod session;

#[path = "../../benches/field/survey.rs"]
mod survey;

use nalgebra::Vector3;
use posed_field::{Anchor, Code, PoleReading, PoleRun, RejectReason, rigid, solve, solve_limbs};
use scenes::{Run, SENSORS, SPACING_M, scenes};
use session::{Reading, Session};

use crate::cli::{json, posed};

/// The first `frames` instants of a scene's recording.
fn pole(run: &Run, frames: usize, spacing_m: f64) -> PoleRun {
    let mut pole = survey::pole(run, spacing_m);
    pole.frames.truncate(frames);
    pole
}

fn scene(name: &str) -> scenes::Scene {
    scenes().into_iter().find(|scene| scene.name == name).unwrap()
}

#[test]
fn given_a_steel_floor_the_map_is_right_to_a_fraction_of_a_millimetre() {
    let run = scene("floor, low transmitter").run(7);
    let solution = solve(pole(&run, 900, SPACING_M), &[], &mut |_| {});
    let map = solution.map.unwrap();
    assert!(map.report.accepted, "{:?}", map.report);
    let corrector = map.corrector();
    let square =
        |of: &dyn Fn(&scenes::Sample) -> f64| run.tests.iter().map(of).sum::<f64>() / run.tests.len() as f64;
    let raw_m = square(&|s| (s.z - s.p).norm_squared()).sqrt();
    let error_m = square(&|s| (corrector.position(&s.z) - s.p).norm_squared()).sqrt();
    assert!(raw_m > 0.02 && error_m < 5e-4, "{raw_m} {error_m}");
    let raw = square(&|s| s.q.angle_to(&s.truth).powi(2)).sqrt();
    let error = square(&|s| corrector.orientation(&s.z, &s.q).angle_to(&s.truth).powi(2)).sqrt();
    assert!(error < 0.1 * raw, "{raw} {error}");
    let covered = run.noisy.iter().filter(|s| {
        let corrected = corrector.correct(&s.z);
        (corrected.position_m - s.p).norm() < 2.0 * corrected.sigma_m
    });
    let share = covered.count() as f64 / run.noisy.len() as f64;
    assert!((0.9..0.998).contains(&share), "{share}");
    assert!(corrector.correct(&Vector3::new(1.5, 3.5, 0.5)).extrapolated);
}

#[test]
fn given_a_pure_scale_error_a_polynomial_of_degree_one_is_enough() {
    let run = scene("scale 1.02").run(3);
    let map = solve(pole(&run, 900, SPACING_M), &[], &mut |_| {}).map.unwrap();
    assert_eq!(map.report.model, "degree 1");
    let corrector = map.corrector();
    let inside = run.tests.iter().filter(|s| !corrector.correct(&s.z).extrapolated);
    let pairs: Vec<_> = inside.map(|s| (corrector.position(&s.z), s.p)).collect();
    assert!(pairs.len() > 1000);
    let motion = rigid(&pairs);
    let square: f64 =
        pairs.iter().map(|(a, b)| (motion.rotation * a + motion.translation.vector - b).norm_squared()).sum();
    assert!((square / pairs.len() as f64).sqrt() < 2e-4);
}

#[test]
fn a_map_whose_gain_noise_hides_is_accepted_and_one_of_noise_alone_is_not() {
    for (scale, useful) in [(1.005, true), (1.0, false)] {
        let run = scenes::Scene { scale: Some((scale, 4e-3)), ..scene("scale 1.02") }.run(3);
        let solution = solve(pole(&run, 900, SPACING_M), &[], &mut |_| {});
        assert_eq!(solution.report.accepted, useful, "{:?}", solution.report);
        if useful {
            let corrector = solution.map.unwrap().corrector();
            let error = |of: &dyn Fn(&scenes::Sample) -> Vector3<f64>| {
                let pairs: Vec<_> = run.tests.iter().map(|s| (of(s), s.p)).collect();
                let motion = rigid(&pairs);
                pairs
                    .iter()
                    .map(|(a, b)| (motion * nalgebra::Point3::from(*a) - b).coords.norm_squared())
                    .sum::<f64>()
            };
            let (raw, mapped) = (error(&|s| s.z), error(&|s| corrector.position(&s.z)));
            assert!(mapped < 0.25 * raw, "{mapped} {raw}");
        }
    }
}

#[test]
fn given_anchors_a_spacing_that_is_a_millimetre_off_is_reported_and_a_right_one_is_not() {
    let run = scene("scale 1.02").run(3);
    let anchors: Vec<Anchor> = [30, 300, 600, 850]
        .into_iter()
        .map(|k| Anchor {
            name: k.to_string(),
            sensor: 2,
            t_s: [run.t_s[k], run.t_s[k]],
            position_m: run.frames[k][2].p,
        })
        .collect();
    for (wrong_m, expected) in [(0.001, true), (-0.001, true), (0.0, false)] {
        // Without anchors a wrong one makes a map that is as smooth.
        let solution = solve(pole(&run, 900, SPACING_M + wrong_m), &anchors, &mut |_| {});
        let reported = solution.report.reasons.iter().any(|reason| reason.code == Code::Spacing);
        assert_eq!(reported, expected, "{wrong_m} m: {:?}", solution.report);
    }
}

/// A wrong spacing makes a map unsure of places, where it still knows lengths: it is reported there, too.
#[test]
fn above_a_steel_floor_half_a_second_on_each_of_three_points_tells_a_wrong_spacing() {
    let scene = scene("floor, low transmitter");
    let run = scene.run(2);
    for (wrong_m, expected) in [(0.001, true), (0.0, false)] {
        let mut recording = pole(&run, 900, SPACING_M + wrong_m);
        let anchors = survey::anchors(&scene, &run, &mut recording, 2);
        let report = solve(recording, &anchors, &mut |_| {}).report;
        let reported = report.reasons.iter().any(|reason| reason.code == Code::Spacing);
        assert_eq!(reported, expected, "{wrong_m} m: {report:?}");
    }
}

#[test]
fn given_a_range_limit_stuck_readings_are_found_and_good_ones_are_kept() {
    let run = scene("range limit with dropouts").run(2);
    let solution = solve(pole(&run, 900, SPACING_M), &[], &mut |_| {});
    let is_stuck = |t_s: f64, sensor: usize| run.frames[(t_s * 30.0).round() as usize][sensor].stuck;
    let stuck = run.frames[..900].iter().flatten().filter(|s| s.stuck).count();
    let good = 900 * SENSORS - stuck;
    let found = solution.rejected.iter().filter(|r| is_stuck(r.t_s, r.sensor)).count();
    let lost = solution.rejected.len() - found;
    assert!(stuck > 500 && found as f64 > 0.95 * stuck as f64, "{found} of {stuck}");
    assert!((lost as f64) < 0.01 * good as f64, "{lost} of {good}");
    assert!(solution.rejected.iter().any(|r| r.reason == RejectReason::Stuck));
}

#[test]
fn given_a_pole_that_is_held_one_way_the_map_is_refused() {
    let rows =
        (0..600).flat_map(|frame| (0..SENSORS).map(move |sensor| (frame, sensor))).map(|(frame, sensor)| {
            let t = f64::from(frame) / 30.0;
            let middle = Vector3::new(
                1.3 + 0.3 * libm::sin(t),
                0.4 * libm::cos(0.7 * t),
                0.6 + 0.2 * libm::sin(1.3 * t),
            );
            let p = middle + Vector3::x() * (0.1 * (sensor as f64 - 2.5));
            (t, sensor, PoleReading { position_m: p * 1.03, orientation: None })
        });
    let run = PoleRun::new((0..SENSORS).map(|k| k.to_string()).collect(), 0.1, rows).unwrap();
    let solution = solve(run, &[], &mut |_| {});
    assert!(!solution.report.accepted);
    assert!(solution.report.reasons.iter().any(|reason| reason.code == Code::Excitation));
}

/// The first 700 instants of a scene as a table.
fn table(run: &Run) -> String {
    use std::fmt::Write;
    let mut csv = String::from("t,sensor,x,y,z,qw,qx,qy,qz\n");
    for (frame, t) in run.frames.iter().zip(&run.t_s).take(700) {
        for (k, s) in frame.iter().enumerate() {
            let q = s.q.quaternion();
            writeln!(csv, "{t},bird-{k},{},{},{},{},{},{},{}", s.z.x, s.z.y, s.z.z, q.w, q.i, q.j, q.k)
                .unwrap();
        }
    }
    csv
}

#[test]
fn given_the_commands_a_file_is_solved_corrected_and_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    std::fs::write(path("pole.csv"), table(&scene("floor, low transmitter").run(1))).unwrap();
    let args =
        ["field", "solve", &path("pole.csv"), "--spacing-m", "0.3", "-o", &path("field.json"), "--json"];
    let solved = posed(args);
    assert_eq!(solved.status.code(), Some(0), "{}", String::from_utf8_lossy(&solved.stderr));
    assert_eq!(json(&solved)["accepted"], true);
    let corrected =
        posed(["field", "correct", &path("field.json"), &path("pole.csv"), "-o", &path("out.csv"), "--json"]);
    assert_eq!(json(&corrected)["rows"], 700 * 6);
    let out = std::fs::read_to_string(path("out.csv")).unwrap();
    assert!(out.starts_with("t,sensor,x,y,z,qw,qx,qy,qz,sigma_m,extrapolated\n"));
    assert_eq!(out.lines().count(), 700 * 6 + 1);
    assert_eq!(
        posed(["field", "show", &path("field.json"), "-o", &path("field.svg")]).status.code(),
        Some(0)
    );
    assert!(std::fs::read_to_string(path("field.svg")).unwrap().starts_with("<svg"));
    // A file of another kind is named, not believed.
    std::fs::write(path("other.json"), "{}").unwrap();
    assert_eq!(posed(["field", "show", &path("other.json"), "-o", &path("x.svg")]).status.code(), Some(1));
}

#[test]
fn given_the_published_method_a_file_is_solved_corrected_and_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let run = scene("floor, low transmitter").run(1);
    std::fs::write(path("pole.csv"), table(&run)).unwrap();
    let solve = |more: &[&str]| {
        let (pole, net) = (path("pole.csv"), path("cascade.json"));
        let first = ["field", "solve", &pole, "--spacing-m", "0.3", "-o", &net, "--json"];
        posed(first.iter().chain(more))
    };
    for filter in ["printed", "repaired", "reduced"] {
        let (csv, svg, out) = (path("ways.csv"), path("ways.svg"), path("out.csv"));
        let solved = solve(&[
            "--method",
            "cascade",
            "--filter",
            filter,
            "--rounds",
            "3",
            "--trajectories",
            &csv,
            "--picture",
            &svg,
            "--corrected",
            &out,
        ]);
        assert_eq!(solved.status.code(), Some(0), "{}", String::from_utf8_lossy(&solved.stderr));
        let report = json(&solved);
        assert_eq!(report["filter"], filter);
        let residuals: Vec<f64> = serde_json::from_value(report["residuals_m"].clone()).unwrap();
        // The printed step stretches the pole.
        let most_m = if filter == "printed" { 0.06 } else { 0.01 };
        assert!(residuals.len() == 3 && residuals[2] < most_m, "{filter}: {residuals:?}");
        assert!(std::fs::read_to_string(&svg).unwrap().starts_with("<svg"));
        let ways = std::fs::read_to_string(&csv).unwrap();
        assert_eq!(ways.lines().count() as u64, report["readings"].as_u64().unwrap() + 1);
        // The file corrects other poses as the run corrected its own.
        let again =
            posed(["field", "correct", &path("cascade.json"), &path("pole.csv"), "-o", &path("2.csv")]);
        assert_eq!(again.status.code(), Some(0));
        assert!(std::fs::read(&out).unwrap() == std::fs::read(path("2.csv")).unwrap());
    }
    let gridded = json(&solve(&["--method", "cascade", "--grid-m", "0.1"]));
    assert!(gridded["pairs"].as_u64().unwrap() < gridded["readings"].as_u64().unwrap() / 2, "{gridded}");
    assert_eq!(solve(&["--rounds", "3"]).status.code(), Some(2));
    assert_eq!(solve(&["--method", "cascade", "--rejected", "r.csv"]).status.code(), Some(2));
    let damaged =
        std::fs::read_to_string(path("cascade.json")).unwrap().replace("\"scale_m\":", "\"scale_m\":-");
    std::fs::write(path("bad.json"), damaged).unwrap();
    let refused = posed(["field", "correct", &path("bad.json"), &path("pole.csv"), "-o", &path("3.csv")]);
    assert_eq!(refused.status.code(), Some(1));
}

#[test]
fn given_a_person_in_place_of_the_pole_bones_keep_their_length() {
    let session = Session::new(1, 40.0, 0.0);
    let limbs = session.limbs();
    let solution = solve_limbs(session.run(900), &limbs, &mut |_| {});
    assert!(solution.report.accepted, "{:?}", solution.report);
    let corrector = solution.map.unwrap().corrector();
    let raw_m = session.bones_m(900..1200, |reading| (reading.z, reading.q));
    let solved_m = session.bones_m(900..1200, |reading: &Reading| {
        (corrector.position(&reading.z), corrector.orientation(&reading.z, &reading.q))
    });
    assert!(raw_m > 5e-3 && solved_m < 0.5 * raw_m, "{raw_m} {solved_m}");
    let raw_m = session.aligned_m(900..1200, |reading| reading.z);
    let solved_m = session.aligned_m(900..1200, |reading| corrector.position(&reading.z));
    assert!(raw_m > 5e-3 && solved_m < 0.6 * raw_m, "{raw_m} {solved_m}");
    // Without a measured bone there is no scale, and none is taken from the readings.
    let mut unmeasured = limbs;
    unmeasured.bones.iter_mut().for_each(|bone| bone.length_m = None);
    let solution = solve_limbs(session.run(900), &unmeasured, &mut |_| {});
    assert!(solution.report.reasons.iter().any(|reason| reason.code == Code::Spacing));
}

#[test]
fn given_the_command_a_session_is_solved_by_its_bones() {
    use std::fmt::Write;
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let session = Session::new(2, 27.0, 2.0);
    let run = session.run(810);
    let mut csv = String::from("t,sensor,x,y,z,qw,qx,qy,qz\n");
    let mut stage = String::from(
        "name = \"Body\"\n[body]\n[[device]]\nname = \"flock\"\ndriver = \"flock-of-birds\"\nport = \"/dev/none\"\n",
    );
    for (address, name) in run.sensors.iter().enumerate() {
        let address = address + 2;
        write!(stage, "[[sensor]]\nname = \"{name}\"\ndevice = \"flock\"\naddress = {address}\n").unwrap();
    }
    for frame in &run.frames {
        for (name, reading) in run.sensors.iter().zip(&frame.readings) {
            let (p, q) = (reading.unwrap().position_m, reading.unwrap().orientation.unwrap());
            let t = frame.t_s;
            writeln!(csv, "{t},{name},{},{},{},{},{},{},{}", p.x, p.y, p.z, q.w, q.i, q.j, q.k).unwrap();
        }
    }
    std::fs::write(path("session.csv"), csv).unwrap();
    std::fs::write(path("stage.toml"), &stage).unwrap();
    let stage_toml = stage;
    let (session_csv, stage, field, out) =
        (path("session.csv"), path("stage.toml"), path("field.json"), path("out.csv"));
    let solve = ["field", "solve", &session_csv, "--body", &stage, "-o", &field, "--json"];
    let bone = format!("upper_arm_r={}", session.build.upper_arm_m);
    let standing = ["--bone", &bone, "--corrected", &out, "--n-pose", "0,2"];
    let no_height = posed(solve.iter().copied().chain(standing));
    assert_eq!(no_height.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&no_height.stderr).contains("height_m"));
    let sized = stage_toml.replace("[body]\n", &format!("[body]\nheight_m = {}\n", session.height_m));
    std::fs::write(path("stage.toml"), sized).unwrap();
    let solved = posed(solve.iter().copied().chain(standing));
    assert_eq!(solved.status.code(), Some(0), "{}", String::from_utf8_lossy(&solved.stderr));
    assert_eq!(json(&solved)["accepted"], true);
    assert_eq!(std::fs::read_to_string(&out).unwrap().lines().count(), 810 * 6 + 1);
    let late = posed(solve.iter().copied().chain(["--n-pose", "90,92"]));
    assert!(String::from_utf8_lossy(&late.stderr).contains("both sides"));
    std::fs::write(path("stage.toml"), stage_toml).unwrap();
    let refused = posed(solve);
    assert_eq!(refused.status.code(), Some(1));
    assert_eq!(json(&refused)["reasons"][0]["code"], "spacing");
}
