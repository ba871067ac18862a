//! What a live chain needs to know, from a recorded movement.
//!
//! In: a posture at rest that counts as zero, then a movement of all hinges. Out: how each sensor sits, each hinge's axis, and how
//! far the two halves of the movement disagree about it. The offline solution of the module above does the work.

use nalgebra::{Matrix3, Vector3};

use super::live::{CalibratedHinge, CalibratedSegment, ChainCalibration};
use super::{ChainError, ChainPose, ChainSegment, Epoch, HingeAxes, Solved};
use super::{level_orientations, refined_axes, solve, steps_s};
use posed_geometry::{orientation_to_wxyz, wrapped_rad};

/// What a movement does not show at all, degrees.
const UNKNOWN_DEG: f64 = 90.0;
/// The axis' height in the room, squared, has to differ so much less between its two sensors than between one and the opposite of
/// the other: an axis that stays level throughout may point either way.
const CLEAR: f64 = 0.1;

/// Angular velocities about a second axis are at least this part of those about the first (standard deviations), in both
/// sensors: where both turn about the hinge alone, and in step, axes that are wrong together explain the movement as well.
const SECOND: f64 = 0.1;

/// Finds how the sensors of a chain sit and where its hinges are, offline: [`solve`] over the whole and over both halves,
/// half of whose difference is [`CalibratedHinge::quality_deg`]; 90 where the axis is ambiguous (`docs/methods/chain.md`).
///
/// # Errors
/// As [`solve`]: a joint whose axis the movement does not show, or times that do not rise.
///
/// # Panics
/// As [`solve`].
pub fn calibrate(segments: &[ChainSegment], epochs: &[Epoch]) -> Result<ChainCalibration, ChainError> {
    let whole = solve(segments, epochs)?;
    let (early, late) = epochs.split_at(epochs.len() / 2);
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
            let halves = [early, late].map(|half| axes_in(half, &axes, *parent, at));
            let shown = points_clearly(&whole, &axes, *parent, at)
                && [*parent, at].into_iter().all(|index| rotates_about_two(epochs, index));
            let quality_deg = if shown { apart_deg(&halves) } else { UNKNOWN_DEG };
            CalibratedHinge {
                parent_axis: axes.first.into(),
                axis: axes.second.into(),
                zero_rad,
                quality_deg,
            }
        });
        CalibratedSegment { name: segment.name.clone(), quat_wxyz: orientation_to_wxyz(&mount), hinge }
    });
    Ok(ChainCalibration { segments: found.collect() })
}

/// The axes by a part of the movement alone, in both sensors.
fn axes_in(epochs: &[Epoch], axes: &HingeAxes, parent: usize, at: usize) -> [Vector3<f64>; 2] {
    let steps_s = steps_s(epochs);
    let [before, behind] = [parent, at].map(|index| level_orientations(epochs, &steps_s, index));
    refined_axes(axes, &before, &behind, &steps_s)
}

/// Whether it is clear which of the two ways the axis points in the second sensor.
fn points_clearly(whole: &Solved, axes: &HingeAxes, parent: usize, at: usize) -> bool {
    let [before, behind] = [(parent, axes.first), (at, axes.second)]
        .map(|(index, axis)| (index, whole.mounts[index].inverse() * axis));
    let (mut same, mut opposite) = (0.0, 0.0);
    for pose in &whole.poses {
        let [a, b] = [before, behind].map(|(index, axis)| (pose.orientations[index] * axis).z);
        same += (a - b).powi(2);
        opposite += (a + b).powi(2);
    }
    same < CLEAR * opposite
}

/// Whether a sensor turned about more than one axis.
fn rotates_about_two(epochs: &[Epoch], index: usize) -> bool {
    let gyros_rad_s = || epochs.iter().filter_map(|epoch| Some(epoch.samples[index]?.gyro_rad_s));
    let gyros_rad_s = || gyros_rad_s().filter(|w| w.iter().all(|value| value.is_finite()));
    let count = gyros_rad_s().count().max(1) as f64;
    let mean: Vector3<f64> = gyros_rad_s().sum::<Vector3<f64>>() / count;
    let spread: Matrix3<f64> = gyros_rad_s().map(|w| (w - mean) * (w - mean).transpose()).sum();
    let mut variances: Vec<f64> = spread.symmetric_eigenvalues().iter().copied().collect();
    variances.sort_by(f64::total_cmp);
    variances[1] > SECOND * SECOND * variances[2]
}

/// Half of how far the axes of both halves lie apart, degrees, in the sensor where that is more: about the error of the whole.
fn apart_deg([early, late]: &[[Vector3<f64>; 2]; 2]) -> f64 {
    let apart = early[0].angle(&late[0]).max(early[1].angle(&late[1]));
    (0.5 * apart.to_degrees()).min(UNKNOWN_DEG)
}
