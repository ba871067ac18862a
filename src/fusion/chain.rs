//! A custom skeleton of hinges, solved without magnetometers and with the mounting found from the movement.
//!
//! In: the segments with their parents, and a recording of one IMU per segment. Out: per epoch the orientation of
//! every segment and the angle of every hinge. Offline in one respect only: the axes are found from the whole movement
//! first; the filters then run forward and never look ahead.
//!
//! Zero is the posture in which the recording begins (its first quarter of a second) and bending from there is positive; in that
//! posture all segment frames are parallel, x and z of the root level and z as near to its first hinge's axis as that allows.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::ahrs::{Ahrs, ImuSample, Params};
use super::hinge::{Hinge, HingeParams, wrap};
use super::mounting::{HingeAxes, Refused, hinge_axes};

/// How much of the beginning shows the zero, s.
const ZERO_S: f64 = 0.25;
/// How often axes and headings are improved in turn.
const ROUNDS: usize = 8;

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
    /// One per segment.
    pub samples: Vec<Option<ImuSample>>,
}

/// The chain at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct ChainPose {
    /// Time, s.
    pub t_s: f64,
    /// Segment to room (z up, yaw 0 at the start), one per segment.
    pub orientations: Vec<UnitQuaternion<f64>>,
    /// Flexion, rad, one per segment; 0 for the root.
    pub flexion_rad: Vec<f64>,
}

/// A solved chain.
#[derive(Clone, Debug, PartialEq)]
pub struct Solved {
    /// The hinge above each segment: its axis in the parent's and the segment's own sensor.
    pub axes: Vec<Option<HingeAxes>>,
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

/// Solves a recording.
///
/// # Errors
/// A joint whose axis the movement does not show, or times that do not rise.
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
    let mut poses = poses(segments, &axes, &motions, &level, epochs);
    // Bending is positive.
    for (index, axes) in axes.iter_mut().enumerate() {
        let Some(axes) = axes else { continue };
        if poses.iter().map(|pose| pose.flexion_rad[index]).sum::<f64>() < 0.0 {
            *axes = HingeAxes { first: -axes.first, second: -axes.second, ..*axes };
            poses.iter_mut().for_each(|pose| pose.flexion_rad[index] *= -1.0);
        }
    }
    Ok(Solved { axes, poses })
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

/// One sensor's orientations in its level frame, twice over the recording: the second run begins with the gyro bias
/// and the tilt that the first one found.
fn level_orientations(epochs: &[Epoch], steps_s: &[f64], index: usize) -> Vec<UnitQuaternion<f64>> {
    // The delay of the sensors' low-pass is not known here, and between equal sensors it cancels.
    let params = Params { gyro_delay_s: 0.0, ..Params::default() };
    let mut filter = Ahrs::new(params);
    let run = |filter: &mut Ahrs| -> Vec<UnitQuaternion<f64>> {
        let push = |(epoch, dt_s): (&Epoch, &f64)| {
            match epoch.samples[index] {
                Some(sample) => _ = filter.push(&ImuSample { mag: None, ..sample }, *dt_s),
                None => filter.coast(*dt_s),
            }
            filter.orientation_6d()
        };
        epochs.iter().zip(steps_s).map(push).collect()
    };
    run(&mut filter);
    filter.restart();
    run(&mut filter)
}

/// Angle and heading over time of one hinge.
struct Motion {
    /// Angle, rad; its zero depends on the mounting.
    angle_rad: Vec<f64>,
    /// Turn of the level frame behind the hinge into the one before it, rad.
    heading_rad: Vec<f64>,
}

/// Improves the axes with the orientations, and returns the hinge's motion.
///
/// Rates show the axes only as well as skin and straps let them, whose quick play they feel most. The axis as seen
/// from both sensors points the same way in the room, `R1 j1 = H R2 j2` with H the heading between
/// the level frames: the pair that agrees best over the whole movement is the first pair of singular vectors of the sum of
/// `R1' H R2`, and in orientations that play is small and its mean zero.
fn refine(
    mut axes: HingeAxes,
    before: &[UnitQuaternion<f64>],
    behind: &[UnitQuaternion<f64>],
    steps_s: &[f64],
) -> (HingeAxes, Motion) {
    let hinge = |axes: &HingeAxes| Hinge::new(HingeParams::default(), [axes.first, axes.second]);
    let smooth = |axes: &HingeAxes| {
        let steps = before.iter().zip(behind).zip(steps_s).map(|((a, b), dt_s)| (*a, *b, *dt_s));
        hinge(axes).smooth(steps)
    };
    let mut heading_rad = smooth(&axes);
    for _ in 0..ROUNDS {
        let mut sum = Matrix3::zeros();
        let mut last: Option<UnitQuaternion<f64>> = None;
        for ((a, b), heading) in before.iter().zip(behind).zip(&heading_rad) {
            let relative = a.inverse() * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), *heading) * b;
            // By how far the joint moved: a pause says no more than a moment.
            let weight = last.map_or(0.0, |last| last.angle_to(&relative));
            sum += relative.to_rotation_matrix().into_inner() * weight;
            last = Some(relative);
        }
        let svd = sum.svd(true, true);
        let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { break };
        let (first, second): (Vector3<f64>, Vector3<f64>) = (u.column(0).into(), v_t.row(0).transpose());
        let sign = first.dot(&axes.first).signum();
        let (first, second) = (first * sign, second * sign);
        let moved = first.angle(&axes.first).max(second.angle(&axes.second));
        axes = HingeAxes { first, second, ..axes };
        heading_rad = smooth(&axes);
        if moved < 1e-4 {
            break;
        }
    }
    let hinge = hinge(&axes);
    let angles = before.iter().zip(behind).zip(&heading_rad);
    let angle_rad = angles.map(|((a, b), heading)| hinge.angle_at_rad(*heading, a, b)).collect();
    (axes, Motion { angle_rad, heading_rad })
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
    axes: HingeAxes,
    before: &[UnitQuaternion<f64>],
    behind: &[UnitQuaternion<f64>],
    steps_s: &[f64],
) -> [Vector3<f64>; 2] {
    let (axes, _) = refine(axes, before, behind, steps_s);
    [axes.first, axes.second]
}

/// Segment orientations in the room and flexions, with zero and sign as the module says.
fn poses(
    segments: &[ChainSegment],
    axes: &[Option<HingeAxes>],
    motions: &[Option<Motion>],
    level: &[Vec<UnitQuaternion<f64>>],
    epochs: &[Epoch],
) -> Vec<ChainPose> {
    let Some(start_s) = epochs.first().map(|epoch| epoch.t_s) else { return Vec::new() };
    let begin = epochs.iter().take_while(|epoch| epoch.t_s - start_s <= ZERO_S).count();
    // About the first angle, so that no average is taken across the wrap.
    let zero = |angles: &[f64]| {
        angles[0] + angles[..begin].iter().map(|a| wrap(a - angles[0])).sum::<f64>() / begin as f64
    };
    let zeros: Vec<f64> =
        motions.iter().map(|motion| motion.as_ref().map_or(0.0, |motion| zero(&motion.angle_rad))).collect();
    // Sensor to room: each level frame turned into the root's.
    let sensors = |k: usize| {
        let mut headings: Vec<f64> = Vec::with_capacity(segments.len());
        for (segment, motion) in segments.iter().zip(motions) {
            headings.push(match (&segment.hinge, motion) {
                (Some((parent, _)), Some(motion)) => headings[*parent] + motion.heading_rad[k],
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
            .map(|(motion, zero)| motion.as_ref().map_or(0.0, |motion| wrap(motion.angle_rad[k] - zero)))
            .collect(),
    };
    (0..epochs.len()).map(pose).collect()
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::so3;

    const RATE_HZ: f64 = 100.0;

    /// Three segments on two parallel hinges, sensors askew, gyros biased, no magnetometer.
    fn recording() -> (Vec<ChainSegment>, Vec<Epoch>, Vec<[f64; 2]>) {
        recording_held(&UnitQuaternion::identity())
    }

    /// The same, held turned in the room.
    fn recording_held(held: &UnitQuaternion<f64>) -> (Vec<ChainSegment>, Vec<Epoch>, Vec<[f64; 2]>) {
        let mounts = [
            so3::exp(&Vector3::new(0.4, -0.9, 0.3)),
            so3::exp(&Vector3::new(-1.2, 0.5, 2.0)),
            so3::exp(&Vector3::new(1.9, 0.2, -0.7)),
        ];
        let levers =
            [Vector3::new(0.0, 0.2, 0.03), Vector3::new(0.02, -0.15, 0.0), Vector3::new(0.0, -0.2, 0.0)];
        let angles = |t: f64| {
            let grow = (t / 4.0).min(1.0);
            [grow * (0.7 - 0.7 * (1.3 * t).cos()), grow * (0.6 - 0.6 * (1.9 * t).cos())]
        };
        let poses = |t: f64| {
            let grow = (t / 4.0).min(1.0);
            let upright = so3::exp(&(Vector3::x() * std::f64::consts::FRAC_PI_2));
            let whole = so3::exp(
                &(Vector3::new((0.9 * t).sin(), 0.6 * (0.7 * t).sin(), 0.8 * (1.1 * t).sin()) * grow),
            ) * held
                * upright;
            let [a, b] = angles(t);
            let second = whole * so3::exp(&(Vector3::z() * a));
            let third = second * so3::exp(&(Vector3::z() * b));
            let knee = Vector3::new(0.2 * (1.7 * t).sin(), 0.2 * (1.3 * t).cos(), 1.0) * grow;
            let ankle = knee + second * Vector3::new(0.0, -0.4, 0.0);
            [
                (whole, knee + whole * levers[0]),
                (second, knee + second * levers[1]),
                (third, ankle + third * levers[2]),
            ]
        };
        let segments = vec![
            ChainSegment { name: "a".into(), hinge: None },
            ChainSegment { name: "b".into(), hinge: Some((0, "one".into())) },
            ChainSegment { name: "c".into(), hinge: Some((1, "two".into())) },
        ];
        let h = 1e-3;
        let (mut epochs, mut truth) = (Vec::new(), Vec::new());
        for k in 0..(60.0 * RATE_HZ) as usize {
            let t = k as f64 / RATE_HZ;
            let (before, now, after) = (poses(t - h), poses(t), poses(t + h));
            let samples = (0..3)
                .map(|i| {
                    let rate = so3::log(&(before[i].0.inverse() * after[i].0)) / (2.0 * h);
                    let accel = (after[i].1 + before[i].1 - now[i].1 * 2.0) / (h * h) + Vector3::z() * 9.81;
                    Some(ImuSample {
                        gyro_rad_s: mounts[i].inverse() * rate + Vector3::new(0.004, -0.003, 0.005),
                        accel_m_s2: mounts[i].inverse() * (now[i].0.inverse() * accel),
                        mag: None,
                    })
                })
                .collect();
            epochs.push(Epoch { t_s: t, samples });
            truth.push(angles(t));
        }
        (segments, epochs, truth)
    }

    #[test]
    fn a_chain_is_solved_from_its_movement_alone() {
        let (segments, epochs, truth) = recording();
        let solved = solve(&segments, &epochs).unwrap();
        for joint in 0..2 {
            let sum: f64 = solved
                .poses
                .iter()
                .zip(&truth)
                .map(|(pose, truth)| (pose.flexion_rad[joint + 1] - truth[joint]).powi(2))
                .sum();
            let rms = (sum / truth.len() as f64).sqrt().to_degrees();
            assert!(rms < 1.5, "joint {joint}: {rms} degrees");
        }
    }

    /// A hinge that stands upright for the first seconds says nothing of the heading between its sensors meanwhile.
    #[test]
    fn an_axis_that_stands_upright_at_first_is_solved_from_the_first_sample() {
        let turn = so3::exp(&(Vector3::x() * -std::f64::consts::FRAC_PI_2));
        let (segments, epochs, truth) = recording_held(&turn);
        let solved = solve(&segments, &epochs).unwrap();
        for (k, (pose, truth)) in solved.poses.iter().zip(&truth).enumerate() {
            let off = (pose.flexion_rad[1] - truth[0]).to_degrees();
            assert!(off.abs() < 6.0, "{off} degrees off at epoch {k}");
        }
    }

    /// Sensors in foam: they play by some degrees at 8 Hz, which their rates feel ten times as much as their orientations.
    #[test]
    fn soft_straps_do_not_spoil_the_axis() {
        let (segments, mut epochs, truth) = recording();
        for (k, epoch) in epochs.iter_mut().enumerate() {
            let phase = std::f64::consts::TAU * 8.0 * k as f64 / RATE_HZ;
            for (i, sample) in epoch.samples.iter_mut().flatten().enumerate() {
                let axis = Vector3::new((i as f64).cos(), 0.7, (i as f64).sin()).normalize();
                sample.gyro_rad_s += axis * (1.5 * (phase + i as f64).sin());
            }
        }
        let solved = solve(&segments, &epochs).unwrap();
        for joint in 0..2 {
            let squares = solved.poses.iter().zip(&truth);
            let sum: f64 =
                squares.map(|(pose, truth)| (pose.flexion_rad[joint + 1] - truth[joint]).powi(2)).sum();
            let rms = (sum / truth.len() as f64).sqrt().to_degrees();
            assert!(rms < 3.5, "joint {joint}: {rms} degrees");
        }
    }

    #[test]
    fn missing_samples_are_bridged() {
        let (segments, mut epochs, truth) = recording();
        for (k, epoch) in epochs.iter_mut().enumerate() {
            if k % 7 == 3 {
                epoch.samples[1] = None;
            }
        }
        let solved = solve(&segments, &epochs).unwrap();
        let worst = solved
            .poses
            .iter()
            .zip(&truth)
            .map(|(pose, truth)| (pose.flexion_rad[1] - truth[0]).abs().to_degrees())
            .fold(0.0, f64::max);
        assert!(worst < 6.0, "{worst} degrees");
    }

    #[test]
    fn a_chain_that_does_not_move_names_the_joint() {
        let (segments, mut epochs, _) = recording();
        let still = epochs[0].clone();
        for epoch in &mut epochs {
            epoch.samples.clone_from(&still.samples);
        }
        let error = solve(&segments, &epochs).unwrap_err();
        assert!(error.to_string().starts_with("joint `one`: the movement shows too little"), "{error}");
    }

    #[test]
    fn times_must_rise() {
        let (segments, mut epochs, _) = recording();
        epochs[10].t_s = epochs[9].t_s;
        assert!(matches!(solve(&segments, &epochs), Err(ChainError::Time { .. })));
    }
}
