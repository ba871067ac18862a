//! Somebody who is scripted is written into files as programs write them, and followed.

use std::fmt::Write as _;

use nalgebra::Matrix3;

use super::*;
use crate::body::{Activity, Script, TrueBody};

const HEIGHT_M: f64 = 1.7;
const RATE_HZ: f64 = 100.0;
/// Index in a [`TrueBody`], and the point in its axes, of what a table names.
const POINTS: [(&str, usize); 14] = [
    ("Hips", 1),
    ("RightUpLeg", 4),
    ("LeftUpLeg", 8),
    ("RightLeg", 5),
    ("LeftLeg", 9),
    ("RightFoot", 12),
    ("LeftFoot", 14),
    ("RightArm", 2),
    ("LeftArm", 6),
    ("RightForeArm", 3),
    ("LeftForeArm", 7),
    ("RightHand", 11),
    ("LeftHand", 13),
    ("Neck", 10),
];

fn scripted(activity: Activity, t_s: f64) -> TrueBody {
    let script = Script { activity, calibration: false, facing: 0.0, mistake: None };
    let build = Build::of_height(HEIGHT_M);
    script.at(t_s + 4.0, &build).place(&build)
}

/// A table of joint centres in other axes and another unit, without the columns that `without` names.
fn table(activity: Activity, seconds: f64, axes: &Matrix3<f64>, unit_m: f64, without: &str) -> String {
    let build = Build::of_height(HEIGHT_M);
    let mut names: Vec<String> = POINTS.iter().map(|(name, _)| (*name).to_owned()).collect();
    names.extend(["RightToeBase", "LeftToeBase", "HeadTop_End", "Spine"].map(str::to_owned));
    let kept = |name: &str| without.is_empty() || !name.contains(without);
    let mut text = String::from("time_s");
    for name in names.iter().filter(|name| kept(name)) {
        _ = write!(text, ",{name}.x,{name}.y,{name}.z");
    }
    for frame in 0..(seconds * RATE_HZ) as usize {
        let t_s = frame as f64 / RATE_HZ;
        let body = scripted(activity, t_s);
        let soles = build.soles_m(&body);
        let mut points: Vec<Vector3<f64>> = POINTS.iter().map(|(_, index)| body[*index].origin_m).collect();
        points.extend([soles[0][1], soles[1][1]]);
        points.push(body[10].origin_m + body[10].axes * Vector3::y() * build.head_m);
        points.push(body[1].origin_m + body[1].axes * Vector3::y() * 0.1);
        _ = write!(text, "\n{:.4}", 7.0 + t_s);
        for (_, point) in names.iter().zip(&points).filter(|(name, _)| kept(name)) {
            let point = axes * point / unit_m;
            _ = write!(text, ",{:.6},{:.6},{:.6}", point.x, point.y, point.z);
        }
    }
    text
}

fn of_table(text: &str) -> Result<Take, TakeError> {
    let recording = Recording::of_table(Path::new("walk.csv"), text.as_bytes(), None)?;
    Take::new(vec![recording], HEIGHT_M)
}

/// Worst angle between segments and those they hang on, of the script and of who follows it, degrees.
fn worst_deg(take: &Take, activity: Activity, segments: &[(usize, usize)]) -> f64 {
    let mut worst: f64 = 0.0;
    for step in 0..100 {
        let t_s = 2.0 + 0.02 * f64::from(step);
        let (found, expected) = (take.at(t_s).place(&take.build()), scripted(activity, t_s));
        for (segment, parent) in segments {
            let between = |body: &TrueBody| {
                let q = |index: usize| body[index].orientation();
                q(*parent).inverse() * q(*segment)
            };
            worst = worst.max(between(&found).angle_to(&between(&expected)).to_degrees());
        }
    }
    worst
}

const LEGS: [(usize, usize); 4] = [(4, 1), (5, 4), (8, 1), (9, 8)];
const ARMS: [(usize, usize); 2] = [(2, 0), (6, 0)];

#[test]
fn who_follows_a_table_moves_as_it_says() {
    let text = table(Activity::Strolling, 6.0, &Matrix3::identity(), 1.0, "");
    let take = of_table(&text).unwrap();
    let usual = Build::of_height(HEIGHT_M);
    for (found, expected) in [
        (take.build().thigh_m, usual.thigh_m),
        (take.build().shank_m, usual.shank_m),
        (take.build().upper_arm_m, usual.upper_arm_m),
        (take.build().shoulder_width_m, usual.shoulder_width_m),
        (take.build().hip_width_m, usual.hip_width_m),
    ] {
        assert!((found / expected - 1.0).abs() < 1e-3, "{found} {expected}");
    }
    let legs = worst_deg(&take, Activity::Strolling, &LEGS);
    assert!(legs < 4.0, "{legs}");
    let arms = worst_deg(&take, Activity::Strolling, &ARMS);
    assert!(arms < 4.0, "{arms}");
}

/// Where one clip goes over into the next is no clip: 0.8 s of two that are long enough, also from the last to the first.
#[test]
fn what_joins_two_clips_is_neither() {
    let text = table(Activity::Reaching, 6.0, &Matrix3::identity(), 1.0, "");
    let recording = || Recording::of_table(Path::new("reach.csv"), text.as_bytes(), None).unwrap();
    let take = Take::new(vec![recording(), recording()], HEIGHT_M).unwrap();
    let lap_s = take.duration_s();
    let seam_s = SEAM as f64 / KNOTS_HZ;
    // A lap later, after the beginning: who begins has stood before.
    let at = |t_s: f64| take.clip(lap_s + t_s);
    assert_eq!(take.clip(0.5 * BEGIN_S), None);
    assert_eq!(
        (at(0.5 * seam_s), at(0.25 * lap_s), at(0.5 * lap_s + 0.5 * seam_s), at(0.75 * lap_s)),
        (None, Some(0), None, Some(1))
    );
    let outside = (0..1000).filter(|k| at(f64::from(*k) * lap_s / 1000.0).is_some()).count();
    // Two seams, each with what a spline reaches beyond it.
    let expected = 1.0 - 2.0 * (seam_s + 5.0 / KNOTS_HZ) / lap_s;
    assert!((outside as f64 / 1000.0 - expected).abs() < 0.01, "{outside} {expected}");
}

#[test]
fn axes_and_units_of_a_table_are_found() {
    let expected = of_table(&table(Activity::Strolling, 3.0, &Matrix3::identity(), 1.0, "")).unwrap();
    let y_up = Matrix3::new(0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0);
    let z_down = Matrix3::new(1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0);
    let left_handed = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0));
    for (axes, unit_m) in [(y_up, 0.01), (z_down, 1.0), (left_handed, 1e-3), (y_up * left_handed, 0.0254)] {
        let found = of_table(&table(Activity::Strolling, 3.0, &axes, unit_m, "")).unwrap();
        for t_s in [0.0, 0.7, 1.9, 4.4] {
            let (found, expected) =
                (found.at(t_s).place(&found.build()), expected.at(t_s).place(&expected.build()));
            for (found, expected) in found.iter().zip(&expected) {
                assert!((found.axes - expected.axes).norm() < 0.02, "{axes} {t_s}");
                assert!((found.origin_m - expected.origin_m).norm() < 0.01, "{axes} {t_s}");
            }
        }
    }
}

#[test]
fn hips_that_a_table_leaves_out_are_found() {
    let take = of_table(&table(Activity::Strolling, 6.0, &Matrix3::identity(), 1.0, "UpLeg")).unwrap();
    let build = take.build();
    let usual = Build::of_height(HEIGHT_M);
    assert!((build.thigh_m / usual.thigh_m - 1.0).abs() < 0.1, "{}", build.thigh_m);
    let legs = worst_deg(&take, Activity::Strolling, &LEGS);
    assert!(legs < 20.0, "{legs}");
}

/// Nothing leaps where a recording begins again, and sensors feel what they could.
#[test]
fn seams_are_smooth() {
    let take = of_table(&table(Activity::Strolling, 2.0, &Matrix3::identity(), 1.0, "")).unwrap();
    assert!((1.2..2.0).contains(&take.duration_s()));
    let build = take.build();
    let at = |t_s: f64| take.at(t_s).place(&build);
    let (mut most, mut most_change): (f64, f64) = (0.0, 0.0);
    let mut before: Option<Vector3<f64>> = None;
    for step in 0..4000 {
        let t_s = f64::from(step) * 2e-3;
        let bodies = [-1e-3, 0.0, 1e-3].map(|dt_s| at(t_s + dt_s));
        for segment in [0, 3, 5, 12] {
            let m = bodies.each_ref().map(|body| body[segment].origin_m);
            let accel_m_s2 = (m[0] + m[2] - m[1] * 2.0) * 1e6;
            most = most.max(accel_m_s2.norm());
            if segment == 12 {
                let change = before.map_or(0.0, |before| (accel_m_s2 - before).norm());
                most_change = most_change.max(change);
                before = Some(accel_m_s2);
            }
        }
    }
    assert!(most < 100.0 && most_change < 10.0, "{most} {most_change}");
    // After many laps it is still somebody who walks on the floor.
    for t_s in [100.0, 1000.0, 100_000.0] {
        let body = at(t_s);
        assert!((body[1].origin_m.z - 0.9).abs() < 0.15 && (body[0].axes[(2, 1)]) > 0.9, "{t_s}");
    }
}

#[test]
fn who_follows_begins_in_an_n_pose() {
    let take = of_table(&table(Activity::Squats, 2.0, &Matrix3::identity(), 1.0, "")).unwrap();
    let build = take.build();
    let stood =
        Posture { pelvis_m: Vector3::z() * (build.thigh_m + build.shank_m + ANKLE_M), ..Posture::default() };
    for (found, expected) in take.at(-1.0).place(&build).iter().zip(&stood.place(&build)) {
        assert!((found.axes - expected.axes).norm() < 1e-9);
        assert!((found.origin_m - expected.origin_m).norm() < 1e-9);
    }
}

#[test]
fn what_is_wrong_with_a_table_is_said() {
    let message = |text: &str| of_table(text).unwrap_err().to_string();
    let whole = table(Activity::Squats, 1.0, &Matrix3::identity(), 1.0, "");
    let without = table(Activity::Squats, 1.0, &Matrix3::identity(), 1.0, "LeftFoot");
    assert!(message(&without).starts_with("walk.csv: no joint for the left ankle was found among "));
    assert!(message("a,b\n1,2\n").contains("no columns like `left_knee_x`"));
    let (head, rest) = whole.split_once('\n').unwrap();
    let broken = format!("{head}\n{}", rest.replacen("0.", "none", 1));
    assert!(message(&broken).starts_with("walk.csv: line 2, column "), "{}", message(&broken));
    let timeless = whole.replace("time_s", "frame");
    assert!(message(&timeless).contains("column t: there is no column of times: state `follows_rate_hz`"));
    let backwards = format!("{whole}\n{}", rest.lines().next().unwrap());
    assert!(message(&backwards).contains("column time_s: expected a time after"), "{}", message(&backwards));
    let short: Vec<&str> = whole.lines().take(20).collect();
    assert!(message(&short.join("\n")).contains("at least 0.5 s"));
    let swapped = whole.replace("ForeArm", "Q").replace("Foot", "ForeArm").replace('Q', "Foot");
    assert!(message(&swapped).contains("are the joints what they are called?"), "{}", message(&swapped));
    assert!(message(head).contains("at least one row"));
    let twice = whole.replace(rest.lines().nth(3).unwrap().split(',').nth(1).unwrap(), "");
    assert!(of_table(&twice).is_ok(), "a row without a value is left out");
}

/// A BVH file with a T-pose at rest, y up, in cm.
fn bvh(activity: Activity, seconds: f64) -> String {
    // Name, parent, segment whose rotation it has, and where it begins in the axes of its parent's segment at rest (forward, up, right).
    let b = Build::of_height(HEIGHT_M);
    let (hip, shoulder) = (0.5 * b.hip_width_m, 0.5 * b.shoulder_width_m);
    let toes = (0.06, -0.06);
    let bones: [(&str, usize, usize, [f64; 3]); 17] = [
        ("Hips", 0, 1, [0.0; 3]),
        ("Spine", 0, 0, [0.0, 0.001, 0.0]),
        ("Head", 1, 10, [0.0, b.trunk_m, 0.0]),
        ("RightArm", 1, 2, [0.0, b.trunk_m, shoulder]),
        ("RightForeArm", 3, 3, [0.0, -b.upper_arm_m, 0.0]),
        ("RightHand", 4, 11, [0.0, -b.forearm_m, 0.0]),
        ("LeftArm", 1, 6, [0.0, b.trunk_m, -shoulder]),
        ("LeftForeArm", 6, 7, [0.0, -b.upper_arm_m, 0.0]),
        ("LeftHand", 7, 13, [0.0, -b.forearm_m, 0.0]),
        ("RightUpLeg", 0, 4, [0.0, 0.0, hip]),
        ("RightLeg", 9, 5, [0.0, -b.thigh_m, 0.0]),
        ("RightFoot", 10, 12, [0.0, -b.shank_m, 0.0]),
        ("RightToeBase", 11, 12, [toes.0, toes.1, 0.0]),
        ("LeftUpLeg", 0, 8, [0.0, 0.0, -hip]),
        ("LeftLeg", 13, 9, [0.0, -b.thigh_m, 0.0]),
        ("LeftFoot", 14, 14, [0.0, -b.shank_m, 0.0]),
        ("LeftToeBase", 15, 14, [toes.0, toes.1, 0.0]),
    ];
    // The file's axes: x to the figure's left, y up, z forward; arms level at rest.
    let file = Matrix3::new(0.0, 0.0, -1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0);
    let from_room = Matrix3::new(0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0);
    let rest = |segment: usize| match segment {
        2 | 3 | 11 => file * crate::body::kinematics::about_x(-std::f64::consts::FRAC_PI_2),
        6 | 7 | 13 => file * crate::body::kinematics::about_x(std::f64::consts::FRAC_PI_2),
        _ => file,
    };
    fn open(
        text: &mut String,
        bones: &[(&str, usize, usize, [f64; 3])],
        rest: &impl Fn(usize) -> Matrix3<f64>,
        at: usize,
        order: &mut Vec<usize>,
    ) {
        let (name, parent, _, offset) = bones[at];
        let offset = rest(bones[parent].2) * Vector3::from(offset) * 100.0;
        let word = if at == 0 { "ROOT" } else { "JOINT" };
        let channels = if at == 0 { "6 Xposition Yposition Zposition" } else { "3" };
        _ = writeln!(
            text,
            "{word} {name} {{ OFFSET {} {} {} CHANNELS {channels} Zrotation Xrotation Yrotation",
            offset.x, offset.y, offset.z
        );
        order.push(at);
        for child in (1..bones.len()).filter(|child| bones[*child].1 == at) {
            open(text, bones, rest, child, order);
        }
        if !bones.iter().skip(1).any(|bone| bone.1 == at) {
            let end = if name == "Head" { "0 20 0" } else { "0 0 5" };
            _ = writeln!(text, "End Site {{ OFFSET {end} }}");
        }
        text.push_str("}\n");
    }
    let mut text = String::from("HIERARCHY\n");
    let mut order = Vec::new();
    open(&mut text, &bones, &rest, 0, &mut order);
    let frames = (seconds * RATE_HZ) as usize;
    _ = writeln!(text, "MOTION\nFrames: {}\nFrame Time: {}", frames + 1, 1.0 / RATE_HZ);
    text.push_str(&"0 ".repeat(3 + 3 * bones.len()));
    for frame in 0..frames {
        let body = scripted(activity, frame as f64 / RATE_HZ);
        let turned = |bone: usize| from_room * body[bones[bone].2].axes * rest(bones[bone].2).transpose();
        let hips = from_room * body[1].origin_m * 100.0;
        _ = write!(text, "\n{} {} {}", hips.x, hips.y, hips.z);
        for bone in &order {
            let own = turned(*bone);
            let local = if *bone == 0 { own } else { turned(bones[*bone].1).transpose() * own };
            for angle in fit::zxy(&local) {
                _ = write!(text, " {}", angle.to_degrees());
            }
        }
    }
    text
}

#[test]
fn who_follows_a_bvh_file_moves_as_it_says() {
    let text = bvh(Activity::Reaching, 6.0);
    let recording = Recording::of_bvh(Path::new("reach.bvh"), &text).unwrap();
    let take = Take::new(vec![recording], HEIGHT_M).unwrap();
    assert!((take.build().upper_arm_m / Build::of_height(HEIGHT_M).upper_arm_m - 1.0).abs() < 1e-3);
    let limbs = [(11, 0), (13, 0), (10, 0), (5, 4), (9, 8)];
    let worst = worst_deg(&take, Activity::Reaching, &limbs);
    assert!(worst < 6.0, "{worst}");
}

#[test]
fn what_is_wrong_with_a_bvh_file_is_said() {
    let message = |text: &str| Recording::of_bvh(Path::new("reach.bvh"), text).unwrap_err().to_string();
    assert!(
        message("HIERARCHY\nROOT").starts_with("reach.bvh: line 2, column 5: expected the name of a joint")
    );
    let text = bvh(Activity::Reaching, 1.0).replace("LeftForeArm", "Tentacle");
    assert!(
        message(&text).starts_with("reach.bvh: no joint for the left elbow was found among Hips, "),
        "{}",
        message(&text)
    );
}

#[test]
fn a_file_that_is_not_there_or_of_another_kind_is_named() {
    let read = |name: &str| {
        Take::read(&[name.into()], Path::new("/nowhere"), None, HEIGHT_M).unwrap_err().to_string()
    };
    assert!(read("walk.bvh").starts_with("/nowhere/walk.bvh: "));
    let odd = std::env::temp_dir().join("posed-take.txt");
    std::fs::write(&odd, "x").unwrap();
    assert!(read(odd.to_str().unwrap()).contains("should end in .csv"));
    std::fs::remove_file(odd).unwrap();
}
