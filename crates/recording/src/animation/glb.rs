//! Binary glTF 2.0: a node per segment with a small solid to look at, and one animation of their rotations.

use nalgebra::Vector3;
use serde_json::{Value, json};

use super::gltf::{Buffer, Channels, Contents, file, solid};
use super::{Frame, children, end_m, offset_m};
use posed_fusion::body::{BodySegment, SEGMENTS, Skeleton};

/// Width of a segment's solid, m.
const WIDTH_M: f64 = 0.05;

pub(super) fn bytes(skeleton: &Skeleton, frames: &[Frame]) -> Vec<u8> {
    let mut buffer = Buffer::default();
    let solid = solid(&mut buffer);
    let begin_s = frames.first().map_or(0.0, |frame| frame.t_s);
    let times: Vec<f32> = frames.iter().map(|frame| (frame.t_s - begin_s) as f32).collect();
    let times = buffer.floats("SCALAR", 1, &times);

    let mut channels = Channels::new(times);
    for segment in BodySegment::ALL {
        let index = segment.index();
        let own = frames.iter().map(|frame| {
            let own = frame.orientations[index];
            segment.parent().map_or(own, |parent| frame.orientations[parent.index()].inverse() * own)
        });
        let output = buffer.rotations(own);
        channels.push(index, "rotation", output);
    }
    let output = buffer.vectors(frames.iter().map(|frame| frame.pelvis_m));
    channels.push(BodySegment::Pelvis.index(), "translation", output);
    let contents = Contents {
        name: "body",
        roots: vec![BodySegment::Pelvis.index()],
        nodes: nodes(skeleton),
        meshes: vec![json!({"primitives": [solid]})],
        materials: Vec::new(),
    };
    file(contents, channels, buffer)
}

/// Segments first, by their index, then a solid for each.
fn nodes(skeleton: &Skeleton) -> Vec<Value> {
    let vector = |v: Vector3<f64>| json!([v.x, v.y, v.z]);
    let mut nodes = Vec::new();
    for segment in BodySegment::ALL {
        let mut below: Vec<usize> = children(segment).map(BodySegment::index).collect();
        below.push(SEGMENTS + segment.index());
        nodes.push(json!({
            "name": segment.name(), "translation": vector(offset_m(skeleton, segment)), "children": below
        }));
    }
    for segment in BodySegment::ALL {
        let end = end_m(skeleton, segment);
        // Upwards for the trunk, a short stump for the hips.
        let length = if end.y == 0.0 { 2.0 * WIDTH_M } else { -end.y };
        nodes.push(json!({
            "name": format!("{}_solid", segment.name()), "mesh": 0, "scale": [WIDTH_M, length, WIDTH_M]
        }));
    }
    nodes
}
