//! A custom skeleton of hinges, solved without magnetometers and with the mounting found from the movement.
//!
//! In: the segments with their parents, and a recording of one IMU per segment. Out: per epoch the orientation of
//! every segment and the angle of every hinge. Offline: tilt, axes and headings are each found from the whole recording.
//!
//! Zero is the posture in which the recording begins (its first quarter of a second) and bending from there is positive; in that
//! posture all segment frames are parallel, x and z of the root level and z as near to its first hinge's axis as that allows.

mod calibrate;
mod guide;
mod joint;
mod live;
mod quality;
#[cfg(test)]
mod tests;

use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use calibrate::calibrate;
pub use guide::Guide;
pub use live::{CalibratedHinge, CalibratedSegment, ChainCalibration, LiveChain, LivePose};

use super::ahrs::{ImuSample, Params, smoothed};
use super::mounting::{HingeAxes, Refused, hinge_axes};
use posed_geometry::wrapped_rad;

/// How much of the beginning shows the zero, s.
const ZERO_S: f64 = 0.25;

/// A segment of the chain; the root has no hinge.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChainSegment {
    /// Its name.
    pub name: String,
    /// The hinge it hangs on: index of the parent segment, which comes earlier, and the joint's name.
    pub hinge: Option<(usize, String)>,
}

/// All segments' samples at one time; a missing one is `None`.
#[derive(Clone, Debug, PartialEq)]
pub struct Epoch {
    /// Time, s.
    pub t_s: f64,
    /// One per segment, in their order, sensor axes.
    pub samples: Vec<Option<ImuSample>>,
}

/// The chain at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct ChainPose {
    /// Time, s.
    pub t_s: f64,
    /// Segment to room (z up, yaw 0 at the start), one per segment, in their order.
    pub orientations: Vec<UnitQuaternion<f64>>,
    /// Flexion of the hinge above, rad from -pi to pi, one per segment; 0 for the root.
    pub flexion_rad: Vec<f64>,
    /// Its standard deviation, rad, one per segment; 0 for the root.
    pub sigma_rad: Vec<f64>,
}

/// Axes are used that are known to so much, degrees.
pub const GOOD_DEG: f64 = 5.0;
/// Sensors that play more than this against each other have no hinge between them, degrees.
pub const LOOSE_DEG: f64 = 10.0;

/// A solved chain; its accuracy is measured in `docs/body.md`, Chains of hinges.
#[derive(Clone, Debug, PartialEq)]
pub struct Solved {
    /// The hinge above each segment: its axis in the parent's (first) and the segment's own sensor (second); `None` for a
    /// root.
    pub axes: Vec<Option<HingeAxes>>,
    /// How well the recording shows the axes of the hinge above each segment, degrees: half of how far those of its two halves lie apart,
    /// and 90 where it fits several (`docs/methods/chain.md`); `None` for a root. Angles of a hinge above [`GOOD_DEG`] may be anything.
    pub quality_deg: Vec<Option<f64>>,
    /// How far the two sensors of the hinge above each segment play against each other about each direction, root mean square, degrees: soft
    /// tissue and straps, or above [`LOOSE_DEG`] a joint that is no hinge; `None` for a root.
    pub play_deg: Vec<Option<f64>>,
    /// How each sensor sits: segment to sensor, from the first posture.
    pub mounts: Vec<UnitQuaternion<f64>>,
    /// One per epoch.
    pub poses: Vec<ChainPose>,
}

/// Why a chain cannot be solved.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ChainError {
    /// A joint's axis does not show.
    #[error("joint `{joint}`: {reason}")]
    Joint {
        /// Its name.
        joint: String,
        /// What was missing.
        reason: Refused,
    },
    /// Times do not rise.
    #[error("the time does not rise after {t_s} s")]
    Time {
        /// Where.
        t_s: f64,
    },
}

/// Solves a recording offline, without magnetometers: each segment's orientation and each hinge's angle at every epoch.
/// Method: `docs/methods/chain.md`, begun as Seel et al. (2014). The joint's play and an axis that stays upright go into the
/// angles.
///
/// # Errors
/// [`ChainError::Joint`] where the movement does not show an axis, [`ChainError::Time`] where times do not rise.
///
/// # Panics
/// An epoch has fewer samples than there are segments, or a parent does not come before its child.
pub fn solve(segments: &[ChainSegment], epochs: &[Epoch]) -> Result<Solved, ChainError> {
    if let Some(pair) = epochs
        .windows(2)
        .find(|pair| pair[1].t_s.partial_cmp(&pair[0].t_s) != Some(std::cmp::Ordering::Greater))
    {
        return Err(ChainError::Time { t_s: pair[0].t_s });
    }
    let steps_s = steps_s(epochs);
    let level: Vec<Vec<UnitQuaternion<f64>>> =
        (0..segments.len()).map(|index| level_orientations(epochs, &steps_s, index)).collect();
    let mut axes = Vec::with_capacity(segments.len());
    let mut motions: Vec<Option<Motion>> = Vec::with_capacity(segments.len());
    for (index, segment) in segments.iter().enumerate() {
        let Some((parent, joint)) = &segment.hinge else {
            axes.push(None);
            motions.push(None);
            continue;
        };
        let shown = find_axes(epochs, *parent, index)
            .map_err(|reason| ChainError::Joint { joint: joint.clone(), reason })?;
        let (refined, motion) = refine(shown, &level[*parent], &level[index], &steps_s);
        axes.push(Some(refined));
        motions.push(Some(motion));
    }
    let (mounts, mut poses) = poses(segments, &axes, &motions, &level, epochs);
    // Bending is positive.
    for (index, axes) in axes.iter_mut().enumerate() {
        let Some(axes) = axes else { continue };
        if poses.iter().map(|pose| pose.flexion_rad[index]).sum::<f64>() < 0.0 {
            *axes = HingeAxes { first: -axes.first, second: -axes.second, ..*axes };
            poses.iter_mut().for_each(|pose| pose.flexion_rad[index] *= -1.0);
        }
    }
    let play_deg = |motion: &Motion| {
        let play_rad2 = &motion.joint.play_rad2;
        let mean_rad2 = play_rad2.iter().sum::<f64>() / play_rad2.len().max(1) as f64;
        mean_rad2.sqrt().to_degrees()
    };
    let play_deg = motions.iter().map(|motion| motion.as_ref().map(play_deg)).collect();
    let mut solved = Solved { axes, quality_deg: Vec::new(), play_deg, mounts, poses };
    solved.quality_deg = quality::quality_deg(segments, epochs, &solved);
    state_sigmas(segments, &motions, &mut solved);
    Ok(solved)
}

/// How far each angle may be off.
fn state_sigmas(segments: &[ChainSegment], motions: &[Option<Motion>], solved: &mut Solved) {
    for (k, pose) in solved.poses.iter_mut().enumerate() {
        let sigma_rad = |at: usize| {
            let ((parent, _), Motion { joint, .. }) =
                segments[at].hinge.as_ref().zip(motions[at].as_ref())?;
            let axis = solved.mounts[*parent].inverse() * solved.axes[at].as_ref()?.first;
            let quality_rad = solved.quality_deg[at]?.to_radians();
            let upright = (pose.orientations[*parent] * axis).z;
            Some(joint::sigma_rad(upright, joint.heading_rad2[k], quality_rad, joint.play_rad2[k]))
        };
        pose.sigma_rad = (0..segments.len()).map(|at| sigma_rad(at).unwrap_or(0.0)).collect();
    }
}

/// Time since the epoch before, s; the first as long as the mean.
fn steps_s(epochs: &[Epoch]) -> Vec<f64> {
    let nominal_s = match epochs {
        [first, .., last] => (last.t_s - first.t_s) / (epochs.len() - 1) as f64,
        _ => 0.01,
    };
    let rest = epochs.windows(2).map(|pair| pair[1].t_s - pair[0].t_s);
    std::iter::once(nominal_s).take(epochs.len()).chain(rest).collect()
}

/// One sensor's orientations in its level frame, each from the whole recording.
fn level_orientations(epochs: &[Epoch], steps_s: &[f64], index: usize) -> Vec<UnitQuaternion<f64>> {
    // The delay of the sensors' low-pass is not known here, and between equal sensors it cancels.
    let params = Params::instantaneous();
    let samples: Vec<_> =
        epochs.iter().map(|epoch| epoch.samples[index]).zip(steps_s.iter().copied()).collect();
    smoothed(&params, &samples)
}

/// One hinge over time.
struct Motion {
    /// Angle, rad; its zero depends on the mounting.
    angle_rad: Vec<f64>,
    joint: joint::Joint,
}

/// Improves the axes with the orientations, and returns the hinge's motion.
///
/// Rates show the axes only as well as skin and straps let them, whose quick play they feel most; in orientations that
/// play is small and its mean zero.
fn refine(
    axes: HingeAxes,
    before: &[UnitQuaternion<f64>],
    behind: &[UnitQuaternion<f64>],
    steps_s: &[f64],
) -> (HingeAxes, Motion) {
    let joint = joint::solve([axes.first, axes.second], before, behind, steps_s);
    let angles = before.iter().zip(behind).zip(&joint.heading_rad);
    let angle_rad = angles.map(|((a, b), heading)| joint::angle_rad(&joint.axes, *heading, a, b)).collect();
    let [first, second] = joint.axes;
    (HingeAxes { first, second, ..axes }, Motion { angle_rad, joint })
}

fn find_axes(epochs: &[Epoch], parent: usize, child: usize) -> Result<HingeAxes, Refused> {
    let pairs: Vec<_> = epochs
        .iter()
        .filter_map(|epoch| {
            let (a, b) = (epoch.samples[parent]?, epoch.samples[child]?);
            Some(([a.gyro_rad_s, b.gyro_rad_s], [a.accel_m_s2, b.accel_m_s2]))
        })
        .filter(|(w, a)| w.iter().chain(a).all(|v| v.iter().all(|v| v.is_finite())))
        .collect();
    hinge_axes(&pairs)
}

/// The axes of a hinge, improved with the orientations of the sensors beside it; first and second sensor.
pub(super) fn refined_axes(
    axes: &HingeAxes,
    before: &[UnitQuaternion<f64>],
    behind: &[UnitQuaternion<f64>],
    steps_s: &[f64],
) -> [Vector3<f64>; 2] {
    joint::solve([axes.first, axes.second], before, behind, steps_s).axes
}

/// How the sensors sit; segment orientations in the room and flexions, with zero and sign as the module says.
fn poses(
    segments: &[ChainSegment],
    axes: &[Option<HingeAxes>],
    motions: &[Option<Motion>],
    level: &[Vec<UnitQuaternion<f64>>],
    epochs: &[Epoch],
) -> (Vec<UnitQuaternion<f64>>, Vec<ChainPose>) {
    let Some(start_s) = epochs.first().map(|epoch| epoch.t_s) else { return Default::default() };
    let begin = epochs.iter().take_while(|epoch| epoch.t_s - start_s <= ZERO_S).count();
    // About the first angle, so that no average is taken across the wrap.
    let zero = |angles: &[f64]| {
        angles[0] + angles[..begin].iter().map(|a| wrapped_rad(a - angles[0])).sum::<f64>() / begin as f64
    };
    let zeros: Vec<f64> =
        motions.iter().map(|motion| motion.as_ref().map_or(0.0, |motion| zero(&motion.angle_rad))).collect();
    // Sensor to room: each level frame turned into the root's.
    let sensors = |k: usize| {
        let mut headings: Vec<f64> = Vec::with_capacity(segments.len());
        for (segment, motion) in segments.iter().zip(motions) {
            headings.push(match (&segment.hinge, motion) {
                (Some((parent, _)), Some(motion)) => headings[*parent] + motion.joint.heading_rad[k],
                _ => 0.0,
            });
        }
        headings
            .into_iter()
            .zip(level)
            .map(|(heading, q)| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading) * q[k])
            .collect::<Vec<_>>()
    };
    let start = sensors(0);
    let root = root_frame(segments, axes, &start);
    let mounts: Vec<_> = start.iter().map(|q| q.inverse() * root).collect();
    let pose = |k: usize| ChainPose {
        t_s: epochs[k].t_s,
        orientations: sensors(k).iter().zip(&mounts).map(|(q, mount)| q * mount).collect(),
        flexion_rad: motions
            .iter()
            .zip(&zeros)
            .map(|(motion, zero)| {
                motion.as_ref().map_or(0.0, |motion| wrapped_rad(motion.angle_rad[k] - zero))
            })
            .collect(),
        sigma_rad: Vec::new(),
    };
    let poses = (0..epochs.len()).map(pose).collect();
    (mounts, poses)
}

/// The common segment frame in the first posture: y up, z the level part of the first hinge's axis.
fn root_frame(
    segments: &[ChainSegment],
    axes: &[Option<HingeAxes>],
    start: &[UnitQuaternion<f64>],
) -> UnitQuaternion<f64> {
    let axis = axes.iter().zip(segments).find_map(|(axes, segment)| {
        let (parent, _) = segment.hinge.as_ref()?;
        Some(start[*parent] * axes.as_ref()?.first)
    });
    let z = axis.map_or(Vector3::x(), |axis| Vector3::new(axis.x, axis.y, 0.0));
    let z = z.try_normalize(0.1).unwrap_or_else(Vector3::x);
    let y = Vector3::z();
    UnitQuaternion::from_basis_unchecked(&[y.cross(&z), y, z])
}
