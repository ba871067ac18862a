//! What a live chain needs to know, from a recorded movement.
//!
//! In: a posture at rest that counts as zero, then a movement of all hinges. Out: how each sensor sits, each hinge's axis, and how
//! far the two halves of the movement disagree about it. The offline solution of the module above does the work.

use super::live::{CalibratedHinge, CalibratedSegment, ChainCalibration};
use super::{ChainError, ChainSegment, Epoch, HingeAxes, solve};
use crate::geometry::{orientation_to_wxyz, wrapped_rad};

/// What two halves say that do not agree at all, or of which one shows no axis, degrees.
const UNKNOWN_DEG: f64 = 90.0;

/// Finds out how a chain is worn.
///
/// # Errors
/// A joint whose axis the movement does not show, or times that do not rise.
pub fn calibrate(segments: &[ChainSegment], epochs: &[Epoch]) -> Result<ChainCalibration, ChainError> {
    let whole = solve(segments, epochs)?;
    let (early, late) = epochs.split_at(epochs.len() / 2);
    let halves = [solve(segments, early), solve(segments, late)];
    let quality_deg = |at: usize| match &halves {
        [Ok(early), Ok(late)] => {
            early.axes[at].zip(late.axes[at]).map_or(UNKNOWN_DEG, |(a, b)| apart_deg(&a, &b))
        }
        _ => UNKNOWN_DEG,
    };
    let found = segments.iter().enumerate().map(|(at, segment)| {
        let mount = whole.mounts[at];
        let hinge = segment.hinge.as_ref().zip(whole.axes[at]).map(|((parent, _), axes)| {
            let axis = mount.inverse() * axes.second;
            let twist = |pose: &super::ChainPose| {
                let relative = pose.orientations[*parent].inverse() * pose.orientations[at];
                2.0 * relative.imag().dot(&axis).atan2(relative.w)
            };
            let zero_rad =
                whole.poses.first().map_or(0.0, |pose| wrapped_rad(twist(pose) - pose.flexion_rad[at]));
            CalibratedHinge {
                parent_axis: axes.first.into(),
                axis: axes.second.into(),
                zero_rad,
                quality_deg: quality_deg(at),
            }
        });
        CalibratedSegment { name: segment.name.clone(), quat_wxyz: orientation_to_wxyz(&mount), hinge }
    });
    Ok(ChainCalibration { segments: found.collect() })
}

/// How far the same axis of both halves lies apart, degrees, in the sensor where that is more; half of it is what the whole is
/// off by, or less.
fn apart_deg(a: &HingeAxes, b: &HingeAxes) -> f64 {
    let sign = a.first.dot(&b.first).signum();
    let apart = (a.first * sign).angle(&b.first).max((a.second * sign).angle(&b.second));
    (0.5 * apart.to_degrees()).min(UNKNOWN_DEG)
}
