//! The bytes of one message of each kind were made by others' writers (rosbags 0.11.9; keys and gid by eclipse-zenoh's and xxhash's own).

use super::*;
use posed_drivers::Timestamp;
use posed_fusion::body::BodySegment;
use posed_stage::output::{Inertial, Measured, SegmentState, SensorState};

const EPOCH_UTC_NS: i64 = 1_700_000_000_000_000_000;
const T: Timestamp = Timestamp::from_nanos(250_000_000);

fn stage(more: &str) -> Stage {
    Stage::parse(&format!(
        "name = \"Hall 2\"\n[[device]]\nname = \"f\"\ndriver = \"flock-of-birds\"\nport = \"auto\"\n\
         [[sensor]]\nname = \"pelvis\"\ndevice = \"f\"\naddress = 1\n\
         [[sensor]]\nname = \"l5\"\ndevice = \"f\"\naddress = 2\n{more}"
    ))
    .unwrap()
}

fn publisher(more: &str) -> Publisher {
    let stage = stage(&format!("{more}\n[body]\nname = \"anna\"\nheight_m = 1.8\n"));
    Publisher::new(&stage, stage.ros2.as_ref().unwrap(), EPOCH_UTC_NS)
}

fn pose(position_m: [f64; 3]) -> PoseEstimate {
    PoseEstimate {
        position_m: Some(position_m),
        orientation_wxyz: [1.0, 0.0, 0.0, 0.0],
        velocity_m_s: None,
        angular_velocity_rad_s: [0.0; 3],
        covariance: [0.0; 21],
        sigma_m: None,
    }
}

fn frame(states: [SensorState; 2]) -> Estimate {
    let poses = [pose([0.1, 0.2, 0.3]), pose([0.0, 0.0, 0.1])];
    let sensor = |(state, pose)| SensorEstimate { state, pose: Some(pose), ..SensorEstimate::default() };
    let sensors = states.into_iter().zip(poses).map(sensor).collect();
    Estimate { t_valid: T, sensors, ..Estimate::default() }
}

/// Name and message of all that a frame gives.
fn emitted(publisher: &mut Publisher, estimate: &Estimate) -> Vec<(String, Vec<u8>)> {
    let mut messages = Vec::new();
    let names: Vec<_> = publisher.topics().iter().map(|topic| topic.name.clone()).collect();
    publisher.frame(estimate, |topic, bytes| messages.push((names[topic].clone(), bytes)));
    messages
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

const STAMP_MAP: &str = "00f1536580b2e60e040000006d617000";
const PLACE: &str = "9a9999999999b93f9a9999999999c93f333333333333d33f";
const IDENTITY: &str = "000000000000000000000000000000000000000000000000000000000000f03f";

#[test]
fn poses_and_transforms_have_the_bytes_that_others_write() {
    let messages = emitted(&mut publisher("[ros2]"), &frame([SensorState::Ok, SensorState::Suspect]));
    let names: Vec<_> = messages.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["pelvis/pose", "tf"], "what is suspect is left out");
    assert_eq!(hex(&messages[0].1), format!("00010000{STAMP_MAP}{PLACE}{IDENTITY}"));
    let child = "0700000070656c7669730000";
    assert_eq!(hex(&messages[1].1), format!("0001000001000000{STAMP_MAP}{child}{PLACE}{IDENTITY}"));
    let two = emitted(&mut publisher("[ros2]"), &frame([SensorState::Ok; 2]));
    assert_eq!((two[2].1.len(), hex(&two[2].1[0x5c..0x60])), (172, "00f15365".to_owned()));
}

#[test]
fn angles_that_are_known_stand_beside_their_names_and_segments_that_are_shown_in_the_tree() {
    let mut publisher = publisher("[ros2]\nnamespace = \"hall\"\nframe = \"room\"");
    let mut body = Body::unknown(0, BodySegment::BEFORE_SHOULDERS);
    body.t_valid = T;
    let mut messages = Vec::new();
    publisher.body(&body, |topic, bytes| messages.push((topic, bytes)));
    assert!(messages.is_empty(), "nothing is known");
    let joints = publisher.bodies[0].joints.clone();
    let (first, last) = (&joints[0], &joints[joints.len() - 1]);
    (body.angles_rad[first.0], body.angles_rad[last.0]) = (Some(0.5), Some(1.0));
    body.segments[0].position_m = Some([0.1, 0.2, 0.3]);
    body.segments[0].orientation_wxyz = Some([1.0, 0.0, 0.0, 0.0]);
    body.segments[0].state = SegmentState::Suspect;
    body.t_valid = Timestamp::from_nanos(T.as_nanos() + 1);
    publisher.body(&body, |topic, bytes| messages.push((topic, bytes)));
    let [(topic, bytes)] = &messages[..] else { panic!("{messages:?}") };
    assert_eq!(publisher.topics()[*topic].name, "hall/joint_states");
    let text = String::from_utf8_lossy(bytes);
    assert!(text.contains(&format!("{}\0", first.1)) && text.contains(&format!("{}\0", last.1)), "{text}");
    assert!(hex(bytes).ends_with("000000000000e03f000000000000f03f0000000000000000"), "{}", hex(bytes));
    body.segments[0].state = SegmentState::Inferred;
    body.t_valid = Timestamp::from_nanos(T.as_nanos() + 2);
    messages.clear();
    publisher.body(&body, |topic, bytes| messages.push((topic, bytes)));
    let text = String::from_utf8_lossy(&messages[1].1);
    assert!(
        messages[1].0 == publisher.tf && text.contains("room\0") && text.contains("hall/anna_"),
        "{text}"
    );
}

#[test]
fn an_imu_is_told_at_its_own_time_and_what_is_not_known_of_it_says_so() {
    let stage = Stage::parse(
        "name = \"a\"\n[ros2]\n[[device]]\nname = \"x\"\ndriver = \"xbus\"\nport = \"auto\"\n[[sensor]]\nname = \"wrist\"\ndevice = \"x\"\naddress = 0\n",
    )
    .unwrap();
    let mut publisher = Publisher::new(&stage, stage.ros2.as_ref().unwrap(), EPOCH_UTC_NS);
    // A quarter of a turn about z in a second, and the measurement is a second old.
    let turn = std::f64::consts::FRAC_PI_2;
    let mut covariance = [0.0; 21];
    (covariance[15], covariance[18], covariance[20]) = (4.0, 9.0, 16.0);
    let estimated = PoseEstimate {
        position_m: None,
        angular_velocity_rad_s: [0.0, 0.0, turn],
        covariance,
        ..pose([0.0; 3])
    };
    let inertial = Inertial { specific_force_m_s2: Some([0.0, 0.0, 9.81]), ..Inertial::default() };
    let measured = Measured {
        t_valid: T,
        position_m: None,
        clipped: false,
        orientation_wxyz: None,
        button: None,
        inertial: Some(inertial),
    };
    let sensor = SensorEstimate {
        state: SensorState::Ok,
        pose: Some(estimated),
        measured: Some(measured),
        ..SensorEstimate::default()
    };
    let t_valid = Timestamp::from_nanos(T.as_nanos() + 1_000_000_000);
    let mut estimate = Estimate { t_valid, sensors: vec![sensor], ..Estimate::default() };
    let messages = emitted(&mut publisher, &estimate);
    let [(name, bytes)] = &messages[..] else { panic!("{messages:?}") };
    assert_eq!((name.as_str(), &hex(bytes)[8..24]), ("wrist/imu/data", "00f1536580b2e60e"));
    // A frame of five letters and a NUL: the doubles begin at 0x1c.
    let double = |at: usize| f64::from_le_bytes(bytes[0x1c + 8 * at..][..8].try_into().unwrap());
    let numbers: Vec<f64> = (0..37).map(double).collect();
    assert_eq!(bytes.len(), 0x1c + 8 * 37);
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
    assert!(near(&numbers[..4], &[0.0, 0.0, -half, half]), "{numbers:?}");
    assert!(near(&numbers[4..13], &[9.0, 0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 16.0]), "{numbers:?}");
    assert_eq!((&numbers[13..17], numbers[25 + 2]), (&[0.0, 0.0, 0.0, -1.0][..], 9.81));
    assert_eq!(numbers[28..], [0.0; 9]);
    estimate.sensors[0].state = SensorState::Stuck;
    estimate.t_valid = Timestamp::from_nanos(t_valid.as_nanos() + 1);
    let (_, bytes) = &emitted(&mut publisher, &estimate)[0];
    assert_eq!(bytes[0x1c + 32..][..8], UNKNOWN.to_le_bytes(), "an orientation that is not to be used");
}

#[test]
fn keys_tokens_gids_and_attachments_are_those_of_rmw_zenoh() {
    let publisher = publisher("[ros2]\nnamespace = \"hall/a\"\ndomain_id = 7");
    let node = Node { domain_id: 0, namespace: String::new(), name: "posed".to_owned() };
    let tf = &publisher.topics()[publisher.tf];
    let hash = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087";
    assert_eq!(node.key(tf), format!("0/tf/tf2_msgs::msg::dds_::TFMessage_/{hash}"));
    let zid = "aac3178e146ba6f1fc6e6a4085e77f21";
    let token = node.publisher_token(zid, 9, tf);
    let expected =
        format!("@ros2_lv/0/{zid}/0/10/MP/%/%/posed/%tf/tf2_msgs::msg::dds_::TFMessage_/{hash}/::,10:,:,:,,");
    assert_eq!(token, expected);
    assert_eq!(hex(&gid(&token)), "29b58c6ae844b3afaca8acc3520b1453");
    let attached = attachment(1, 2, gid(&token));
    assert_eq!(
        hex(&attached),
        "0100000000000000020000000000000010".to_owned() + "29b58c6ae844b3afaca8acc3520b1453"
    );
    let own = publisher.node();
    assert_eq!(own.token(zid), format!("@ros2_lv/7/{zid}/0/0/NN/%/%hall%a/posed_hall_2"));
    let names: Vec<_> = publisher.topics().iter().map(|topic| own.key(topic)).collect();
    assert!(
        names[1].starts_with("7/hall/a/pelvis/pose/geometry_msgs::msg::dds_::PoseStamped_/RIHS01_"),
        "{names:?}"
    );
}

#[test]
fn names_are_such_as_ros_takes_and_no_two_are_alike() {
    let mut names = Names::default();
    let made = ["left hand", "left-hand", "_left__hand_", "1", "頭", "s"].map(|text| names.of(text));
    assert_eq!(made, ["left_hand", "left_hand_2", "left_hand_3", "s1", "s", "s_2"]);
}

#[test]
fn a_rate_thins_each_stream() {
    let mut publisher = publisher("[ros2]\nrate_hz = 10.0");
    let mut count = 0;
    for n in 0..100 {
        let t_valid = Timestamp::from_nanos(n * 10_000_000);
        let estimate = Estimate { t_valid, ..frame([SensorState::Ok; 2]) };
        publisher.frame(&estimate, |topic, _| count += usize::from(topic == 0));
    }
    assert_eq!(count, 10);
}
