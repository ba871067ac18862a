//! A body's movement as files that other programs open: BVH, TRC, C3D, STO, glTF with VRM, and USD.
//!
//! In: a skeleton, and segment orientations over time (room, z up). Out: files with y up. Those for animation hold the 23 segments of
//! [`posed_fusion::body::WholeSegment`] at rest in a T-pose and look along +z; TRC holds points in the axes of a body that looks along the room's x: x forward,
//! y up, z right, as ISB and OpenSim have it. It never leaves a half-written file behind, and never invents frames but to make them equally spaced.

mod bvh;
mod c3d;
mod glb;
mod gltf;
mod humanoid;
mod items;
mod markers;
mod mot;
mod skin;
mod sto;
#[cfg(test)]
mod tests;
mod trc;
mod usd;

use std::path::Path;

use nalgebra::{UnitQuaternion, Vector3};
use thiserror::Error;

pub use bvh::BoneNames;
pub use items::{Item, Line, write_items};
pub use mot::OpensimModel;

use crate::atomic_file::AtomicFile;
use posed_fusion::body::{SEGMENTS, Skeleton};

/// Kinds of files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Biovision hierarchy: Blender and most animation programs, by the names and in the unit of one of them; degrees, Z then X then Y. But for
    /// [`BoneNames::Posed`] the first frame is the T-pose.
    Bvh(BoneNames),
    /// Track row column: joint centres as markers, m, for OpenSim.
    Trc,
    /// Binary glTF: an animated, skinned figure for browsers, m; its time begins with 0.
    Glb,
    /// The same with the bones of VRM 1.0.
    Vrm,
    /// The movement of VRM 1.0, for any such model.
    Vrma,
    /// C3D for motion laboratories: the same markers and the rotations of 23 segments; mm, z up.
    C3d,
    /// Orientations of segments for OpenSim's OpenSense, a quaternion for each body.
    Sto,
    /// Coordinates of the joints of one of OpenSim's models.
    Mot(OpensimModel),
    /// USD as text, with a skeleton of UsdSkel and its animation, m.
    Usda,
}

impl Format {
    /// By the end of a file's name, in letters of either case; `None` for any other end.
    pub fn of(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "bvh" => Some(Self::Bvh(BoneNames::Posed)),
            "trc" => Some(Self::Trc),
            "glb" => Some(Self::Glb),
            "vrm" => Some(Self::Vrm),
            "vrma" => Some(Self::Vrma),
            "usda" => Some(Self::Usda),
            "c3d" => Some(Self::C3d),
            "sto" => Some(Self::Sto),
            "mot" => Some(Self::Mot(OpensimModel::Rajagopal)),
            _ => None,
        }
    }
}

/// Why an animation cannot be written.
#[derive(Debug, Error)]
pub enum AnimationError {
    /// Fewer than two frames.
    #[error("an animation takes two frames at least, and there are {0}")]
    TooShort(usize),
    /// The file cannot be written.
    #[error("cannot write {file}: {source}")]
    Io {
        /// Which file.
        file: String,
        /// Why.
        source: std::io::Error,
    },
}

/// One time of a body, room axes (z up).
#[derive(Clone, Copy, Debug, PartialEq)]
struct Frame {
    t_s: f64,
    orientations: [UnitQuaternion<f64>; SEGMENTS],
    pelvis_m: Vector3<f64>,
}

/// A body's movement.
#[derive(Clone, Debug, PartialEq)]
pub struct Animation {
    skeleton: Skeleton,
    frames: Vec<Frame>,
}

impl Animation {
    /// An animation of this skeleton without a frame.
    pub fn new(skeleton: Skeleton) -> Self {
        Self { skeleton, frames: Vec::new() }
    }

    /// Its skeleton is this one, as it is known at the end.
    pub fn resize(&mut self, skeleton: Skeleton) {
        self.skeleton = skeleton;
    }

    /// Appends a frame: its time, s; the orientations, segment to room, by [`posed_fusion::body::BodySegment::index`]; the hips' mid-point in the
    /// room, m. A frame whose time does not rise is left out.
    pub fn push(&mut self, t_s: f64, orientations: [UnitQuaternion<f64>; SEGMENTS], pelvis_m: Vector3<f64>) {
        if self.frames.last().is_none_or(|last| t_s > last.t_s) {
            self.frames.push(Frame { t_s, orientations, pelvis_m });
        }
    }

    /// Writes the file, whole or not at all. Frames are brought to equal distances at their mean rate, as many as there are;
    /// between two frames segments turn the shortest way.
    ///
    /// # Errors
    /// Fewer than two frames, or a file that cannot be written.
    pub fn write(&self, path: &Path, format: Format) -> Result<(), AnimationError> {
        let (rate_hz, frames) = self.even()?;
        let bytes = match format {
            Format::Bvh(names) => bvh::text(&self.skeleton, rate_hz, &frames, names).into_bytes(),
            Format::Trc => trc::text(&self.skeleton, rate_hz, &frames, path).into_bytes(),
            Format::Glb => glb::bytes(&self.skeleton, &frames, glb::Kind::Glb),
            Format::Vrm => glb::bytes(&self.skeleton, &frames, glb::Kind::Vrm),
            Format::Vrma => glb::bytes(&self.skeleton, &frames, glb::Kind::Vrma),
            Format::C3d => c3d::bytes(&self.skeleton, rate_hz, &frames),
            Format::Sto => sto::text(rate_hz, &frames).into_bytes(),
            Format::Mot(model) => mot::text(rate_hz, &frames, model).into_bytes(),
            Format::Usda => usd::text(&self.skeleton, rate_hz, &frames).into_bytes(),
        };
        let failed = |source| AnimationError::Io { file: path.display().to_string(), source };
        AtomicFile::replace(path, &bytes).map_err(failed)
    }

    /// Equally spaced frames at the mean rate: the formats know no other. Between two frames segments turn the
    /// shortest way.
    fn even(&self) -> Result<(f64, Vec<Frame>), AnimationError> {
        let [first, .., last] = self.frames.as_slice() else {
            return Err(AnimationError::TooShort(self.frames.len()));
        };
        let steps = self.frames.len() - 1;
        let span_s = last.t_s - first.t_s;
        let mut at = 0;
        let frames = (0..=steps)
            .map(|k| {
                let t_s = first.t_s + span_s * k as f64 / steps as f64;
                while at + 2 < self.frames.len() && self.frames[at + 1].t_s <= t_s {
                    at += 1;
                }
                between(&self.frames[at], &self.frames[at + 1], t_s)
            })
            .collect();
        Ok((steps as f64 / span_s, frames))
    }
}

fn between(a: &Frame, b: &Frame, t_s: f64) -> Frame {
    let part = ((t_s - a.t_s) / (b.t_s - a.t_s)).clamp(0.0, 1.0);
    let orientation = |i: usize| {
        let step = posed_geometry::so3::log(&(a.orientations[i].inverse() * b.orientations[i]));
        a.orientations[i] * posed_geometry::so3::exp(&(step * part))
    };
    Frame {
        t_s,
        orientations: std::array::from_fn(orientation),
        pelvis_m: a.pelvis_m.lerp(&b.pelvis_m, part),
    }
}
