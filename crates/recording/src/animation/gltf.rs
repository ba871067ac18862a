//! What binary glTF 2.0 files are made of: numbers in one chunk, a solid, a container.

use nalgebra::{UnitQuaternion, Vector3};
use serde_json::{Value, json};

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

/// Uses of a view, which say where a processor of graphics keeps it: attributes of vertices, and their indices.
const VERTICES: u16 = 34962;
const INDICES: u16 = 34963;

/// The binary chunk as it grows, with its views and accessors.
#[derive(Default)]
pub(super) struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    /// Appends numbers and returns their accessor.
    pub(super) fn floats(&mut self, kind: &str, width: usize, numbers: &[f32]) -> usize {
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

    /// Appends vectors and returns their accessor.
    pub(super) fn vectors(&mut self, vectors: impl Iterator<Item = Vector3<f64>>) -> usize {
        let numbers: Vec<f32> = vectors.flat_map(|v| [v.x, v.y, v.z].map(|part| part as f32)).collect();
        self.floats("VEC3", 3, &numbers)
    }

    /// Appends a vector of each vertex and returns their accessor.
    pub(super) fn vertices(&mut self, vectors: &[Vector3<f64>]) -> usize {
        let accessor = self.vectors(vectors.iter().copied());
        self.used_as(accessor, VERTICES)
    }

    /// Appends the four joints that move each vertex and returns their accessor.
    pub(super) fn joints(&mut self, joints: &[u8]) -> usize {
        let accessor =
            self.append(joints, json!({"componentType": 5121, "count": joints.len() / 4, "type": "VEC4"}));
        self.used_as(accessor, VERTICES)
    }

    /// Appends by how much each of the four does and returns their accessor.
    pub(super) fn weights(&mut self, weights: &[f32]) -> usize {
        let accessor = self.floats("VEC4", 4, weights);
        self.used_as(accessor, VERTICES)
    }

    /// Appends the corners of triangles and returns their accessor.
    pub(super) fn indices(&mut self, indices: &[u16]) -> usize {
        let bytes: Vec<u8> = indices.iter().flat_map(|index| index.to_le_bytes()).collect();
        let accessor =
            self.append(&bytes, json!({"componentType": 5123, "count": indices.len(), "type": "SCALAR"}));
        self.used_as(accessor, INDICES)
    }

    /// Appends matrices that only move, m, and returns their accessor.
    pub(super) fn matrices_of_translations(
        &mut self,
        translations: impl Iterator<Item = Vector3<f64>>,
    ) -> usize {
        let numbers: Vec<f32> = translations
            .flat_map(|m| nalgebra::Matrix4::new_translation(&m).map(|number| number as f32).data.0)
            .flatten()
            .collect();
        self.floats("MAT4", 16, &numbers)
    }

    fn used_as(&mut self, accessor: usize, target: u16) -> usize {
        let view = self.accessors[accessor]["bufferView"].as_u64().unwrap_or(0) as usize;
        self.views[view]["target"] = json!(target);
        accessor
    }

    /// Appends rotations and returns their accessor.
    pub(super) fn rotations(&mut self, rotations: impl Iterator<Item = UnitQuaternion<f64>>) -> usize {
        let mut numbers = Vec::new();
        let mut last: Option<[f64; 4]> = None;
        for q in rotations {
            let mut xyzw = [q.i, q.j, q.k, q.w];
            // Neighbours in one half of the sphere, so that a linear interpolation takes the short way.
            if last.is_some_and(|last| last.iter().zip(xyzw).map(|(a, b)| a * b).sum::<f64>() < 0.0) {
                xyzw = xyzw.map(|part| -part);
            }
            last = Some(xyzw);
            numbers.extend(xyzw.map(|part| part as f32));
        }
        self.floats("VEC4", 4, &numbers)
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

/// An octahedron's primitive: pointed, of length 1 along -y.
pub(super) fn solid(buffer: &mut Buffer) -> Value {
    let corners = buffer.floats("VEC3", 3, CORNERS.as_flattened());
    let faces = buffer.indices(&FACES);
    json!({"attributes": {"POSITION": corners}, "indices": faces})
}

/// What moves which nodes, at times that all share.
pub(super) struct Channels {
    times: usize,
    samplers: Vec<Value>,
    channels: Vec<Value>,
}

impl Channels {
    /// Of an animation whose times, s, are that accessor's.
    pub(super) fn new(times: usize) -> Self {
        Self { times, samplers: Vec::new(), channels: Vec::new() }
    }

    /// Moves a node by the numbers of an accessor: its `rotation` or `translation`.
    pub(super) fn push(&mut self, node: usize, path: &str, output: usize) {
        self.channels.push(json!({"sampler": self.samplers.len(), "target": {"node": node, "path": path}}));
        self.samplers.push(json!({"input": self.times, "output": output, "interpolation": "LINEAR"}));
    }
}

/// What is in a file beside its numbers and its one animation.
pub(super) struct Contents<'a> {
    pub(super) name: &'a str,
    /// Nodes that hang below no other.
    pub(super) roots: Vec<usize>,
    pub(super) nodes: Vec<Value>,
    pub(super) meshes: Vec<Value>,
    pub(super) skins: Vec<Value>,
    pub(super) materials: Vec<Value>,
    /// What says more than the format itself: its name, and what it says.
    pub(super) extension: Option<(&'a str, Value)>,
}

/// The bytes of a file.
pub(super) fn file(contents: Contents<'_>, channels: Channels, buffer: Buffer) -> Vec<u8> {
    let Contents { name, roots, nodes, meshes, skins, materials, extension } = contents;
    let mut document = json!({
        "asset": {"version": "2.0", "generator": concat!("posed ", env!("CARGO_PKG_VERSION"))},
        "scene": 0,
        "scenes": [{"nodes": roots}],
        "nodes": nodes,
        "animations": [{"name": name, "samplers": channels.samplers, "channels": channels.channels}],
        "buffers": [{"byteLength": buffer.bytes.len()}],
        "bufferViews": buffer.views,
        "accessors": buffer.accessors,
    });
    // An empty list is against the format.
    for (list, items) in [("meshes", meshes), ("skins", skins), ("materials", materials)] {
        if !items.is_empty() {
            document[list] = json!(items);
        }
    }
    if let Some((name, says)) = extension {
        document["extensionsUsed"] = json!([name]);
        document["extensions"] = json!({ name: says });
    }
    container(document.to_string().into_bytes(), buffer.bytes)
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
