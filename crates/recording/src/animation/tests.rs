//! Files read back by readers of their own, written from the formats' descriptions.

use nalgebra::{Matrix3, Rotation3};

use super::*;
use posed_fusion::body::{BodySegment, Limb, WHOLE, WholeSegment, joint_rotation, upright, whole};

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

/// Where the joints of the 23 are, m, axes of the figure: left, up, forward of a body that looks along the room's x.
fn expected(animation: &Animation, frame: &Frame) -> Vec<(WholeSegment, Vector3<f64>)> {
    let all = whole(&frame.orientations);
    let origins = animation.skeleton.whole_origins_m(&all, frame.pelvis_m);
    WholeSegment::ALL
        .into_iter()
        .map(|segment| (segment, origins[segment.index()]))
        .map(|(segment, at)| (segment, Vector3::new(at.y, at.z, at.x)))
        .collect()
}

#[test]
fn a_bvh_reader_finds_the_joints_where_they_are() {
    let animation = moving();
    let (rate_hz, frames) = animation.even().unwrap();
    let expected = expected(&animation, frames.last().unwrap());
    for (names, per_m, spine, toe, bones) in [
        (BoneNames::Posed, 1.0, "t8", "toe_l", 23),
        (BoneNames::Blender, 1.0, "spine.003", "toe.L", 22),
        (BoneNames::Motionbuilder, 100.0, "Spine3", "LeftToeBase", 23),
        (BoneNames::Mixamo, 100.0, "mixamorig:Spine2", "mixamorig:LeftToeBase", 22),
    ] {
        let text = bvh::text(&animation.skeleton, rate_hz, &frames, names);
        let read = read_bvh(&text);
        // Five ends: head, hands, toes.
        assert_eq!(read.len(), bones + 5, "{names:?}");
        let at = |name: &str| read.iter().find(|(known, _)| known == name).unwrap().1 / per_m;
        for (segment, name) in [(WholeSegment::T8, spine), (WholeSegment::ToeL, toe)] {
            let expected = expected.iter().find(|(known, _)| *known == segment).unwrap().1;
            // Where a piece of the spine has no bone the one below it is straight for both: a millimetre too long, where somebody bends by 60 degrees.
            let is_exact = bones == WHOLE || segment == WholeSegment::ToeL;
            let limit_m = if is_exact { 1e-5 } else { 0.0015 };
            assert!((at(name) - expected).norm() < limit_m, "{names:?} {name}: {} {expected}", at(name));
        }
        if names == BoneNames::Posed {
            for (segment, expected) in &expected {
                assert!((at(segment.name()) - expected).norm() < 1e-5, "{segment:?}");
            }
        }
        // For programs with names of their own the first frame is the rest: no rotation.
        let rows: Vec<&str> =
            text.lines().skip_while(|line| !line.starts_with("Frame Time")).skip(1).collect();
        let is_rest = rows[0].split_whitespace().skip(3).all(|angle| angle.parse::<f64>() == Ok(0.0));
        let has_rest = names != BoneNames::Posed;
        assert_eq!((is_rest, rows.len()), (has_rest, frames.len() + usize::from(has_rest)), "{names:?}");
    }
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
    assert_eq!(cells.len(), 2 + 3 * 19);
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
            "MAT4" => 16,
            _ => 4,
        };
        let size = match accessor["componentType"].as_u64().unwrap() {
            5126 => 4,
            5123 => 2,
            _ => 1,
        };
        let count = accessor["count"].as_u64().unwrap();
        assert_eq!(view["byteLength"].as_u64().unwrap(), count * width * size);
        let end = view["byteOffset"].as_u64().unwrap() + view["byteLength"].as_u64().unwrap();
        assert!(end as usize <= binary);
    }
    (document, bytes[28 + json..].to_vec())
}

#[test]
fn a_glb_file_is_a_skinned_figure_that_moves() {
    let animation = moving();
    let (_, frames) = animation.even().unwrap();
    let (document, numbers) = read_glb(&glb::bytes(&animation.skeleton, &frames, glb::Kind::Vrm));
    let nodes = document["nodes"].as_array().unwrap();
    // All of the 23 but L3, and the figure.
    assert_eq!(nodes.len(), WHOLE);
    assert_eq!(document["animations"][0]["channels"].as_array().unwrap().len(), WHOLE);
    let bones = &document["extensions"]["VRMC_vrm"]["humanoid"]["humanBones"];
    for bone in ["hips", "spine", "upperChest", "head", "leftHand", "rightFoot", "rightToes"] {
        assert_eq!(nodes[bones[bone]["node"].as_u64().unwrap() as usize]["name"], bone);
    }
    let floats = |accessor: &serde_json::Value| -> Vec<f32> {
        let accessor = &document["accessors"][accessor.as_u64().unwrap() as usize];
        let view = &document["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let begin = view["byteOffset"].as_u64().unwrap() as usize;
        let bytes = &numbers[begin..begin + view["byteLength"].as_u64().unwrap() as usize];
        bytes.chunks_exact(4).map(|four| f32::from_le_bytes(four.try_into().unwrap())).collect()
    };
    let primitive = &document["meshes"][0]["primitives"][0];
    let weights = floats(&primitive["attributes"]["WEIGHTS_0"]);
    assert!(weights.chunks_exact(4).all(|four| (four.iter().sum::<f32>() - 1.0).abs() < 1e-6));
    // It stands on the floor, is as tall as the person, and looks ahead: toes and nose, not heels.
    let points = floats(&primitive["attributes"]["POSITION"]);
    let heights = || points.iter().skip(1).step_by(3).copied();
    let (low, high) = heights().fold((f32::MAX, f32::MIN), |(low, high), y| (low.min(y), high.max(y)));
    assert!((-0.02..0.03).contains(&low) && (1.75..1.9).contains(&high), "{low} {high}");
    let soles = points.chunks_exact(3).filter(|point| point[1] < 0.05).map(|point| point[2]);
    assert!(soles.fold(0.0, f32::max) > 0.2);
    // Normals point outwards, and so do the triangles.
    let normals = floats(&primitive["attributes"]["NORMAL"]);
    let indices = &document["accessors"][primitive["indices"].as_u64().unwrap() as usize];
    let view = &document["bufferViews"][indices["bufferView"].as_u64().unwrap() as usize];
    let begin = view["byteOffset"].as_u64().unwrap() as usize;
    let corners: Vec<usize> = numbers[begin..begin + view["byteLength"].as_u64().unwrap() as usize]
        .chunks_exact(2)
        .map(|two| usize::from(u16::from_le_bytes(two.try_into().unwrap())))
        .collect();
    let vector = |of: &[f32], at: usize| Vector3::new(of[3 * at], of[3 * at + 1], of[3 * at + 2]);
    let (mut outwards, mut inwards) = (0, 0);
    for triangle in corners.chunks_exact(3) {
        let [a, b, c] = [0, 1, 2].map(|k| vector(&points, triangle[k]));
        let face = (b - a).cross(&(c - a));
        if face.norm() < 1e-9 {
            continue;
        }
        let normal = [0, 1, 2].iter().map(|k| vector(&normals, triangle[*k])).sum::<Vector3<f32>>();
        if face.dot(&normal) > 0.0 { outwards += 1 } else { inwards += 1 }
    }
    assert!(outwards > 5000 && inwards == 0, "{outwards} {inwards}");
}

#[test]
fn a_movement_for_any_model_has_no_figure() {
    let animation = moving();
    let (_, frames) = animation.even().unwrap();
    let (document, _) = read_glb(&glb::bytes(&animation.skeleton, &frames, glb::Kind::Vrma));
    assert!(document.get("meshes").is_none() && document.get("skins").is_none());
    assert_eq!(document["extensionsUsed"][0], "VRMC_vrm_animation");
    // Rotations of all bones, and a place of the hips alone.
    let channels = document["animations"][0]["channels"].as_array().unwrap();
    let moved = channels.iter().filter(|channel| channel["target"]["path"] == "translation").count();
    assert_eq!((channels.len(), moved), (WHOLE, 1));
}

#[test]
fn a_usd_file_has_a_rotation_of_every_joint_at_every_time() {
    let animation = moving();
    let (rate_hz, frames) = animation.even().unwrap();
    let text = usd::text(&animation.skeleton, rate_hz, &frames);
    assert!(text.contains("\"pelvis/l5/l3/t12/t8/neck/head\""));
    let (_, rotations) = text.split_once("quatf[] rotations.timeSamples = {\n").unwrap();
    let rows: Vec<&str> = rotations.lines().take_while(|line| line.trim() != "}").collect();
    assert_eq!(rows.len(), frames.len());
    assert!(rows.iter().all(|row| row.matches('(').count() == WHOLE));
    assert_eq!(text.matches('{').count(), text.matches('}').count());
}

#[test]
fn a_c3d_file_has_what_its_parameters_say() {
    let animation = moving();
    let (rate_hz, frames) = animation.even().unwrap();
    let bytes = c3d::bytes(&animation.skeleton, rate_hz, &frames);
    let word = |at: usize| usize::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]));
    let float = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    assert_eq!((bytes[0], bytes[1], word(2), word(8), bytes.len() % 512), (2, 0x50, 35, frames.len(), 0));
    // From record to record, as a reader goes.
    let (mut at, mut starts) = (512 + 4, Vec::new());
    while bytes[at] != 0 {
        let name = &bytes[at + 2..at + 2 + usize::from(bytes[at])];
        let offset = at + 2 + usize::from(bytes[at]);
        if name == b"DATA_START" {
            starts.push(word(offset + 4));
        }
        at = offset + word(offset);
    }
    assert!(at < 512 * (1 + usize::from(bytes[514])));
    assert_eq!((starts.len(), starts[0]), (2, word(16)));
    // The last hips, mm, z up; and the last rotation's residual, behind which there are zeros alone.
    let hips = 512 * (starts[0] - 1) + 16 * 35 * (frames.len() - 1);
    let expected = frames.last().unwrap().pelvis_m * 1000.0;
    assert!((f64::from(float(hips + 8)) - expected.z).abs() < 1e-3 && float(hips + 12) == 0.0);
    let rotations = 512 * (starts[1] - 1);
    let end = rotations + 4 * 17 * 23 * frames.len();
    assert!(end <= bytes.len() && bytes.len() - end < 512);
    let column: f32 = (0..3).map(|k| float(rotations + 4 * k).powi(2)).sum();
    assert!((column - 1.0).abs() < 1e-5 && float(rotations + 60) == 1.0);
    // Shoulders that go with the torso have no angles.
    let mut still = frames.clone();
    for frame in &mut still {
        let torso = frame.orientations[BodySegment::Torso.index()];
        for shoulder in BodySegment::SHOULDERS {
            frame.orientations[shoulder.index()] = torso;
        }
    }
    assert_eq!(c3d::bytes(&animation.skeleton, rate_hz, &still)[2], 33);
}

#[test]
fn a_sto_file_has_a_quaternion_of_every_body() {
    let animation = moving();
    let (rate_hz, frames) = animation.even().unwrap();
    let text = sto::text(rate_hz, &frames);
    let (header, table) = text.split_once("endheader\n").unwrap();
    assert!(header.lines().any(|line| line == "DataType=Quaternion"));
    let rows: Vec<Vec<&str>> = table.lines().map(|line| line.split('\t').collect()).collect();
    assert!(rows[0][0] == "time" && rows[0][1] == "pelvis_imu" && rows.len() == 1 + frames.len());
    assert!(rows.iter().all(|row| row.len() == 15));
    // It begins upright, all axes parallel to OpenSim's.
    for cell in &rows[1][1..] {
        let parts: Vec<f64> = cell.split(',').map(|part| part.parse().unwrap()).collect();
        assert!(parts.len() == 4 && (parts[0].abs() - 1.0).abs() < 1e-6, "{cell}");
    }
}

/// Columns of a MOT file by their labels.
fn read_mot(text: &str) -> Vec<(String, Vec<f64>)> {
    let (_, table) = text.split_once("endheader\n").unwrap();
    let mut lines = table.lines().map(|line| line.split('\t'));
    let mut columns: Vec<(String, Vec<f64>)> =
        lines.next().unwrap().map(|label| (label.to_owned(), Vec::new())).collect();
    for line in lines {
        for (column, cell) in columns.iter_mut().zip(line) {
            column.1.push(cell.parse().unwrap());
        }
    }
    columns
}

#[test]
fn a_mot_file_has_the_coordinates_of_its_model() {
    let animation = moving();
    let (rate_hz, frames) = animation.even().unwrap();
    let whole_body = read_mot(&mot::text(rate_hz, &frames, OpensimModel::Rajagopal));
    let legs = read_mot(&mot::text(rate_hz, &frames, OpensimModel::Gait2392));
    assert_eq!((whole_body.len(), legs.len()), (1 + 6 + 10 + 3 + 14, 1 + 6 + 10 + 3));
    let last = |columns: &[(String, Vec<f64>)], label: &str| {
        *columns.iter().find(|(known, _)| known == label).unwrap().1.last().unwrap()
    };
    let t = 0.98_f64;
    for side in ["r", "l"] {
        for (label, expected_rad) in
            [("hip_flexion", 0.9), ("hip_adduction", 0.4), ("hip_rotation", -0.3), ("knee_angle", 0.9)]
        {
            let found = last(&whole_body, &format!("{label}_{side}"));
            assert!((found - (expected_rad * t).to_degrees()).abs() < 0.2, "{label}_{side} {found}");
        }
        // Knees of the other model bend by negative angles; a palm that faces the thigh is a quarter turn from one that faces ahead.
        let knee = format!("knee_angle_{side}");
        assert!((last(&legs, &knee) + last(&whole_body, &knee)).abs() < 1e-6);
        let pronation = last(&whole_body, &format!("pro_sup_{side}")) - 90.0;
        assert!((pronation - (0.4 * t).to_degrees()).abs() < 0.2, "{pronation}");
        let flexion = last(&whole_body, &format!("wrist_flex_{side}"));
        assert!((flexion - (0.9 * t).to_degrees()).abs() < 0.2, "{flexion}");
    }
    // Forward is a negative extension. Up is y, and ahead is x.
    assert!((last(&whole_body, "lumbar_extension") + (0.9 * t).to_degrees()).abs() < 0.2);
    let height_m = last(&whole_body, "pelvis_ty");
    assert!((height_m - 0.9).abs() < 1e-6 && last(&whole_body, "pelvis_tx") > 0.25, "{height_m}");
}

/// An arm that goes up sideways passes the pose in which two of its angles are one.
#[test]
fn coordinates_do_not_jump_where_an_arm_passes_the_horizontal() {
    let mut animation = Animation::new(Skeleton::from_height(1.8));
    for k in 0..=100 {
        let mut all = [upright(); SEGMENTS];
        for limb in [Limb::ArmR, Limb::ArmL] {
            let [_, arm, forearm] = limb.segments();
            let raised = Vector3::x() * (arm.side() * -0.025 * f64::from(k));
            all[arm.index()] = upright()
                * posed_geometry::so3::exp(&(Vector3::z() * 0.1))
                * posed_geometry::so3::exp(&raised);
            all[forearm.index()] = all[arm.index()];
        }
        all[BodySegment::HandR.index()] = all[BodySegment::ForearmR.index()];
        all[BodySegment::HandL.index()] = all[BodySegment::ForearmL.index()];
        animation.push(0.01 * f64::from(k), all, Vector3::zeros());
    }
    let (rate_hz, frames) = animation.even().unwrap();
    for (label, column) in read_mot(&mot::text(rate_hz, &frames, OpensimModel::Rajagopal)) {
        for (before, after) in column.iter().zip(&column[1..]) {
            assert!((after - before).abs() < 2.0, "{label}: {before} {after}");
        }
    }
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
