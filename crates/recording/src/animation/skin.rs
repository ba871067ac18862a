//! A figure to look at: a rounded solid along each bone, skinned to it, so that joints bend without gaps.
//!
//! In: bones in their rest pose. Out: points, normals, triangles, and the bones that move each point. It is of our own making and looks like nobody.

use nalgebra::Vector3;
use serde_json::{Value, json};

use super::gltf::Buffer;
use super::humanoid::{Bone, below, joints_m};
use posed_fusion::body::{Skeleton, WholeSegment as W};

/// Points around a solid, and rings along each of its round ends and between them.
const AROUND: usize = 14;
const RINGS: usize = 4;
/// A round end reaches beyond its point by no more than this, of the solid's length; the head's solid ends so much below its top.
const ROUND: f64 = 0.7;
const BELOW_TOP: f64 = 0.4;
/// A solid's first part, of its length, bends with the bone above, too.
const BENDS: f64 = 0.25;

/// Of a person of 1 m: half the breadth and half the depth at both ends of the solid along a bone.
fn girth(segment: W) -> [[f64; 2]; 2] {
    match segment {
        W::Pelvis => [[0.088, 0.06], [0.08, 0.056]],
        W::L5 | W::L3 => [[0.078, 0.054], [0.076, 0.052]],
        W::T12 => [[0.08, 0.054], [0.09, 0.06]],
        W::T8 => [[0.095, 0.062], [0.05, 0.045]],
        W::Neck => [[0.03, 0.03], [0.028, 0.03]],
        W::Head => [[0.042, 0.052], [0.044, 0.052]],
        W::ShoulderR | W::ShoulderL => [[0.035, 0.035], [0.034, 0.032]],
        W::UpperArmR | W::UpperArmL => [[0.028, 0.03], [0.022, 0.023]],
        W::ForearmR | W::ForearmL => [[0.022, 0.023], [0.014, 0.017]],
        W::HandR | W::HandL => [[0.011, 0.022], [0.007, 0.016]],
        W::UpperLegR | W::UpperLegL => [[0.046, 0.048], [0.032, 0.034]],
        W::LowerLegR | W::LowerLegL => [[0.03, 0.034], [0.019, 0.021]],
        W::FootR | W::FootL => [[0.022, 0.018], [0.026, 0.011]],
        W::ToeR | W::ToeL => [[0.025, 0.009], [0.02, 0.007]],
    }
}

/// Points with what moves them.
#[derive(Default)]
pub(super) struct Skin {
    /// Every bone's joint, m.
    pub(super) joints_m: Vec<Vector3<f64>>,
    points_m: Vec<Vector3<f64>>,
    normals: Vec<Vector3<f64>>,
    /// Of each point: the bone, the one above it, and the share of the latter.
    moved_by: Vec<(usize, usize, f64)>,
    triangles: Vec<[usize; 3]>,
}

impl Skin {
    /// The figure in the rest pose.
    pub(super) fn of(skeleton: &Skeleton, bones: &[Bone]) -> Self {
        let mut skin = Self { joints_m: joints_m(bones), ..Self::default() };
        let height_m = bones[0].offset_m.y + skeleton.trunk_m + skeleton.head_m;
        for (at, bone) in bones.iter().enumerate() {
            // The middle one of several.
            let below = below(bones, at).find(|child| bones[*child].segment.side() == bone.segment.side());
            let from_m = skin.joints_m[at];
            let to_m = match (bone.end_m, below) {
                (Some(end_m), _) if bone.segment == W::Head => from_m + end_m * (1.0 - BELOW_TOP),
                (Some(end_m), _) => from_m + end_m,
                (None, Some(below)) => skin.joints_m[below],
                (None, None) => continue,
            };
            // A foot reaches back to its heel, along the floor.
            let from_m = match bone.segment {
                W::FootR | W::FootL => {
                    Vector3::new(from_m.x, to_m.y.max(0.6 * from_m.y), from_m.z - 0.025 * height_m)
                }
                _ => from_m,
            };
            skin.solid(
                at,
                bone.parent.unwrap_or(at),
                from_m,
                to_m,
                girth(bone.segment).map(|half| half.map(|m| m * height_m)),
            );
        }
        skin
    }

    /// A rounded solid between two points, m: an ellipse at each end, closed by halves of ellipsoids that reach beyond by little.
    fn solid(
        &mut self,
        bone: usize,
        above: usize,
        from_m: Vector3<f64>,
        to_m: Vector3<f64>,
        halves_m: [[f64; 2]; 2],
    ) {
        let length_m = (to_m - from_m).norm();
        let along = (to_m - from_m) / length_m;
        // Breadth is sideways, of arms upwards; depth is what is left.
        let sideways = if along.x.abs() > 0.7 { Vector3::y() } else { Vector3::x() };
        let depth = along.cross(&sideways).normalize();
        let breadth = depth.cross(&along);
        let begin = self.points_m.len();
        let rings = 2 * RINGS + RINGS;
        for ring in 0..=rings {
            // Where along the solid, how wide, and how far the normal points along.
            let (place_m, width, slant) = if ring <= RINGS {
                let angle = std::f64::consts::FRAC_PI_2 * (1.0 - ring as f64 / RINGS as f64);
                let (s, c) = libm::sincos(angle);
                (-s * halves_m[0][1].min(ROUND * length_m), c, -s)
            } else if ring < 2 * RINGS {
                (length_m * (ring - RINGS) as f64 / RINGS as f64, 1.0, 0.0)
            } else {
                let angle = std::f64::consts::FRAC_PI_2 * (ring - 2 * RINGS) as f64 / RINGS as f64;
                let (s, c) = libm::sincos(angle);
                (length_m + s * halves_m[1][1].min(ROUND * length_m), c, s)
            };
            let t = (place_m / length_m).clamp(0.0, 1.0);
            let half = |k: usize| width * (halves_m[0][k] + t * (halves_m[1][k] - halves_m[0][k]));
            let (wide_m, deep_m) = (half(0), half(1));
            for point in 0..AROUND {
                let (s, c) = libm::sincos(std::f64::consts::TAU * point as f64 / AROUND as f64);
                self.points_m.push(from_m + along * place_m + breadth * (wide_m * c) + depth * (deep_m * s));
                let around = breadth * (c * deep_m.max(1e-6)) + depth * (s * wide_m.max(1e-6));
                let level = (1.0 - slant * slant).max(0.0).sqrt();
                let normal = around.normalize() * level + along * slant;
                self.normals.push(normal.try_normalize(1e-9).unwrap_or(along));
                self.moved_by.push((bone, above, 0.5 * (1.0 - t / BENDS).max(0.0)));
            }
        }
        for ring in 0..rings {
            for point in 0..AROUND {
                let next = (point + 1) % AROUND;
                let at = |ring: usize, point: usize| begin + ring * AROUND + point;
                let [a, b, c, d] = [at(ring, point), at(ring, next), at(ring + 1, point), at(ring + 1, next)];
                self.triangles.extend([[a, b, c], [b, d, c]]);
            }
        }
    }

    /// The primitive of a mesh.
    pub(super) fn primitive(&self, buffer: &mut Buffer) -> Value {
        let positions = buffer.vertices(&self.points_m);
        let normals = buffer.vertices(&self.normals);
        let joints: Vec<u8> = self
            .moved_by
            .iter()
            // A bone that does not move a point must not be named twice.
            .flat_map(|(bone, above, share)| [*bone as u8, if *share > 0.0 { *above as u8 } else { 0 }, 0, 0])
            .collect();
        let weights: Vec<f32> = self
            .moved_by
            .iter()
            .flat_map(|(bone, above, share)| {
                let share = if bone == above { 0.0 } else { *share as f32 };
                [1.0 - share, share, 0.0, 0.0]
            })
            .collect();
        let (joints, weights) = (buffer.joints(&joints), buffer.weights(&weights));
        let indices: Vec<u16> = self.triangles.as_flattened().iter().map(|index| *index as u16).collect();
        let indices = buffer.indices(&indices);
        json!({
            "attributes": {"POSITION": positions, "NORMAL": normals, "JOINTS_0": joints, "WEIGHTS_0": weights},
            "indices": indices, "material": 0
        })
    }
}
