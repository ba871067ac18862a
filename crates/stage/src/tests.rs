//! Stage files that are right, and the one that the design shows.

use super::*;
use crate::layout::ChainLayout;

const DESIGN: &str = r#"
name = "Stage A"

[[device]]
name = "flock"
driver = "flock-of-birds"     # motionstar, fastrak, xbus, x-imu3, slimevr
port = "/dev/ttyUSB0"         # or "auto", "tcp://HOST:PORT", "udp://HOST:PORT"
baud = 115200
format = "position-quaternion"

[[sensor]]
name = "left"
device = "flock"
address = 1                    # 0 is a stand-alone unit; several sensors on one Flock mean group mode

[body]                         # segments: torso, pelvis, upper_arm_r, forearm_r, thigh_r, shank_r and _l
skeleton = "human"             # or "custom" with [[body.segments]]
height_m = 1.80
mounting = "calibrate"         # or "given"

[[body.calibration]]           # for a recorded file: when which pose or movement was held
kind = "n_pose"                # t_pose, elbow_flexion_r, elbow_pronation_r, knee_flexion_r, ...
start_s = 0.0
end_s = 3.0
"#;

#[test]
fn the_example_of_the_design_is_right() {
    let stage = Stage::parse(DESIGN).unwrap_or_else(|problems| panic!("{problems}"));
    assert_eq!(stage.devices[0].port, "/dev/ttyUSB0");
    assert_eq!(stage.devices[0].driver.word(), "flock-of-birds");
    assert_eq!(stage.sensors[0].address, 1);
    assert_eq!(stage.bodies.first().map(|body| body.skeleton), Some(Skeleton::Human));
    assert_eq!(check(DESIGN).warnings, []);
}

#[test]
fn a_stage_without_devices_is_right() {
    let stage = Stage::parse("name = \"offline\"").unwrap();
    assert_eq!(stage.frame_wait_ms, 5.0);
    assert!(stage.devices.is_empty());
}

#[test]
fn a_custom_chain_needs_neither_lengths_nor_magnetometer() {
    let text = r#"
name = "chain"
[body]
skeleton = "custom"
[[body.segments]]
name = "base"
[[body.segments]]
name = "link"
parent = "base"
joint = "first"
kind = "hinge"
[[body.calibration]]
kind = "first_flexion"
start_s = 0
end_s = 2
"#;
    let body = Stage::parse(text).unwrap_or_else(|problems| panic!("{problems}")).bodies.remove(0);
    assert_eq!(body.segments[1].kind, Some(JointKind::Hinge));
}

#[test]
fn what_of_a_chain_is_not_followed_is_reported() {
    let device = "name = \"c\"\n[[device]]\nname = \"worn\"\ndriver = \"xbus\"\nport = \"/dev/ttyUSB0\"\n\
        [[sensor]]\nname = \"base\"\ndevice = \"worn\"\naddress = 1\n[body]\nskeleton = \"custom\"\n\
        [[body.segments]]\nname = \"base\"\n";
    let link = |n: usize, parent: &str, kind: &str| {
        format!(
            "[[body.segments]]\nname = \"link{n}\"\nparent = \"{parent}\"\njoint = \"j{n}\"\nkind = \"{kind}\"\n"
        )
    };
    let sensor =
        |n: usize| format!("[[sensor]]\nname = \"link{n}\"\ndevice = \"worn\"\naddress = {}\n", n + 1);
    let reported = |text: &str| {
        let report = check(text);
        assert!(report.ok, "{report:?}");
        let is_followed = ChainLayout::of(&Stage::parse(text).unwrap(), 0).is_some();
        assert_eq!(is_followed, report.warnings.is_empty(), "{report:?}");
        report.warnings.into_iter().map(|warning| (warning.line, warning.message)).collect::<Vec<_>>()
    };
    let begin = device.find("[body]").unwrap();
    let with =
        |sensors: &str, links: &str| format!("{}{sensors}{}{links}", &device[..begin], &device[begin..]);
    assert_eq!(reported(&with(&sensor(1), &link(1, "base", "hinge"))), []);
    let unworn = reported(&with("", &link(1, "base", "hinge")));
    assert_eq!(unworn, [(14, "no IMU sits on `link1`: the chain is not followed live".to_owned())]);
    let ball = reported(&with(&sensor(1), &link(1, "base", "ball")));
    assert_eq!(ball, [(22, "`j1` is no hinge, and chains with other joints are not solved".to_owned())]);
    let (sensors, links): (String, String) = (1..=17).map(|n| (sensor(n), link(n, "base", "hinge"))).unzip();
    let long = reported(&with(&sensors, &links));
    assert_eq!(long.len(), 1, "{long:?}");
    assert_eq!(long[0].1, "chains of more than 17 segments are not followed live");
}

#[test]
fn a_line_that_is_too_slow_gets_a_warning_and_stays_right() {
    let sensors: String = (1..=8)
        .map(|n| format!("[[sensor]]\nname = \"s{n}\"\ndevice = \"flock\"\naddress = {n}\n"))
        .collect();
    let text = format!(
        "name = \"s\"\n[[device]]\nname = \"flock\"\ndriver = \"flock-of-birds\"\nport = \"/dev/ttyS0\"\nbaud = 115200\n{sensors}"
    );
    let report = check(&text);
    assert!(report.ok, "{report:?}");
    // The table of the Flock's manual: seven birds fit in this format.
    assert_eq!((report.warnings.len(), report.warnings[0].line), (1, 6), "{report:?}");
    let seven = text.replace("[[sensor]]\nname = \"s8\"\ndevice = \"flock\"\naddress = 8\n", "");
    assert_eq!(check(&seven).warnings, []);
}

#[test]
fn a_stage_survives_json_and_messagepack() {
    let stage = Stage::parse(DESIGN).unwrap();
    let json = serde_json::to_string(&stage).unwrap();
    assert_eq!(serde_json::from_str::<Stage>(&json).unwrap(), stage);
    let packed = rmp_serde::to_vec_named(&stage).unwrap();
    assert_eq!(rmp_serde::from_slice::<Stage>(&packed).unwrap(), stage);
}

#[test]
fn several_problems_come_at_once_with_their_lines() {
    let text = "nam = \"s\"\n[[device]]\nname = \"d\"\ndriver = \"flock-of-birds\"\nport = \"ttyUSB0\"\nbaud = \"115200\"\n[[sensor]]\nname = \"s\"\ndevice = \"d\"\naddress = 0\n";
    let report = check(text);
    let found: Vec<(usize, &str)> = report.problems.iter().map(|p| (p.line, p.key.as_str())).collect();
    assert_eq!(found, [(1, "nam"), (5, "port"), (6, "baud")], "{report:#?}");
}

proptest::proptest! {
    /// Cut out, doubled or overwritten pieces of a good file: never a panic, and a line for every problem.
    #[test]
    fn a_damaged_file_is_answered(start in 0..DESIGN.len(), length in 0..40usize, with in "[\\[\\]a-z=\"\\n0-9. ]{0,8}") {
        let end = (start + length).min(DESIGN.len());
        fuzz(format!("{}{with}{}", &DESIGN[..start], &DESIGN[end..]).as_bytes());
        fuzz(format!("{}{}{}", &DESIGN[..end], &DESIGN[start..end], &DESIGN[end..]).as_bytes());
    }
}

#[test]
fn segments_of_the_stage_file_are_those_of_the_body() {
    use posed_fusion::body::BodySegment;
    assert_eq!(BodySegment::ALL.map(BodySegment::name), crate::SEGMENTS);
}

#[test]
fn a_body_whose_height_is_not_known_does_not_run_and_serves_on_files() {
    let text = |body: &str| {
        format!(
            "name = \"A\"\n[body]\n{body}[[device]]\nname = \"chain\"\ndriver = \"xbus\"\nport = \"auto\"\n\
             [[sensor]]\nname = \"forearm_r\"\ndevice = \"chain\"\naddress = 1\n"
        )
    };
    let report = check(&text(""));
    assert!(!report.ok);
    assert_eq!((report.problems[0].line, report.problems[0].key.as_str()), (2, "height_m"));
    assert!(Stage::parse(&text("")).is_ok());
    assert!(check(&text("height_m = 1.7\n")).ok);
}
