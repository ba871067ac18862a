//! Bones as a receiver puts them together again.

use std::collections::BTreeMap;

use nalgebra::Quaternion;
use rosc::decoder;

use super::*;
use crate::testing;
use posed_fusion::body::{BodySegment, SEGMENTS, WholeSegment, whole};
use posed_stage::output::{PoseEstimate, SegmentState, SensorEstimate, SensorState};

type Transform = (Vector3<f64>, UnitQuaternion<f64>);

fn stage(more: &str) -> (Stage, posed_stage::Vmc) {
    let text = format!(
        "name = \"A\"\n[vmc]\n{more}\n[body]\nheight_m = 1.8\n[[device]]\nname = \"f\"\ndriver = \"flock-of-birds\"\nport = \"auto\"\n\
         [[sensor]]\nname = \"hand\"\ndevice = \"f\"\naddress = 1\nsegment = \"forearm_r\"\n"
    );
    let stage = Stage::parse(&text).unwrap();
    let settings = stage.vmc.clone().unwrap();
    (stage, settings)
}

fn body(orientations: &[UnitQuaternion<f64>; SEGMENTS]) -> Body {
    testing::body(1500, orientations)
}

/// Segment to room of a body that looks along the room's y: N-pose.
fn facing_y() -> [UnitQuaternion<f64>; SEGMENTS] {
    [UnitQuaternion::new_unchecked(Quaternion::new(0.5, 0.5, 0.5, 0.5)); SEGMENTS]
}

/// Messages by address and name, whatever the datagrams; each is one bundle that fits.
fn received(publisher: &mut Publisher, body: &Body) -> BTreeMap<String, Vec<OscType>> {
    let mut all = BTreeMap::new();
    publisher.body(body, |datagram| {
        assert!(datagram.len() <= DATAGRAM && datagram.starts_with(b"#bundle\0\0\0\0\0\0\0\0\x01"));
        let (rest, packet) = decoder::decode_udp(datagram).unwrap();
        let OscPacket::Bundle(bundle) = packet else { panic!("{packet:?}") };
        assert!(rest.is_empty());
        for packet in bundle.content {
            let OscPacket::Message(OscMessage { addr, args }) = packet else { panic!("{packet:?}") };
            let key = match args.first() {
                Some(OscType::String(name)) => format!("{addr} {name}"),
                _ => addr,
            };
            all.insert(key, args);
        }
    });
    all
}

fn transform(args: &[OscType]) -> Transform {
    let number = |at: usize| match args[at] {
        OscType::Float(value) => f64::from(value),
        ref other => panic!("{other:?}"),
    };
    assert_eq!(args.len(), 8);
    let rotation = Quaternion::new(number(7), number(4), number(5), number(6));
    assert!((rotation.norm() - 1.0).abs() < 1e-6);
    (Vector3::new(number(1), number(2), number(3)), UnitQuaternion::new_normalize(rotation))
}

/// Joints in Unity's axes, put together from the bones as a receiver does.
fn joints(messages: &BTreeMap<String, Vec<OscType>>) -> [Transform; SEGMENTS] {
    let bone = |segment| transform(&messages[&format!("/VMC/Ext/Bone/Pos {}", bones::name(segment))]);
    let root = transform(&messages["/VMC/Ext/Root/Pos root"]);
    let mut whole = [root; SEGMENTS];
    for segment in Skeleton::PARENTS_FIRST {
        let above = segment.shoulder().or(segment.parent());
        let (at, turned) = above.map_or(root, |above| whole[above.index()]);
        let (offset, rotation) = bone(segment);
        whole[segment.index()] = (at + turned * offset, turned * rotation);
    }
    whole
}

#[test]
fn bones_put_together_are_the_body() {
    let skeleton = Skeleton::from_height(1.8);
    let rotations = |seed: f64| {
        std::array::from_fn::<_, SEGMENTS, _>(|at| {
            let at = at as f64 + seed;
            UnitQuaternion::from_euler_angles(
                libm::sin(at) * 3.0,
                libm::cos(at * 1.7) * 1.5,
                libm::sin(at * 2.3) * 3.0,
            )
        })
    };
    for seed in 0..20 {
        let orientations = rotations(f64::from(seed));
        let body = body(&orientations);
        let (stage, settings) = stage("");
        let messages = received(&mut Publisher::new(&stage, 0, &settings), &body);
        assert_eq!(messages["/VMC/Ext/OK"], [OscType::Int(1)]);
        assert_eq!(messages["/VMC/Ext/T"], [OscType::Float(1.5)]);
        let joints = joints(&messages);
        for segment in BodySegment::ALL {
            let of = &body.segments[segment.index()];
            let origin = Vector3::from(of.position_m.unwrap());
            let joint = origin + orientations[segment.index()] * skeleton.joint_in_segment_m(segment);
            let expected = Vector3::new(joint.x, joint.z, joint.y);
            let (at, turned) = joints[segment.index()];
            assert!((at - expected).norm() < 1e-5, "{segment:?}: {at} for {expected}");
            // The bone points where the segment does: from its joint to its end, which in the T-pose lies along this axis of Unity's.
            let length = skeleton.end_in_segment_m(segment) - skeleton.joint_in_segment_m(segment);
            let along = match segment {
                BodySegment::Torso | BodySegment::Head => Vector3::y(),
                BodySegment::Pelvis => continue,
                BodySegment::UpperArmR | BodySegment::ForearmR | BodySegment::HandR => Vector3::x(),
                BodySegment::UpperArmL | BodySegment::ForearmL | BodySegment::HandL => -Vector3::x(),
                BodySegment::ShoulderR => Vector3::x(),
                BodySegment::ShoulderL => -Vector3::x(),
                BodySegment::FootR | BodySegment::FootL => {
                    Vector3::new(0.0, -skeleton.foot_m, skeleton.toes_m).normalize()
                }
                _ => -Vector3::y(),
            };
            let end = orientations[segment.index()] * length.normalize();
            assert!((turned * along - Vector3::new(end.x, end.z, end.y)).norm() < 1e-5, "{segment:?}");
        }
    }
}

#[test]
fn hanging_arms_are_a_quarter_down_and_everything_else_is_at_rest() {
    let (stage, settings) = stage("");
    let messages = received(&mut Publisher::new(&stage, 0, &settings), &body(&facing_y()));
    let half = 0.5_f64.sqrt();
    for (name, vector) in [
        ("Hips", [0.0, 0.0, 0.0, 1.0]),
        ("Spine", [0.0, 0.0, 0.0, 1.0]),
        ("LeftUpperArm", [0.0, 0.0, half, half]),
        ("RightUpperArm", [0.0, 0.0, -half, half]),
        ("LeftLowerArm", [0.0, 0.0, 0.0, 1.0]),
        ("RightUpperLeg", [0.0, 0.0, 0.0, 1.0]),
    ] {
        let (_, rotation) = transform(&messages[&format!("/VMC/Ext/Bone/Pos {name}")]);
        let expected = Quaternion::new(vector[3], vector[0], vector[1], vector[2]);
        assert!((rotation.into_inner() - expected).norm() < 1e-6, "{name}: {rotation}");
    }
    let (hips, _) = transform(&messages["/VMC/Ext/Bone/Pos Hips"]);
    assert!((hips - Vector3::new(0.4, 0.95, -0.3)).norm() < 1e-6);
    let expected = Vector3::new(-0.129 * 1.8, 0.288 * 1.8, 0.0);
    let (shoulder, _) = chained(&messages, &["Spine", "LeftShoulder", "LeftUpperArm"]);
    assert!((shoulder - expected).norm() < 1e-6, "left is -x: {shoulder}");
    // Arms hang on the spine where no message has shoulders.
    let mut without = body(&facing_y());
    without.segments.truncate(BodySegment::BEFORE_SHOULDERS);
    let messages = received(&mut Publisher::new(&stage, 0, &settings), &without);
    assert!(!messages.contains_key("/VMC/Ext/Bone/Pos LeftShoulder"));
    assert!((chained(&messages, &["Spine", "LeftUpperArm"]).0 - expected).norm() < 1e-6);
}

/// Where a receiver finds a bone that hangs on these, and how it is turned.
fn chained(messages: &BTreeMap<String, Vec<OscType>>, names: &[&str]) -> Transform {
    let bones = names.iter().map(|name| transform(&messages[&format!("/VMC/Ext/Bone/Pos {name}")]));
    bones.fold((Vector3::zeros(), UnitQuaternion::identity()), |(at, turned), (offset, rotation)| {
        (at + turned * offset, turned * rotation)
    })
}

#[test]
fn an_avatar_that_has_all_bones_holds_chest_head_and_limbs_as_one_of_fewer_does() {
    let (fewer, settings) = stage("");
    let (all, all_settings) = stage("bones = \"all\"");
    let trunk = ["Hips", "Spine", "Chest", "UpperChest"];
    for seed in 0..10 {
        let orientations = std::array::from_fn(|at| {
            let at = at as f64 + 20.0 * f64::from(seed);
            let turn = UnitQuaternion::from_euler_angles(
                libm::sin(at) * 0.6,
                libm::cos(at * 1.7) * 0.6,
                libm::sin(at * 2.3),
            );
            facing_y()[0] * turn
        });
        let body = body(&orientations);
        let few = received(&mut Publisher::new(&fewer, 0, &settings), &body);
        let many = received(&mut Publisher::new(&all, 0, &all_settings), &body);
        assert_eq!(many.len(), few.len() + 5, "chest, upper chest, neck, toes");
        let origins_m = Skeleton::from_height(1.8).whole_origins_m(
            &whole(&orientations),
            body.segments[BodySegment::Pelvis.index()].position_m.unwrap().into(),
        );
        for (more, less, segment) in [
            (vec![], vec![], WholeSegment::T8),
            (vec!["Neck", "Head"], vec!["Head"], WholeSegment::Head),
            (
                vec!["LeftShoulder", "LeftUpperArm", "LeftLowerArm", "LeftHand"],
                vec!["LeftShoulder", "LeftUpperArm", "LeftLowerArm", "LeftHand"],
                WholeSegment::HandL,
            ),
        ] {
            let (at, turned) = chained(&many, &[&trunk[..], &more].concat());
            let (_, expected) = chained(&few, &[&["Hips", "Spine"][..], &less].concat());
            assert!(turned.angle_to(&expected) < 1e-5, "{segment:?}");
            let origin_m = origins_m[segment.index()];
            assert!(
                (at - Vector3::new(origin_m.x, origin_m.z, origin_m.y)).norm() < 1e-5,
                "{segment:?}: {at} for {origin_m}"
            );
        }
        let (toes_m, _) =
            chained(&many, &["Hips", "RightUpperLeg", "RightLowerLeg", "RightFoot", "RightToes"]);
        let origin_m = origins_m[WholeSegment::ToeR.index()];
        assert!((toes_m - Vector3::new(origin_m.x, origin_m.z, origin_m.y)).norm() < 1e-5);
    }
    // Nobody bends: every bone is as it rests, arms but hanging.
    let many = received(&mut Publisher::new(&all, 0, &all_settings), &body(&facing_y()));
    for name in
        ["Spine", "Chest", "UpperChest", "Neck", "LeftShoulder", "RightShoulder", "LeftToes", "RightToes"]
    {
        assert!(transform(&many[&format!("/VMC/Ext/Bone/Pos {name}")]).1.angle() < 1e-6, "{name}");
    }
    // Without a chest there is no spine; without a head's sensor, no neck.
    let mut body = body(&facing_y());
    body.segments[BodySegment::Head.index()].sensor = None;
    let many = received(&mut Publisher::new(&all, 0, &all_settings), &body);
    assert!(
        many.contains_key("/VMC/Ext/Bone/Pos UpperChest") && !many.contains_key("/VMC/Ext/Bone/Pos Neck")
    );
    body.segments[BodySegment::Torso.index()].state = SegmentState::Missing;
    let many = received(&mut Publisher::new(&all, 0, &all_settings), &body);
    assert!(!many.contains_key("/VMC/Ext/Bone/Pos Spine") && many.contains_key("/VMC/Ext/Bone/Pos LeftToes"));
}

#[test]
fn heading_and_height_are_those_of_the_avatar() {
    let (stage, settings) = stage("heading_deg = 90.0\nheight_m = 0.9");
    // Looking along the room's x; turned to the left it looks along y, which is Unity's forward.
    let upright = [posed_fusion::body::upright(); SEGMENTS];
    let messages = received(&mut Publisher::new(&stage, 0, &settings), &body(&upright));
    let (hips, rotation) = transform(&messages["/VMC/Ext/Bone/Pos Hips"]);
    assert!(rotation.angle() < 1e-6);
    // (0.4, -0.3) turned by a quarter is (0.3, 0.4); half as large.
    assert!((hips - Vector3::new(0.15, 0.475, 0.2)).norm() < 1e-6, "{hips}");
}

#[test]
fn what_sensors_do_not_show_is_not_sent_and_nothing_is_said_to_be_nothing() {
    let (stage, settings) = stage("");
    let mut body = body(&facing_y());
    body.segments[BodySegment::Torso.index()].state = SegmentState::Suspect;
    let messages = received(&mut Publisher::new(&stage, 0, &settings), &body);
    let bones: Vec<_> = messages.keys().filter_map(|key| key.strip_prefix("/VMC/Ext/Bone/Pos ")).collect();
    let legs =
        ["Hips", "LeftFoot", "LeftLowerLeg", "LeftUpperLeg", "RightFoot", "RightLowerLeg", "RightUpperLeg"];
    assert_eq!(bones, legs, "no arms, no head");
    // A foot without a sensor of its own is left to whoever knows better.
    body.segments[BodySegment::FootL.index()].sensor = None;
    let messages = received(&mut Publisher::new(&stage, 0, &settings), &body);
    assert!(!messages.contains_key("/VMC/Ext/Bone/Pos LeftFoot"));
    body.segments[BodySegment::Pelvis.index()].state = SegmentState::Missing;
    let messages = received(&mut Publisher::new(&stage, 0, &settings), &body);
    assert_eq!(messages["/VMC/Ext/OK"], [OscType::Int(0)]);
    assert_eq!(messages.len(), 2);
    let mut emitted = 0;
    let mut publisher = Publisher::new(&stage, 0, &settings);
    received(&mut publisher, &body);
    publisher.look(2.0, |_| emitted += 1);
    assert_eq!(emitted, 0, "half a second ago");
    publisher.look(3.0, |_| emitted += 1);
    assert_eq!(emitted, 1);
}

#[test]
fn the_rate_is_kept_and_trackers_are_sent_in_room_axes() {
    let (stage, settings) = stage("rate_hz = 30.0\ntrackers = true");
    let mut publisher = Publisher::new(&stage, 0, &settings);
    let pose = PoseEstimate {
        position_m: Some([0.1, 0.2, 0.3]),
        orientation_wxyz: [0.5_f64.sqrt(), 0.0, 0.0, 0.5_f64.sqrt()],
        velocity_m_s: None,
        angular_velocity_rad_s: [0.0; 3],
        covariance: [0.0; 21],
        sigma_m: None,
    };
    let sensor = SensorEstimate { state: SensorState::Ok, pose: Some(pose), ..SensorEstimate::default() };
    let estimate = Estimate { sensors: vec![sensor], ..Estimate::default() };
    publisher.frame(&estimate, |_| panic!("a body follows"));
    let mut body = body(&facing_y());
    let messages = received(&mut publisher, &body);
    let (position, rotation) = transform(&messages["/VMC/Ext/Tra/Pos hand"]);
    assert!((position - Vector3::new(0.1, 0.3, 0.2)).norm() < 1e-6);
    assert!(
        (rotation.coords.y + 0.5_f64.sqrt()).abs() < 1e-6 && rotation.coords.x.abs() < 1e-6,
        "{rotation}"
    );
    let mut frames = 0;
    for k in 1..=100 {
        body.t_valid = Timestamp::from_nanos(1_500_000_000 + k * 10_000_000);
        frames += usize::from(!received(&mut publisher, &body).is_empty());
    }
    assert!((29..=31).contains(&frames), "{frames} in a second");
}

#[test]
fn trackers_are_sent_where_a_body_has_a_height_and_never_comes() {
    let (stage, settings) = stage("rate_hz = 50.0\ntrackers = true");
    let mut publisher = Publisher::new(&stage, 0, &settings);
    let mut sent_s = Vec::new();
    let at = |s: f64| Timestamp::from_secs_f64(s);
    for k in 0..100 {
        let t_s = 5.0 + 0.01 * f64::from(k);
        publisher.frame(&Estimate { t_valid: at(t_s), ..Estimate::default() }, |_| sent_s.push(t_s));
    }
    assert!(sent_s[0] < 5.3 && (30..=40).contains(&sent_s.len()), "{sent_s:?}");
    // A body that comes after all brings them again.
    let body = Body { t_valid: at(6.0), ..body(&facing_y()) };
    assert!(!received(&mut publisher, &body).is_empty());
    publisher.frame(&Estimate { t_valid: at(6.1), ..Estimate::default() }, |_| panic!("a body follows"));
}

#[test]
fn bytes_are_those_of_the_protocol() {
    let (stage, settings) = stage("");
    let mut publisher = Publisher::new(&stage, 0, &settings);
    let mut emitted = Vec::new();
    publisher.look(1.5, |datagram| emitted.push(datagram.to_vec()));
    let mut expected = b"#bundle\0\0\0\0\0\0\0\0\x01\0\0\0\x14/VMC/Ext/OK\0,i\0\0\0\0\0\0".to_vec();
    expected.extend_from_slice(b"\0\0\0\x14/VMC/Ext/T\0\0,f\0\0\x3f\xc0\0\0");
    assert_eq!(emitted, [expected]);
}
