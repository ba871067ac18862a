//! What a live chain needs to know, from a recorded movement.
//!
//! In: a posture at rest that counts as zero, then a movement of all hinges. Out: how each sensor sits, each hinge's axis, and how
//! well it is known. The offline solution of the module above does the work.

use super::live::{CalibratedHinge, CalibratedSegment, ChainCalibration};
use super::quality::UNKNOWN_DEG;
use super::{ChainError, ChainPose, ChainSegment, Epoch, solve};
use posed_geometry::{orientation_to_wxyz, wrapped_rad};

/// Finds how the sensors of a chain sit and where its hinges are, offline: by [`solve`], whose
/// [`quality_deg`](super::Solved::quality_deg) says how well.
///
/// # Errors
/// As [`solve`]: a joint whose axis the movement does not show, or times that do not rise.
///
/// # Panics
/// As [`solve`].
pub fn calibrate(segments: &[ChainSegment], epochs: &[Epoch]) -> Result<ChainCalibration, ChainError> {
    let whole = solve(segments, epochs)?;
    let found = segments.iter().enumerate().map(|(at, segment)| {
        let mount = whole.mounts[at];
        let hinge = segment.hinge.as_ref().zip(whole.axes[at]).map(|((parent, _), axes)| {
            let axis = mount.inverse() * axes.second;
            let twist = |pose: &ChainPose| {
                let relative = pose.orientations[*parent].inverse() * pose.orientations[at];
                2.0 * libm::atan2(relative.imag().dot(&axis), relative.w)
            };
            let zero_rad =
                whole.poses.first().map_or(0.0, |pose| wrapped_rad(twist(pose) - pose.flexion_rad[at]));
            CalibratedHinge {
                parent_axis: axes.first.into(),
                axis: axes.second.into(),
                zero_rad,
                quality_deg: whole.quality_deg[at].unwrap_or(UNKNOWN_DEG),
            }
        });
        CalibratedSegment { name: segment.name.clone(), quat_wxyz: orientation_to_wxyz(&mount), hinge }
    });
    Ok(ChainCalibration { segments: found.collect() })
}
