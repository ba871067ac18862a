//! What is read from a file: points and turns of a body, frame by frame, before they are fitted.

use std::path::{Path, PathBuf};

use nalgebra::{UnitQuaternion, Vector3};

use super::names::{JOINTS, Joint};
use crate::motion_file::{FileError, MotionText};

/// Why a recording of a person was refused.
#[derive(Debug, thiserror::Error)]
pub enum TakeError {
    /// It cannot be read, or makes no sense.
    #[error(transparent)]
    File(#[from] FileError),
    /// A joint is missing that a body cannot be followed without.
    #[error("{path}: no joint for the {joint} was found among {names}")]
    Joint {
        /// Which file.
        path: PathBuf,
        /// Which joint.
        joint: Joint,
        /// What the file calls its joints.
        names: String,
    },
    /// The joints are not those of a person.
    #[error("{path}: {problem}")]
    Figure {
        /// Which file.
        path: PathBuf,
        /// What cannot be.
        problem: String,
    },
}

/// Recorded joints of a person, as they stand in a file: any unit, any axes.
#[derive(Clone, Debug)]
pub struct Recording {
    /// The file.
    pub(super) path: PathBuf,
    /// Which joints it has.
    pub(super) has: [bool; JOINTS],
    /// Spans of time that do not belong together, at least one.
    pub(super) clips: Vec<Clip>,
}

/// One span of frames, in the order of time.
#[derive(Clone, Debug, Default)]
pub(super) struct Clip {
    pub(super) t_s: Vec<f64>,
    pub(super) frames: Vec<Frame>,
}

/// Points and turns at one time, file axes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Frame {
    /// By [`Joint::index`], the file's unit; anything where the recording does not have the joint.
    pub(super) points: [Vector3<f64>; JOINTS],
    /// Axes (forward, up, right, as in the N-pose) of head, right and left hand; `None` where the file tells only points.
    pub(super) turns: Option<[UnitQuaternion<f64>; 3]>,
}

impl Recording {
    /// Reads a file: `.bvh`, or a table `.csv` or `.csv.gz`; `rate_hz`: frames per second of a table without a column of times.
    ///
    /// # Errors
    /// The file cannot be read, or holds no person: see [`TakeError`].
    pub fn read(path: &Path, rate_hz: Option<f64>) -> Result<Self, TakeError> {
        match MotionText::read(path)? {
            MotionText::Bvh(text) => Self::of_bvh(path, &text),
            MotionText::Table(bytes) => Self::of_table(path, &bytes, rate_hz),
        }
    }

    pub(super) fn has(&self, joint: Joint) -> bool {
        self.has[joint.index()]
    }

    pub(super) fn frames(&self) -> impl Iterator<Item = &Frame> {
        self.clips.iter().flat_map(|clip| &clip.frames)
    }

    pub(super) fn frames_mut(&mut self) -> impl Iterator<Item = &mut Frame> {
        self.clips.iter_mut().flat_map(|clip| &mut clip.frames)
    }
}

impl Frame {
    pub(super) fn at(&self, joint: Joint) -> Vector3<f64> {
        self.points[joint.index()]
    }

    /// The mean of several with these weights, whose sum is 1; there is at least one.
    pub(super) fn mean(frames: &[(f64, &Self)]) -> Self {
        let mut points = [Vector3::zeros(); JOINTS];
        for (weight, frame) in frames {
            points.iter_mut().zip(&frame.points).for_each(|(sum, point)| *sum += point * *weight);
        }
        let turns = frames.first().and_then(|(_, first)| first.turns).map(|first| {
            std::array::from_fn(|index| {
                let mut sum = nalgebra::Quaternion::new(0.0, 0.0, 0.0, 0.0);
                for (weight, frame) in frames {
                    let turn = frame.turns.map_or(first[index], |turns| turns[index]).into_inner();
                    // A rotation is two quaternions.
                    sum += turn * if turn.dot(&first[index]) < 0.0 { -weight } else { *weight };
                }
                UnitQuaternion::new_normalize(sum)
            })
        });
        Self { points, turns }
    }

    /// Between the right and the left one.
    pub(super) fn middle(&self, of: fn(usize) -> Joint) -> Vector3<f64> {
        0.5 * (self.at(of(0)) + self.at(of(1)))
    }

    /// From the left one to the right one.
    pub(super) fn across(&self, of: fn(usize) -> Joint) -> Vector3<f64> {
        self.at(of(0)) - self.at(of(1))
    }
}

/// Which of several joints of the spine is taken: the first that lies well above the hips.
pub(super) fn spine(
    candidates: &[usize],
    at: impl Fn(usize) -> Vector3<f64>,
    hips: Vector3<f64>,
    trunk: f64,
) -> Option<usize> {
    candidates.iter().copied().find(|candidate| (at(*candidate) - hips).norm() > 0.15 * trunk)
}
