//! Files read back by readers of their own, written from the formats' descriptions.

use nalgebra::{Matrix3, Rotation3};

use super::*;
use posed_fusion::body::joint_rotation;

/// A second of a moving body, unequally spaced.
fn moving() -> Animation {
    let skeleton = Skeleton::from_height(1.8);
    let mut animation = Animation::new(skeleton);
    for k in 0..50 {
        let t = 0.02 * f64::from(k);
        let mut all = [upright(); SEGMENTS];
        all[BodySegment::Pelvis.index()] =
            UnitQuaternion::from_euler_angles(0.1 * t, 0.0, 0.7 * t) * upright();
        for segment in Skeleton::PARENTS_FIRST {
            if let Some(parent) = segment.parent() {
                let angles = [0.9 * t, 0.4 * t, -0.3 * t];
                all[segment.index()] = all[parent.index()] * joint_rotation(segment, &angles);
            }
        }
        let t_s = t + 0.001 * f64::from(k % 3);
        animation.push(t_s, all, Vector3::new(0.3 * t, 0.1, 0.9));
    }
    animation
}

/// Joint centres of the last frame as a BVH reader finds them.
fn read_bvh(text: &str) -> Vec<(String, Vector3<f64>)> {
    let (hierarchy, motion) = text.split_once("MOTION\n").unwrap();
    let values: Vec<f64> =
        motion.lines().last().unwrap().split_whitespace().map(|word| word.parse().unwrap()).collect();
    let mut at = 0;
    let mut stack: Vec<(Matrix3<f64>, Vector3<f64>)> = vec![(Matrix3::identity(), Vector3::zeros())];
    let mut found = Vec::new();
    let mut name = String::new();
    for line in hierarchy.lines().skip(1) {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[0] {
            "ROOT" | "JOINT" => name = words[1].to_owned(),
            "End" => name = format!("{name} end"),
            "OFFSET" => {
                let offset = Vector3::from_fn(|i, _| words[i + 1].parse::<f64>().unwrap());
                let (axes, origin) = *stack.last().unwrap();
                stack.push((axes, origin + axes * offset));
                found.push((name.clone(), origin + axes * offset));
            }
            "CHANNELS" => {
                let (mut axes, mut origin) = stack.pop().unwrap();
                for channel in &words[2..] {
                    let value = values[at];
                    at += 1;
                    let unit = match channel.as_bytes()[0] {
                        b'X' => Vector3::x_axis(),
                        b'Y' => Vector3::y_axis(),
                        _ => Vector3::z_axis(),
                    };
                    if channel.ends_with("position") {
                        origin += unit.into_inner() * value;
                        found.last_mut().unwrap().1 = origin;
                    } else {
                        axes *= Rotation3::from_axis_angle(&unit, value.to_radians()).into_inner();
                    }
                }
                stack.push((axes, origin));
            }
            "}" => _ = stack.pop(),
            _ => {}
        }
    }
    assert_eq!(at, values.len());
    found
}

#[test]
fn a_bvh_reader_finds_the_joints_where_they_are() {
    let animation = moving();
    let (rate_hz, frames) = animation.even().unwrap();
    let text = bvh::text(&animation.skeleton, rate_hz, &frames);
    let read = read_bvh(&text);
    let last = frames.last().unwrap();
    let origins = animation.skeleton.origins_m(&last.orientations, last.pelvis_m);
    let mut compared = 0;
    for segment in BodySegment::ALL {
        let q = last.orientations[segment.index()];
        let joint = origins[segment.index()] + q * animation.skeleton.joint_in_segment_m(segment);
        let end = origins[segment.index()] + q * animation.skeleton.end_in_segment_m(segment);
        for (name, point) in &read {
            if name == segment.name() {
                assert!((point - joint).norm() < 1e-5, "{name}: {point} is not {joint}");
                compared += 1;
            } else if *name == format!("{} end", segment.name()) {
                assert!((point - end).norm() < 1e-5, "{name}: {point} is not {end}");
                compared += 1;
            }
        }
    }
    assert_eq!(compared, 14);
}

#[test]
fn a_trc_file_has_a_row_per_frame_and_three_columns_per_marker() {
    let animation = moving();
    let (rate_hz, frames) = animation.even().unwrap();
    let text = trc::text(&animation.skeleton, rate_hz, &frames, Path::new("walk.trc"));
    let lines: Vec<&str> = text.lines().collect();
    assert!(lines[0].ends_with("walk.trc"));
    assert_eq!(lines.len(), 6 + frames.len());
    let cells: Vec<f64> = lines[6].split('\t').map(|cell| cell.parse().unwrap()).collect();
    assert_eq!(cells.len(), 2 + 3 * 14);
    let hips = &cells[2..5];
    assert!(
        (hips[0] - frames[0].pelvis_m.x).abs() < 1e-6 && (hips[1] - 0.9).abs() < 1e-6,
        "y is up: {hips:?}"
    );
}

/// The document of a glTF file whose lengths and accessors have been held against one another, and its numbers.
fn read_glb(bytes: &[u8]) -> (serde_json::Value, Vec<u8>) {
    let number = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!(&bytes[..4], b"glTF");
    assert_eq!((number(4), number(8)), (2, bytes.len()));
    let json = number(12);
    let document: serde_json::Value = serde_json::from_slice(&bytes[20..20 + json]).unwrap();
    let binary = number(20 + json);
    assert_eq!(document["buffers"][0]["byteLength"].as_u64().unwrap() as usize, binary);
    assert_eq!(28 + json + binary, bytes.len());
    for accessor in document["accessors"].as_array().unwrap() {
        let view = &document["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let width = match accessor["type"].as_str().unwrap() {
            "SCALAR" => 1,
            "VEC3" => 3,
            _ => 4,
        };
        let size = if accessor["componentType"] == 5126 { 4 } else { 2 };
        let count = accessor["count"].as_u64().unwrap();
        assert_eq!(view["byteLength"].as_u64().unwrap(), count * width * size);
        let end = view["byteOffset"].as_u64().unwrap() + view["byteLength"].as_u64().unwrap();
        assert!(end as usize <= binary);
    }
    (document, bytes[28 + json..].to_vec())
}

#[test]
fn a_glb_file_is_whole_and_its_accessors_fit() {
    let animation = moving();
    let (_, frames) = animation.even().unwrap();
    let (document, _) = read_glb(&glb::bytes(&animation.skeleton, &frames));
    assert_eq!(document["nodes"].as_array().unwrap().len(), 2 * SEGMENTS);
    let channels = document["animations"][0]["channels"].as_array().unwrap();
    assert_eq!(channels.len(), SEGMENTS + 1);
}

#[test]
fn items_move_along_their_paths_with_y_up() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("items.glb");
    let poses = (0..30).map(|k| nalgebra::Isometry3::translation(0.1 * f64::from(k), 0.0, 1.0)).collect();
    let item = Item { name: "sensor".into(), colour: [0.1, 0.2, 0.3], poses };
    let line = |points_m| Line { name: "axis".into(), colour: [1.0; 3], points_m };
    let lines = [line(vec![Vector3::zeros(), Vector3::z()]), line(vec![Vector3::zeros()])];
    let times: Vec<f64> = (0..30).map(|k| 5.0 + 0.1 * f64::from(k)).collect();
    write_items(&path, &times, std::slice::from_ref(&item), &lines).unwrap();
    let (document, numbers) = read_glb(&std::fs::read(&path).unwrap());
    // The item, its path, and the line that has a length.
    let names: Vec<&str> =
        document["nodes"].as_array().unwrap().iter().map(|node| node["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["sensor", "sensor path", "axis"]);
    let animation = &document["animations"][0];
    let target = animation["channels"][1]["target"]["path"].as_str().unwrap();
    let accessor = &document["accessors"][animation["samplers"][1]["output"].as_u64().unwrap() as usize];
    let view = &document["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
    let end = (view["byteOffset"].as_u64().unwrap() + view["byteLength"].as_u64().unwrap()) as usize;
    let last: Vec<f32> = numbers[end - 12..end]
        .chunks_exact(4)
        .map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap()))
        .collect();
    assert!(
        target == "translation" && (last[0] - 2.9).abs() < 1e-6 && (last[1] - 1.0).abs() < 1e-6,
        "{last:?}"
    );
    assert!(matches!(write_items(&path, &[0.0], &[item], &[]), Err(AnimationError::TooShort(1))));
}

#[test]
fn one_frame_is_no_animation() {
    let mut animation = Animation::new(Skeleton::from_height(1.8));
    animation.push(0.0, [upright(); SEGMENTS], Vector3::zeros());
    animation.push(0.0, [upright(); SEGMENTS], Vector3::zeros());
    assert!(matches!(animation.even(), Err(AnimationError::TooShort(1))));
}
