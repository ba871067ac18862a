//! Binary glTF 2.0: a node per segment with a small solid to look at, and one animation of their rotations.

use nalgebra::Vector3;
use serde_json::{Value, json};

use super::{Frame, children, end_m, offset_m};
use posed_fusion::body::{BodySegment, SEGMENTS, Skeleton};

/// Width of a segment's solid, m.
const WIDTH_M: f64 = 0.05;
/// An octahedron of length 1 along -y, its waist at a fifth.
const CORNERS: [[f32; 3]; 6] = [
    [0.0, 0.0, 0.0],
    [0.5, -0.2, 0.0],
    [0.0, -0.2, 0.5],
    [-0.5, -0.2, 0.0],
    [0.0, -0.2, -0.5],
    [0.0, -1.0, 0.0],
];
const FACES: [u16; 24] = [0, 2, 1, 0, 3, 2, 0, 4, 3, 0, 1, 4, 5, 1, 2, 5, 2, 3, 5, 3, 4, 5, 4, 1];

/// The binary chunk as it grows, with its views and accessors.
#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    /// Appends numbers and returns their accessor.
    fn floats(&mut self, kind: &str, width: usize, numbers: &[f32]) -> usize {
        let bounds = |pick: fn(f32, f32) -> f32| -> Vec<f32> {
            let column =
                |i: usize| numbers.iter().skip(i).step_by(width).copied().reduce(pick).unwrap_or(0.0);
            (0..width).map(column).collect()
        };
        let (min, max) = (bounds(f32::min), bounds(f32::max));
        let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        let accessor = json!({
            "componentType": 5126, "count": numbers.len() / width, "type": kind, "min": min, "max": max
        });
        self.append(&bytes, accessor)
    }

    fn append(&mut self, bytes: &[u8], mut accessor: Value) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(json!({
            "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len()
        }));
        self.bytes.extend_from_slice(bytes);
        accessor["bufferView"] = json!(self.views.len() - 1);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }
}

pub(super) fn bytes(skeleton: &Skeleton, frames: &[Frame]) -> Vec<u8> {
    let mut buffer = Buffer::default();
    let corners = buffer.floats("VEC3", 3, CORNERS.as_flattened());
    let faces: Vec<u8> = FACES.iter().flat_map(|index| index.to_le_bytes()).collect();
    let faces = buffer.append(&faces, json!({"componentType": 5123, "count": FACES.len(), "type": "SCALAR"}));
    let begin_s = frames.first().map_or(0.0, |frame| frame.t_s);
    let times: Vec<f32> = frames.iter().map(|frame| (frame.t_s - begin_s) as f32).collect();
    let times = buffer.floats("SCALAR", 1, &times);

    let (mut samplers, mut channels) = (Vec::new(), Vec::new());
    let mut channel = |node: usize, path: &str, output: usize| {
        channels.push(json!({"sampler": samplers.len(), "target": {"node": node, "path": path}}));
        samplers.push(json!({"input": times, "output": output, "interpolation": "LINEAR"}));
    };
    for segment in BodySegment::ALL {
        let index = segment.index();
        let mut numbers = Vec::with_capacity(4 * frames.len());
        let mut last: Option<[f64; 4]> = None;
        for frame in frames {
            let own = frame.orientations[index];
            let q = segment.parent().map_or(own, |parent| frame.orientations[parent.index()].inverse() * own);
            let mut xyzw = [q.i, q.j, q.k, q.w];
            // Neighbours in one half of the sphere, so that a linear interpolation takes the short way.
            if last.is_some_and(|last| last.iter().zip(xyzw).map(|(a, b)| a * b).sum::<f64>() < 0.0) {
                xyzw = xyzw.map(|part| -part);
            }
            last = Some(xyzw);
            numbers.extend(xyzw.map(|part| part as f32));
        }
        let output = buffer.floats("VEC4", 4, &numbers);
        channel(index, "rotation", output);
    }
    let translations: Vec<f32> = frames
        .iter()
        .flat_map(|frame| [frame.pelvis_m.x, frame.pelvis_m.y, frame.pelvis_m.z])
        .map(|v| v as f32)
        .collect();
    let output = buffer.floats("VEC3", 3, &translations);
    channel(BodySegment::Pelvis.index(), "translation", output);

    let document = json!({
        "asset": {"version": "2.0", "generator": concat!("posed ", env!("CARGO_PKG_VERSION"))},
        "scene": 0,
        "scenes": [{"nodes": [BodySegment::Pelvis.index()]}],
        "nodes": nodes(skeleton),
        "meshes": [{"primitives": [{"attributes": {"POSITION": corners}, "indices": faces}]}],
        "animations": [{"name": "body", "samplers": samplers, "channels": channels}],
        "buffers": [{"byteLength": buffer.bytes.len()}],
        "bufferViews": buffer.views,
        "accessors": buffer.accessors,
    });
    container(document.to_string().into_bytes(), buffer.bytes)
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

/// Header, JSON chunk, binary chunk, each padded to four bytes.
fn container(mut json: Vec<u8>, mut binary: Vec<u8>) -> Vec<u8> {
    json.resize(json.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let total = 12 + 8 + json.len() + 8 + binary.len();
    let mut out = Vec::with_capacity(total);
    out.extend_from_slice(b"glTF");
    for number in [2, total as u32, json.len() as u32] {
        out.extend_from_slice(&number.to_le_bytes());
    }
    out.extend_from_slice(b"JSON");
    out.extend_from_slice(&json);
    out.extend_from_slice(&(binary.len() as u32).to_le_bytes());
    out.extend_from_slice(b"BIN\0");
    out.extend_from_slice(&binary);
    out
}
