//! How well a recording shows the axes of its hinges.
//!
//! In: a chain that was solved, and its recording. Out: per hinge half of how far the axes of the recording's two halves lie apart, or
//! that it fits several axes.

use nalgebra::{Matrix3, Vector3};

use super::{ChainSegment, Epoch, HingeAxes, Solved, level_orientations, refined_axes, steps_s};

/// What a movement does not show at all, degrees.
pub(super) const UNKNOWN_DEG: f64 = 90.0;
/// The axis' height in the room, squared, has to differ so much less between its two sensors than between one and the opposite of
/// the other: an axis that stays level throughout may point either way.
const CLEAR: f64 = 0.1;

/// Angular velocities about a second axis are at least this part of those about the first (standard deviations), in both
/// sensors: where both turn about the hinge alone, and in step, axes that are wrong together explain the movement as well.
const SECOND: f64 = 0.1;

/// Of each segment's hinge, degrees; `None` where it has none.
pub(super) fn quality_deg(segments: &[ChainSegment], epochs: &[Epoch], solved: &Solved) -> Vec<Option<f64>> {
    let halves = epochs.split_at(epochs.len() / 2);
    let of = |(at, segment): (usize, &ChainSegment)| {
        let ((parent, _), axes) = segment.hinge.as_ref().zip(solved.axes[at])?;
        let is_shown = points_clearly(solved, &axes, *parent, at)
            && [*parent, at].into_iter().all(|index| rotates_about_two(epochs, index));
        let halves = || [halves.0, halves.1].map(|half| axes_in(half, &axes, *parent, at));
        Some(if is_shown { apart_deg(&halves()) } else { UNKNOWN_DEG })
    };
    segments.iter().enumerate().map(of).collect()
}

/// The axes by a part of the movement alone, in both sensors.
fn axes_in(epochs: &[Epoch], axes: &HingeAxes, parent: usize, at: usize) -> [Vector3<f64>; 2] {
    let steps_s = steps_s(epochs);
    let [before, behind] = [parent, at].map(|index| level_orientations(epochs, &steps_s, index));
    refined_axes(axes, &before, &behind, &steps_s)
}

/// Whether it is clear which of the two ways the axis points in the second sensor.
fn points_clearly(solved: &Solved, axes: &HingeAxes, parent: usize, at: usize) -> bool {
    let [before, behind] = [(parent, axes.first), (at, axes.second)]
        .map(|(index, axis)| (index, solved.mounts[index].inverse() * axis));
    let (mut same, mut opposite) = (0.0, 0.0);
    for pose in &solved.poses {
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
