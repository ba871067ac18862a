//! A finished session calibrates the field it was recorded in: a recording in, a map and the session corrected out.

use std::collections::BTreeMap;
use std::fmt::Write;

use nalgebra::Vector3;
use posed_recording::table::Poses;
use posed_simulator::scenario::Scenario;
use posed_stage::Stage;
use serde::Deserialize;

use crate::cli::{json, posed};
use posed_rig::{Rig, record};

const SECONDS: f64 = 15.0;
const BODY_SENSORS: [&str; 6] = ["torso", "pelvis", "upper_arm_r", "forearm_r", "upper_arm_l", "forearm_l"];

/// A person who reaches about, a metre from the transmitter and above a steel floor.
fn stage() -> String {
    let mut text = String::from(
        "name = \"Session\"\n[transmitter.pose_in_room]\nposition_m = [0.0, 0.0, 1.0]\norientation_wxyz = [0.0, 1.0, 0.0, 0.0]\n\
         [body]\nheight_m = 1.75\n[[device]]\nname = \"flock\"\ndriver = \"flock-of-birds\"\nport = \"/dev/flock\"\n\
         format = \"position-quaternion\"\n",
    );
    for (address, name) in BODY_SENSORS.iter().enumerate() {
        let address = address + 2;
        write!(text, "[[sensor]]\nname = \"{name}\"\ndevice = \"flock\"\naddress = {address}\n").unwrap();
    }
    text += "[simulation]\nseed = 3\nsigma_signal_per_m3 = 1e-4\n[simulation.floor]\nz_m = 0.1\nmaterial = \"iron\"\nstrength = 0.1\n\
             [[simulation.metal]]\ncenter_m = [1.8, 1.3, 0.9]\nradius_m = 0.16\nmaterial = \"iron\"\n\
             [[simulation.device]]\nname = \"flock\"\nboot_ms = 0.0\n\
             [[simulation.body]]\nname = \"person\"\n[simulation.body.motion]\nkind = \"person\"\nactivity = \"reaching\"\n\
             height_m = 1.75\nposition_m = [1.0, 0.0, 0.0]\nheading_deg = 180\n";
    for name in BODY_SENSORS {
        let offset =
            if name == "torso" || name == "pelvis" { "[-0.1, 0.02, 0.0]" } else { "[0.0, -0.12, 0.04]" };
        write!(
            text,
            "[[simulation.sensor]]\nname = \"{name}\"\nbody = \"person\"\nsegment = \"{name}\"\noffset_m = {offset}\n"
        )
        .unwrap();
    }
    text
}

/// Root mean square of how far distances between sensors are from the truth, m: how bent the space is, wherever it lies.
fn bent_m(rig: &Rig, positions: &BTreeMap<(u64, usize), Vector3<f64>>) -> f64 {
    let (mut square, mut count) = (0.0, 0.0);
    for cycle in &rig.host.truth {
        let key = |sensor| ((cycle.t.as_secs_f64() * 1000.0).round() as u64, sensor);
        for (first, a) in cycle.sensors.iter().enumerate() {
            for b in &cycle.sensors[first + 1..] {
                let (Some(p), Some(q)) = (positions.get(&key(a.sensor)), positions.get(&key(b.sensor)))
                else {
                    continue;
                };
                let truth_m = (a.pose.translation.vector - b.pose.translation.vector).norm();
                square += ((p - q).norm() - truth_m).powi(2);
                count += 1.0;
            }
        }
    }
    assert!(count > 1000.0, "{count} distances");
    f64::sqrt(square / count)
}

fn positions(poses: &Poses) -> BTreeMap<(u64, usize), Vector3<f64>> {
    let named = |sensor: usize| BODY_SENSORS.iter().position(|name| *name == poses.sensors[sensor]).unwrap();
    let row = |row: &posed_recording::table::PoseRow| {
        Some((((row.t_s * 1000.0).round() as u64, named(row.sensor)), Vector3::from(row.position_m?)))
    };
    poses.rows.iter().filter_map(row).collect()
}

#[test]
fn a_recorded_session_is_solved_by_its_bones_and_comes_back_straighter() {
    let toml = stage();
    let stage = Stage::parse(&toml).unwrap();
    let mut rig = Rig::new(&stage, &Scenario::deserialize(stage.simulation.clone().unwrap()).unwrap());
    rig.run_until(SECONDS);
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    record(folder.path().join("session.mcap").as_path(), &rig.log, &toml, "none");
    std::fs::write(path("stage.toml"), &toml).unwrap();
    let (session, stage, map, out) =
        (path("session.mcap"), path("stage.toml"), path("map.json"), path("corrected.csv"));
    let bone = format!("upper_arm_r={}", 0.186 * 1.75);
    let solved = posed([
        "field",
        "solve",
        &session,
        "--body",
        &stage,
        "--bone",
        &bone,
        "-o",
        &map,
        "--corrected",
        &out,
        "--json",
    ]);
    assert_eq!(solved.status.code(), Some(0), "{}", String::from_utf8_lossy(&solved.stdout));
    assert_eq!(json(&solved)["accepted"], true);
    let corrected = positions(&Poses::read(std::path::Path::new(&out)).unwrap());
    // What the devices said.
    let raw = rig.estimates().flat_map(|estimate| {
        estimate.sensors.iter().enumerate().filter_map(|(sensor, seen)| {
            let measured = seen.measured.as_ref()?;
            let t_ms = (measured.t_valid.as_secs_f64() * 1000.0).round() as u64;
            Some(((t_ms, sensor), Vector3::from(measured.position_m?)))
        })
    });
    let (raw_m, corrected_m) = (bent_m(&rig, &raw.collect()), bent_m(&rig, &corrected));
    assert!(raw_m > 2e-3 && corrected_m < 0.6 * raw_m, "{raw_m} {corrected_m}");
}
