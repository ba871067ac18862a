//! Datagrams as a receiver reads them, and bytes of the specification.

use super::*;
use crate::testing::body;
use posed_fusion::body::{SEGMENTS, t_pose, upright};
use posed_stage::output::SegmentState;

fn stage(more: &str) -> (Stage, posed_stage::Mvn) {
    let text = format!(
        "name = \"posed\"\n[mvn]\n{more}\n[body]\nheight_m = 1.8\n[[device]]\nname = \"x\"\ndriver = \"xbus\"\nport = \"auto\"\n\
         [[sensor]]\nname = \"hips\"\ndevice = \"x\"\naddress = 1\nsegment = \"pelvis\"\n"
    );
    let stage = Stage::parse(&text).unwrap();
    let settings = stage.mvn.clone().unwrap();
    (stage, settings)
}

fn publisher(more: &str) -> Publisher {
    let (stage, settings) = stage(more);
    Publisher::new(&stage, 0, &settings)
}

fn t_posed() -> [UnitQuaternion<f64>; SEGMENTS] {
    BodySegment::ALL.map(t_pose)
}

fn sent(publisher: &mut Publisher, body: &Body) -> Vec<Vec<u8>> {
    let mut all: Vec<Vec<u8>> = Vec::new();
    publisher.body(body, |datagram| {
        let size = usize::from(u16::from_be_bytes([datagram[22], datagram[23]]));
        assert!(
            datagram.len() == 24 + size
                && datagram.len() <= 1472
                && datagram[10] == 0x80
                && datagram[17] == 23
        );
        all.push(datagram.to_vec());
    });
    all
}

fn of_type<'a>(sent: &'a [Vec<u8>], kind: &str) -> &'a [u8] {
    sent.iter().find(|datagram| datagram[..6] == *format!("MXTP{kind}").as_bytes()).unwrap()
}

fn number(datagram: &[u8], at: usize) -> f64 {
    f64::from(f32::from_be_bytes(datagram[at..at + 4].try_into().unwrap()))
}

fn count(datagram: &[u8], at: usize) -> u32 {
    u32::from_be_bytes(datagram[at..at + 4].try_into().unwrap())
}

/// Id, numbers of each item behind the header.
fn items(datagram: &[u8], ids: usize, numbers: usize) -> Vec<(u32, Vec<f64>)> {
    let size = 4 * (ids + numbers);
    assert_eq!((datagram.len() - 24) % size, 0);
    assert_eq!(usize::from(datagram[11]), (datagram.len() - 24) / size);
    let item = |at: usize| {
        let numbers = (0..numbers).map(|k| number(datagram, at + 4 * (ids + k))).collect();
        (count(datagram, at + 4 * (ids - 1)), numbers)
    };
    (24..datagram.len()).step_by(size).map(item).collect()
}

/// The examples of the layout: a header, a name and a time.
#[test]
fn bytes_are_those_of_the_specification() {
    let head = wire::Head { sample: 42, time_ms: 1234, character: 0 };
    let mut pose = Datagram::new(2, &head, 1);
    pose.count(1);
    pose.numbers([0.0, 0.0, 0.95, 1.0, 0.0, 0.0, 0.0].iter());
    let expected = [
        0x4d, 0x58, 0x54, 0x50, 0x30, 0x32, 0, 0, 0, 0x2a, 0x80, 1, 0, 0, 4, 0xd2, 0, 0x17, 0, 0, 0, 0, 0,
        0x20, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0x3f, 0x73, 0x33, 0x33, 0x3f, 0x80, 0, 0, 0, 0, 0, 0, 0, 0,
        0, 0, 0, 0, 0, 0,
    ];
    assert_eq!(pose.finish(), expected);
    let mut time = Datagram::new(25, &head, 1);
    time.text("00:00:01.234");
    let bytes = time.finish();
    assert_eq!(bytes[22..28], [0, 0x10, 0, 0, 0, 0x0c]);
    assert!(bytes.ends_with(b"00:00:01.234"));
}

#[test]
fn a_t_pose_has_no_rotation_and_hanging_arms_are_a_quarter_down() {
    let mut publisher = publisher("euler = true\ncharacter = 3");
    let all = sent(&mut publisher, &body(1500, &t_posed()));
    let kinds: Vec<&[u8]> = all.iter().map(|datagram| &datagram[4..6]).collect();
    assert_eq!(kinds, [b"12", b"13", b"02", b"01", b"20", b"25"]);
    assert!(
        all.iter().all(|datagram| datagram[16] == 3 && count(datagram, 6) == 0 && count(datagram, 12) == 0)
    );
    let pose = items(of_type(&all, "02"), 1, 7);
    assert_eq!(pose.len(), 23);
    for (at, (id, numbers)) in pose.iter().enumerate() {
        assert_eq!(*id as usize, at + 1);
        assert!(numbers[3] > 1.0 - 1e-6, "{id}: {numbers:?}");
    }
    assert_eq!(pose[0].1[..3], [0.4_f32, -0.3, 0.95].map(f64::from));
    // The left hand is on the left, which is y.
    assert!(pose[14].1[1] > 0.5 && pose[10].1[1] < -0.9, "{:?} {:?}", pose[14], pose[10]);
    // As it stands, from a floor at 0, named.
    let rest = of_type(&all, "13");
    assert_eq!(count(rest, 24), 23);
    assert_eq!(rest[28..38], *b"\0\0\0\x06Pelvis");
    assert!((number(rest, 46) - 0.53 * 1.8).abs() < 1e-6);
    assert_eq!(count(rest, rest.len() - 4), 0);
    assert!(of_type(&all, "12").ends_with(b"name:posed\nxmid:3\ncolor:6f94b8\n"));
    assert!(of_type(&all, "25").ends_with(b"\0\0\0\x0c00:00:01.500"));

    // N-pose: the arms hang, and all joints' angles are zero. Descriptions come once a second.
    let all = sent(&mut publisher, &body(1520, &[upright(); SEGMENTS]));
    assert_eq!(all.len(), 4);
    let pose = items(of_type(&all, "02"), 1, 7);
    let half = 0.5_f64.sqrt();
    for (id, turned) in [(9, half), (13, -half)] {
        let numbers = &pose[id - 1].1;
        assert!((numbers[3] - half).abs() < 1e-6 && (numbers[4] - turned).abs() < 1e-6, "{id}: {numbers:?}");
    }
    let angles = items(of_type(&all, "20"), 2, 3);
    assert_eq!(angles.len(), 22);
    assert!(angles.iter().all(|(_, numbers)| numbers.iter().all(|angle| angle.abs() < 1e-4)), "{angles:?}");
    assert_eq!((count(of_type(&all, "20"), 24), angles[0].0), (256, 512));
    assert_eq!((count(&all[0], 6), count(&all[0], 12)), (1, 20), "sample and ms");
    let euler = items(of_type(&all, "01"), 1, 6);
    // y up, centimetres: left, up, ahead.
    for (found, expected) in euler[0].1.iter().zip([-30.0, 95.0, 40.0, 0.0, 0.0, 0.0]) {
        assert!((found - expected).abs() < 1e-4, "{euler:?}");
    }
    // A right arm that hangs is turned about what points ahead, which is z there.
    assert!((euler[8].1[5] - 90.0).abs() < 1e-4, "{:?}", euler[8]);
}

#[test]
fn joints_are_put_together_again_and_angles_are_those_of_both_sides() {
    let bent = |side: f64| posed_geometry::so3::exp(&Vector3::new(side * 0.2, side * -0.1, 0.5));
    let mut orientations = [upright(); SEGMENTS];
    for (thigh, shank, foot, side) in [
        (BodySegment::ThighR, BodySegment::ShankR, BodySegment::FootR, 1.0),
        (BodySegment::ThighL, BodySegment::ShankL, BodySegment::FootL, -1.0),
    ] {
        for segment in [thigh, shank, foot] {
            orientations[segment.index()] = upright() * bent(side);
        }
    }
    let all = sent(&mut publisher(""), &body(0, &orientations));
    let angles = items(of_type(&all, "20"), 2, 3);
    let hip = |id: u32| &angles.iter().find(|(point, _)| *point == 256 * id).unwrap().1;
    let (right, left) = (hip(16), hip(20));
    assert!(right.iter().zip(left).all(|(right, left)| (right - left).abs() < 1e-4), "{right:?} {left:?}");
    assert!(right[2] > 25.0 && right[0] > 5.0);
    // What a receiver knows of the figure gives every joint's place.
    let pose = items(of_type(&all, "02"), 1, 7);
    let skeleton = Skeleton::from_height(1.8);
    for segment in WholeSegment::ALL {
        let Some(parent) = segment.parent() else { continue };
        let above = &pose[parent.index()].1;
        let q = UnitQuaternion::new_normalize(Quaternion::new(above[3], above[4], above[5], above[6]));
        let offset_m = whole_t_pose(parent) * skeleton.whole_joint_m(segment);
        let expected = Vector3::new(above[0], above[1], above[2]) + q * offset_m;
        let found = &pose[segment.index()].1;
        assert!((expected - Vector3::new(found[0], found[1], found[2])).norm() < 1e-5, "{segment:?}");
    }
}

#[test]
fn what_is_not_shown_goes_with_its_parent_and_without_hips_nothing_is_sent() {
    let mut publisher = publisher("rate_hz = 50.0");
    let mut shown = body(0, &t_posed());
    shown.segments[BodySegment::ForearmL.index()].state = SegmentState::Missing;
    assert_eq!(items(of_type(&sent(&mut publisher, &shown), "02"), 1, 7).len(), 23);
    let count = (1..=100).filter(|k| !sent(&mut publisher, &body(10 * k, &t_posed())).is_empty()).count();
    assert!((49..=51).contains(&count), "{count} in a second");
    shown = body(2000, &t_posed());
    shown.segments[BodySegment::Pelvis.index()].state = SegmentState::Missing;
    assert!(sent(&mut publisher, &shown).is_empty());
    publisher.rewind();
    assert_eq!(sent(&mut publisher, &body(0, &t_posed())).len(), 5);
}

#[test]
fn velocities_are_those_of_a_body_that_speeds_up_and_turns() {
    let mut publisher = publisher("kinematics = true\nrate_hz = 200.0");
    let (accelerates, turns, t_ms) = (2.0_f64, 1.5_f64, 200_i64);
    let mut all = Vec::new();
    for ms in (0..=t_ms).step_by(10) {
        let t = 1e-3 * ms as f64;
        let turned = posed_geometry::so3::exp(&(Vector3::z() * (turns * t)));
        let mut moved = body(ms, &t_posed().map(|q| turned * q));
        let pelvis = &mut moved.segments[BodySegment::Pelvis.index()];
        pelvis.position_m = Some([0.5 * accelerates * t * t, 0.0, 0.95]);
        all = sent(&mut publisher, &moved);
    }
    let t = 1e-3 * t_ms as f64;
    let near = |found: f64, expected: f64| (found - expected).abs() < 1e-3 * (1.0 + expected.abs());
    let linear = items(of_type(&all, "21"), 1, 9);
    let angular = items(of_type(&all, "22"), 1, 10);
    let hips = &linear[0].1;
    assert!(near(hips[3], accelerates * t) && near(hips[6], accelerates), "{hips:?}");
    // A hand goes about the hips as well.
    let (hand, arm) =
        (&linear[14].1, Vector3::new(linear[14].1[0] - hips[0], linear[14].1[1] - hips[1], 0.0));
    let expected = Vector3::x() * (accelerates * t) + (Vector3::z() * turns).cross(&arm);
    assert!(
        (hand[3] - expected.x).abs() < 5e-3 && (hand[4] - expected.y).abs() < 5e-3,
        "{hand:?} {expected}"
    );
    for (id, numbers) in &angular {
        assert!(near(numbers[6], turns.to_degrees()) && numbers[9].abs() < 0.1, "{id}: {numbers:?}");
    }
    // Of a body with raised arms a little above the hips, in its middle.
    let mass = of_type(&all, "24");
    let [x, y, z] = [24, 28, 32].map(|at| number(mass, at));
    assert!(
        mass.len() == 36 && (x - hips[0]).abs() < 0.02 && y.abs() < 0.02 && (1.0..1.1).contains(&z),
        "{z}"
    );
    // Of who has just come nothing is known yet.
    let still = sent(&mut self::publisher("kinematics = true"), &body(0, &t_posed()));
    assert!(items(of_type(&still, "21"), 1, 9).iter().all(|(_, numbers)| numbers[3..] == [0.0; 6]));
}
