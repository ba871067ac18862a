//! Rigid items that move, and lines beside them, as binary glTF: a sensor, its path, the screws between its key poses.

use std::io::Write;
use std::path::Path;

use nalgebra::{Isometry3, Vector3};
use serde_json::{Value, json};

use super::AnimationError;
use super::gltf::{Buffer, Channels, Contents, file, solid};
use crate::atomic_file::AtomicFile;
use posed_fusion::body::upright;

/// The items' length as a share of the space that they move through, and what of it they are wide.
const LENGTH: f64 = 0.12;
const WIDTH: f64 = 0.5;
/// Length of items that stay where they are, m.
const LEAST_M: f64 = 0.01;
/// glTF's way of drawing a line through points.
const LINE_STRIP: u32 = 3;

/// An item that moves.
#[derive(Clone, Debug)]
pub struct Item {
    /// What it is called.
    pub name: String,
    /// Red, green and blue, 0 to 1.
    pub colour: [f32; 3],
    /// Its pose at each of the times: item to room (z up), m.
    pub poses: Vec<Isometry3<f64>>,
}

/// A line that stays.
#[derive(Clone, Debug)]
pub struct Line {
    /// What it is called.
    pub name: String,
    /// Red, green and blue, 0 to 1.
    pub colour: [f32; 3],
    /// Its points, room, m.
    pub points_m: Vec<Vector3<f64>>,
}

/// Writes items at `times_s` (s, rising; the file begins with 0) with their paths, and lines, whole or not at all: y up, m. Each item is a small
/// solid that points along its own -y axis.
///
/// # Errors
/// Fewer than two times, or a file that cannot be written.
pub fn write_items(
    path: &Path,
    times_s: &[f64],
    items: &[Item],
    lines: &[Line],
) -> Result<(), AnimationError> {
    if times_s.len() < 2 {
        return Err(AnimationError::TooShort(times_s.len()));
    }
    let bytes = bytes(times_s, items, lines);
    let failed = |source| AnimationError::Io { file: path.display().to_string(), source };
    let mut file = AtomicFile::create(path).map_err(failed)?;
    file.write_all(&bytes).map_err(failed)?;
    file.commit().map_err(failed)
}

fn bytes(times_s: &[f64], items: &[Item], lines: &[Line]) -> Vec<u8> {
    let up = upright().inverse();
    let mut buffer = Buffer::default();
    let solid = solid(&mut buffer);
    let times: Vec<f32> = times_s.iter().map(|t_s| (t_s - times_s[0]) as f32).collect();
    let times = buffer.floats("SCALAR", 1, &times);
    let length_m = length_m(items);
    let (mut nodes, mut meshes, mut materials) = (Vec::new(), Vec::new(), Vec::new());
    let mut channels = Channels::new(times);
    for item in items {
        let colour = material(&mut materials, item.colour);
        let mut primitive = solid.clone();
        primitive["material"] = json!(colour);
        meshes.push(json!({"primitives": [primitive]}));
        let node = nodes.len();
        nodes.push(json!({
            "name": item.name, "mesh": meshes.len() - 1,
            "scale": [WIDTH * length_m, length_m, WIDTH * length_m]
        }));
        let turned = item.poses.iter().map(|pose| up * pose.rotation);
        let moved = item.poses.iter().map(|pose| up * pose.translation.vector);
        let output = buffer.rotations(turned);
        channels.push(node, "rotation", output);
        let output = buffer.vectors(moved.clone());
        channels.push(node, "translation", output);
        let way = format!("{} path", item.name);
        line(&mut buffer, &mut nodes, &mut meshes, &way, colour, moved);
    }
    for each in lines.iter().filter(|line| line.points_m.len() > 1) {
        let colour = material(&mut materials, each.colour);
        let points = each.points_m.iter().map(|p| up * p);
        line(&mut buffer, &mut nodes, &mut meshes, &each.name, colour, points);
    }
    let roots = (0..nodes.len()).collect();
    file(
        Contents { name: "motion", roots, nodes, meshes, skins: Vec::new(), materials, extension: None },
        channels,
        buffer,
    )
}

/// Adds a node with a line through points.
fn line(
    buffer: &mut Buffer,
    nodes: &mut Vec<Value>,
    meshes: &mut Vec<Value>,
    name: &str,
    material: usize,
    points: impl Iterator<Item = Vector3<f64>>,
) {
    let points = buffer.vectors(points);
    let primitive = json!({"attributes": {"POSITION": points}, "mode": LINE_STRIP, "material": material});
    meshes.push(json!({"primitives": [primitive]}));
    nodes.push(json!({"name": name, "mesh": meshes.len() - 1}));
}

/// Adds a colour that needs no light; lines have none.
fn material(materials: &mut Vec<Value>, [r, g, b]: [f32; 3]) -> usize {
    let factor = json!({"baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0});
    materials.push(json!({"pbrMetallicRoughness": factor, "emissiveFactor": [0.3 * r, 0.3 * g, 0.3 * b]}));
    materials.len() - 1
}

/// Items as long as a share of the box that they move through.
fn length_m(items: &[Item]) -> f64 {
    let places = || items.iter().flat_map(|item| &item.poses).map(|pose| pose.translation.vector);
    let low = places().reduce(|a, b| a.inf(&b)).unwrap_or_default();
    let high = places().reduce(|a, b| a.sup(&b)).unwrap_or_default();
    (LENGTH * (high - low).max()).max(LEAST_M)
}
