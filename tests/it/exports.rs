//! Files and streams for other programs, opened in those programs or in the readers that others wrote: joints are where ours are.
//!
//! Runs where `POSED_TEST_READERS` names the folder into which `tests/readers/install` has put them.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use nalgebra::Vector3;
use posed_fusion::body::{BodySegment, SEGMENTS, Skeleton, WholeSegment, completed, whole};
use posed_geometry::orientation_from_wxyz;
use posed_protocol::{mvn, vmc};
use posed_simulator::body::Activity;
use posed_stage::Stage;
use posed_stage::output::Body;
use serde_json::{Value, json};

use crate::cli::{json as said, posed};
use posed_rig::{Rig, Said, people_toml, record};

const HEIGHT_M: f64 = 1.8;
const SECONDS: f64 = 6.0;
/// Every so many frames are compared.
const STEP: usize = 20;

/// What is exported, as the end of the file's name, and with which names of bones.
const FILES: [(&str, Option<&str>); 12] = [
    ("bvh", None),
    ("bvh", Some("blender")),
    ("bvh", Some("motionbuilder")),
    ("bvh", Some("mixamo")),
    ("glb", None),
    ("vrm", None),
    ("vrma", None),
    ("usda", None),
    ("c3d", None),
    ("sto", None),
    ("trc", None),
    ("mot", None),
];

/// A take of somebody who strolls and wears fifteen IMUs, and what followed from it.
struct Strolled {
    stage: Stage,
    recording: PathBuf,
    bodies: Vec<Body>,
}

fn strolled(folder: &Path) -> Strolled {
    let (text, scenario) = people_toml(&[("anna", HEIGHT_M, Activity::Strolling)]);
    let text = format!("{text}[vmc]\nbones = \"all\"\n[mvn]\neuler = true\nkinematics = true\n");
    let stage = Stage::parse(&text).unwrap();
    let mut rig = Rig::new(&stage, &scenario);
    rig.run_until(SECONDS);
    let recording = folder.join("take.mcap");
    record(&recording, &rig.log, &text, "");
    let body = |said: &Said| match said {
        Said::Body(body) => Some((**body).clone()),
        _ => None,
    };
    let bodies: Vec<Body> = rig.emitted.iter().filter_map(body).collect();
    let hips_m = |body: &Body| Vector3::from(body.segments[BodySegment::Pelvis.index()].position_m.unwrap());
    let way_m = (hips_m(&bodies[bodies.len() - 1]) - hips_m(&bodies[0])).norm();
    assert!(way_m > 1.0, "{way_m} m in {} frames are no stroll", bodies.len());
    Strolled { stage, recording, bodies }
}

/// Joint centres in the room, m: of the 23 segments by their names, of the fifteen by theirs.
struct Joints {
    t_s: f64,
    whole_m: Vec<Vector3<f64>>,
    fifteen_m: Vec<Vector3<f64>>,
}

fn joints(body: &Body, skeleton: &Skeleton) -> Joints {
    let known: [_; SEGMENTS] =
        std::array::from_fn(|k| body.segments.get(k)?.orientation_wxyz.and_then(orientation_from_wxyz));
    let all = completed(&known);
    let pelvis_m = body.segments[BodySegment::Pelvis.index()].position_m.unwrap().into();
    Joints {
        t_s: body.t_valid.as_secs_f64(),
        whole_m: skeleton.whole_origins_m(&whole(&all), pelvis_m).to_vec(),
        fifteen_m: skeleton.origins_m(&all, pelvis_m).to_vec(),
    }
}

/// What the readers must find: files have their frames at equal distances.
fn truth(bodies: &[Body]) -> Value {
    let skeleton = Skeleton::from_height(HEIGHT_M);
    let all: Vec<Joints> = bodies.iter().map(|body| joints(body, &skeleton)).collect();
    let steps = all.len() - 1;
    let (begin_s, span_s) = (all[0].t_s, all[steps].t_s - all[0].t_s);
    let mut whole_m = vec![Vec::new(); WholeSegment::ALL.len()];
    let mut fifteen_m = vec![Vec::new(); SEGMENTS];
    let frames: Vec<usize> = (0..=steps).step_by(STEP).collect();
    for frame in &frames {
        let t_s = begin_s + span_s * *frame as f64 / steps as f64;
        let after = all.partition_point(|joints| joints.t_s <= t_s).clamp(1, steps);
        let (a, b) = (&all[after - 1], &all[after]);
        let part = (t_s - a.t_s) / (b.t_s - a.t_s);
        let between = |a: &[Vector3<f64>], b: &[Vector3<f64>], found: &mut [Vec<[f64; 3]>]| {
            for ((a, b), found) in a.iter().zip(b).zip(found) {
                found.push(a.lerp(b, part).into());
            }
        };
        between(&a.whole_m, &b.whole_m, &mut whole_m);
        between(&a.fifteen_m, &b.fifteen_m, &mut fifteen_m);
    }
    let named = |names: Vec<&str>, joints_m: Vec<Vec<[f64; 3]>>| -> Value {
        names.into_iter().map(str::to_owned).zip(joints_m.into_iter().map(|m| json!(m))).collect()
    };
    json!({
        "frames": frames,
        "rate_hz": steps as f64 / span_s,
        "segments": WholeSegment::ALL.map(WholeSegment::name),
        "whole_m": named(WholeSegment::ALL.map(WholeSegment::name).to_vec(), whole_m),
        "fifteen_m": named(BodySegment::ALL.map(BodySegment::name).to_vec(), fifteen_m),
        // At the times of their own, which streams tell.
        "bodies": all.iter().map(|joints| {
            let of = |m: &[Vector3<f64>]| m.iter().map(|m| [m.x, m.y, m.z]).collect::<Vec<_>>();
            json!({ "t_s": joints.t_s, "whole_m": of(&joints.whole_m) })
        }).collect::<Vec<_>>(),
    })
}

/// Datagrams as lines of hexadecimal digits.
fn hex(datagrams: &[Vec<u8>]) -> String {
    let mut text = String::new();
    for datagram in datagrams {
        for byte in datagram {
            write!(text, "{byte:02x}").unwrap();
        }
        text.push('\n');
    }
    text
}

#[test]
fn other_programs_find_every_joint_where_it_is() {
    let Some(readers) = std::env::var_os("POSED_TEST_READERS") else {
        println!("skipped: set POSED_TEST_READERS to the folder that tests/readers/install has filled");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let take = strolled(folder.path());
    for (end, bones) in FILES {
        let name = bones.map_or_else(|| format!("take.{end}"), |bones| format!("take-{bones}.{end}"));
        let (recording, output) = (take.recording.to_str().unwrap(), folder.path().join(name));
        let mut args = vec!["export", recording, "--to", end, "--json", "-o", output.to_str().unwrap()];
        args.extend(bones.iter().flat_map(|bones| ["--bones", bones]));
        let done = posed(args);
        assert!(done.status.success(), "{end}: {}", String::from_utf8_lossy(&done.stderr));
        assert_eq!(said(&done)["rows"], take.bodies.len(), "{end}");
    }
    let (mut to_avatars, mut to_mvn) = (Vec::new(), Vec::new());
    let mut avatars = vmc::Publisher::new(&take.stage, 0, take.stage.vmc.as_ref().unwrap());
    let mut programs = mvn::Publisher::new(&take.stage, 0, take.stage.mvn.as_ref().unwrap());
    for body in &take.bodies {
        avatars.body(body, |datagram| to_avatars.push(datagram.to_vec()));
        programs.body(body, |datagram| to_mvn.push(datagram.to_vec()));
    }
    for (name, text) in [
        ("truth.json", truth(&take.bodies).to_string()),
        ("vmc.hex", hex(&to_avatars)),
        ("mvn.hex", hex(&to_mvn)),
    ] {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    let check = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/readers/check");
    let done = Command::new(check).arg(readers).arg(folder.path()).output().unwrap();
    println!("{}", String::from_utf8_lossy(&done.stdout));
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
}
